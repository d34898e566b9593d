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
pub use camera::Camera;
pub use distortion::Distortion;
pub use domain::{Domain, Norm};
pub use lattice::{Lattice, MAX_LEVEL};
#[doc(hidden)]
pub use mask::check_sizes;
pub use mask::{Mask, kept_pixels};
pub use named::NamedCamera;
pub use poses::{inverted, opencv};
pub use ray::Ray;
pub use upright::upright;

// What only our own crates name.
#[doc(hidden)]
pub use {
    camera::{MAX_PIXELS, MAX_REACH, MAX_SIDE, MAX_SKEW, skew},
    mask::{covered, nearest},
};
