//! Exact synthetic datasets: a triangle mesh on a textured disc, under a sun and a sky, ray-traced to posed images and depth.
//!
//! What is exact: cameras, coverage up to sampling, and depth, which is computed in f64 without gaps between triangles and
//! stored as f32. Radiance is a fixed function of position: seen from anywhere, a point has one colour. The scene lies in
//! the box [−1, 1]³ with z up; front is −y, right is +x.
//!
//! In the order in which data flows: [`Mesh`] is read and placed, [`Scene`] answers rays, [`LitScene`] gives hits a colour,
//! [`viewpoints()`] places cameras, [`trace_view`] makes a picture, [`write_dataset`] does all of it into a folder.

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
pub use trace::{GROUND_RADIUS, Hit, Scene, Surface};
pub use triangle::{Crossing, ShearedRay};
pub use view::{PixelSampling, TracedView, trace_view};
pub use viewpoints::{ANGLE, DISTANCE, TARGET, viewpoints};
pub use write::{DEPTH_PNG_SCALE, DatasetSettings, write_dataset};
