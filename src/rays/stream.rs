//! Training rays, as a stream of samples with Jacobians.

use rayon::prelude::*;

use super::pixels::{Pick, PixelSequence, Pixels};
use super::progress::RunProgress;
use super::seeds::Purpose;
use super::shard::{BATCH, Draw, Shard};
use crate::geometry::{Camera, Ray};
use crate::monitor::{Monitor, check};
use crate::render::{Differentiation, JacobianBuffers, Quadrature, RaySamples, TraceBuffers, TracedRays, Tracer};
use crate::{Error, Result};

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
    pub fn draw(&self, shard: Shard) -> Draw {
        Draw { seed: self.pixels.seed(), shard }
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

    /// Draws the rays of `shard` and hands their samples to `sink`, in ray order, with the progress that includes them. A run that
    /// stopped goes on behind the progress `from`.
    ///
    /// # Errors
    /// What `sink` returns, [`Error::Interrupted`], or [`Error::NonFinite`] if more than [`MAX_DROPPED_SHARE`] of the rays
    /// were dropped.
    pub fn run(
        &self,
        shard: Shard,
        from: RunProgress,
        monitor: &dyn Monitor,
        mut sink: impl FnMut(&[RaySamples], &RunProgress) -> Result<()>,
    ) -> Result<RunProgress> {
        monitor.begin("rays", shard.own_rays());
        monitor.advance(from.rays);
        let mut progress = from;
        while progress.batches < shard.batches() {
            check(monitor)?;
            let group = progress.batches..(progress.batches + GROUP).min(shard.batches());
            let samples: Vec<RaySamples> = group
                .clone()
                .into_par_iter()
                .map_init(JacobianBuffers::default, |buffers, n| {
                    let batch = shard.batch(n);
                    let (rays, jitter) = self.batch(batch, shard.rays_of(batch));
                    let (first, how) = (batch * BATCH, &self.differentiation);
                    let samples = self.tracer.jacobians(&rays, &jitter, first, how, self.negligible, buffers);
                    monitor.advance(rays.len() as u64);
                    samples
                })
                .collect();
            progress.batches = group.end;
            progress.rays += group.map(|n| shard.rays_of(shard.batch(n))).sum::<u64>();
            for batch in &samples {
                progress.samples += batch.positions.len() as u64;
                progress.dropped += batch.dropped;
                progress.first_invalid = progress.first_invalid.or(batch.first_invalid.map(|x| x.to_array()));
            }
            sink(&samples, &progress)?;
        }
        monitor.end();
        match progress.first_invalid {
            Some(first) if progress.dropped as f64 > MAX_DROPPED_SHARE * progress.rays as f64 => {
                Err(Error::NonFinite {
                    dropped: progress.dropped,
                    rays: progress.rays,
                    limit_percent: 100.0 * MAX_DROPPED_SHARE,
                    first,
                })
            }
            _ => Ok(progress),
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
