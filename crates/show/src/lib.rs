//! What people look at: files for other tools ([`export`]), pictures ([`picture`]), and pages for a browser
//! ([`viewer`]).

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

pub mod export;
pub mod picture;
pub mod viewer;
