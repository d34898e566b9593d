//! Fits a [`HashGrid`](octobayes_models::HashGrid), or [Gaussian splats](SplatTrainer), to posed images.
//!
//! One step of a hash grid draws rays from all training images, samples them where the occupancy grid is occupied,
//! composites, and moves the parameters against the gradient of the loss (Adam). The backward pass is derived by hand.
//! The number of rays per step adapts to keep the number of samples near a budget, as in instant-ngp. Nothing depends
//! on the number of threads.
//!
//! A [`Shot`] is an image with its camera, [`DatasetFiles`] finds all of a folder. A [`Trainer`] takes steps, and
//! [`quality()`] is what they reached on held-out shots. A [`Run`] is what `octobayes train` does: steps within a
//! [`Budget`], saved as it goes.
//!
//! # Example
//! ```
//! use glam::{DVec3, Vec3};
//! use octobayes::geometry::{Aabb, Camera, Domain};
//! use octobayes_data::PosedImage;
//! use octobayes_models::HashGridConfig;
//! use octobayes_train::{Shot, TrainSettings, Trainer, quality};
//!
//! // A red disc in front of nothing, from four sides.
//! let shot = |i: u32| {
//!     let (sin, cos) = f64::from(i).sin_cos();
//!     let eye = 3.0 * DVec3::new(cos, sin, 0.3);
//!     let inside = |k: i32| (k % 16 - 8).pow(2) + (k / 16 - 8).pow(2) < 16;
//!     let pixels = (0..256).map(|k| if inside(k) { [200, 20, 20, 255] } else { [0; 4] }).collect();
//!     let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [16, 16]);
//!     Shot { name: i.to_string(), camera, image: PosedImage::new([16, 16], pixels), mask: None }
//! };
//! let shots: Vec<Shot> = (0..4).map(shot).collect();
//! let small = HashGridConfig::default().log2_hashmap_size(8).occupancy(16);
//! let settings = TrainSettings::default().config(small).samples_per_step(2048);
//! let mut trainer = Trainer::new(settings, Domain::Box(Aabb::centered_cube(1.0)), &shots)?;
//! (0..5).for_each(|step| _ = trainer.step(f64::from(step) / 5.0));
//! let field = trainer.field(serde_json::Value::Null);
//! assert!(quality(&field, &shots, Vec3::ONE, 100).is_some_and(|found| found.psnr > 0.0));
//! # Ok::<(), octobayes::Error>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod adam;
mod batch;
mod loss;
mod march;
mod occupancy;
mod quality;
mod run;
mod splats;
mod state;
mod tape;
mod trainer;
mod views;

pub use octobayes_data::Selection;
pub use quality::{Quality, one_color, quality, quality_within};
pub use run::{Budget, Description, Finished, Progress, Run, StateFile, Training};
pub use splats::{Rates, Refitted, SplatOrigin, SplatSettings, SplatTrainer, box_of_points, check_mode, refit};
pub use trainer::{StepReport, Trainer};
pub use views::{DatasetFiles, Shot};

/// Parts of a step, for the experiment whose posteriors are over a hash grid's parameters.
#[doc(hidden)]
pub mod parts {
    pub use crate::loss::{RaySample, SampleGradient, composite, density_gradients, end_transmittance};
    pub use crate::march::{Sample, Walk};
    pub use crate::occupancy::OccupancyGrid;
    pub use crate::tape::Tape;
}

use serde::{Deserialize, Serialize};

use octobayes_models::HashGridConfig;

/// Background of the scene during training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// Another colour for every ray, where images are transparent. Empty space must become transparent to match.
    Random,
    /// A fixed colour, which opaque images show too.
    Fixed([f32; 3]),
}

octobayes::setters! {
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
