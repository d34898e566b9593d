//! Formulas over lists of numbers.

mod image;
mod quantile;

pub use image::psnr;
pub use quantile::{median, quantile};
