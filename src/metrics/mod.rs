//! Metrics of image quality, and of how well an uncertainty ranks an error.

mod calibration;
mod ensemble;
mod image;
mod perceptual;
mod rank;
mod sparsification;
mod ssim;

pub use calibration::{Calibration, ErrorDensity, PROBABILITIES};
pub use ensemble::{density_aware, ensemble_variance};
pub use image::psnr;
pub use perceptual::ssimulacra2;
pub use rank::{percentiles, quantile};
pub use sparsification::{ErrorKind, STEPS, Sparsification, sparsification};
pub use ssim::ssim;
