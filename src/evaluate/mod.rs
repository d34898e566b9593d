//! Checks whether an uncertainty shows where a field is wrong, on held-out views with known depth.
//!
//! All measures are compared on the same pixels. In the order in which data flows: [`DepthFiles`] finds the depth maps
//! of frames, and a [`TrueView`] is what a camera should see. [`Evaluator`] renders it and gives every pixel its depth
//! error and all [`Measure`]s of uncertainty; [`HeldOut`] does so for all frames. [`Score`] says how well each measure
//! ranks the error. [`clean_up()`] removes what is too uncertain and compares the images.

mod clean_up;
mod depth_files;
mod held_out;
mod image_check;
mod interval;
mod measure;
mod misfit;
mod score;
mod training_views;
mod truth;
mod view;

pub use clean_up::{CleanUp, SCALE, THRESHOLDS, clean_up};
pub use depth_files::{DepthFiles, FramesWithDepth};
pub use held_out::{DepthFit, HeldOut, Judged};
pub use image_check::{ImageCheck, check_images};
pub use interval::Interval;
pub use measure::{Baseline, Measure, Reading};
pub use misfit::{TrainingImages, measure_misfit};
pub use score::{DepthError, Score};
pub use training_views::{Sighting, TrainingViews};
pub use truth::{DepthMeaning, TrueView};
pub use view::{EvaluatedView, Evaluator};

#[cfg(test)]
mod tests;
