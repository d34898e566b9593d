//! What images are made of: a volume, whose rays are traced one by one, or splats, which are projected image by image.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    DepthProbe, DepthVariance, Differentiation, Probe, RenderedView, Tracer, render_rays, render_view,
    render_view_with_depth,
};
use crate::geometry::{Aabb, Camera, Ray};
use crate::monitor::{Monitor, check};
use crate::{Error, Result};

/// A model as images show it.
pub trait Renderer: Sync {
    /// The box of the model, scene units.
    fn bounds(&self) -> Aabb;

    /// Colour behind the model.
    fn background(&self) -> DVec3;

    /// Distance between the samples of a ray, scene units. `None` for splats, whose rays are not marched; their images
    /// depend on the size of a pixel, by a part of which every splat grows.
    fn march_step(&self) -> Option<f64>;

    /// Whether images may have variances of depth.
    fn takes_variances(&self) -> bool;

    /// Renders a camera's image, with the ray averages of `probes` and `variances` of every pixel's expected depth.
    /// `pixel_offset` is the position in a pixel that its ray passes through (½ for the centre).
    ///
    /// Advances the monitor by one per row. The caller begins and ends the stage.
    ///
    /// # Errors
    /// [`Error::Interrupted`], those of the probes, or if the model cannot render this camera.
    fn image(
        &self,
        camera: &Camera,
        pixel_offset: f64,
        probes: &[Probe],
        variances: &[&dyn DepthVariance],
        monitor: &dyn Monitor,
    ) -> Result<RenderedView> {
        self.strided_image(camera, 1, pixel_offset, probes, variances, monitor)
    }

    /// Every `stride`-th pixel along x and y of [`Renderer::image`]: those of [`Camera::strided`].
    ///
    /// # Errors
    /// As [`Renderer::image`].
    fn strided_image(
        &self,
        camera: &Camera,
        stride: u32,
        pixel_offset: f64,
        probes: &[Probe],
        variances: &[&dyn DepthVariance],
        monitor: &dyn Monitor,
    ) -> Result<RenderedView>;

    /// Renders single image points of some cameras (pixels from the top left corner), as an image of one row.
    ///
    /// # Errors
    /// [`Error::Interrupted`], or if the model cannot render a camera.
    fn points(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<RenderedView>;
}

/// A volume as images show it.
#[derive(Clone)]
pub struct VolumeRenderer<'a> {
    /// Field, sampling and background.
    pub tracer: Tracer<'a>,
    /// Source of ∇σ, for variances of depth.
    pub differentiation: Option<Differentiation<'a>>,
}

impl Renderer for VolumeRenderer<'_> {
    fn bounds(&self) -> Aabb {
        self.tracer.field.bounds()
    }

    fn background(&self) -> DVec3 {
        self.tracer.background()
    }

    fn march_step(&self) -> Option<f64> {
        Some(self.tracer.marcher.step)
    }

    fn takes_variances(&self) -> bool {
        self.differentiation.is_some()
    }

    fn strided_image(
        &self,
        camera: &Camera,
        stride: u32,
        pixel_offset: f64,
        probes: &[Probe],
        variances: &[&dyn DepthVariance],
        monitor: &dyn Monitor,
    ) -> Result<RenderedView> {
        let camera = &camera.strided(stride, pixel_offset);
        if variances.is_empty() {
            return render_view(&self.tracer, camera, pixel_offset, probes, monitor);
        }
        let Some(differentiation) = self.differentiation else {
            return Err(Error::setting("variances of depth", "a source of the density's gradient", "none"));
        };
        let depth = DepthProbe { differentiation, variances };
        render_view_with_depth(&self.tracer, camera, pixel_offset, probes, &depth, monitor)
    }

    fn points(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<RenderedView> {
        // A field that wants many points at once gets all views as one.
        let each = if self.tracer.field.batch() > 0 { views.len() } else { 1 };
        let rendered = views.par_chunks(each.max(1)).map(|views| {
            check(monitor)?;
            let rays = views.iter().flat_map(|(camera, points)| points.iter().map(|&[x, y]| camera.ray(x, y)));
            render_rays(&self.tracer, &rays.collect::<Vec<Ray>>(), &[], None)
        });
        let parts = rendered.collect::<Result<Vec<RenderedView>>>()?;
        let points: usize = parts.iter().map(|part| part.pixels.len()).sum();
        Ok(RenderedView::joined([points as u32, 1], parts))
    }
}
