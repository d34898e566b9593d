//! Metrics of image quality, and of how well an uncertainty ranks an error.

#[cfg(feature = "evaluate")]
mod calibration;
mod conformal;
#[cfg(feature = "evaluate")]
mod density;
mod detection;
mod ensemble;
mod image;
mod rank;
mod sparsification;
mod ssim;

#[cfg(feature = "evaluate")]
pub use calibration::{Calibration, DensityCalibration, PROBABILITIES};
pub use conformal::conformal_factor;
#[cfg(feature = "evaluate")]
pub use density::ErrorDensity;
pub use detection::Detection;
pub use ensemble::ensemble_variance;
pub use image::psnr;
pub use rank::{median, quantile, spearman};
pub use sparsification::{ErrorKind, STEPS, Sparsification, sparsification};
pub use ssim::ssim;
