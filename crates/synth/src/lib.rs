//! Exact synthetic datasets: posed images and depth, ray-traced from a triangle mesh on a textured
//! disc under sun and sky.
//!
//! Cameras are exact, and so is coverage up to sampling. Depth is computed in f64, without gaps between triangles,
//! and stored as f32. Radiance is a fixed function of position: a point has the same colour from anywhere. The
//! scene lies in the box [−1, 1]³ with z up; front is −y, right is +x.
//!
//! In the order in which data flows: [`Mesh`] is read and placed. [`MeshScene`] intersects rays. Sun, sky
//! and ground give hits a colour. [`viewpoints()`] places cameras. [`write_dataset`] writes pictures and depth to a
//! folder.
//!
//! # Example
//! ```
//! use glam::DVec3;
//! use octobayes::geometry::Ray;
//! use octobayes_synth::{Mesh, MeshScene, Up};
//!
//! // A tetrahedron, placed on the ground in the middle of the scene.
//! let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
//! let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
//! let mesh = Mesh::new(corners, faces).map_err(|(expected, found)| format!("expected {expected}, found {found}"))?;
//! let scene = MeshScene::new(mesh.placed(Up::Z).0);
//! let down = Ray { origin: DVec3::new(0.0, 0.0, 3.0), direction: -DVec3::Z };
//! let hit = scene.nearest(&down).ok_or("nothing is hit")?;
//! assert!(hit.t < 3.0 + 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod mesh;
mod shade;
mod staged;
#[cfg(test)]
mod testing;
mod texture;
mod trace;
mod triangle;
mod view;
mod viewpoints;
mod write;

pub use mesh::{HALF_HEIGHT, Mesh, Placement, RADIUS, Up};
pub use shade::LitScene;
pub use texture::Texture;
pub use trace::{GROUND_RADIUS, Hit, MeshScene, Surface};
pub use viewpoints::{ANGLE, DISTANCE, TARGET, viewpoints};
pub use write::{DEPTH_PNG_SCALE, DatasetSettings, write_dataset};
