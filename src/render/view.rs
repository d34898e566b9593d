//! Rendering of whole images.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::probe::{WeightedRay, averages};
use super::trace::TraceBuffers;
use super::{CompositingWeights, Pixel, Probe, Tracer};
use crate::geometry::{Aabb, Camera, MAX_PIXELS, Ray};
use crate::monitor::{Monitor, check};
use crate::{Error, Result};

/// The image of a field, row by row from the top left pixel.
#[derive(Debug, Clone, Default)]
pub struct RenderedView {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`.
    pub pixels: Vec<Pixel>,
    /// `[height · width]`: s, the spread of the ray's weights, scene units. s² is their variance and, on average, that
    /// of what lies within one sample: δ²/12 for samples δ apart, or a splat's own extent along the ray.
    pub spread: Vec<f64>,
    /// `[ray averages of all probes in order][height · width]`: ray averages of log10 U. NaN where nothing was hit.
    pub log10_uncertainty: Vec<Vec<f64>>,
    /// Number of rays dropped because the field was not finite; they show the background.
    pub dropped: u64,
}

impl RenderedView {
    /// `[height · width]`: the pixels, and where their median depths lie, scene units, of the camera and the pixel
    /// offset that the view was rendered with.
    pub fn median_points(&self, camera: &Camera, pixel_offset: f64) -> impl Iterator<Item = (&Pixel, DVec3)> {
        let width = self.resolution[0] as usize;
        self.pixels.iter().enumerate().map(move |(i, pixel)| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + pixel_offset);
            (pixel, camera.ray(x, y).at(pixel.median_depth))
        })
    }
}

/// Approximate number of points of a ray per query
/// ([`RadianceField::batch`](crate::field::RadianceField::batch)).
const POINTS_PER_RAY: usize = 4;

/// Number of values per pixel that the probes give.
fn channels(probes: &[Probe]) -> usize {
    probes.iter().map(|probe| probe.averages.len()).sum()
}

/// Renders a camera's image. `pixel_offset` is the position in a pixel that its ray
/// passes through (½ for the centre).
///
/// Advances the monitor by one per row. The caller begins and ends the stage.
///
/// # Errors
/// [`crate::Error::Interrupted`], or if the image is too large.
pub fn render_view(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    probes: &[Probe],
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    check_size(camera)?;
    let [width, height] = camera.resolution;
    // A field that prefers many points at once gets several rows: a ray evaluates a few points at a time.
    let together = tracer.field.batch().div_ceil(POINTS_PER_RAY * width.max(1) as usize).max(1);
    let rows: Vec<u32> = (0..height).collect();
    let rows: Vec<RenderedView> = rows
        .par_chunks(together)
        .map(|rows| {
            check(monitor)?;
            let ray = |row: u32, x: u32| camera.ray(f64::from(x) + pixel_offset, f64::from(row) + pixel_offset);
            let rays: Vec<Ray> = rows.iter().flat_map(|&row| (0..width).map(move |x| ray(row, x))).collect();
            let rendered = render_rays(tracer, &rays, probes);
            monitor.advance(rows.len() as u64);
            Ok(rendered)
        })
        .collect::<Result<_>>()?;
    Ok(RenderedView::joined(camera.resolution, rows))
}

/// Refuses images that are too large.
pub fn check_size(camera: &Camera) -> Result<()> {
    let [width, height] = camera.resolution;
    if camera.pixels() as f64 <= MAX_PIXELS {
        return Ok(());
    }
    let expected = format!("an image of at most {MAX_PIXELS:e} pixels");
    Err(Error::setting("resolution", expected, format!("{width} x {height}")))
}

impl RenderedView {
    /// The image of `resolution` pixels whose rows, one or several each, are `parts`.
    #[doc(hidden)]
    #[must_use]
    pub fn joined(resolution: [u32; 2], parts: Vec<Self>) -> Self {
        let averages = parts.first().map_or(0, |part| part.log10_uncertainty.len());
        let mut view = Self { resolution, log10_uncertainty: vec![Vec::new(); averages], ..Self::default() };
        for part in parts {
            view.pixels.extend(part.pixels);
            view.spread.extend(part.spread);
            view.dropped += part.dropped;
            view.log10_uncertainty.iter_mut().zip(part.log10_uncertainty).for_each(|(all, part)| all.extend(part));
        }
        view
    }
}

/// Renders single rays, as an image of one row.
#[must_use]
pub fn render_rays(tracer: &Tracer, rays: &[Ray], probes: &[Probe]) -> RenderedView {
    let background: DVec3 = tracer.background();
    let mut buffers = TraceBuffers::default();
    // The middle of every interval makes the image deterministic.
    tracer.trace(rays, &vec![0.5; rays.len()], &mut buffers);
    let traced = &buffers.traced;
    let mut quadrature = CompositingWeights::default();
    quadrature.set(traced, tracer.marcher.step);
    let colors = tracer.visible_colors(rays, traced, &quadrature);
    let (mut samples, mut dropped) = (Vec::with_capacity(rays.len()), traced.dropped);
    for r in 0..rays.len() {
        let of_ray = traced.samples(r);
        let is_finite = colors[of_ray.clone()].iter().all(|color| color.is_finite());
        if !is_finite {
            dropped += 1;
        }
        samples.push(if is_finite { of_ray } else { 0..0 });
    }
    let weighted = WeightedRays {
        rays,
        samples,
        quadrature: &quadrature,
        positions: &traced.positions,
        colors: &colors,
        t: &traced.t,
        // A sample may lie anywhere in its interval.
        thickness: vec![tracer.marcher.step.powi(2) / 12.0; rays.len()],
        background,
        bounds: tracer.marcher.bounds,
        dropped,
    };
    weighted.view(probes)
}

/// Rays whose samples are weighted and coloured: all that an image of them needs.
pub struct WeightedRays<'a> {
    /// `[rays]`.
    pub rays: &'a [Ray],
    /// `[rays]`: which samples are each ray's.
    pub samples: Vec<Range<usize>>,
    /// `[samples]`.
    pub quadrature: &'a CompositingWeights,
    /// `[samples]`, scene units.
    pub positions: &'a [Vec3],
    /// `[samples]`, 0..1.
    pub colors: &'a [Vec3],
    /// `[samples]`: distances along the ray, scene units.
    pub t: &'a [f64],
    /// `[rays]`: variance of the distance of what a ray meets within its samples, scene units².
    pub thickness: Vec<f64>,
    /// Colour behind all samples.
    pub background: DVec3,
    /// The box in which depths lie.
    pub bounds: Aabb,
    /// Number of rays with values that are not finite.
    pub dropped: u64,
}

impl WeightedRays<'_> {
    /// The image of one row.
    #[must_use]
    pub fn view(self, probes: &[Probe]) -> RenderedView {
        let rays = self.rays;
        let mut row = RenderedView {
            resolution: [rays.len() as u32, 1],
            pixels: Vec::with_capacity(rays.len()),
            spread: Vec::with_capacity(rays.len()),
            log10_uncertainty: Vec::with_capacity(channels(probes)),
            dropped: self.dropped,
        };
        let mut weighted = Vec::with_capacity(rays.len());
        for (r, ray) in rays.iter().enumerate() {
            let samples = self.samples[r].clone();
            let pixel = self.quadrature.pixel(&samples, self.colors, self.t, self.background);
            row.pixels.push(pixel);
            let ray = WeightedRay {
                weights: &self.quadrature.weights[samples.clone()],
                positions: &self.positions[samples.clone()],
                at_expected: self.bounds.clamp(ray.at(pixel.expected_depth).as_vec3()),
                spread: (pixel.depth_variance + self.thickness[r]).sqrt(),
            };
            row.spread.push(ray.spread);
            weighted.push(ray);
        }
        for probe in probes {
            row.log10_uncertainty.extend(averages(&weighted, probe));
        }
        row
    }
}
