//! Checks whether an uncertainty shows where a model is wrong, on held-out views with known depth.
//!
//! All measures are compared on the same pixels. An [`Evaluation`] has the settings; it finds the files, renders all
//! frames and returns a [`Report`]. In the order in which data flows: [`DepthFiles`] finds the depth maps of frames,
//! and a [`TrueView`] is what a camera should see. [`Evaluator`] renders the model there, and computes the
//! depth error and all [`Measure`]s of uncertainty of every pixel. [`Score`] is how well each measure ranks the error.
//! [`clean_up()`] removes what is too uncertain and compares the images.
//!
//! # Example
//! Formulas over pixels are in [`metrics`]:
//! ```
//! use octobayes_evaluation::metrics::{ErrorKind, sparsification};
//!
//! let errors: Vec<f64> = (0..1000).map(|i| f64::from(i % 37)).collect();
//! // A guess that is right for all but every tenth pixel.
//! let uncertainty: Vec<f64> = errors.iter().enumerate().map(|(i, e)| if i % 10 == 0 { 0.0 } else { *e }).collect();
//! let ause = sparsification(&uncertainty, &errors, ErrorKind::Mae).map(|curves| curves.area);
//! assert!(ause.is_some_and(|area| area > 0.0 && area < 0.2));
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod clean_up;
mod depth_files;
mod image_check;
mod interval;
mod judge;
mod kinds;
mod looked;
mod measure;
pub mod metrics;
mod report;
mod score;
mod training_cameras;
mod truly_seen;
mod truth;
mod verdict;
mod view;

pub use clean_up::{CleanUp, SCALE, THRESHOLDS, clean_up};
pub use depth_files::DepthFiles;
pub use image_check::{ImageCheck, check_images, memory_of_images};
pub use interval::Interval;
pub use judge::{Evaluation, Judged, Prepared};
pub use kinds::{JUMP, MeasureOfKind, OfKind, PixelKind, THIN};
pub use measure::Reading;
pub use report::{Inside, NeverSeen, Part, Report, Scored, ViewReport};
pub use score::{ByError, DepthError, Score};
pub use training_cameras::training_cameras;

// The parts of an evaluation, for this crate's experiments.
#[doc(hidden)]
pub use depth_files::FramesWithDepth;
#[doc(hidden)]
pub use kinds::{Outline, TrueParts};
#[doc(hidden)]
pub use measure::{Baseline, Measure};
#[doc(hidden)]
pub use truth::{DepthMeaning, TrueView};
#[doc(hidden)]
pub use view::{EvaluatedView, Evaluator};

#[cfg(test)]
mod tests;
