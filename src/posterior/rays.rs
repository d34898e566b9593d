//! Training rays, as a stream of samples with Jacobians.

use std::collections::{HashMap, HashSet};

use rayon::prelude::*;

use super::pixels::{Pick, PixelSequence, Pixels};
use super::seeds::Purpose;
use crate::geometry::{Camera, Ray};
use crate::monitor::{Monitor, check};
use crate::render::{Differentiation, JacobianBuffers, Quadrature, RaySamples, TraceBuffers, TracedRays, Tracer};
use crate::{Error, Result};

/// Rays per batch: batch b holds rays b · 512 …; any batch can be drawn alone.
const BATCH: u64 = 512;
/// Batches between two visits to the posterior.
const GROUP: u64 = 16;
/// A run fails if a larger share of its rays is dropped because the field was not finite.
pub const MAX_DROPPED_SHARE: f64 = 0.01;

/// A sample with at least this share of its pixel lies on a visible surface.
pub const SURFACE_WEIGHT: f32 = 0.05;

/// Draws pixels from all training images and differentiates them.
pub struct RayStream<'a> {
    /// Field, sampling and background.
    pub tracer: Tracer<'a>,
    /// How the field is differentiated.
    pub differentiation: Differentiation<'a>,
    /// By how much ‖∂C/∂x‖ of any sample may be off for what is left out beside the cutoff, 1 / scene unit; 0 leaves out nothing.
    pub negligible: f64,
    /// Training cameras, at least one.
    pub cameras: &'a [Camera],
    /// Where in a pixel the ray goes through: ½ is its centre.
    pub pixel_offset: f64,
    /// Which pixels, in which order.
    pub pixels: PixelSequence,
}

/// Which rays of a run are drawn: batches `index`, `index + of`, `index + 2 · of`, … of a run of `rays` rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct Share {
    /// Rays of the whole run.
    pub rays: u64,
    /// Which part this is, from 0.
    pub index: u64,
    /// Parts that the run is split into.
    pub of: u64,
}

impl Share {
    /// All rays of a run.
    #[must_use]
    pub fn whole(rays: u64) -> Self {
        Self { rays, index: 0, of: 1 }
    }

    /// Batches of this part.
    fn batches(&self) -> u64 {
        self.rays.div_ceil(BATCH).saturating_sub(self.index).div_ceil(self.of)
    }

    /// Index in the whole run of this part's n-th batch.
    fn batch(&self, n: u64) -> u64 {
        self.index + n * self.of
    }

    /// Rays of a batch of the whole run.
    fn rays_of(&self, batch: u64) -> u64 {
        BATCH.min(self.rays - batch * BATCH)
    }

    /// Whether a run of this part can have come as far as `tally` says.
    #[must_use]
    pub fn admits(&self, tally: &Tally) -> bool {
        tally.batches <= self.batches() && tally.rays <= self.own_rays() && tally.dropped <= tally.rays
    }

    /// Whether this is a part of something: at least one ray and part, and an index below their number.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.rays > 0 && self.of > 0 && self.index < self.of
    }

    /// Rays of this part.
    #[must_use]
    pub fn own_rays(&self) -> u64 {
        // Only the run's last batch can be short.
        self.batches().checked_sub(1).map_or(0, |last| last * BATCH + self.rays_of(self.batch(last)))
    }
}

/// The rays of one sequence of pixels that sums are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
pub struct Draw {
    /// Seed of the sequence's pixels and jitter.
    pub seed: u64,
    /// Which of its rays.
    pub share: Share,
}

impl Draw {
    /// Whether these rays are but a part of a run.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.share.of > 1
    }

    /// Whether no two of these can have a ray in common.
    ///
    /// Batch b of a seed is the same in every run, whatever the run's length. Of one seed, therefore, only different
    /// parts of the same run are disjoint.
    #[must_use]
    pub fn are_disjoint(draws: impl IntoIterator<Item = Self>) -> bool {
        let mut split = HashMap::new();
        let mut parts = HashSet::new();
        draws.into_iter().all(|draw| {
            let Share { rays, of, .. } = draw.share;
            *split.entry(draw.seed).or_insert((rays, of)) == (rays, of) && parts.insert(draw)
        })
    }

    /// The same rays in as few draws as possible, sorted: parts that make up a run become the run.
    #[must_use]
    pub fn joined(draws: impl IntoIterator<Item = Self>) -> Vec<Self> {
        let mut draws: Vec<Self> = draws.into_iter().collect();
        draws.sort_unstable_by_key(|draw| (draw.seed, draw.share.rays, draw.share.of, draw.share.index));
        let of_one_run = |a: &Self, b: &Self| (a.seed, a.share.rays, a.share.of) == (b.seed, b.share.rays, b.share.of);
        let join = |parts: &[Self]| {
            let Self { seed, share } = parts[0];
            let are_all = parts.iter().map(|part| part.share.index).eq(0..share.of);
            if are_all { vec![Self { seed, share: Share::whole(share.rays) }] } else { parts.to_vec() }
        };
        draws.chunk_by(of_one_run).flat_map(join).collect()
    }
}

/// What came out of a run so far, apart from the samples themselves: also the place where it can be taken up again.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Tally {
    /// Batches of the share that are done.
    pub batches: u64,
    /// Rays drawn: R.
    pub rays: u64,
    /// Samples with a Jacobian.
    pub samples: u64,
    /// Rays dropped because the field was not finite.
    pub dropped: u64,
    /// Position of the first sample that was not.
    pub first_invalid: Option<[f32; 3]>,
}

impl Tally {
    /// Both runs together.
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        Self {
            batches: self.batches + other.batches,
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
            dropped: self.dropped + other.dropped,
            first_invalid: self.first_invalid.or(other.first_invalid),
        }
    }
}

impl<'a> RayStream<'a> {
    /// The same stream with other pixels.
    #[must_use]
    pub fn with_pixels(&self, kind: Pixels, seed: u64) -> RayStream<'a> {
        let resolutions = self.cameras.iter().map(|c| c.resolution).collect();
        RayStream { tracer: self.tracer.clone(), pixels: PixelSequence::new(kind, seed, resolutions), ..*self }
    }

    /// The same stream with the pixels that its run draws for another purpose.
    #[must_use]
    pub fn for_purpose(&self, purpose: Purpose) -> RayStream<'a> {
        self.with_pixels(self.pixels.kind(), purpose.seed(self.pixels.seed()))
    }

    /// What is drawn by a run of this part of the stream, to its end.
    #[must_use]
    pub fn draw(&self, share: Share) -> Draw {
        Draw { seed: self.pixels.seed(), share }
    }

    /// Rays and jitters of one batch.
    fn batch(&self, batch: u64, count: u64) -> (Vec<Ray>, Vec<f64>) {
        let picks = self.pixels.picks(batch * BATCH, count);
        let ray = |pick: &Pick| {
            let [x, y] = pick.pixel.map(|i| f64::from(i) + self.pixel_offset);
            (self.cameras[pick.camera].ray(x, y), pick.jitter)
        };
        picks.iter().map(ray).unzip()
    }

    /// Draws the rays of `share` and hands their samples to `sink`, in ray order, with the tally that includes them. A run that
    /// stopped goes on behind the tally `from`.
    ///
    /// # Errors
    /// What `sink` returns, [`Error::Interrupted`], or [`Error::NonFinite`] if more than [`MAX_DROPPED_SHARE`] of the rays
    /// were dropped.
    pub fn run(
        &self,
        share: Share,
        from: Tally,
        monitor: &dyn Monitor,
        mut sink: impl FnMut(&[RaySamples], &Tally) -> Result<()>,
    ) -> Result<Tally> {
        monitor.begin("rays", share.own_rays());
        monitor.advance(from.rays);
        let mut tally = from;
        while tally.batches < share.batches() {
            check(monitor)?;
            let group = tally.batches..(tally.batches + GROUP).min(share.batches());
            let samples: Vec<RaySamples> = group
                .clone()
                .into_par_iter()
                .map_init(JacobianBuffers::default, |buffers, n| {
                    let batch = share.batch(n);
                    let (rays, jitter) = self.batch(batch, share.rays_of(batch));
                    let (first, how) = (batch * BATCH, &self.differentiation);
                    let samples = self.tracer.jacobians(&rays, &jitter, first, how, self.negligible, buffers);
                    monitor.advance(rays.len() as u64);
                    samples
                })
                .collect();
            tally.batches = group.end;
            tally.rays += group.map(|n| share.rays_of(share.batch(n))).sum::<u64>();
            for batch in &samples {
                tally.samples += batch.positions.len() as u64;
                tally.dropped += batch.dropped;
                tally.first_invalid = tally.first_invalid.or(batch.first_invalid.map(|x| x.to_array()));
            }
            sink(&samples, &tally)?;
        }
        monitor.end();
        match tally.first_invalid {
            Some(first) if tally.dropped as f64 > MAX_DROPPED_SHARE * tally.rays as f64 => Err(Error::NonFinite {
                dropped: tally.dropped,
                rays: tally.rays,
                limit_percent: 100.0 * MAX_DROPPED_SHARE,
                first,
            }),
            _ => Ok(tally),
        }
    }
}

impl RayStream<'_> {
    /// Up to `count` points on visible surfaces, `[n]` scene units: samples of weight ≥ [`SURFACE_WEIGHT`], in ray order,
    /// found by tracing at most `rays` rays without differentiating them.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn surface_points(&self, count: usize, rays: u64, monitor: &dyn Monitor) -> Result<Vec<[f32; 3]>> {
        let mut points = Vec::new();
        let batches = rays.div_ceil(BATCH);
        for group in (0..batches).step_by(GROUP as usize) {
            check(monitor)?;
            let found: Vec<Vec<[f32; 3]>> = (group..(group + GROUP).min(batches))
                .into_par_iter()
                .map_init(TraceBuffers::default, |buffers, batch| {
                    let (rays, jitter) = self.batch(batch, BATCH);
                    self.tracer.trace(&rays, &jitter, buffers);
                    visible(&buffers.traced, self.tracer.marcher.step)
                })
                .collect();
            points.extend(found.into_iter().flatten().take(count - points.len()));
            if points.len() == count {
                break;
            }
        }
        Ok(points)
    }
}

/// Samples of weight ≥ [`SURFACE_WEIGHT`].
fn visible(traced: &TracedRays, step: f64) -> Vec<[f32; 3]> {
    let mut quadrature = Quadrature::default();
    quadrature.set(traced, step);
    let weighted = quadrature.weights.iter().zip(&traced.positions);
    weighted.filter(|(w, _)| **w >= f64::from(SURFACE_WEIGHT)).map(|(_, x)| x.to_array()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shares_split_a_run_without_overlap(rays in 1_u64..20_000, of in 1_u64..7) {
            let mut batches: Vec<u64> = Vec::new();
            let mut drawn = 0;
            for index in 0..of {
                let share = Share { rays, index, of };
                batches.extend((0..share.batches()).map(|n| share.batch(n)));
                drawn += share.own_rays();
                prop_assert_eq!(share.own_rays(), (0..share.batches()).map(|n| share.rays_of(share.batch(n))).sum::<u64>());
            }
            batches.sort_unstable();
            prop_assert_eq!(drawn, rays);
            prop_assert_eq!(batches, (0..rays.div_ceil(BATCH)).collect::<Vec<_>>());
        }

        /// Never called disjoint when two draws have a batch of one seed in common; parts of one run always are.
        #[test]
        fn disjoint_draws_have_no_batch_in_common(
            draws in proptest::collection::vec((0_u64..2, 1_u64..3, 1_u64..4, 0_u64..3), 0..5)
        ) {
            let draws: Vec<Draw> = draws
                .into_iter()
                .map(|(seed, rays, of, index)| Draw { seed, share: Share { rays: 4000 * rays, index: index % of, of } })
                .collect();
            let batches = |draw: &Draw| -> Vec<(u64, u64)> {
                let Draw { seed, share } = *draw;
                (0..share.batches()).map(|n| (seed, share.batch(n))).collect()
            };
            let mut all: Vec<(u64, u64)> = draws.iter().flat_map(batches).collect();
            let drawn = all.len();
            all.sort_unstable();
            if Draw::are_disjoint(draws.iter().copied()) {
                let joined = Draw::joined(draws.iter().copied());
                let mut again: Vec<(u64, u64)> = joined.iter().flat_map(batches).collect();
                again.sort_unstable();
                prop_assert_eq!(&again, &all);
                prop_assert!(joined.len() <= draws.len());
                all.dedup();
                prop_assert_eq!(all.len(), drawn);
            } else {
                let same_run = |a: &Draw, b: &Draw| (a.share.rays, a.share.of) == (b.share.rays, b.share.of);
                let doubtful = |i: usize| draws[..i].iter().any(|a| {
                    let b = &draws[i];
                    a.seed == b.seed && (a == b || !same_run(a, b))
                });
                prop_assert!((0..draws.len()).any(doubtful));
            }
        }
    }

    #[test]
    fn the_parts_of_a_run_are_the_run() {
        let part = |index| Draw { seed: 7, share: Share { rays: 5000, index, of: 3 } };
        let other = Draw { seed: 1, share: Share::whole(10) };
        let whole = Draw { seed: 7, share: Share::whole(5000) };
        assert_eq!(Draw::joined([part(2), other, part(0), part(1)]), [other, whole]);
        assert_eq!(Draw::joined([part(2), part(0)]), [part(0), part(2)]);
    }
}
