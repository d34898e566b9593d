//! Training rays as a stream of samples with Jacobians.

use rayon::prelude::*;

use super::pixels::{Pick, PixelSequence, Pixels};
use super::progress::RunProgress;
use super::seeds::Purpose;
use super::shard::{BATCH, Draw, Shard};
use crate::geometry::{Camera, Ray};
use crate::monitor::{Monitor, check};
use crate::render::{
    CompositingWeights, Differentiation, JacobianBuffers, RaySamples, TraceBuffers, TracedRays, Tracer,
};
use crate::{Error, Result};

/// Number of batches passed to the posterior together.
const GROUP: u64 = 16;
/// Largest fraction of rays that may be dropped because the field was not finite. Beyond it, a run fails.
pub const MAX_DROPPED_SHARE: f64 = 0.01;

/// Least weight in its pixel of a sample on a visible surface.
pub const SURFACE_WEIGHT: f32 = 0.05;

/// Draws pixels from all training images and differentiates them.
pub struct RayStream<'a> {
    /// Field, sampling and background.
    pub tracer: Tracer<'a>,
    /// The method of differentiating the field.
    pub differentiation: Differentiation<'a>,
    /// Training cameras, at least one.
    pub cameras: &'a [Camera],
    /// Position of rays within their pixel; ½ is the centre.
    pub pixel_offset: f64,
    /// The pixels in their order.
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

    /// The draw made by a complete run of this shard of the stream.
    #[must_use]
    pub fn draw(&self, shard: Shard) -> Draw {
        Draw { seed: self.pixels.seed(), shard }
    }

    /// Rays and jitter of one batch.
    fn batch(&self, batch: u64, count: u64) -> (Vec<Ray>, Vec<f64>) {
        let picks = self.pixels.picks(batch * BATCH, count);
        let ray = |pick: &Pick| {
            let [x, y] = pick.pixel.map(|i| f64::from(i) + self.pixel_offset);
            (self.cameras[pick.camera].ray(x, y), pick.jitter)
        };
        picks.iter().map(ray).unzip()
    }

    /// Draws the rays of `shard` and passes their samples to `sink`, in ray order, with the progress that
    /// includes them.
    ///
    /// A stopped run is resumed after the progress `from`.
    ///
    /// # Errors
    /// What `sink` returns, [`Error::Interrupted`], or [`Error::NonFinite`] if more than
    /// [`MAX_DROPPED_SHARE`] of the rays were dropped.
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
                    let samples = self.tracer.jacobians(&rays, &jitter, first, how, buffers);
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
    /// Finds up to `count` points on visible surfaces, `[n]` in scene units.
    ///
    /// These are the samples of weight ≥ [`SURFACE_WEIGHT`], in ray order, along at most `rays` rays. The rays
    /// are traced but not differentiated.
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

/// Positions of samples of weight ≥ [`SURFACE_WEIGHT`].
fn visible(traced: &TracedRays, step: f64) -> Vec<[f32; 3]> {
    let mut quadrature = CompositingWeights::default();
    quadrature.set(traced, step);
    let weighted = quadrature.weights.iter().zip(&traced.positions);
    weighted.filter(|(w, _)| **w >= f64::from(SURFACE_WEIGHT)).map(|(_, x)| x.to_array()).collect()
}
