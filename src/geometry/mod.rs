//! Boxes, contracted domains, rays, pinhole cameras, and the lattice over the unit cube.
//!
//! Positions handed to fields are `f32` in scene units, because fields are trained in it. Rays, cameras and
//! the map to the lattice are `f64`: a lattice coordinate at level 16 needs more than 24 bits.

mod aabb;
mod camera;
mod distortion;
mod domain;
mod lattice;
mod mask;
mod named;
mod poses;
mod ray;
mod upright;

pub use aabb::Aabb;
#[cfg(feature = "files")]
pub(crate) use aabb::NGP_SCALE;
pub use camera::Camera;
#[doc(hidden)]
pub use camera::MAX_PIXELS;
#[cfg(feature = "files")]
pub(crate) use camera::{MAX_REACH, MAX_SIDE, MAX_SKEW, skew};
pub use distortion::Distortion;
pub use domain::{Domain, Norm};
pub use lattice::{Lattice, MAX_LEVEL};
pub use mask::{Mask, kept_pixels};
#[cfg(feature = "files")]
pub(crate) use mask::{covered, nearest};
pub use named::NamedCamera;
pub use poses::{inverted, opencv};
pub use ray::Ray;
pub use upright::upright;
