//! Files: this crate's own container, sorted runs, and writing without half-written results.
//!
//! Readers treat every file as untrusted: they check sizes against the bytes present before they allocate
//! anything.

mod atomic;
mod cell;
pub mod container;
pub mod memory;
mod mix;
pub mod place;
pub mod sorted;
mod source;
mod whole;

pub use atomic::{AtomicFile, beside, remove_leftovers};
pub use cell::cell;
pub use mix::{evenly, mix};
pub use source::{open, refuse_pipe};
pub use whole::{read, read_text, text_of};
