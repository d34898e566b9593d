//! Measurement of the quantities that claims of the zoo are about.

use octobayes::posterior::Covariance;
use octobayes::uncertainty::UncertaintyField;

use super::Quantity;

/// U counts as lowered at a vertex if it lies more than this many decades below the prior: less than for a vertex to
/// count as [moved](octobayes::uncertainty::MOVED), because some scenes hardly lower it.
const LOWERED: f64 = 0.1;

impl Quantity {
    /// Measures the quantity for a field that was not pooled. [`Quantity::Diagonal`], [`Quantity::Block`] and
    /// [`Quantity::Lowered`] are 0 if the field did not keep its vertex sums.
    pub fn read(self, field: &UncertaintyField) -> f64 {
        let record = field.record();
        // Decades below the prior, for every vertex.
        let gains = |covariance: Covariance| {
            let prior = covariance.prior(record.lambda);
            let sums = field.sums().unwrap_or_default().iter();
            sums.map(move |e| (prior / covariance.deviation(e, record.rays, record.lambda)).log10())
        };
        match self {
            Self::Diagonal => gains(Covariance::Diagonal).fold(0.0, f64::max),
            Self::Block => gains(Covariance::Block).fold(0.0, f64::max),
            Self::Lowered => {
                let lowered = gains(Covariance::Trace).filter(|&gain| gain > LOWERED).count();
                lowered as f64 / field.lattice().dense_vertices() as f64
            }
            Self::Dropped => record.dropped as f64 / record.rays.max(1) as f64,
        }
    }
}
