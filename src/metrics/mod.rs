//! Metrics of image quality, and of how well an uncertainty ranks an error.

mod calibration;
mod conformal;
mod density;
mod detection;
mod ensemble;
mod image;
mod perceptual;
mod rank;
mod sparsification;
mod ssim;

pub use calibration::{Calibration, DensityCalibration, PROBABILITIES};
pub use conformal::conformal_factor;
pub use density::ErrorDensity;
pub use detection::Detection;
pub use ensemble::{density_aware, ensemble_variance};
pub use image::psnr;
pub use perceptual::ssimulacra2;
pub use rank::{percentiles, quantile, spearman};
pub use sparsification::{ErrorKind, STEPS, Sparsification, sparsification};
pub use ssim::ssim;
