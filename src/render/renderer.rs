//! A model in front of its background, ready for rays: the interface that runs, images, evaluations and next views use.
//!
//! Rays of a volume are marched one by one, in any order. Any other model prepares a [`CameraView`] first, and its
//! rays are drawn camera by camera.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{
    CompositingWeights, GradientMethod, Probe, RaySamples, RenderedView, VisibleSegment, VolumeRenderer, WeightedRays,
    check_size,
};
use crate::Result;
use crate::geometry::{Aabb, Camera, Ray};
use crate::monitor::{Monitor, check};

/// What a view is prepared for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outputs {
    /// Only its colours.
    Colors,
    /// Its derivatives as well.
    Derivatives,
}

/// Image points of a camera whose rays are drawn together.
#[derive(Debug, Clone, Default)]
pub struct ImagePoints {
    /// Column and row, pixels from the top left corner.
    pub at: Vec<[f64; 2]>,
    /// Shift of each ray's samples, in steps of the march; other models ignore it.
    pub jitter: Vec<f64>,
    /// Index of the first ray in the run.
    pub first: u64,
}

/// Samples along rays with their weights in the pixels: ray r owns `offsets[r]..offsets[r + 1]`.
#[derive(Debug, Clone)]
pub struct WeightedSamples {
    /// `[rays + 1]`.
    pub offsets: Vec<usize>,
    /// `[n]`: scene units.
    pub positions: Vec<Vec3>,
    /// `[n]`: w, the share of the pixel's colour.
    pub weights: Vec<f64>,
    /// `[n]`: distances along the ray, scene units.
    pub t: Vec<f64>,
    /// `[n]`: σ, 1 / scene unit; empty if the model has no density.
    pub densities: Vec<f32>,
    /// `[n]`: colours, for the images that [`Renderer`] makes itself; empty if the model makes its own.
    pub colors: Vec<Vec3>,
    /// `[rays]`: whether the ray was dropped because the field was not finite.
    pub is_dropped: Vec<bool>,
}

impl Default for WeightedSamples {
    fn default() -> Self {
        Self {
            offsets: vec![0],
            positions: Vec::new(),
            weights: Vec::new(),
            t: Vec::new(),
            densities: Vec::new(),
            colors: Vec::new(),
            is_dropped: Vec::new(),
        }
    }
}

impl WeightedSamples {
    /// Indices of the samples of ray `r`.
    #[must_use]
    pub fn samples(&self, r: usize) -> std::ops::Range<usize> {
        self.offsets[r]..self.offsets[r + 1]
    }

    /// The samples of several groups of rays, one after the other.
    #[must_use]
    pub fn joined(parts: Vec<Self>) -> Self {
        let mut whole = Self::default();
        for part in parts {
            let first = whole.positions.len();
            whole.offsets.extend(part.offsets[1..].iter().map(|offset| first + offset));
            whole.positions.extend(part.positions);
            whole.weights.extend(part.weights);
            whole.t.extend(part.t);
            whole.densities.extend(part.densities);
            whole.colors.extend(part.colors);
            whole.is_dropped.extend(part.is_dropped);
        }
        whole
    }
}

/// A model in front of its background.
pub trait Renderer: Send + Sync {
    /// The box of the model, scene units.
    fn bounds(&self) -> Aabb;

    /// The box of nearly all of it, where single parts may lie far away.
    fn main_box(&self) -> Aabb {
        self.bounds()
    }

    /// Colour behind the model.
    fn background(&self) -> DVec3;

    /// Size of the model, bytes; 0 if unknown.
    fn memory(&self) -> usize {
        0
    }

    /// The volume, if rays are marched: then they can be drawn in any order. The images of all other models depend on
    /// the size of a pixel.
    fn marched(&self) -> Option<&VolumeRenderer<'_>> {
        None
    }

    /// Distance between the samples of a ray, scene units; `None` if rays are not marched.
    fn march_step(&self) -> Option<f64> {
        self.marched().map(|volume| volume.tracer.marcher.step)
    }

    /// Smallest efficient batch, in points; 0 if a few hundred are enough.
    fn batch(&self) -> usize {
        self.marched().map_or(0, |volume| volume.tracer.field.batch())
    }

    /// Source of the derivatives: a model that is not marched has its own.
    fn method(&self) -> GradientMethod {
        GradientMethod::Analytic
    }

    /// Prepares a camera's view.
    fn view<'v>(&'v self, camera: &Camera, to: Outputs) -> Box<dyn CameraView + 'v>;

    /// Image points with equal numbers are cheaper one after the other.
    fn tile_of(&self, _at: [f64; 2]) -> [u32; 2] {
        [0; 2]
    }

    /// Whether a camera that has this sight stands in matter.
    fn stands_in_matter(&self, camera: &Camera, sight: &[VisibleSegment]) -> bool;

    /// Renders a camera's image, with the ray averages of `probes`. `pixel_offset` is the position in a pixel that its
    /// ray passes through (½ for the centre).
    ///
    /// Advances the monitor by one per row. The caller begins and ends the stage.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`], or if the model cannot render this camera.
    fn image(
        &self,
        camera: &Camera,
        pixel_offset: f64,
        probes: &[Probe],
        monitor: &dyn Monitor,
    ) -> Result<RenderedView> {
        self.strided_image(camera, 1, pixel_offset, probes, monitor)
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
        monitor: &dyn Monitor,
    ) -> Result<RenderedView> {
        check_size(camera)?;
        let resolution = camera.strided(stride, pixel_offset).resolution;
        let [width, height] = resolution;
        let row = |y: u32| {
            check(monitor)?;
            let at = |x: u32| [x, y].map(|i| f64::from(i * stride) + pixel_offset);
            let row = composited(self, *camera, (0..width).map(at).collect(), probes, monitor)?;
            monitor.advance(1);
            Ok(row)
        };
        let rows = (0..height).into_par_iter().map(row).collect::<Result<_>>()?;
        Ok(RenderedView::joined(resolution, rows))
    }

    /// Renders single image points of some cameras (pixels from the top left corner), as an image of one row.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`], or if the model cannot render a camera.
    fn points(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<RenderedView> {
        let of_view = |(camera, points): &(Camera, Vec<[f64; 2]>)| {
            check(monitor)?;
            composited(self, *camera, points.clone(), &[], monitor)
        };
        let parts = views.par_iter().map(of_view).collect::<Result<Vec<RenderedView>>>()?;
        let points: usize = parts.iter().map(|part| part.pixels.len()).sum();
        Ok(RenderedView::joined([points as u32, 1], parts))
    }

    /// The samples with weights of single image points of some cameras, in their order. With
    /// [colours](WeightedSamples::colors) they are all that an image needs.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    fn weighted(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<WeightedSamples>;
}

/// A camera in front of a model.
pub trait CameraView: Send + Sync {
    /// The samples of rays with their Jacobians, a list for each group of points. The view must be one of
    /// [`Outputs::Derivatives`].
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    fn samples(&self, points: &[ImagePoints], monitor: &dyn Monitor) -> Result<Vec<RaySamples>>;

    /// How far rays see: samples without any, but with [`RaySamples::sight`].
    fn sight(&self, points: &[ImagePoints]) -> Vec<RaySamples>;
}

/// Image points of a camera, composited from their samples, as an image of one row.
fn composited<R: Renderer + ?Sized>(
    renderer: &R,
    camera: Camera,
    points: Vec<[f64; 2]>,
    probes: &[Probe],
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    let rays: Vec<Ray> = points.iter().map(|&[x, y]| camera.ray(x, y)).collect();
    let samples = renderer.weighted(&[(camera, points)], monitor)?;
    let ranges: Vec<_> = (0..rays.len()).map(|ray| samples.samples(ray)).collect();
    let mut quadrature = CompositingWeights { transmittance_after: Vec::new(), weights: samples.weights.clone() };
    for range in &ranges {
        let mut left = 1.0;
        quadrature.transmittance_after.extend(samples.weights[range.clone()].iter().map(|weight| {
            left -= weight;
            left
        }));
    }
    let weighted = WeightedRays {
        rays: &rays,
        samples: ranges,
        quadrature: &quadrature,
        positions: &samples.positions,
        colors: &samples.colors,
        t: &samples.t,
        thickness: vec![0.0; rays.len()],
        background: renderer.background(),
        bounds: renderer.bounds(),
        dropped: samples.is_dropped.iter().filter(|dropped| **dropped).count() as u64,
    };
    Ok(weighted.view(probes))
}
