//! How well a measure ranks the depth error, and how large that error is.

use serde::{Deserialize, Serialize};

use super::EvaluatedView;
use crate::metrics::{ErrorKind, Sparsification, sparsification, spearman};
use octobayes::metrics::quantile;

/// A figure for each [`ErrorKind`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ByError {
    /// Of the mean absolute error.
    pub mae: f64,
    /// Of the mean squared error.
    pub mse: f64,
    /// Of its root.
    pub rmse: f64,
}

/// How well one measure ranks the depth error.
#[derive(Debug, Clone, Serialize)]
pub struct Score {
    /// Area under the sparsification error, over the pixels of all views together.
    pub ause_pooled: ByError,
    /// The same, where both curves are divided by their start ([`Sparsification::area_from_start`]).
    pub ause_from_start: ByError,
    /// [`Sparsification::rise`] over all pixels.
    pub rise: ByError,
    /// Mean of the areas of single views.
    pub ause_mean_over_views: ByError,
    /// [`Sparsification::risk`] over all pixels.
    pub risk: ByError,
    /// [`Sparsification::least_risk`] of these pixels.
    pub least_risk: ByError,
    /// Spearman's rank correlation with the absolute error over all pixels; 0 if the measure is the same everywhere.
    pub rank_correlation: f64,
    /// The same, mean of single views.
    pub rank_correlation_mean_over_views: f64,
    /// In the order of [`ErrorKind::ALL`]: the curves over all pixels.
    #[serde(skip)]
    pub curves: [Sparsification; 3],
}

impl From<[f64; 3]> for ByError {
    /// In the order of [`ErrorKind::ALL`].
    fn from([mae, mse, rmse]: [f64; 3]) -> Self {
        Self { mae, mse, rmse }
    }
}

impl Score {
    /// Scores the measure of index `m`; `None` if there is nothing to rank (see [`sparsification`]).
    #[must_use]
    pub fn new(views: &[EvaluatedView], m: usize) -> Option<Self> {
        let errors: Vec<f64> = views.iter().flat_map(|v| &v.absolute_error).copied().collect();
        let measure: Vec<f64> = views.iter().flat_map(|v| &v.measures[m]).copied().collect();
        let [mae, mse, rmse] = ErrorKind::ALL.map(|kind| sparsification(&measure, &errors, kind));
        let curves = [mae?, mse?, rmse?];
        let mean = |kind| {
            let areas = views.iter().filter_map(|v| sparsification(&v.measures[m], &v.absolute_error, kind));
            let areas: Vec<f64> = areas.map(|s| s.area).collect();
            areas.iter().sum::<f64>() / areas.len() as f64
        };
        let pooled = |figure: fn(&Sparsification) -> f64| curves.each_ref().map(figure).into();
        let correlation = |v: &EvaluatedView| spearman(&v.measures[m], &v.absolute_error);
        let correlations: Vec<f64> = views.iter().filter_map(correlation).collect();
        Some(Self {
            ause_pooled: pooled(|curve| curve.area),
            ause_from_start: pooled(Sparsification::area_from_start),
            rise: pooled(Sparsification::rise),
            ause_mean_over_views: ErrorKind::ALL.map(mean).into(),
            risk: pooled(Sparsification::risk),
            least_risk: pooled(Sparsification::least_risk),
            rank_correlation: spearman(&measure, &errors).unwrap_or(0.0),
            rank_correlation_mean_over_views: correlations.iter().sum::<f64>() / correlations.len().max(1) as f64,
            curves,
        })
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
        Self::of(views.iter().flat_map(|v| &v.absolute_error).copied().collect())
    }

    /// Of these errors; `None` if there are none.
    pub(crate) fn of(mut errors: Vec<f64>) -> Option<Self> {
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
