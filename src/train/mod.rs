//! Fits a [`HashGrid`](crate::field::HashGrid), or [Gaussian splats](SplatTrainer), to posed images.
//!
//! One step of a hash grid draws rays from all training images, samples them where the occupancy grid is occupied,
//! composites, and moves the parameters against the gradient of the loss (Adam). The backward pass is derived by hand.
//! The number of rays per step adapts to keep the number of samples near a budget, as in instant-ngp. Nothing depends
//! on the number of threads.

mod adam;
mod batch;
mod loss;
mod march;
mod occupancy;
mod pixel_gradient;
mod quality;
mod run;
mod splats;
mod state;
mod tape;
mod trainer;
mod views;

pub use crate::dataset::Selection;
// For the experiment that compares measures with the gradients of all parameters.
#[doc(hidden)]
pub use pixel_gradient::{PixelGradient, PixelGradients};
pub use quality::{Quality, one_color, quality, quality_within};
pub use run::{Budget, Description, Finished, Progress, Run, StateFile, Training};
pub use splats::{Rates, SplatOrigin, SplatSettings, SplatTrainer, box_of_points};
pub use trainer::{StepReport, Trainer};
pub use views::{DatasetFiles, Shot};

use serde::{Deserialize, Serialize};

use crate::field::HashGridConfig;

/// Background of the scene during training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// Another colour for every ray, where images are transparent. Empty space must become transparent to match.
    Random,
    /// A fixed colour, which opaque images show too.
    Fixed([f32; 3]),
}

setters! {
    /// Settings of a training run.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub struct TrainSettings {
        /// Size of the field.
        pub config: HashGridConfig,
        /// Seed of weights, rays and backgrounds.
        pub seed: u64,
        /// Background of the scene.
        pub background: Background,
        /// Approximate number of samples per step; the number of rays follows from it.
        pub samples_per_step: u64,
        /// Initial learning rate of Adam.
        pub learning_rate: f32,
        /// Share of the learning rate that is left at the end. The rate decays exponentially.
        pub final_rate: f32,
        /// Factor of the distortion loss; 0 for none.
        pub distortion: f32,
    }
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            config: HashGridConfig::default(),
            seed: 0,
            background: Background::Random,
            samples_per_step: 1 << 14,
            learning_rate: 2e-2,
            final_rate: 0.03,
            distortion: 0.0,
        }
    }
}

#[cfg(test)]
mod tests;
