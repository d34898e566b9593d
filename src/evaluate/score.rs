//! How well a measure ranks the depth error, and how large that error is.

use serde::{Deserialize, Serialize};

use super::EvaluatedView;
use crate::metrics::{ErrorKind, Sparsification, quantile, sparsification, spearman};

/// Area under the sparsification error (AUSE) of one measure.
#[derive(Debug, Clone)]
pub struct Score {
    /// `[error kinds]`: curves and area over the pixels of all views together.
    pub pooled: Vec<Sparsification>,
    /// `[error kinds]`: mean of the areas of single views.
    pub per_view_mean: Vec<f64>,
    /// Spearman's rank correlation with the absolute error over all pixels; 0 if the measure is the same everywhere.
    pub rank_correlation: f64,
    /// The same, mean of single views.
    pub rank_correlation_per_view: f64,
}

impl Score {
    /// Scores the measure of index `m` for every [`ErrorKind`]; `None` if there is nothing to rank (see
    /// [`sparsification`]).
    #[must_use]
    pub fn new(views: &[EvaluatedView], m: usize) -> Option<Self> {
        let errors: Vec<f64> = views.iter().flat_map(|v| &v.absolute_error).copied().collect();
        let measure: Vec<f64> = views.iter().flat_map(|v| &v.measures[m]).copied().collect();
        let pooled = ErrorKind::ALL.iter().map(|&kind| sparsification(&measure, &errors, kind));
        let mean = |kind| {
            let areas = views.iter().filter_map(|v| sparsification(&v.measures[m], &v.absolute_error, kind));
            let areas: Vec<f64> = areas.map(|s| s.area).collect();
            areas.iter().sum::<f64>() / areas.len() as f64
        };
        let correlation = |v: &EvaluatedView| spearman(&v.measures[m], &v.absolute_error);
        let correlations: Vec<f64> = views.iter().filter_map(correlation).collect();
        Some(Self {
            pooled: pooled.collect::<Option<_>>()?,
            per_view_mean: ErrorKind::ALL.iter().map(|&kind| mean(kind)).collect(),
            rank_correlation: spearman(&measure, &errors).unwrap_or(0.0),
            rank_correlation_per_view: correlations.iter().sum::<f64>() / correlations.len().max(1) as f64,
        })
    }

    /// Pooled area for one kind of error.
    #[must_use]
    pub fn area(&self, kind: ErrorKind) -> f64 {
        let index = ErrorKind::ALL.iter().position(|k| *k == kind).unwrap_or(0);
        self.pooled[index].area
    }
}

/// Absolute error of the median depth over the pixels of all views, in scene units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DepthError {
    /// Number of pixels.
    pub pixels: usize,
    /// Median.
    pub median: f64,
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub percentile_95: f64,
}

impl DepthError {
    /// Collects the errors of all views; `None` if there are no pixels.
    #[must_use]
    pub fn new(views: &[EvaluatedView]) -> Option<Self> {
        let mut errors: Vec<f64> = views.iter().flat_map(|v| &v.absolute_error).copied().collect();
        let n = errors.len();
        errors.sort_unstable_by(f64::total_cmp);
        (n > 0).then(|| Self {
            pixels: n,
            median: quantile(&errors, 0.5),
            mean: errors.iter().sum::<f64>() / n as f64,
            percentile_95: quantile(&errors, 0.95),
        })
    }
}
