//! Runs that end when a mean error is reached.
//!
//! The rays are drawn in two halves of equal size, each with its own sums and its own, independent pixels. Where
//! log10 U of the halves differs by Δ, the whole is off by about Δ/2, because its variance is half of theirs. Δ
//! is measured at every vertex that moved from the prior, each time that the number of rays has doubled. (Halves
//! of one low-discrepancy sequence would complement each other, and their difference would be twice too large.)
//!
//! Of pooled fields, the halves share what pooling smears. There, the mean of the halves'
//! [error bars](crate::uncertainty::ErrorBars) takes the place of Δ/2, over the vertices whose error is known.

use super::builder::{Builder, FieldSource};
use crate::Result;
use crate::metrics::quantile;
use crate::monitor::Monitor;
use crate::rays::{Purpose, RaySet, RayStream, RunProgress, Shard};
use crate::uncertainty::{Finish, MOVED, UncertaintyField};

/// Number of rays before the first measurement.
const FIRST_RAYS: u64 = 65_536;

/// Estimated error of log10 U at the vertices that moved by more than half a decade from the prior; of pooled fields at
/// those whose error is known.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct SamplingError {
    /// Number of these vertices.
    pub vertices: usize,
    /// Mean of |Δ log10 U|.
    pub mean: f64,
    /// 95th percentile of |Δ log10 U|.
    pub percentile_95: f64,
}

impl SamplingError {
    /// From the error bars of two halves.
    fn from_bars(field: &UncertaintyField) -> Self {
        Self::from_errors(field.errors_of_moved().flatten().collect())
    }

    /// From log10 U by two treatments at these vertices.
    pub(super) fn from_pairs(pairs: &[(f64, f64)]) -> Self {
        Self::from_errors(pairs.iter().map(|(a, b)| (a - b).abs()).collect())
    }

    /// From |Δ log10 U| at these vertices.
    fn from_errors(mut errors: Vec<f64>) -> Self {
        if errors.is_empty() {
            return Self { vertices: 0, mean: 0.0, percentile_95: 0.0 };
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        errors.sort_unstable_by(f64::total_cmp);
        Self { vertices: errors.len(), mean, percentile_95: quantile(&errors, 0.95) }
    }
}

/// One half of the rays: its sums and its progress.
type Half<P> = (Builder<P>, RunProgress);

/// Draws two halves of rays into two builders until the estimated mean error of log10 U is within `decades`, or `most`
/// rays are drawn.
///
/// The first half uses the pixels of `stream`; the second has its own.
///
/// # Errors
/// As [`RayStream::run`], or if sums cannot leave memory.
pub(super) fn draw<P: Finish>(
    builders: [Builder<P>; 2],
    stream: &RayStream,
    decades: f64,
    most: u64,
    monitor: &dyn Monitor,
) -> Result<([Half<P>; 2], SamplingError)> {
    let other_pixels = stream.for_purpose(Purpose::SecondHalf);
    let streams = [stream, &other_pixels];
    let is_pooled = builders[0].settings().pooling.is_on();
    let mut halves = builders.map(|builder| (builder, RunProgress::default()));
    let mut rays = FIRST_RAYS.min(most);
    loop {
        for ((builder, progress), stream) in halves.iter_mut().zip(streams) {
            *progress = stream.run(Shard::whole((rays / 2).max(1)), *progress, monitor, |batches, _| {
                builder.add_within_budget(batches).map(|_| ())
            })?;
        }
        // Error bars are made of a copy of both halves.
        Builder::spill_both(halves.each_mut().map(|half| &mut half.0), is_pooled)?;
        let error = if is_pooled {
            SamplingError::from_bars(&with_error_bars(&halves, stream)?)
        } else {
            let drawn = halves.iter().map(|half| half.1.rays).sum();
            SamplingError::from_errors(halves[0].0.errors(&halves[1].0, drawn)?)
        };
        if error.vertices > 0 && error.mean <= decades || rays == most {
            return Ok((halves, error));
        }
        rays = (2 * rays).min(most);
    }
}

/// The field of two halves so far, with the error bars of their disagreement.
fn with_error_bars<P: Finish>(halves: &[Half<P>; 2], stream: &RayStream) -> Result<UncertaintyField> {
    let groups = halves.iter().map(|(builder, _)| builder.clone()).collect();
    let progress = halves.each_ref().map(|half| half.1);
    let source = FieldSource { progress: progress.into_iter().sum(), stream: Some(stream), ..FieldSource::default() };
    Builder::finish_groups(groups, ray_sets(stream, halves), &progress, &source)
}

/// The two halves of `stream`'s rays.
pub(super) fn ray_sets<P>(stream: &RayStream, halves: &[Half<P>; 2]) -> Vec<RaySet> {
    let [first, second] = halves.each_ref().map(|half| Shard::whole(half.1.rays));
    vec![stream.ray_set(first), stream.for_purpose(Purpose::SecondHalf).ray_set(second)]
}

impl<P: Finish> Builder<P> {
    /// Half the difference of log10 U between this builder and another, each with half of `rays`, at the vertices that
    /// both together move by more than half a decade.
    fn errors(&self, other: &Self, rays: u64) -> Result<Vec<f64>> {
        let lambda = self.settings().prior_precision(self.lattice());
        let covariance = self.settings().covariance;
        let moved = covariance.prior(lambda) * 10_f64.powf(-MOVED);
        self.paired(other, |mine, theirs| {
            let mut sum = mine;
            sum += &theirs;
            let [a, b] = [mine, theirs].map(|half| covariance.deviation(&half, rays / 2, lambda).log10());
            (covariance.deviation(&sum, rays, lambda) < moved).then(|| 0.5 * (a - b).abs())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Estimation, GridKind, GridSettings, Outcome, RayError, RaySettings};
    use crate::field::ClosedForm;
    use crate::posterior::{Criterion, Pooling};
    use crate::uncertainty::{MOVED, Support};

    fn run(grid: GridKind, decades: f64, most: u64) -> (Outcome, SamplingError) {
        run_on(GridSettings::default().grid(grid), decades, most)
    }

    fn run_on(grid: GridSettings, decades: f64, most: u64) -> (Outcome, SamplingError) {
        let field = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(10, [100, 100]);
        let rays = RaySettings { rays: most, ..RaySettings::default() };
        let grid = GridSettings { level: 5, ..grid };
        let outcome = Estimation::new(&field, &cameras).rays(rays).grid(grid).until_mean_error(decades).run().unwrap();
        let Some(RayError::Halves(error)) = outcome.errors.rays else { panic!("{:?}", outcome.errors) };
        (outcome, error)
    }

    #[test]
    fn the_halves_add_up_on_either_grid() {
        let (octree, a) = run(GridKind::Octree, 1e-9, 20_000);
        let (dense, b) = run(GridKind::Dense, 1e-9, 20_000);
        assert_eq!(octree.progress.rays, 20_000, "the error cannot be reached");
        assert_eq!(a.vertices, b.vertices);
        assert!((a.mean - b.mean).abs() < 1e-9 && (a.percentile_95 - b.percentile_95).abs() < 1e-9);
        let difference = crate::uncertainty::compare(&octree.field, &dense.field, 20_000, 0).unwrap();
        assert!(difference.in_box.unwrap().max <= 0.01, "the tolerance");
    }

    #[test]
    fn other_criteria_hold_too() {
        let field = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(4, [32, 32]);
        let refined = |criteria: Vec<Criterion>| {
            let criteria = criteria.into_iter().collect();
            let grid = GridSettings { criteria, level: 5, ..GridSettings::default() };
            let rays = RaySettings { rays: 1_000, ..RaySettings::default() };
            let run = Estimation::new(&field, &cameras).rays(rays).grid(grid).until_mean_error(1e-9);
            run.run().unwrap().field.summary().vertices
        };
        // Space that none of a few rays reached is refined where there is density.
        let sensitive = refined(vec![Criterion::Sensitivity]);
        assert!(refined(vec![Criterion::Sensitivity, Criterion::Density]) > sensitive + 1_000);
    }

    #[test]
    #[ignore = "slow: a reference of 400,000 rays"]
    fn the_estimate_is_about_the_true_error_and_ends_the_run() {
        let many = 400_000;
        let truth = run(GridKind::Octree, 1e-9, many).0.field.on_dense_grid();
        let moved = truth.prior() * 10_f64.powf(-MOVED);
        for pooling in [Pooling::Off, Pooling::Auto] {
            let grid = GridSettings::default().pooling(pooling);
            let (Outcome { field, progress, .. }, error) = run_on(grid, 0.1, many);
            assert!(error.mean <= 0.1 && progress.rays < many / 2, "{progress:?} {error:?}");
            let Support::Octree(tree) = field.support() else { panic!("an octree was asked for") };
            // Where pooling moves a vertex that few rays have seen, the error is unknown.
            let least = if pooling.is_on() { 4 } else { 0 };
            let counts = |v: usize| field.deviations().get(v) < moved && field.sums().unwrap()[v].rays >= least;
            let error_at = |(v, point)| {
                let at_limit = truth.deviations().get(truth.lattice().dense_index(point));
                (field.deviations().get(v) / at_limit).log10().abs()
            };
            let vertices = tree.vertex_positions().enumerate().filter(|(v, _)| counts(*v));
            let errors: Vec<f64> = vertices.map(error_at).collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            // The reference has the run's own rays and more: of n and N rays, they differ by √(1 − n/N) of the error.
            let mean = mean / (1.0 - progress.rays as f64 / many as f64).sqrt();
            // Two-sided: a quarter more or less allows for the error of the reference itself and for vertices
            // on either side of half a decade.
            assert!((0.75..1.33).contains(&(error.mean / mean)), "{pooling}: estimated {}, found {mean}", error.mean);
        }
    }
}
