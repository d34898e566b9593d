//! What the views of an evaluation come to before anything is ranked: the error of depth, and what is odd about the maps.

use super::{DepthError, EvaluatedView, FramesWithDepth, TrueView};
use octobayes::estimate::Model;
use octobayes::geometry::Domain;
use octobayes::metrics::quantile;
use octobayes::monitor::Message;
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, DepthReadings, LargestDepth};

/// What else may be wrong if depths are.
const CAUSES: &str = "likely causes: --depth-encoding, --z-depth, or units of the cameras";

/// The length to which errors of depth are compared, scene units.
pub(super) fn size_of(model: &dyn Model) -> f64 {
    match model.natural_domain() {
        Domain::Box(_) => model.main_box().longest_edge(),
        Domain::Contracted { radius, .. } => 2.0 * radius,
    }
}

/// Whether half of the depths are so far off that they are probably misread.
pub(super) fn are_far_off(error: &DepthError, model: &dyn Model) -> bool {
    error.median > 0.1 * size_of(model)
}

/// What the loop over frames leaves.
#[derive(Default)]
pub(super) struct Looked {
    /// The views, without their images.
    pub views: Vec<EvaluatedView>,
    /// What the cameras should see, if it is needed again.
    pub truths: Vec<TrueView>,
    /// What the depth maps hold at opaque pixels.
    pub counts: DepthReadings,
    /// The largest depth at these pixels.
    pub largest: LargestDepth,
    /// `[n]`: the absolute errors if the maps hold the other kind of depth.
    pub otherwise: Vec<f64>,
}

impl Looked {
    /// The error of depth. Says what is odd about the maps. Refuses them if nearly no pixel holds a measurement, or if
    /// no error of a model explains half of them.
    ///
    /// Models trained from five views are off by a hundredth of their box in the median, a wrong encoding by the
    /// distance of the cameras.
    pub fn error_of_depth(
        &self,
        maps: &FramesWithDepth,
        model: &dyn Model,
        tell: &mut dyn FnMut(Message),
    ) -> Result<DepthError> {
        let wrong = |expected, found| Err(Error::malformed(&maps.source, "depth maps", expected, found));
        if self.counts.are_nearly_all_unmeasured() {
            let expected = format!("depths of what the model shows in at least 1 % of the opaque pixels; {CAUSES}");
            return wrong(expected, self.counts.to_string());
        }
        let error = DepthError::new(&self.views).ok_or_else(|| self.too_few(maps, "pixels with depth"))?;
        let (widest, size) = (model.main_box().longest_edge(), size_of(model));
        let found = format!("half of the depths are off by more than {:.4} scene units", error.median);
        if error.median > widest {
            return wrong(format!("depths within the model's box, {widest:.4} across; {CAUSES}"), found);
        }
        if self.counts.measured < self.counts.total() {
            tell(Message::Note(self.counts.to_string()));
        }
        if let Some(doubt) = self.largest.doubt(self.counts.measured) {
            tell(Message::Warning(doubt));
        }
        let mut otherwise = self.otherwise.clone();
        otherwise.sort_unstable_by(f64::total_cmp);
        let other = quantile(&otherwise, 0.5);
        if other < 0.5 * error.median {
            let (kind, flag) = match maps.encoding.kind {
                DepthKind::Z => ("distance from the camera", "without --z-depth"),
                DepthKind::Euclidean => ("depth along the viewing axis", "with --z-depth"),
            };
            tell(Message::Note(format!("{found}; if the maps hold {kind} ({flag}), by more than {other:.4}")));
        }
        if are_far_off(&error, model) {
            tell(Message::Warning(format!("{found}, and the model is {size:.4} across; {CAUSES}")));
        }
        Ok(error)
    }

    /// The error that there are too few pixels of known depth.
    pub fn too_few(&self, maps: &FramesWithDepth, expected: &str) -> Error {
        let pixels: usize = self.views.iter().map(|view| view.pixels.len()).sum();
        let mut found = format!("{pixels} pixels of {} views", self.views.len());
        if self.counts.measured < self.counts.total() {
            found += &format!("; {}", self.counts);
        }
        Error::malformed(&maps.source, "depth maps", expected, found)
    }
}
