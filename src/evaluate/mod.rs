//! Does an uncertainty tell where a field is wrong? Judged on held-out views whose depth is known, all measures on the same pixels.
//!
//! In the order in which data flows: a [`TrueView`] is what a camera should see, [`Evaluator`] renders it and gives every pixel its depth
//! error and all [`Measure`]s of uncertainty, [`Score`] says how well each ranks the error, [`clean_up()`] removes what is too
//! uncertain and asks whether images get better.

mod clean_up;
mod measure;
mod score;
mod truth;
mod view;

pub use clean_up::{CleanUp, SCALE, THRESHOLDS, clean_up};
pub use measure::{Baseline, Measure, Reading};
pub use score::{DepthError, Score};
pub use truth::{DepthFiles, TrueView};
pub use view::{EvaluatedView, Evaluator};

#[cfg(test)]
mod tests;
