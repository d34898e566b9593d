//! A single picture: colour and coverage from jittered samples, depth from the ray through the pixel's centre.

use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::shade::LitScene;
use super::trace::Surface;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};

/// A traced picture, row by row from the top left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct TracedView {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: red, green, blue, straight alpha. Colour is the mean of the sRGB-encoded samples that hit
    /// something (encoded, because radiance fields composite encoded values). Alpha is the share of such samples.
    pub rgba: Vec<[u8; 4]>,
    /// `[height · width]`: Euclidean distance from the camera along the ray through the pixel's centre, in scene
    /// units; 0 where the ray hits nothing.
    pub depth: Vec<f32>,
    /// `[height · width]`: whether that ray hits the mesh first, and not the ground.
    pub is_object: Vec<bool>,
}

/// Sampling of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelSampling {
    /// Samples along x and along y of a pixel: one in each cell of this grid.
    pub per_side: u32,
    /// Seed of the jitter, together with `view` and the pixel.
    pub seed: u64,
    /// Index of the picture in the dataset.
    pub view: u32,
}

/// Traces a camera's picture. Advances the monitor by one per row. The caller begins and ends the stage.
///
/// # Errors
/// [`octobayes::Error::Interrupted`] only.
pub fn trace_view(
    lit: &LitScene,
    camera: &Camera,
    sampling: PixelSampling,
    monitor: &dyn Monitor,
) -> Result<TracedView> {
    let [width, height] = camera.resolution;
    let rows: Vec<Vec<([u8; 4], f32, bool)>> = (0..height)
        .into_par_iter()
        .map(|row| {
            check(monitor)?;
            let pixels = (0..width).map(|column| pixel(lit, camera, sampling, [column, row])).collect();
            monitor.advance(1);
            Ok(pixels)
        })
        .collect::<Result<_>>()?;
    let (mut rgba, mut depth, mut is_object) = (Vec::new(), Vec::new(), Vec::new());
    for (color, distance, is) in rows.into_iter().flatten() {
        rgba.push(color);
        depth.push(distance);
        is_object.push(is);
    }
    Ok(TracedView { resolution: camera.resolution, rgba, depth, is_object })
}

fn pixel(lit: &LitScene, camera: &Camera, sampling: PixelSampling, [column, row]: [u32; 2]) -> ([u8; 4], f32, bool) {
    let corner = [column, row].map(f64::from);
    let mut rng = ChaCha8Rng::seed_from_u64(sampling.seed);
    // Pictures have at most 1e8 < 2³² pixels, so every pixel of every picture has its own stream.
    let index = u64::from(row) * u64::from(camera.resolution[0]) + u64::from(column);
    rng.set_stream(u64::from(sampling.view) << 32 | index);

    let (mut sum, mut hits) = (DVec3::ZERO, 0_u32);
    let n = sampling.per_side;
    for cell in 0..n * n {
        let [x, y] = [cell % n, cell / n].map(|k| (f64::from(k) + rng.random::<f64>()) / f64::from(n));
        let ray = camera.ray(corner[0] + x, corner[1] + y);
        if let Some(hit) = lit.scene().nearest(&ray) {
            sum += lit.color(&ray, &hit);
            hits += 1;
        }
    }
    let byte = |v: f64| (255.0 * v).round() as u8;
    let [r, g, b] = (sum / f64::from(hits.max(1))).to_array().map(byte);
    let alpha = byte(f64::from(hits) / f64::from(n * n));

    let center = lit.scene().nearest(&camera.ray(corner[0] + 0.5, corner[1] + 0.5));
    let is_object = center.is_some_and(|hit| hit.surface != Surface::Ground);
    ([r, g, b, alpha], center.map_or(0.0, |hit| hit.t as f32), is_object)
}
