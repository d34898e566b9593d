//! Whole images.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

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

/// An image of a field, row by row from the top left pixel.
#[derive(Debug, Clone)]
pub struct RenderedView {
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`.
    pub pixels: Vec<Pixel>,
    /// `[height · width]`: blended log10 U; NaN where nothing was hit (with [`Blend::Hit`]). Empty if not asked for.
    pub log10_uncertainty: Vec<f64>,
    /// Rays dropped because the field was not finite; they show the background.
    pub dropped: u64,
}

/// Renders a camera's image; `pixel_offset` is where in a pixel the ray goes through (½ for the centre), and
/// `log10_uncertainty` gives log10 U at a scene point.
///
/// # Errors
/// [`crate::Error::Interrupted`] only.
pub fn render_view(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    log10_uncertainty: Option<(&(dyn Fn(Vec3) -> f64 + Sync), Blend)>,
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    let [width, height] = camera.resolution;
    let rows: Vec<_> = (0..height)
        .into_par_iter()
        .map(|row| {
            check(monitor)?;
            let rays: Vec<Ray> =
                (0..width).map(|x| camera.ray(f64::from(x) + pixel_offset, f64::from(row) + pixel_offset)).collect();
            let rendered = render_rays(tracer, &rays, log10_uncertainty);
            monitor.advance(1);
            Ok(rendered)
        })
        .collect::<Result<_>>()?;
    let mut view = RenderedView {
        resolution: camera.resolution,
        pixels: Vec::with_capacity(rows.len() * width as usize),
        log10_uncertainty: Vec::new(),
        dropped: 0,
    };
    for (pixels, uncertainty, dropped) in rows {
        view.pixels.extend(pixels);
        view.log10_uncertainty.extend(uncertainty);
        view.dropped += dropped;
    }
    Ok(view)
}

fn render_rays(
    tracer: &Tracer,
    rays: &[Ray],
    log10_uncertainty: Option<(&(dyn Fn(Vec3) -> f64 + Sync), Blend)>,
) -> (Vec<Pixel>, Vec<f64>, u64) {
    let background: DVec3 = tracer.background();
    // The middle of every interval: an image is deterministic.
    let traced = tracer.trace(rays, &vec![0.5; rays.len()]);
    let mut quadrature = Quadrature::default();
    let mut pixels = Vec::with_capacity(rays.len());
    let mut blended = Vec::new();
    for ray in 0..rays.len() {
        let samples = traced.samples(ray);
        quadrature.set(&traced.radiance[samples.clone()], tracer.marcher.step);
        pixels.push(quadrature.pixel(&traced.radiance[samples.clone()], &traced.t[samples.clone()], background));
        if let Some((log10_u, blend)) = log10_uncertainty {
            let (mut sum, mut weight) = (0.0, 0.0);
            for (&w, &x) in quadrature.weights.iter().zip(&traced.positions[samples]) {
                if w > 0.0 {
                    sum += w * log10_u(x);
                    weight += w;
                }
            }
            blended.push(match blend {
                Blend::Hit => sum / weight,
                Blend::Official => sum + OFFICIAL_EMPTY * quadrature.end_transmittance(),
            });
        }
    }
    (pixels, blended, traced.dropped)
}
