//! How good an image is, and how well an uncertainty ranks an error.

mod image;
mod sparsification;

pub use image::psnr;
pub use sparsification::{ErrorKind, STEPS, Sparsification, sparsification};
