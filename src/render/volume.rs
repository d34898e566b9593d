//! A volume, whose rays are marched one by one.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    CameraView, CompositingWeights, Differentiation, GradientMethod, ImagePoints, JacobianBuffers, Outputs, Probe,
    RayBatch, RaySamples, RenderedView, Renderer, TraceBuffers, Tracer, VisibleSegment, WeightedSamples, render_rays,
    render_view,
};
use crate::geometry::{Aabb, Camera, Ray};
use crate::monitor::{Monitor, check};
use crate::{Error, Result};

/// A camera stands in matter if half of its rays lose half of their light within so many samples.
pub const INSIDE_MATTER_SAMPLES: f64 = 4.0;

/// A field in front of its background, and how its rays are marched.
#[derive(Clone)]
pub struct VolumeRenderer<'a> {
    /// Field, sampling and background.
    pub tracer: Tracer<'a>,
    /// Source of ∇σ and ∇c, for samples with Jacobians; images need none.
    pub differentiation: Option<Differentiation<'a>>,
}

impl VolumeRenderer<'_> {
    /// Finite-difference step along the axes, scene units; 0 where there is none.
    #[must_use]
    pub fn difference_step(&self) -> DVec3 {
        self.differentiation.map_or(DVec3::ZERO, |differentiation| differentiation.differences.step)
    }

    /// The samples of batches of rays, with their Jacobians, and calls `on_rays` with the number of rays that are
    /// done. If the monitor requests a stop, some are missing. A field that prefers many points at once gets those of
    /// all batches, from this thread.
    ///
    /// # Errors
    /// [`Error::Interrupted`], or if there is no source of derivatives.
    pub(crate) fn samples(
        &self,
        batches: &[RayBatch],
        monitor: &dyn Monitor,
        on_rays: impl Fn(u64) + Sync,
    ) -> Result<Vec<RaySamples>> {
        let Self { tracer, differentiation } = self;
        let Some(differentiation) = differentiation else {
            return Err(Error::setting("Jacobians", "a source of the field's derivatives", "none"));
        };
        if self.batch() > 0 {
            let samples = tracer.jacobians_together(batches, differentiation, monitor)?;
            on_rays(batches.iter().map(|batch| batch.rays.len() as u64).sum());
            return Ok(samples);
        }
        let each = batches.par_iter().map_init(JacobianBuffers::default, |buffers, batch| {
            // So that slow fields stop soon; callers check, too.
            if monitor.interrupted() {
                return RaySamples::default();
            }
            let samples = tracer.jacobians(batch, differentiation, buffers);
            on_rays(batch.rays.len() as u64);
            samples
        });
        Ok(each.collect())
    }

    /// The samples of rays with their weights, each ray shifted by its `jitter` in `[0, 1)` steps.
    pub(crate) fn weighted_rays(&self, rays: &[Ray], jitter: &[f64]) -> WeightedSamples {
        let mut buffers = TraceBuffers::default();
        self.tracer.trace(rays, jitter, &mut buffers);
        let mut quadrature = CompositingWeights::default();
        quadrature.set(&buffers.traced, self.tracer.marcher.step);
        let traced = buffers.traced;
        WeightedSamples {
            offsets: traced.offsets,
            positions: traced.positions,
            weights: quadrature.weights,
            t: traced.t,
            densities: traced.densities,
            colors: Vec::new(),
            is_dropped: traced.is_dropped,
        }
    }

    /// How many of `views` the field gets as one: all, if it prefers many points at once.
    fn together<T>(&self, views: &[T]) -> usize {
        if self.batch() > 0 { views.len().max(1) } else { 1 }
    }
}

impl Renderer for VolumeRenderer<'_> {
    fn bounds(&self) -> Aabb {
        self.tracer.field.bounds()
    }

    fn background(&self) -> DVec3 {
        self.tracer.background()
    }

    fn memory(&self) -> usize {
        self.tracer.field.memory()
    }

    fn marched(&self) -> Option<&VolumeRenderer<'_>> {
        Some(self)
    }

    fn method(&self) -> GradientMethod {
        self.differentiation.map_or(GradientMethod::Analytic, |differentiation| differentiation.method())
    }

    fn view<'v>(&'v self, camera: &Camera, _to: Outputs) -> Box<dyn CameraView + 'v> {
        Box::new(VolumeView { volume: self, camera: *camera })
    }

    fn stands_in_matter(&self, camera: &Camera, sight: &[VisibleSegment]) -> bool {
        let marcher = &self.tracer.marcher;
        let near = sight.iter().filter(|segment| segment.until <= INSIDE_MATTER_SAMPLES * marcher.step).count();
        marcher.bounds.contains(camera.position.as_vec3()) && 2 * near >= sight.len().max(1)
    }

    fn strided_image(
        &self,
        camera: &Camera,
        stride: u32,
        pixel_offset: f64,
        probes: &[Probe],
        monitor: &dyn Monitor,
    ) -> Result<RenderedView> {
        render_view(&self.tracer, &camera.strided(stride, pixel_offset), pixel_offset, probes, monitor)
    }

    fn points(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<RenderedView> {
        let rendered = views.par_chunks(self.together(views)).map(|views| {
            check(monitor)?;
            let rays = views.iter().flat_map(|(camera, points)| points.iter().map(|&[x, y]| camera.ray(x, y)));
            Ok(render_rays(&self.tracer, &rays.collect::<Vec<Ray>>(), &[]))
        });
        let parts = rendered.collect::<Result<Vec<RenderedView>>>()?;
        let points: usize = parts.iter().map(|part| part.pixels.len()).sum();
        Ok(RenderedView::joined([points as u32, 1], parts))
    }

    fn weighted(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<WeightedSamples> {
        let parts = views.par_chunks(self.together(views)).map(|views| {
            check(monitor)?;
            let rays = views.iter().flat_map(|(camera, points)| points.iter().map(|&[x, y]| camera.ray(x, y)));
            let rays: Vec<Ray> = rays.collect();
            Ok(self.weighted_rays(&rays, &vec![0.5; rays.len()]))
        });
        Ok(WeightedSamples::joined(parts.collect::<Result<_>>()?))
    }
}

/// A camera in front of a volume.
struct VolumeView<'v, 'a> {
    volume: &'v VolumeRenderer<'a>,
    camera: Camera,
}

impl VolumeView<'_, '_> {
    fn batch(&self, points: &ImagePoints) -> RayBatch {
        let rays = points.at.iter().map(|&[x, y]| self.camera.ray(x, y)).collect();
        RayBatch { rays, jitter: points.jitter.clone(), first: points.first }
    }
}

impl CameraView for VolumeView<'_, '_> {
    fn samples(&self, points: &[ImagePoints], monitor: &dyn Monitor) -> Result<Vec<RaySamples>> {
        let batches: Vec<RayBatch> = points.iter().map(|points| self.batch(points)).collect();
        let samples = self.volume.samples(&batches, monitor, |_| {})?;
        check(monitor).map(|()| samples)
    }

    fn sight(&self, points: &[ImagePoints]) -> Vec<RaySamples> {
        let tracer = &self.volume.tracer;
        let step = tracer.marcher.step;
        let (mut buffers, mut quadrature) = (TraceBuffers::default(), CompositingWeights::default());
        let of_points = |points: &ImagePoints| {
            let batch = self.batch(points);
            tracer.trace(&batch.rays, &batch.jitter, &mut buffers);
            let traced = &buffers.traced;
            quadrature.set(traced, step);
            let segment = |(r, &ray): (usize, &Ray)| {
                let dark = traced.samples(r).find(|&i| quadrature.transmittance_after[i] < 0.5);
                let until = dark.map_or(f64::INFINITY, |i| traced.t[i] + 0.5 * step);
                VisibleSegment { ray, until }
            };
            let kept = batch.rays.iter().enumerate().filter(|(r, _)| !traced.is_dropped[*r]);
            let sight = kept.map(segment).collect();
            let (dropped, first_invalid) = (traced.dropped, traced.first_invalid);
            RaySamples { sight, dropped, first_invalid, ..RaySamples::default() }
        };
        points.iter().map(of_points).collect()
    }
}
