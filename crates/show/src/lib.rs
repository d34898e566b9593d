//! What people look at: files for other tools ([`export`]), pictures ([`picture`]), and pages for a browser
//! ([`viewer`], [`comparison`], [`depth_page`], [`plan_page`]).
//!
//! # Example
//! ```
//! use octobayes::estimate::{Estimation, GridSettings, RaySettings};
//! use octobayes::field::ClosedForm;
//! use octobayes_show::export::write_leaves;
//!
//! let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(4, [32, 32]));
//! let rays = RaySettings::default().rays(2000).occupancy(32);
//! let field = Estimation::new(&scene, &cameras).rays(rays).grid(GridSettings::default().level(4)).run()?.field;
//! let folder = tempfile::tempdir()?;
//! // For NumPy: centres, edges and U of all leaves.
//! write_leaves(&folder.path().join("leaves.npz"), &field, None)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

pub mod comparison;
pub mod depth_page;
pub mod export;
pub mod picture;
pub mod plan_page;
pub mod viewer;
