//! Measures the cost of a run's approximations on a few of its own rays.
//!
//! The first rays of the run are summed four times on the same lattice. The first sum is the run's own. The
//! second leaves nothing out (every sample of every ray, as with `--cutoff 0`). The third uses better derivatives:
//! the field's own if it has them, otherwise differences over half the step. The fourth marches with a quarter of the
//! step. The error of a field consists of these costs, the tolerance, which is guaranteed, and what the number of rays
//! leaves open ([`SamplingError`]).

use super::builder::Builder;
use super::{Estimation, GridSettings, RaySettings, SamplingError};
use crate::geometry::Lattice;
use crate::rays::{RayStream, RunProgress, Shard};
use crate::render::GradientMethod;
use crate::uncertainty::{Finish, MOVED};
use crate::{Error, Result};

/// Effect of the approximations on log10 U, at vertices that the audited rays moved by more than half a decade.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Audit {
    /// Number of audited rays.
    pub rays: u64,
    /// Effect of samples that were left out.
    pub cutoff: SamplingError,
    /// Effect of the derivatives, compared with better ones; `None` if the run's own are exact.
    pub derivatives: Option<SamplingError>,
    /// Effect of the march step.
    pub march: MarchShift,
}

/// How log10 U changes if rays are marched with [`MarchShift::FINER`] times as many samples.
///
/// A step is a property of the model: a hash grid or an MLP was trained with one, and is another model with another.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct MarchShift {
    /// Number of vertices.
    pub vertices: usize,
    /// Mean of log10 U with the finer step minus that of the run.
    pub shift: f64,
    /// 95th percentile of |Δ log10 U|. It includes that samples have other places, which more rays average out.
    pub percentile_95: f64,
}

impl MarchShift {
    /// How much finer the step is.
    pub const FINER: f64 = 4.0;
}

impl Audit {
    /// Number of audited rays, unless the run has fewer.
    pub const RAYS: u64 = 8_192;

    /// Audits a run whose rays are those of `stream`, on `lattice`.
    pub(super) fn measure<P: Finish>(run: &Estimation, stream: &RayStream, lattice: &Lattice) -> Result<Self> {
        let Estimation { model, domain, rays, monitor, .. } = run;
        let Some(field) = stream.source.marched().map(|volume| volume.tracer.field) else {
            return Err(Error::setting("audit", "rays that are marched", model.kind()));
        };
        let count = rays.rays.min(Self::RAYS);
        let grid = GridSettings { memory: None, ..run.grid };
        let sums_of = |stream: &RayStream| {
            let mut builder = Builder::<P>::new(grid, *domain, None)?;
            stream.run(Shard::whole(count), RunProgress::default(), *monitor, |batches, _| {
                builder.add(batches);
                Ok(())
            })?;
            Ok(builder)
        };
        let sums = |rays: RaySettings| sums_of(&run.stream(&rays, lattice)?);
        let own = sums_of(stream)?;
        let cutoff = own.differs(&sums(RaySettings { cutoff: 0.0, ..*rays })?, count)?;
        let better = match (rays.gradient.of(field)?, field.differentiable()) {
            (Some(_), _) => None,
            (None, Some(_)) => Some(RaySettings { step: None, gradient: GradientMethod::Analytic, ..*rays }),
            (None, None) => {
                // Forward differences of half the width would share half of their error.
                let edges = rays.differences(lattice, &field.bounds()).step / lattice.edge();
                let (step, gradient) = (Some(0.5 * edges.max_element()), GradientMethod::FiniteDifference);
                Some(RaySettings { step, gradient, ..*rays })
            }
        };
        let derivatives = better.map(|better| own.differs(&sums(better)?, count)).transpose()?;
        let step = rays.march_step.unwrap_or_else(|| field.suggested_step()) / MarchShift::FINER;
        let finer = own.pairs(&sums(RaySettings { march_step: Some(step), ..*rays })?, count)?;
        let shift = finer.iter().map(|(own, finer)| finer - own).sum::<f64>() / finer.len().max(1) as f64;
        let SamplingError { vertices, percentile_95, .. } = SamplingError::from_pairs(&finer);
        Ok(Self { rays: count, cutoff, derivatives, march: MarchShift { vertices, shift, percentile_95 } })
    }
}

impl<P: Finish> Builder<P> {
    /// log10 U by two treatments of the same `rays`, at vertices that either moves by more than half a decade.
    fn pairs(&self, other: &Self, rays: u64) -> Result<Vec<(f64, f64)>> {
        let lambda = self.settings().prior_precision(self.lattice());
        let covariance = self.settings().covariance;
        let moved = covariance.prior(lambda).log10() - MOVED;
        let log10 = |sums| covariance.deviation(&sums, rays, lambda).log10();
        self.paired(other, |mine, theirs| {
            let (a, b) = (log10(mine), log10(theirs));
            (a.min(b) < moved).then_some((a, b))
        })
    }

    /// The difference between the two.
    fn differs(&self, other: &Self, rays: u64) -> Result<SamplingError> {
        Ok(SamplingError::from_pairs(&self.pairs(other, rays)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::ClosedForm;

    fn audit(rays: RaySettings) -> Audit {
        let field = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(10, [100, 100]);
        let grid = GridSettings { level: 6, ..GridSettings::default() };
        let rays = RaySettings { rays: 1_000, ..rays };
        Estimation::new(&field, &cameras).rays(rays).grid(grid).prepare().unwrap().audit().unwrap()
    }

    #[test]
    #[ignore = "slow: several seconds"]
    fn coarser_approximations_are_found_out() {
        let good = audit(RaySettings::default());
        assert!(good.rays == 1_000 && good.cutoff.vertices > 1_000);
        // The defaults were chosen to cost less than the tolerance. The courtyard has no derivatives of its own.
        assert!(good.cutoff.mean < 1e-3 && good.derivatives.unwrap().mean < 1e-3, "{good:?}");
        let careless = audit(RaySettings { cutoff: 1e-2, ..RaySettings::default() });
        assert!(careless.cutoff.mean > 20.0 * good.cutoff.mean + 1e-3, "{careless:?}");
        let coarse = audit(RaySettings { step: Some(1.0), ..RaySettings::default() });
        assert!(coarse.derivatives.unwrap().mean > 1e-2, "{coarse:?}");
        // A smooth scene is marched finely enough; a step of a twelfth of the box passes over its walls.
        assert!(good.march.vertices > 1_000 && good.march.shift.abs() < 0.02, "{good:?}");
        let hasty = audit(RaySettings { march_step: Some(0.2), ..RaySettings::default() });
        assert!(hasty.march.shift.abs() > 0.1 && hasty.march.percentile_95 > 0.3, "{hasty:?}");
        let exact = audit(RaySettings { cutoff: 0.0, ..RaySettings::default() });
        assert_eq!((exact.cutoff.mean, exact.cutoff.percentile_95), (0.0, 0.0));
    }
}
