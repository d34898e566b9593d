//! Trained volumes of other programs, and [`open()`], which opens any model by its name.
//!
//! Each kind is a [`TrainedField`](octobayes::field::TrainedField):
//! - [`HashGrid`]: a multiresolution hash grid with two tiny networks, as `octobayes train` fits it (instant-ngp's
//!   design);
//! - [`NerfMlp`]: the multilayer perceptron of the first NeRF, as nerf-pytorch saves it;
//! - [`Ppng`]: a Plenoptic PNG, in one of two [`Coordinates`];
//! - voxel grids from `.npz` ([`read_voxel_grid`]), whose field is in the library.
//!
//! # Example
//! ```
//! use glam::Vec3;
//! use octobayes::field::{ClosedForm, VoxelGrid};
//! use octobayes_models::{open, write_voxel_grid};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("ball.npz");
//! write_voxel_grid(&VoxelGrid::bake(&ClosedForm::ball(), [9; 3], Vec3::Z), &path)?;
//! let model = open(path.to_str().unwrap(), None)?;
//! assert_eq!(model.describe(), "voxel grid of 9 x 9 x 9 points");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

#[doc(hidden)]
pub mod elementary;
#[doc(hidden)]
pub mod hash_grid;
mod mlp;
mod open;
mod ppng;
mod voxels;
mod window;

pub use hash_grid::{HashGrid, HashGridConfig};
pub use mlp::NerfMlp;
pub use open::{checksum, has_coordinates, is_of_splats, open, open_model, refuse_model, volume};
pub use ppng::{Coordinates, Ppng};
pub use voxels::{read_voxel_grid, write_voxel_grid};
