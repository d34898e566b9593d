//! Density fitted to what cameras see: rays through the volume lose as much light as those through the model.
//!
//! Averaged over a cell, a thin opaque layer is thick and foggy, and what the slider leaves of it is too transparent.
//! So optical depths τ of rays through the volume, whole and cleaned, are compared with those that are seen. Every
//! sample is multiplied by the geometric mean of the quotients of its rays, weighted by the light that they lose there
//! (MART: multiplicative algebraic reconstruction).

use glam::Vec3;
use rayon::prelude::*;

use super::bricks::coded;
use super::grid::Grid;
use super::march::Volume;
use super::pack::Pages;
use super::seen::SeenRay;

/// Corrections. More of them follow the noise of single rays.
const ROUNDS: usize = 2;
/// Smallest and largest τ: what is thinner is clear, what is thicker is opaque.
const DEPTHS: [f64; 2] = [0.02, 4.0];
/// Largest correction at a time, a factor.
const MAX_CORRECTION_FACTOR: f64 = 3.0;
/// One in this many rays through the whole scene is used. Most of them are opaque in both.
const RAY_STRIDE: usize = 4;
/// Light that must be lost around a sample for it to be corrected.
const MIN_LOST_LIGHT: f32 = 0.02;
/// Sums are kept in so many parts, whatever the number of threads, so that values do not depend on it.
const PARTS: usize = 4;

/// Optical depths along the edges of cells, `[bricks][SAMPLES]`, corrected by rays through the whole scene and through
/// the cleaned one. `log10` determines what was removed. `ids` as [`super::fit::first_of_faces`] returns them.
pub fn fitted(
    mut depths: Vec<f32>,
    (grid, pages): (&Grid, &Pages),
    ids: &[u32],
    [whole, cleaned]: [&[SeenRay]; 2],
    log10: impl Fn(Vec3) -> f64 + Sync,
) -> Vec<f32> {
    let rays: Vec<&SeenRay> = whole.iter().step_by(RAY_STRIDE).chain(cleaned).collect();
    let part = rays.len().div_ceil(PARTS).max(1);
    for _ in 0..ROUNDS {
        let matter = coded(&depths);
        let volume = Volume { grid, pages, matter: &matter };
        let parts: Vec<Vec<[f32; 2]>> = rays.par_chunks(part).map(|rays| sums(&volume, ids, rays, &log10)).collect();
        depths.par_iter_mut().zip(ids).for_each(|(depth, id)| {
            let add = |a: [f32; 2], b: [f32; 2]| [a[0] + b[0], a[1] + b[1]];
            let [sum, light] = parts.iter().map(|part| part[*id as usize]).fold([0.0; 2], add);
            if light >= MIN_LOST_LIGHT {
                *depth *= (sum / light).exp();
            }
        });
    }
    depths
}

/// Sums over the `rays` at every sample: of the logarithm of what τ is to be multiplied by, weighted by the light that
/// is lost there, and of the light.
fn sums(volume: &Volume, ids: &[u32], rays: &[&SeenRay], log10: impl Fn(Vec3) -> f64) -> Vec<[f32; 2]> {
    let mut sums = vec![[0.0; 2]; ids.len()];
    let mut steps = Vec::new();
    let depth = |passed: f64| (-passed.max(f64::MIN_POSITIVE).ln()).clamp(DEPTHS[0], DEPTHS[1]);
    for ray in rays {
        steps.clear();
        let passed = volume.march(&ray.ray, |x| ray.keeps(x, &log10), |step| steps.push(step));
        let factor = depth(1.0 - f64::from(ray.opacity)) / depth(passed.transmittance);
        let factor = factor.clamp(1.0 / MAX_CORRECTION_FACTOR, MAX_CORRECTION_FACTOR).ln() as f32;
        for step in &steps {
            for (i, share) in step.corners() {
                let ([sum, light], lost) = (&mut sums[ids[i] as usize], step.weight * share);
                *sum += lost * factor;
                *light += lost;
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::viewer::fit::first_of_faces;
    use crate::viewer::grid::{SAMPLES, sample};
    use octobayes::geometry::{Aabb, Domain, Ray};

    /// A foggy slab across x. The slider removes its farther half.
    #[test]
    fn rays_lose_as_much_light_as_is_seen_whole_and_cleaned() {
        let bounds = Aabb::centered_cube(1.0);
        let grid = Grid::new(bounds, &Domain::Box(bounds), 21);
        let bricks = grid.all_bricks();
        let pages = Pages::new(&grid, &bricks);
        let positions: Vec<DVec3> =
            bricks.iter().flat_map(|b| (0..SAMPLES).map(|i| grid.origin + grid.edge * sample(*b, i))).collect();
        let depths = positions.iter().map(|x| if x.x.abs() < 0.31 { 0.1 } else { 0.0 }).collect();
        let log10 = |x: Vec3| f64::from(-x.x);
        let rays = |most: f64, opacity: f32, count: u32| -> Vec<SeenRay> {
            let share = |k: u32, factor: f64| 1.6 * (f64::from(k) * factor).fract() - 0.8;
            let ray = |k| {
                let target = DVec3::new(0.0, share(k, 0.754_877), share(k, 0.569_840));
                let ray = Ray::new(target + 3.0 * DVec3::X, -DVec3::X);
                SeenRay { ray, opacity, log10: 0.0, depth: 3.0, span: [3.0; 2], most }
            };
            (0..count).map(ray).collect()
        };
        // Of the nearer half is seen more than of both before the fit.
        let (whole, cleaned) = (rays(f64::INFINITY, 0.97, 8000), rays(0.0, 0.9, 8000));
        let lost = |depths: &[f32], ray: &SeenRay| {
            let matter = coded(depths);
            let volume = Volume { grid: &grid, pages: &pages, matter: &matter };
            1.0 - volume.march(&ray.ray, |x| ray.keeps(x, log10), |_| {}).transmittance
        };
        let before: Vec<f32> = depths;
        let after = fitted(before.clone(), (&grid, &pages), &first_of_faces(&bricks), [&whole, &cleaned], log10);
        for (ray, seen) in [(&whole[77], 0.97), (&cleaned[77], 0.9)] {
            let [unfitted, fitted] = [&before, &after].map(|depths| lost(depths, ray));
            assert!((unfitted - seen).abs() > 0.2, "the fit has something to do: {unfitted} of {seen}");
            assert!((fitted - seen).abs() < 0.06, "{fitted} instead of {seen}; {unfitted} before");
        }
        assert!(before.iter().zip(&after).all(|(a, b)| (*a > 0.0) == (*b > 0.0)), "what is empty stays empty");
    }
}
