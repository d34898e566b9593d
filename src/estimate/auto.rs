//! As many rays as a wanted error takes.
//!
//! Two halves of equally many rays, each with its own sums and its own, independent pixels. Where log10 U of the halves differs by Δ, the whole, whose
//! variance is half of theirs, is off by about Δ/2. That is measured at every vertex that moved from the prior, each time that the
//! number of rays has doubled. (Halves of one low-discrepancy sequence would complement each other: their difference says twice too much.)

use rayon::prelude::*;

use super::{FieldBuilder, GridSettings};
use crate::geometry::Domain;
use crate::metrics::quantile;
use crate::monitor::Monitor;
use crate::rays::{Draw, Purpose, RayStream, RunProgress, Shard};
use crate::{Error, Result};

/// Rays before the first look.
const FIRST: u64 = 65_536;

/// How far log10 U is off, estimated at the vertices that moved by more than half a decade from the prior.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct SamplingError {
    /// Vertices looked at.
    pub vertices: usize,
    /// Mean of |Δ log10 U|.
    pub mean: f64,
    /// 95th percentile of |Δ log10 U|.
    pub percentile_95: f64,
}

impl SamplingError {
    /// From log10 U of two halves at the vertices looked at.
    fn of_halves(halves: &[(f64, f64)]) -> Self {
        Self::of(halves.iter().map(|(a, b)| 0.5 * (a - b).abs()).collect())
    }

    /// From |Δ log10 U| at the vertices looked at.
    pub(super) fn of(mut errors: Vec<f64>) -> Self {
        if errors.is_empty() {
            return Self { vertices: 0, mean: 0.0, percentile_95: 0.0 };
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        errors.sort_unstable_by(f64::total_cmp);
        Self { vertices: errors.len(), mean, percentile_95: quantile(&errors, 0.95) }
    }
}

/// Rays until an error is reached.
#[derive(Debug, Clone, Copy)]
pub struct AutoRun {
    /// Mean error of log10 U to reach.
    pub tolerance: f64,
    /// Rays to stop at.
    pub most: u64,
}

impl AutoRun {
    /// Draws rays until the estimated mean error is within the tolerance; returns their sums, and what was reached.
    ///
    /// # Errors
    /// As [`AutoRun::halves`].
    pub fn run(
        &self,
        stream: &RayStream,
        settings: GridSettings,
        domain: Domain,
        monitor: &dyn Monitor,
    ) -> Result<(FieldBuilder, RunProgress, SamplingError)> {
        let (halves, tallies, error) = self.halves(stream, settings, domain, monitor)?;
        Ok((FieldBuilder::joined(halves, stream)?, tallies[0].with(&tallies[1]), error))
    }

    /// What the halves of a finished run of `stream` were made of.
    #[must_use]
    pub fn draws(stream: &RayStream, tallies: &[RunProgress; 2]) -> Vec<Draw> {
        let [first, second] = tallies.map(|tally| Shard::whole(tally.rays));
        vec![stream.draw(first), stream.for_purpose(Purpose::SecondHalf).draw(second)]
    }

    /// As [`AutoRun::run`], but returns each half's sums by themselves.
    ///
    /// # Errors
    /// As [`RayStream::run`], or if the grid has a budget, whose limits would differ between the halves.
    pub fn halves(
        &self,
        stream: &RayStream,
        settings: GridSettings,
        domain: Domain,
        monitor: &dyn Monitor,
    ) -> Result<([FieldBuilder; 2], [RunProgress; 2], SamplingError)> {
        if settings.needs_plan() {
            let found = "--memory or --refine ray-count";
            return Err(Error::setting("--rays auto", "a grid without limits to its refinement", found));
        }
        let other_pixels = stream.for_purpose(Purpose::SecondHalf);
        let streams = [stream, &other_pixels];
        let mut halves = [FieldBuilder::new(settings, domain)?, FieldBuilder::new(settings, domain)?];
        let mut tallies = [RunProgress::default(); 2];
        let mut rays = FIRST.min(self.most);
        loop {
            for ((half, stream), tally) in halves.iter_mut().zip(streams).zip(&mut tallies) {
                *tally = stream.run(Shard::whole((rays / 2).max(1)), *tally, monitor, |batches, _| {
                    half.add(batches);
                    Ok(())
                })?;
            }
            let drawn = tallies[0].rays + tallies[1].rays;
            let error = SamplingError::of_halves(&halves[0].both(&halves[1], drawn));
            if error.vertices > 0 && error.mean <= self.tolerance || rays == self.most {
                return Ok((halves, tallies, error));
            }
            rays = (2 * rays).min(self.most);
        }
    }
}

impl FieldBuilder {
    /// The sums of both halves of `stream`'s rays together, refined where there is density if the settings say so.
    ///
    /// # Errors
    /// As [`FieldBuilder::want_density`].
    pub fn joined(halves: [Self; 2], stream: &RayStream) -> Result<Self> {
        let [mut whole, other] = halves;
        whole.absorb(&other);
        whole.want_density(stream)?;
        Ok(whole)
    }

    /// log10 U by the rays of this builder and by those of another, half of `rays` each, at the vertices that both together move by more than half a decade.
    fn both(&self, other: &Self, rays: u64) -> Vec<(f64, f64)> {
        let lambda = self.settings().lambda(self.lattice());
        let covariance = self.settings().covariance;
        let moved = covariance.prior(lambda) / 10_f64.sqrt();
        let pairs = self.paired(other);
        let looked_at = pairs.into_par_iter().filter_map(|(mine, theirs)| {
            let mut sum = mine;
            sum.add(&theirs);
            let half = |sums| covariance.deviation(&sums, rays / 2, lambda).log10();
            (covariance.deviation(&sum, rays, lambda) < moved).then(|| (half(mine), half(theirs)))
        });
        looked_at.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::Provenance;
    use crate::estimate::{GridKind, RaySettings};
    use crate::field::{ClosedForm, RadianceField};
    use crate::monitor::Silent;
    use crate::posterior::Criterion;
    use crate::uncertainty::UncertaintyField;

    fn run(grid: GridKind, tolerance: f64, most: u64) -> (UncertaintyField, RunProgress, SamplingError) {
        let field = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(10, [100, 100]);
        let settings = GridSettings { grid, level: 5, ..GridSettings::default() };
        let domain = Domain::Box(field.bounds());
        let lattice = settings.lattice(domain).unwrap();
        let stream = RaySettings::default().stream(&field, &cameras, &settings, &lattice, &Silent).unwrap();
        let (builder, tally, error) = AutoRun { tolerance, most }.run(&stream, settings, domain, &Silent).unwrap();
        let share = Some(Shard::whole(tally.rays));
        let field = builder.finish(&Provenance { source: "test".into(), tally, share, stream: Some(&stream) });
        (field, tally, error)
    }

    #[test]
    fn the_halves_add_up_on_either_grid() {
        let (octree, tally, a) = run(GridKind::Octree, 1e-9, 20_000);
        let (dense, _, b) = run(GridKind::Dense, 1e-9, 20_000);
        assert_eq!(tally.rays, 20_000, "the tolerance cannot be met");
        assert_eq!(a.vertices, b.vertices);
        assert!((a.mean - b.mean).abs() < 1e-9 && (a.percentile_95 - b.percentile_95).abs() < 1e-9);
        let difference = crate::uncertainty::compare(&octree, &dense, 20_000, 0).unwrap();
        assert!(difference.in_box.unwrap().max <= 0.01, "the tolerance");
    }

    #[test]
    fn other_criteria_hold_too() {
        let field = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(4, [32, 32]);
        let refined = |criteria: Vec<Criterion>| {
            let criteria = criteria.into_iter().collect();
            let settings = GridSettings { criteria, level: 5, ..GridSettings::default() };
            let domain = Domain::Box(field.bounds());
            let lattice = settings.lattice(domain).unwrap();
            let stream = RaySettings::default().stream(&field, &cameras, &settings, &lattice, &Silent).unwrap();
            let run = AutoRun { tolerance: 1e-9, most: 1_000 };
            let (builder, tally, _) = run.run(&stream, settings, domain, &Silent).unwrap();
            let provenance = Provenance { source: "test".into(), tally, share: None, stream: Some(&stream) };
            builder.finish(&provenance).summary().vertices
        };
        // What no ray of a few reached is refined where there is density.
        let sensitive = refined(vec![Criterion::Sensitivity]);
        assert!(refined(vec![Criterion::Sensitivity, Criterion::Density]) > sensitive + 1_000);
    }

    #[test]
    fn the_estimate_is_about_the_true_error_and_ends_the_run() {
        let (truth, ..) = run(GridKind::Octree, 1e-9, 500_000);
        let truth = truth.on_dense_grid();
        let moved = truth.prior() / 10_f64.sqrt();
        for tolerance in [0.2, 0.1] {
            let (field, tally, error) = run(GridKind::Octree, tolerance, 250_000);
            let field = field.on_dense_grid();
            assert!(error.mean <= tolerance && tally.rays < 250_000, "{tally:?} {error:?}");
            let pairs = field.deviations().iter().zip(truth.deviations().iter());
            let errors: Vec<f64> = pairs.filter(|(a, _)| *a < moved).map(|(a, b)| (a / b).log10().abs()).collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            // Two-sided: a quarter more or less, for what the truth is off by itself and for vertices on either side of half a decade.
            assert!((0.75..1.33).contains(&(error.mean / mean)), "estimated {}, found {mean}", error.mean);
        }
    }
}
