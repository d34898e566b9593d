//! Metrics of image quality, and of how well an uncertainty ranks an error.

mod calibration;
mod conformal;
mod detection;
mod ensemble;
pub mod normal;
mod rank;
mod sparsification;
mod ssim;

pub use calibration::{Calibration, PROBABILITIES};
pub use conformal::conformal_factor;
pub use detection::Detection;
pub use ensemble::ensemble_variance;
pub use rank::spearman;
pub use sparsification::{ErrorKind, STEPS, Sparsification, sparsification};
pub use ssim::ssim;
