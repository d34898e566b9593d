//! Quality of a field on images that it was not trained on.

use std::time::{Duration, Instant};

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;

use super::Shot;
use super::march::Walk;
use super::occupancy::OccupancyGrid;
use octobayes::field::{Radiance, RadianceField};
use octobayes::metrics::psnr;
use octobayes_models::HashGrid;

/// Samples taken per ray between two checks of its transmittance.
const ROUND: usize = 8;
/// Rays end when their transmittance falls below this. What is behind changes a pixel by no more; half a
/// step of 8 bits is 2e-3.
const OPAQUE: f64 = 1e-4;

/// Quality of a field on held-out images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Mean PSNR of the images, dB.
    pub psnr: f64,
    /// Number of images.
    pub views: usize,
    /// Number of pixels compared, over all images.
    pub pixels: usize,
}

/// Measures the PSNR on images over `background`. `None` without images.
///
/// About `pixels` pixels are compared: every k-th along x and y of each image. Samples sit where training puts
/// them, with longer steps where space is contracted. The renderer of all fields shows the same, more slowly.
#[must_use]
pub fn quality(field: &HashGrid, shots: &[Shot], background: Vec3, pixels: usize) -> Option<Quality> {
    let all: u64 = shots.iter().map(|shot| shot.camera.pixels()).sum();
    if all == 0 {
        return None;
    }
    let stride = (all as f64 / pixels.max(1) as f64).sqrt().ceil().max(1.0) as u32;
    let grid = OccupancyGrid::reached(field.config().occupancy, field.space(), field.occupied());
    let views: Vec<(f64, usize)> = shots
        .iter()
        .map(|shot| {
            let [width, height] = shot.camera.resolution;
            let rows: Vec<u32> = (0..height).step_by(stride as usize).collect();
            let columns: Vec<u32> = (0..width).step_by(stride as usize).collect();
            let pixels = rows.iter().flat_map(|y| columns.iter().map(move |x| (y * width + x) as usize));
            let found: Vec<DVec3> =
                rows.par_iter().flat_map_iter(|&y| row(field, &grid, shot, y, &columns, background)).collect();
            let kept = pixels.zip(found).filter(|(i, _)| shot.keeps(*i));
            let (truth, found): (Vec<DVec3>, Vec<DVec3>) =
                kept.map(|(i, color)| (shot.image.over(i, background.as_dvec3()), color)).unzip();
            (psnr(&found, &truth), found.len())
        })
        // An image that is masked altogether has no quality.
        .filter(|(_, pixels)| *pixels > 0)
        .collect();
    if views.is_empty() {
        return None;
    }
    Some(Quality {
        psnr: views.iter().map(|view| view.0).sum::<f64>() / views.len() as f64,
        views: views.len(),
        pixels: views.iter().map(|view| view.1).sum(),
    })
}

/// Pixels of a first comparison, from which the time of others is estimated.
const FIRST_PIXELS: usize = 256;

/// Like [`quality`], on as many of the `pixels` as are compared within `allowance`, but on a few hundred at least: a
/// model that has hardly begun to learn is fog, whose rays take a hundred times as long.
#[must_use]
pub fn quality_within(
    field: &HashGrid,
    shots: &[Shot],
    background: Vec3,
    pixels: usize,
    allowance: Duration,
) -> Option<Quality> {
    let start = Instant::now();
    let mut count = pixels.min(FIRST_PIXELS);
    loop {
        let begun = Instant::now();
        let found = quality(field, shots, background, count)?;
        let each = begun.elapsed().as_secs_f64() / found.pixels.max(1) as f64;
        let left = allowance.saturating_sub(start.elapsed()).as_secs_f64();
        // Half of what seems to fit, and not too many at once: the first few may have been quick ones.
        let fitting = (0.5 * left / each.max(1e-9)) as usize;
        let next = fitting.min(16 * count).min(pixels);
        if count >= pixels || next < 2 * count {
            return Some(found);
        }
        count = next;
    }
}

/// Like [`quality`], for the best single colour for all `shots`: what a model reaches that has learnt nothing.
#[must_use]
pub fn one_color(shots: &[Shot], background: Vec3, pixels: usize) -> Option<Quality> {
    let all: u64 = shots.iter().map(|shot| shot.camera.pixels()).sum();
    let every = (all as usize / pixels.max(1)).max(1);
    let background = background.as_dvec3();
    let truths: Vec<Vec<DVec3>> = shots
        .iter()
        .map(|shot| {
            let kept = (0..shot.image.len()).step_by(every).filter(|&i| shot.keeps(i));
            kept.map(|i| shot.image.over(i, background)).collect::<Vec<DVec3>>()
        })
        .filter(|truth| !truth.is_empty())
        .collect();
    let compared: usize = truths.iter().map(Vec::len).sum();
    if compared == 0 {
        return None;
    }
    let mean = truths.iter().flatten().sum::<DVec3>() / compared as f64;
    let psnrs = truths.iter().map(|truth| psnr(&vec![mean; truth.len()], truth));
    Some(Quality { psnr: psnrs.sum::<f64>() / truths.len() as f64, views: truths.len(), pixels: compared })
}

/// Colours of the pixels of a row at these columns.
fn row(field: &HashGrid, grid: &OccupancyGrid, shot: &Shot, y: u32, columns: &[u32], background: Vec3) -> Vec<DVec3> {
    let space = field.space();
    let rays = columns.iter().map(|x| shot.camera.ray(f64::from(*x) + 0.5, f64::from(y) + 0.5));
    let rays: Vec<_> = rays.collect();
    // The middle of every interval makes the image deterministic.
    let mut walks: Vec<Walk> = rays.iter().map(|ray| Walk::new(space, *ray, 0.5)).collect();
    let mut pixels = vec![(DVec3::ZERO, 1.0_f64); rays.len()];
    let (mut owners, mut deltas, mut positions, mut directions) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut radiance = Vec::new();
    loop {
        owners.clear();
        deltas.clear();
        positions.clear();
        directions.clear();
        for (owner, (walk, ray)) in walks.iter_mut().zip(&rays).enumerate() {
            if pixels[owner].1 < OPAQUE {
                continue;
            }
            for sample in std::iter::from_fn(|| walk.next(space, grid)).take(ROUND) {
                owners.push(owner);
                deltas.push(sample.delta);
                positions.push(space.bounds.clamp(ray.at(sample.t).as_vec3()));
                directions.push(ray.direction.as_vec3());
            }
        }
        if owners.is_empty() {
            break;
        }
        radiance.resize(owners.len(), Radiance::default());
        field.evaluate(&positions, &directions, &mut radiance);
        for ((&owner, delta), radiance) in owners.iter().zip(&deltas).zip(&radiance) {
            let (color, transmittance) = &mut pixels[owner];
            let optical_depth = f64::from(radiance.density) * delta;
            *color += *transmittance * -(-optical_depth).exp_m1() * radiance.color.as_dvec3();
            *transmittance *= (-optical_depth).exp();
        }
    }
    pixels.into_iter().map(|(color, transmittance)| color + transmittance * background.as_dvec3()).collect()
}
