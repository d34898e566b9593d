//! Training rays as a stream of samples with Jacobians.

use std::ops::Range;

use rayon::prelude::*;

use super::pixels::{Pick, PixelSequence, Pixels};
use super::progress::RunProgress;
use super::seeds::Purpose;
use super::shard::{BATCH, Draw, Shard};
use crate::geometry::{Aabb, Camera, Mask, Ray};
use crate::monitor::{Monitor, check};
use crate::render::{
    CompositingWeights, Differentiation, JacobianBuffers, RayGroup, RaySamples, RaysTogether, TraceBuffers, TracedRays,
    Tracer,
};
use crate::{Error, Result};

/// Number of batches passed to the posterior together.
const GROUP: u64 = 16;
/// Largest fraction of rays that may be dropped because the field was not finite. Beyond it, a run fails.
pub const MAX_DROPPED_SHARE: f64 = 0.01;

/// Least weight in its pixel of a sample on a visible surface.
pub const SURFACE_WEIGHT: f32 = 0.05;

/// Points that a batch asks about when it begins: a round of samples along each ray.
const FIRST_POINTS: usize = 4096;
/// A field that wants many points at once gets them from batches of rays in different stages. A batch whose last rays
/// are long asks about few points for many rounds: 128 are enough for a hundred such rounds beside a fresh batch. More
/// batches than that makes are not begun, for memory's sake.
const LEAST_POINTS: usize = 128;

/// A run whose batches ask the field together.
struct TogetherRun<'t> {
    shard: Shard,
    /// Number of the shard's batches that have begun.
    begun: u64,
    /// Points that the field wants at once.
    batch: usize,
    together: RaysTogether<'t>,
}

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
    /// Rays that miss this box are drawn and counted, but neither traced nor passed on.
    pub reach: Option<Aabb>,
}

impl<'a> RayStream<'a> {
    /// The same stream with other pixels, wherever they look.
    #[must_use]
    pub fn with_pixels(&self, kind: Pixels, seed: u64) -> RayStream<'a> {
        let pixels = self.pixels.reordered(kind, seed);
        RayStream { tracer: self.tracer.clone(), pixels, reach: None, ..*self }
    }

    /// The same stream over the pixels that masks keep, one or none for each camera.
    ///
    /// # Errors
    /// If the masks are not those of the cameras, or if they keep no pixel.
    pub fn with_masks(self, masks: &[Option<Mask>]) -> Result<Self> {
        if masks.iter().all(Option::is_none) {
            return Ok(self);
        }
        let resolutions: Vec<[u32; 2]> = self.cameras.iter().map(|camera| camera.resolution).collect();
        let sizes: Vec<Option<[u32; 2]>> = masks.iter().map(|mask| mask.as_ref().map(Mask::resolution)).collect();
        let fits = |(size, of): (&Option<[u32; 2]>, &[u32; 2])| size.is_none_or(|size| size == *of);
        if sizes.len() != resolutions.len() || !sizes.iter().zip(&resolutions).all(fits) {
            let expected = format!("a mask or none for each camera, of its size: {resolutions:?}");
            return Err(Error::setting("masks", expected, format!("{sizes:?}")));
        }
        if masks.iter().flatten().all(|mask| mask.pixels() == 0) && masks.iter().all(Option::is_some) {
            return Err(Error::setting("masks", "pixels that were trained on", "masks that keep none"));
        }
        let pixels = PixelSequence::masked(self.pixels.kind(), self.pixels.seed(), resolutions, masks.to_vec());
        Ok(Self { pixels, ..self })
    }

    /// Checksum of everything that the rays depend on: the cameras, and their masks if they have any.
    #[must_use]
    pub fn cameras_checksum(&self) -> u32 {
        let cameras = Camera::checksum(self.cameras);
        let masks = self.pixels.masks();
        if masks.is_empty() {
            return cameras;
        }
        let mut hasher = crc32fast::Hasher::new_with_initial(cameras);
        for mask in masks {
            hasher.update(&mask.as_ref().map_or(0, |mask| 1 | u64::from(mask.checksum()) << 1).to_le_bytes());
        }
        hasher.finalize()
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

    /// The samples of some batches of a shard, each for itself. Batches that begin after the monitor was interrupted
    /// are left out.
    fn draw_apart(&self, shard: &Shard, batches: Range<u64>, monitor: &dyn Monitor) -> Vec<RaySamples> {
        batches
            .into_par_iter()
            .map_init(JacobianBuffers::default, |buffers, n| {
                // So that slow fields stop soon; the caller checks, too.
                if monitor.interrupted() {
                    return RaySamples::default();
                }
                let batch = shard.batch(n);
                let (rays, jitter) = self.batch(batch, shard.rays_of(batch));
                let (first, how) = (batch * BATCH, &self.differentiation);
                let samples = self.tracer.jacobians(&rays, &jitter, first, how, buffers);
                monitor.advance(shard.rays_of(batch));
                samples
            })
            .collect()
    }

    /// The samples of the next `count` batches, of which and of later ones the field is asked together.
    fn draw_together(&self, run: &mut TogetherRun, count: u64, monitor: &dyn Monitor) -> Result<Vec<RaySamples>> {
        let (shard, together) = (run.shard, &mut run.together);
        while (together.finished() as u64) < count {
            check(monitor)?;
            while run.begun < shard.batches()
                && together.points() < run.batch
                && together.running() < run.batch / LEAST_POINTS + GROUP as usize
            {
                let lacking = (run.batch - together.points()).div_ceil(FIRST_POINTS) as u64;
                let next = run.begun..(run.begun + lacking).min(shard.batches());
                run.begun = next.end;
                let group = |n| {
                    let batch = shard.batch(n);
                    let (rays, jitter) = self.batch(batch, shard.rays_of(batch));
                    RayGroup { rays, jitter, first: batch * BATCH }
                };
                together.begin(next.into_par_iter().map(group).collect());
            }
            together.ask();
        }
        let samples = together.take(count as usize);
        let before = run.begun - together.len() as u64 - samples.len() as u64;
        monitor.advance((before..).zip(&samples).map(|(n, _)| shard.rays_of(shard.batch(n))).sum());
        Ok(samples)
    }

    /// Rays of one batch, each with its jitter.
    fn picked(&self, batch: u64, count: u64) -> Vec<(Ray, f64)> {
        let picks = self.pixels.picks(batch * BATCH, count);
        let ray = |pick: &Pick| {
            let [x, y] = pick.pixel.map(|i| f64::from(i) + self.pixel_offset);
            (self.cameras[pick.camera].ray(x, y), pick.jitter)
        };
        picks.iter().map(ray).collect()
    }

    /// Rays and jitter of one batch, without the rays that reach nothing.
    fn batch(&self, batch: u64, count: u64) -> (Vec<Ray>, Vec<f64>) {
        let picked = self.picked(batch, count).into_iter();
        picked.filter(|(ray, _)| self.reach.is_none_or(|reach| reach.clip(ray).is_some())).unzip()
    }

    /// Draws the rays of `shard` and passes their samples to `sink`, in ray order, with the progress that
    /// includes them.
    ///
    /// A stopped run is resumed after the progress `from`. A field that wants many points at once
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
        mut sink: impl FnMut(&[RaySamples], &RunProgress) -> Result<()>,
    ) -> Result<RunProgress> {
        monitor.begin("rays", shard.own_rays());
        monitor.advance(from.rays);
        let mut progress = from;
        let mut together = (self.tracer.field.batch() > 0).then(|| TogetherRun {
            shard,
            begun: from.batches,
            batch: self.tracer.field.batch(),
            together: RaysTogether::new(&self.tracer, &self.differentiation),
        });
        while progress.batches < shard.batches() {
            check(monitor)?;
            let group = progress.batches..(progress.batches + GROUP).min(shard.batches());
            let samples = match &mut together {
                Some(run) => self.draw_together(run, group.end - group.start, monitor)?,
                None => self.draw_apart(&shard, group.clone(), monitor),
            };
            // Whoever asked to stop gets no group that may be incomplete.
            check(monitor)?;
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
            let group: Vec<u64> = (group..(group + GROUP).min(batches)).collect();
            // A field that wants many points at once sees the whole group as one.
            let each = if self.tracer.field.batch() > 0 { group.len() } else { 1 };
            let found: Vec<Vec<[f32; 3]>> = group
                .par_chunks(each)
                .map_init(TraceBuffers::default, |buffers, batches| {
                    let (rays, jitter): (Vec<Ray>, Vec<f64>) =
                        batches.iter().flat_map(|&batch| self.picked(batch, BATCH)).unzip();
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

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::estimate::{GridSettings, RaySettings};
    use crate::field::{ClosedForm, Differentiable, Radiance, RadianceField, RadianceJet, VoxelGrid};
    use crate::geometry::{Aabb, Domain};
    use crate::monitor::Silent;
    use crate::render::GradientMethod;
    use glam::Vec3;

    /// A scene that wants many points at once, and remembers how many it got.
    struct Wide {
        scene: VoxelGrid,
        batch: usize,
        /// Points of every call from the thread of the run.
        calls: Mutex<Vec<usize>>,
    }

    fn scene() -> VoxelGrid {
        VoxelGrid::bake(&ClosedForm::courtyard(), [64; 3], Vec3::Z)
    }

    impl Wide {
        fn note(&self, points: usize) {
            self.calls.lock().unwrap().push(points);
        }
    }

    impl RadianceField for Wide {
        fn bounds(&self) -> Aabb {
            self.scene.bounds()
        }
        fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
            self.note(positions.len());
            self.scene.evaluate(positions, directions, out);
        }
        fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
            self.note(positions.len());
            self.scene.densities(positions, out);
        }
        fn differentiable(&self) -> Option<&dyn Differentiable> {
            Some(self)
        }
        fn suggested_step(&self) -> f64 {
            self.scene.suggested_step()
        }
        fn batch(&self) -> usize {
            self.batch
        }
    }

    impl Differentiable for Wide {
        fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
            self.note(positions.len());
            self.scene.differentiable().unwrap().jets(positions, directions, out);
        }
    }

    #[test]
    fn rays_that_ask_together_get_what_they_get_apart() {
        let cameras = ClosedForm::half_circle(5, [64, 48]);
        let rays = 100_000;
        for gradient in [GradientMethod::FiniteDifference, GradientMethod::ForwardDifference, GradientMethod::Analytic]
        {
            let draw = |batch: usize, shard: Shard, from: u64| {
                let field = Wide { scene: scene(), batch, calls: Mutex::default() };
                let lattice = GridSettings::default().level(6).lattice(Domain::Box(field.bounds())).unwrap();
                let settings = RaySettings::default().rays(rays).gradient(gradient).occupancy(32);
                let stream = settings.stream(&field, &cameras, &lattice, &Silent).unwrap();
                field.calls.lock().unwrap().clear();
                let mut groups = Vec::new();
                let from = RunProgress { batches: from, rays: from * BATCH, ..RunProgress::default() };
                let progress = stream.run(shard, from, &Silent, |samples, progress| {
                    groups.push((samples.to_vec(), *progress));
                    Ok(())
                });
                let calls = field.calls.lock().unwrap().clone();
                (groups, progress.unwrap(), calls)
            };
            for (shard, from) in [(Shard::whole(rays), 0), (Shard::new(rays, 1, 2), 16)] {
                let (apart, progress, _) = draw(0, shard, from);
                assert!(progress.samples > 10_000, "{progress:?}");
                let (together, same, calls) = draw(1 << 13, shard, from);
                assert!(apart == together && progress == same, "{gradient:?}");
                // Only when there is no other ray to begin do the last ones ask about less.
                let all: usize = calls.iter().sum();
                let mut so_far = 0;
                let early = calls.iter().take_while(|points| {
                    so_far += **points;
                    so_far < all / 2
                });
                let early: Vec<usize> = early.copied().collect();
                assert!(early.len() > 20 && early.iter().all(|points| *points >= 1 << 13), "{gradient:?}: {early:?}");
            }
        }
    }

    #[test]
    fn what_was_cut_short_is_not_handed_on() {
        /// Asks to stop once the field was asked a few times.
        struct Impatient<'a>(&'a Wide);
        impl Monitor for Impatient<'_> {
            fn begin(&self, _: &str, _: u64) {}
            fn advance(&self, _: u64) {}
            fn end(&self) {}
            fn interrupted(&self) -> bool {
                self.0.calls.lock().unwrap().len() > 200
            }
        }
        let cameras = ClosedForm::half_circle(5, [64, 48]);
        for batch in [0, 1 << 12] {
            let field = Wide { scene: scene(), batch, calls: Mutex::default() };
            let lattice = GridSettings::default().level(6).lattice(Domain::Box(field.bounds())).unwrap();
            let settings = RaySettings::default().occupancy(32);
            let stream = settings.stream(&field, &cameras, &lattice, &Silent).unwrap();
            field.calls.lock().unwrap().clear();
            let monitor = Impatient(&field);
            let mut drawn = 0;
            let result = stream.run(Shard::whole(4_000_000), RunProgress::default(), &monitor, |samples, _| {
                assert!(samples.iter().all(|batch| !batch.positions.is_empty()), "a batch that was left out");
                drawn += 1;
                Ok(())
            });
            assert!(matches!(result, Err(Error::Interrupted)), "{result:?}");
            assert!(drawn < 100, "{drawn}");
        }
    }
}
