//! An interval of depth that was calibrated on views of known depth.

use super::UncertaintyField;

/// Depth errors of at most `factor` deviations are to be as frequent as `probability`, by split conformal prediction
/// ([`conformal_factor`](crate::metrics::conformal_factor)).
///
/// It holds for pixels that are exchangeable with those that it was calibrated on: of views of this scene that were
/// chosen as those were, by this model. It promises nothing of other scenes, of views from elsewhere, or of any single
/// pixel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Conformal {
    /// Share of errors that the interval is to hold.
    pub probability: f64,
    /// Half width of the interval in deviations.
    pub factor: f64,
    /// Number of pixels that it was calibrated on.
    pub pixels: u64,
    /// Number of views that showed them.
    pub views: u64,
}

impl Conformal {
    /// Whether a calibration can have given these numbers, for numbers read from files.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        let share = self.probability > 0.0 && self.probability < 1.0;
        share
            && self.factor >= 0.0
            && self.factor.is_finite()
            && self.pixels > 0
            && (1..=self.pixels).contains(&self.views)
    }
}

impl UncertaintyField {
    /// The calibrated interval of depth, if there is one for these deviations.
    #[must_use]
    pub fn conformal(&self) -> Option<&Conformal> {
        self.conformal.as_ref()
    }

    /// The same field with a calibrated interval of depth.
    #[must_use]
    pub fn with_conformal(self, conformal: Conformal) -> Self {
        Self { conformal: Some(conformal), ..self }
    }
}
