//! Training rays as a stream of samples with Jacobians.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::by_camera::CameraByCamera;
use super::pixels::{PixelSample, PixelSequence, Pixels};
use super::portions::{GROUP, Portions};
use super::seeds::Purpose;
use super::shard::{BATCH, RaySet, RunProgress, Shard};
use crate::geometry::{Camera, Mask, Ray, check_sizes};
use crate::monitor::{Monitor, check};
use crate::render::{RayBatch, RaySamples, Renderer, WeightedSamples};
use crate::{Error, Result};

/// Largest fraction of rays that may be dropped because the field was not finite. Beyond it, a run fails.
pub const MAX_DROPPED_SHARE: f64 = 0.01;

/// Threads that a group of rays of splats keeps busy. A group takes about 1.3 kB for each of its 8,192 rays, so that
/// more of them at once than threads need only fill the memory.
const THREADS_PER_GROUP: usize = 4;
/// Most cameras that a pilot or a check looks through, if each of their views has to be prepared.
const MAX_PREPARED_CAMERAS: usize = 16;

/// Least weight in its pixel of a sample on a visible surface.
pub const SURFACE_WEIGHT: f32 = 0.05;

/// Rays that a thread traces together in search of surfaces: one may have hundreds of samples.
const RAYS_TRACED: usize = 32;

/// Points that a batch of rays evaluates when it begins: a round of samples along each ray.
const FIRST_POINTS: usize = 4096;
/// Batches drawn together start with this multiple of the field's batch size, so that calls stay large after most rays
/// have ended.
const AT_FIRST: usize = 4;

/// Batches that are passed to the posterior together: their number, and their samples in ray order.
type Group = (u64, Vec<RaySamples>);

/// How a stream of rays ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum End {
    /// After its last ray.
    Complete(RunProgress),
    /// After these rays, because the monitor requested it.
    Stopped(RunProgress),
}

/// Draws pixels from all training images and differentiates them.
pub struct RayStream<'a> {
    /// The model.
    #[doc(hidden)]
    pub source: Arc<dyn Renderer + 'a>,
    /// Training cameras, at least one.
    pub cameras: &'a [Camera],
    /// Position of rays within their pixel; ½ is the centre.
    pub pixel_offset: f64,
    /// The pixels in their order.
    #[doc(hidden)]
    pub pixels: PixelSequence,
}

impl<'a> RayStream<'a> {
    /// The same stream with other pixels, wherever they look.
    #[must_use]
    pub fn with_pixels(&self, kind: Pixels, seed: u64) -> RayStream<'a> {
        let pixels = self.pixels.reordered(kind, seed);
        RayStream { source: Arc::clone(&self.source), pixels, ..*self }
    }

    /// The same stream over the pixels that masks keep, one or none for each camera.
    ///
    /// # Errors
    /// If the masks are not those of the cameras, or if they keep no pixel.
    pub fn with_masks(self, masks: &[Option<Mask>]) -> Result<Self> {
        if masks.iter().all(Option::is_none) {
            return Ok(self);
        }
        check_sizes(self.cameras, masks)?;
        if masks.iter().flatten().all(|mask| mask.pixels() == 0) && masks.iter().all(Option::is_some) {
            return Err(Error::setting("masks", "pixels that were trained on", "masks that keep none"));
        }
        let resolutions = self.cameras.iter().map(|camera| camera.resolution).collect();
        let pixels = PixelSequence::masked(self.pixels.kind(), self.pixels.seed(), resolutions, masks.to_vec());
        Ok(Self { pixels, ..self })
    }

    /// Checksum of everything that the rays depend on: the cameras, and their masks if they have any.
    #[must_use]
    pub fn cameras_checksum(&self) -> u32 {
        Camera::checksum_with(self.cameras, self.pixels.masks())
    }

    /// The same stream through few cameras, spread over all, if each costs as much as thousands of rays.
    #[must_use]
    pub(crate) fn through_few_cameras(&self) -> RayStream<'a> {
        let few = RayStream { source: Arc::clone(&self.source), pixels: self.pixels.clone(), ..*self };
        match self.source.marched() {
            Some(_) => few,
            None => RayStream { pixels: self.pixels.thinned(MAX_PREPARED_CAMERAS), ..few },
        }
    }

    /// Number of cameras that rays come from.
    pub(crate) fn cameras_in_use(&self) -> usize {
        // No round is longer.
        self.pixels.shares(1 << 20).into_iter().filter(|share| *share > 0).count()
    }

    /// The same stream with the pixels that its run draws for another purpose.
    #[must_use]
    pub(crate) fn for_purpose(&self, purpose: Purpose) -> RayStream<'a> {
        self.with_pixels(self.pixels.kind(), purpose.seed(self.pixels.seed()))
    }

    /// The draw made by a complete run of this shard of the stream.
    #[must_use]
    pub fn ray_set(&self, shard: Shard) -> RaySet {
        RaySet { seed: self.pixels.seed(), shard }
    }

    /// The samples of some batches of a shard, in groups. If the monitor was interrupted, some are missing.
    fn samples(
        &self,
        shard: &Shard,
        batches: Range<u64>,
        rays_together: u64,
        by_camera: &mut Option<CameraByCamera<'_>>,
        monitor: &dyn Monitor,
    ) -> Result<Vec<Group>> {
        let rays = |n| shard.rays_of(shard.batch(n));
        let grouped = |all: Vec<RaySamples>| {
            let mut all = all.into_iter();
            let group = |_| all.by_ref().take(GROUP as usize).collect::<Vec<_>>();
            let groups = batches.clone().step_by(GROUP as usize).map(group);
            groups.map(|group| (group.len() as u64, group)).collect()
        };
        let Some(volume) = self.source.marched() else {
            let of = |n| (shard.batch(n) * BATCH)..(shard.batch(n) * BATCH + rays(n));
            return by_camera.as_mut().map_or(Ok(Vec::new()), |by_camera| {
                by_camera.samples(&batches.clone().map(of).collect::<Vec<_>>(), monitor).map(grouped)
            });
        };
        let drawn: Vec<RayBatch> = batches.clone().into_par_iter().map(|n| self.batch(shard, n)).collect();
        let advance = |rays| monitor.advance(rays);
        if volume.batch() > 0 {
            return Ok(grouped(volume.samples(&drawn, monitor, advance)?));
        }
        let portions: Vec<RayBatch> = drawn.iter().flat_map(|batch| batch.portions(rays_together as usize)).collect();
        Ok(vec![(batches.end - batches.start, volume.samples(&portions, monitor, advance)?)])
    }

    /// Rays of one batch, each with its jitter.
    fn picked(&self, batch: u64, count: u64) -> Vec<(Ray, f64)> {
        let picks = self.pixels.picks(batch * BATCH, count);
        let ray = |pick: &PixelSample| {
            let [x, y] = pick.pixel.map(|i| f64::from(i) + self.pixel_offset);
            (self.cameras[pick.camera].ray(x, y), pick.jitter)
        };
        picks.iter().map(ray).collect()
    }

    /// Batch `n` of a shard.
    fn batch(&self, shard: &Shard, n: u64) -> RayBatch {
        let batch = shard.batch(n);
        let (rays, jitter) = self.picked(batch, shard.rays_of(batch)).into_iter().unzip();
        RayBatch { rays, jitter, first: batch * BATCH }
    }

    /// Draws the rays of `shard` and passes their samples to `sink`, in ray order, with the progress that
    /// includes them.
    ///
    /// A stopped run is resumed after the progress `from`. A field that prefers many points at once
    /// ([`RadianceField::batch`](crate::field::RadianceField::batch)) gets them, on the thread that calls this; the
    /// samples are the same.
    ///
    /// # Errors
    /// What `sink` returns, [`Error::Interrupted`], or [`Error::NonFinite`] if more than
    /// [`MAX_DROPPED_SHARE`] of the rays were dropped.
    pub fn run(
        &self,
        shard: Shard,
        from: RunProgress,
        monitor: &dyn Monitor,
        sink: impl FnMut(&[RaySamples], &RunProgress) -> Result<()>,
    ) -> Result<RunProgress> {
        match self.run_until(shard, from, monitor, sink)? {
            End::Complete(progress) => Ok(progress),
            End::Stopped(_) => Err(Error::Interrupted),
        }
    }

    /// As [`RayStream::run`], but a request of the monitor to stop is no error.
    ///
    /// # Errors
    /// What `sink` returns, or [`Error::NonFinite`].
    pub(crate) fn run_until(
        &self,
        shard: Shard,
        from: RunProgress,
        monitor: &dyn Monitor,
        mut sink: impl FnMut(&[RaySamples], &RunProgress) -> Result<()>,
    ) -> Result<End> {
        monitor.begin("rays", shard.own_rays());
        monitor.advance(from.rays);
        let mut progress = from;
        // Groups of batches that are drawn at once; of a volume that answers any number of points, less than one.
        let (groups, mut by_camera) = match self.source.marched() {
            Some(volume) => ((AT_FIRST * volume.batch()).div_ceil(FIRST_POINTS * GROUP as usize) as u64, None),
            None => {
                let Self { cameras, pixels, pixel_offset, .. } = self;
                let by_camera = CameraByCamera::new(&*self.source, cameras, pixels, *pixel_offset, shard.rays)?;
                (rayon::current_num_threads().div_ceil(THREADS_PER_GROUP) as u64, Some(by_camera))
            }
        };
        while progress.batches < shard.batches() {
            if monitor.interrupted() {
                return Ok(End::Stopped(progress));
            }
            let portions = Portions::after(&progress);
            let most = if groups == 0 { portions.batches } else { groups * GROUP };
            let drawn = progress.batches..(progress.batches + most).min(shard.batches());
            let samples = self.samples(&shard, drawn, portions.rays, &mut by_camera, monitor);
            // After a request to stop, no group is passed on that may be incomplete.
            if matches!(samples, Err(Error::Interrupted)) || monitor.interrupted() {
                return Ok(End::Stopped(progress));
            }
            for (batches, group) in samples? {
                let own = progress.batches..progress.batches + batches;
                progress.rays += own.map(|n| shard.rays_of(shard.batch(n))).sum::<u64>();
                progress.batches += batches;
                for batch in &group {
                    progress.samples += batch.positions.len() as u64;
                    progress.dropped += batch.dropped;
                    progress.first_invalid = progress.first_invalid.or(batch.first_invalid.map(|x| x.to_array()));
                }
                sink(&group, &progress)?;
            }
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
            _ => Ok(End::Complete(progress)),
        }
    }
}

impl RayStream<'_> {
    /// Finds up to `count` points on visible surfaces, `[n]` in scene units.
    ///
    /// These are the samples of weight ≥ [`SURFACE_WEIGHT`] along at most `rays` rays, in ray order. The rays are
    /// traced but not differentiated.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn surface_points(&self, count: usize, rays: u64, monitor: &dyn Monitor) -> Result<Vec<[f32; 3]>> {
        self.surface_points_where(&|_| true, count, rays, monitor)
    }

    /// [`RayStream::surface_points`] at which `counts` holds.
    pub(crate) fn surface_points_where(
        &self,
        counts: &(dyn Fn(Vec3) -> bool + Sync),
        count: usize,
        rays: u64,
        monitor: &dyn Monitor,
    ) -> Result<Vec<[f32; 3]>> {
        let mut points = Vec::new();
        let Some(volume) = self.source.marched() else {
            let found = self.through_few_cameras().surface_by_camera(counts, rays, monitor)?;
            // Camera by camera, so that the first would be those of few.
            let every = found.len().div_ceil(count).max(1);
            return Ok(found.into_iter().step_by(every).collect());
        };
        let batches = rays.div_ceil(BATCH);
        for group in (0..batches).step_by(GROUP as usize) {
            check(monitor)?;
            let group: Vec<u64> = (group..(group + GROUP).min(batches)).collect();
            // A field that prefers many points at once sees the whole group as one.
            let (each, together) = if volume.batch() > 0 { (group.len(), usize::MAX) } else { (1, RAYS_TRACED) };
            let found: Vec<Vec<[f32; 3]>> = group
                .par_chunks(each)
                .map(|batches| {
                    let of_batch = |&batch: &u64| self.picked(batch, BATCH.min(rays - batch * BATCH));
                    let (rays, jitter): (Vec<Ray>, Vec<f64>) = batches.iter().flat_map(of_batch).unzip();
                    let mut found = Vec::new();
                    for (rays, jitter) in rays.chunks(together).zip(jitter.chunks(together)) {
                        visible(&volume.weighted_rays(rays, jitter), counts, &mut found);
                    }
                    found
                })
                .collect();
            points.extend(found.into_iter().flatten().take(count - points.len()));
            if points.len() == count {
                break;
            }
        }
        Ok(points)
    }

    /// The positions of all samples that `rays` rays show with a weight of at least [`SURFACE_WEIGHT`].
    fn surface_by_camera(
        &self,
        counts: &(dyn Fn(Vec3) -> bool + Sync),
        rays: u64,
        monitor: &dyn Monitor,
    ) -> Result<Vec<[f32; 3]>> {
        let mut points = Vec::new();
        for (camera, share) in self.pixels.shares(rays).into_iter().enumerate().filter(|(_, share)| *share > 0) {
            let at = |n| self.pixels.of_camera(camera, n).pixel.map(|i| f64::from(i) + self.pixel_offset);
            let views = [(self.cameras[camera], (0..share).map(at).collect())];
            visible(&self.source.weighted(&views, monitor)?, counts, &mut points);
        }
        Ok(points)
    }
}

/// Appends the positions of samples of weight ≥ [`SURFACE_WEIGHT`] at which `counts` holds.
fn visible(samples: &WeightedSamples, counts: &(dyn Fn(Vec3) -> bool + Sync), found: &mut Vec<[f32; 3]>) {
    let weighted = samples.weights.iter().zip(&samples.positions);
    let is_visible = |(w, x): &(&f64, &Vec3)| **w >= f64::from(SURFACE_WEIGHT) && counts(**x);
    found.extend(weighted.filter(is_visible).map(|(_, x)| x.to_array()));
}

#[cfg(test)]
mod tests;
