//! Whole images.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::trace::TraceBuffers;
use super::{Pixel, Quadrature, Tracer};
use crate::Result;
use crate::geometry::{Camera, Ray};
use crate::monitor::{Monitor, check};

/// How log10 U is blended along a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Blend {
    /// Σ w log10 U / Σ w: what the ray meets.
    #[default]
    Hit,
    /// Σ w log10 U − 3 T_end: the official code's, for which empty space is certain.
    Official,
}

/// The official code's log10 U of the part of a ray that hits nothing.
const OFFICIAL_EMPTY: f64 = -3.0;

/// A scalar of space to blend along rays beside colour: log10 U at a scene point.
#[derive(Clone, Copy)]
pub struct Probe<'a> {
    /// log10 U at a point.
    pub log10: &'a (dyn Fn(Vec3) -> f64 + Sync),
    /// How it is blended.
    pub blend: Blend,
}

/// An image of a field, row by row from the top left pixel.
#[derive(Debug, Clone, Default)]
pub struct RenderedView {
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`.
    pub pixels: Vec<Pixel>,
    /// `[probes][height · width]`: blended log10 U; NaN where nothing was hit (with [`Blend::Hit`]).
    pub log10_uncertainty: Vec<Vec<f64>>,
    /// Rays dropped because the field was not finite; they show the background.
    pub dropped: u64,
}

/// Renders a camera's image; `pixel_offset` is where in a pixel the ray goes through (½ for the centre).
///
/// Advances the monitor by one per row; the caller begins and ends the stage.
///
/// # Errors
/// [`crate::Error::Interrupted`] only.
pub fn render_view(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    probes: &[Probe],
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    let [width, height] = camera.resolution;
    let rows: Vec<RenderedView> = (0..height)
        .into_par_iter()
        .map(|row| {
            check(monitor)?;
            let y = f64::from(row) + pixel_offset;
            let rays: Vec<Ray> = (0..width).map(|x| camera.ray(f64::from(x) + pixel_offset, y)).collect();
            let rendered = render_rays(tracer, &rays, probes);
            monitor.advance(1);
            Ok(rendered)
        })
        .collect::<Result<_>>()?;
    let mut view = RenderedView {
        resolution: camera.resolution,
        log10_uncertainty: vec![Vec::new(); probes.len()],
        ..RenderedView::default()
    };
    for row in rows {
        view.pixels.extend(row.pixels);
        view.dropped += row.dropped;
        for (all, part) in view.log10_uncertainty.iter_mut().zip(row.log10_uncertainty) {
            all.extend(part);
        }
    }
    Ok(view)
}

/// Renders any group of rays as one row.
fn render_rays(tracer: &Tracer, rays: &[Ray], probes: &[Probe]) -> RenderedView {
    let background: DVec3 = tracer.background();
    let mut buffers = TraceBuffers::default();
    // The middle of every interval: an image is deterministic.
    tracer.trace(rays, &vec![0.5; rays.len()], &mut buffers);
    let traced = &buffers.traced;
    let mut quadrature = Quadrature::default();
    quadrature.set(traced, tracer.marcher.step);
    let colors = tracer.visible_colors(rays, traced, &quadrature);
    let mut row = RenderedView {
        resolution: [rays.len() as u32, 1],
        pixels: Vec::with_capacity(rays.len()),
        log10_uncertainty: vec![Vec::with_capacity(rays.len()); probes.len()],
        dropped: traced.dropped,
    };
    for ray in 0..rays.len() {
        let mut samples = traced.samples(ray);
        if colors[samples.clone()].iter().any(|color| !color.is_finite()) {
            row.dropped += 1;
            samples = 0..0;
        }
        row.pixels.push(quadrature.pixel(&samples, &colors, &traced.t, background));
        for (probe, blended) in probes.iter().zip(&mut row.log10_uncertainty) {
            let weighted = quadrature.weights[samples.clone()].iter().zip(&traced.positions[samples.clone()]);
            let hit = weighted.filter(|(w, _)| **w > 0.0);
            let (sum, weight) = hit.fold((0.0, 0.0), |(sum, total), (w, &x)| (sum + w * (probe.log10)(x), total + w));
            blended.push(match probe.blend {
                Blend::Hit => sum / weight,
                Blend::Official => sum + OFFICIAL_EMPTY * quadrature.end_transmittance(&samples),
            });
        }
    }
    row
}
