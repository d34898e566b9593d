//! What a claim of the zoo is compared with.

use super::Quantity;
use crate::posterior::Covariance;
use crate::uncertainty::UncertaintyField;

/// A vertex counts as moved if it lies more than this many decades below the prior.
const MOVED: f64 = 0.1;

impl Quantity {
    /// The quantity, of a field that kept its evidence and was not pooled; 0 of one that did not keep it.
    #[must_use]
    pub fn of(self, field: &UncertaintyField) -> f64 {
        let protocol = field.protocol();
        // Decades below the prior, of every vertex.
        let gains = |covariance: Covariance| {
            let prior = covariance.prior(protocol.lambda);
            let sums = field.sums().unwrap_or_default().iter();
            sums.map(move |e| (prior / covariance.deviation(e, protocol.rays, protocol.lambda)).log10())
        };
        match self {
            Self::Diagonal => gains(Covariance::Diagonal).fold(0.0, f64::max),
            Self::Block => gains(Covariance::Block).fold(0.0, f64::max),
            Self::Moved => {
                let moved = gains(Covariance::Trace).filter(|&gain| gain > MOVED).count();
                moved as f64 / field.lattice().dense_vertices() as f64
            }
            Self::Dropped => protocol.dropped as f64 / protocol.rays.max(1) as f64,
        }
    }
}
