//! Where depths of a trained radiance field can be trusted, in scene units.

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod deviation;
mod edges;
mod measure;
mod photographs;
mod sweep;
mod training_views;
mod trust;

pub use deviation::{DEPTH_JUMP, DepthDeviation, FieldFactors, LEVEL, NINETY};
pub use measure::{Length, Snapped, SurfacePoint, SurveyedView, Surveyor};
pub use photographs::{Photograph, find_images};
pub use sweep::Sweep;
pub use training_views::{CONFIRMING_VIEWS, Sighting, TrainingViews};
pub use trust::Trust;
