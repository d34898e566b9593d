//! Fits Gaussian splats to posed images.
//!
//! One step draws one training image (Kerbl et al. 2023): ellipses on the image, tile by tile and front to back, the
//! mean absolute error, and its derivatives by the chain rule back to centres, deviations, rotations, opacities and
//! colours, which Adam moves. Splats begin near the surface of the visual hull, at COLMAP's points, or anywhere in the
//! box, and become more where images ask for it. [`octobayes_splats`]' renderer projects splats; compositing is f32
//! code of its own, which takes eight pixels at a time. Nothing depends on the number of threads.

mod cloud;
mod growth;
mod loss;
mod picture;
mod project;
mod raster;
mod refit;
mod start;
mod state;
#[cfg(test)]
mod tests;
mod trainer;

pub use refit::{Refitted, check_mode, refit};
pub use start::{SplatOrigin, box_of_points};
pub use trainer::SplatTrainer;

use serde::{Deserialize, Serialize};

use super::{Background, Shot};

octobayes::setters! {
    /// Settings of a run that trains splats.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub struct SplatSettings {
        /// Seed of first places, order of images, backgrounds and growth.
        pub seed: u64,
        /// Background of the scene.
        pub background: Background,
        /// Most splats.
        pub most: usize,
        /// Adam's first rates.
        pub rates: Rates,
    }
}

/// First rates of Adam for each kind of parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Of centres, in half edges of what the first splats fill; a hundredth is left at the end.
    pub mean: f32,
    /// Of the logarithms of deviations; a fifth is left at the end.
    pub scale: f32,
    /// Of rotations.
    pub rotation: f32,
    /// Of the logits of opacities.
    pub opacity: f32,
    /// Of colours; a twentieth of it for what depends on the direction.
    pub color: f32,
}

impl Default for SplatSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            background: Background::Random,
            most: 15_000,
            rates: Rates { mean: 1.6e-3, scale: 0.01, rotation: 3e-3, opacity: 0.05, color: 0.01 },
        }
    }
}

impl SplatSettings {
    /// Three splats for eight pixels of the largest image: 15,000 at 200 × 200. More would share pixels, fewer would
    /// blur them.
    #[must_use]
    pub fn most_for(shots: &[Shot]) -> usize {
        let pixels = shots.iter().map(|shot| shot.camera.pixels()).max().unwrap_or(0);
        (3 * pixels as usize / 8).clamp(1000, 1_000_000)
    }
}
