//! An interval of depth that was calibrated on views of known depth.

use serde_json::{Value, json};

use super::super::file::Source;
use super::{Change, Layer};
use crate::Result;
use crate::rays::MAX_RAYS;
use crate::uncertainty::UncertaintyField;

/// Depth errors of at most `factor` deviations are to be as frequent as `probability`, by split conformal prediction
/// (`conformal_factor` of `octobayes-evaluation`).
///
/// It holds for pixels that are exchangeable with those that it was calibrated on: of views of this scene that were
/// chosen as those were, by this model. It does not hold for other scenes, for views from elsewhere, or for any
/// single pixel.
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

impl Layer for Conformal {
    /// `interval` was that of another deviation, √(Var + s²), whose factors are not these.
    const NAME: &'static str = "calibration";
    const DEPENDS_ON: &'static [Change] = &[Change::Covariance, Change::Prior, Change::Vertices];
    const WITHOUT: &'static str = "not calibrated (evaluate --calibrate)";

    fn head(&self) -> Value {
        json!(self)
    }

    fn read(head: Value, file: &mut Source) -> Result<Self> {
        let head: Self = file.head(Self::NAME, head)?;
        let Self { probability, factor, pixels, views } = head;
        let is_possible = probability > 0.0 && probability < 1.0 && (0.0..=f64::from(f32::MAX)).contains(&factor);
        if is_possible && (1..=MAX_RAYS).contains(&pixels) && (1..=pixels).contains(&views) {
            return Ok(head);
        }
        let expected = "an interval that a calibration can give";
        Err(file.malformed("header, calibration", expected, format!("{head:?}")))
    }

    fn info(&self) -> String {
        self.to_string()
    }
}

impl std::fmt::Display for Conformal {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Self { probability, factor, pixels, views } = self;
        let percent = 100.0 * probability;
        write!(f, "{percent:.0} % of depth errors below {factor:.3} deviations, by {pixels} pixels of {views} views")
    }
}

impl UncertaintyField {
    /// The calibrated interval of depth, if there is one for these deviations.
    #[must_use]
    pub fn conformal(&self) -> Option<&Conformal> {
        self.layers.conformal.as_ref()
    }

    /// The same field with a calibrated interval of depth.
    #[must_use]
    pub fn with_conformal(mut self, conformal: Conformal) -> Self {
        self.layers.conformal = Some(conformal);
        self
    }
}
