//! log10 U fitted to what cameras see.
//!
//! Values at the samples of a lattice, chosen such that every ray through the volume, as the shader marches it, has the
//! log10 U that `render` gives it. Letters: a = share of a sample in a ray, w · b with w the light lost at a step and b
//! the sample's share in its interpolation; v = values at the samples; s = what is seen. First v = Σ a s / Σ a, then
//! corrections v += Σ a r / Σ a by the residual r = s − Σ a v / Σ a (SIRT: simultaneous iterative reconstruction).

use std::collections::HashMap;

use rayon::prelude::*;

use super::grid::{CELLS, SAMPLES, SIDE, place};
use super::march::{Step, Volume};
use super::seen::SeenRay;
use octobayes::metrics::median;

/// Corrections. More of them follow the noise of single rays.
const CORRECTIONS: usize = 3;
/// Light that must be lost around a sample for it to be fitted.
const MIN_LOST_LIGHT: f32 = 0.02;
/// Rays that lose less do not count.
const MIN_RAY_LOSS: f32 = 0.3;
/// Steps that count for less of their ray are left out.
const MIN_STEP_SHARE: f32 = 0.004;
/// Sums are kept in so many parts, whatever the number of threads, so that values do not depend on it.
const PARTS: usize = 4;
/// Not fitted.
const NONE: u32 = u32::MAX;
/// Rays by which depth is judged.
const JUDGES: usize = 20_000;

/// Values at the samples that rays see.
pub struct Fit {
    /// `[bricks][SAMPLES]`: place among the values, or [`NONE`].
    ids: Vec<u32>,
    /// log10 U.
    values: Vec<f32>,
    /// Light lost around each of them.
    light: Vec<f32>,
}

/// Rays with what they lose at their steps.
#[derive(Default)]
struct Paths {
    /// One more than rays.
    ends: Vec<usize>,
    steps: Vec<Step>,
    /// log10 U of each ray.
    seen: Vec<f32>,
}

impl Fit {
    /// Fits log10 U at samples to that of `rays`; `ids` as [`first_of_faces`] returns them.
    pub fn new(volume: &Volume, mut ids: Vec<u32>, rays: &[SeenRay]) -> Self {
        let part = rays.len().div_ceil(PARTS).max(1);
        let mut paths: Vec<Paths> = rays.par_chunks(part).map(|rays| Paths::new(volume, rays)).collect();
        let mut is_met = vec![false; ids.len()];
        for step in paths.iter().flat_map(|paths| &paths.steps) {
            step.corners().for_each(|(i, _)| is_met[ids[i] as usize] = true);
        }
        let mut count = 0;
        let numbers: Vec<u32> = is_met
            .into_iter()
            .map(|is_met| {
                count += u32::from(is_met);
                if is_met { count - 1 } else { NONE }
            })
            .collect();
        ids.iter_mut().for_each(|id| *id = numbers[*id as usize]);
        paths.retain(|paths| !paths.seen.is_empty());
        let mut fit = Self { ids, values: vec![0.0; count as usize], light: vec![0.0; count as usize] };
        for round in 0..=CORRECTIONS {
            let sums: Vec<(Vec<f32>, Vec<f32>)> = paths.par_iter().map(|paths| fit.left(paths)).collect();
            let mut total = (vec![0.0_f32; fit.values.len()], vec![0.0_f32; fit.values.len()]);
            for (sums, light) in sums {
                total.0.iter_mut().zip(sums).for_each(|(all, part)| *all += part);
                total.1.iter_mut().zip(light).for_each(|(all, part)| *all += part);
            }
            for (value, (sum, light)) in fit.values.iter_mut().zip(total.0.iter().zip(&total.1)) {
                *value += sum / light.max(f32::MIN_POSITIVE);
            }
            if round == 0 {
                fit.light = total.1;
            }
        }
        fit
    }

    /// log10 U at a sample of the atlas; `None` where hardly any ray came.
    pub fn at(&self, sample: usize) -> Option<f32> {
        let id = self.ids[sample] as usize;
        self.light.get(id).filter(|light| **light >= MIN_LOST_LIGHT).map(|_| self.values[id])
    }

    /// Σ a r and Σ a of all samples.
    fn left(&self, paths: &Paths) -> (Vec<f32>, Vec<f32>) {
        let (mut sums, mut light) = (vec![0.0_f32; self.values.len()], vec![0.0_f32; self.values.len()]);
        for (range, seen) in paths.ends.windows(2).zip(&paths.seen) {
            let steps = &paths.steps[range[0]..range[1]];
            let total: f32 = steps.iter().map(|step| step.weight).sum();
            let mut left = *seen;
            for step in steps {
                for (i, share) in step.corners() {
                    left -= step.weight * share * self.values[self.ids[i] as usize] / total;
                }
            }
            for step in steps {
                for (i, share) in step.corners() {
                    let (id, lost) = (self.ids[i] as usize, step.weight * share);
                    light[id] += lost;
                    sums[id] += lost * left;
                }
            }
        }
        (sums, light)
    }
}

impl Paths {
    fn new(volume: &Volume, rays: &[SeenRay]) -> Self {
        let mut paths = Self { ends: vec![0], ..Self::default() };
        for ray in rays.iter().filter(|ray| ray.opacity >= MIN_RAY_LOSS && ray.log10.is_finite()) {
            let before = paths.steps.len();
            let passed = volume.march(
                &ray.ray,
                |_| true,
                |step| {
                    if step.weight >= MIN_STEP_SHARE {
                        paths.steps.push(step);
                    }
                },
            );
            if passed.transmittance > f64::from(1.0 - MIN_RAY_LOSS) || paths.steps.len() == before {
                paths.steps.truncate(before);
                continue;
            }
            paths.ends.push(paths.steps.len());
            paths.seen.push(ray.log10);
        }
        paths
    }
}

/// How much deeper the volume is than what rays see, in the median, as a share of the depth. 0 if nothing
/// is seen.
pub fn deeper(volume: &Volume, rays: &[SeenRay]) -> f64 {
    let judges: Vec<&SeenRay> = rays.iter().step_by(rays.len().div_ceil(JUDGES).max(1)).collect();
    let off: Vec<f64> = judges
        .into_par_iter()
        .filter(|ray| ray.opacity > 0.5)
        .filter_map(|ray| {
            let depth = volume.march(&ray.ray, |_| true, |_| {}).depth;
            (depth > 0.0).then_some((depth - ray.depth) / ray.depth)
        })
        .collect();
    if off.is_empty() { 0.0 } else { median(off) }
}

/// For every sample of an atlas, the first sample at the same place: faces of bricks are repeated.
pub fn first_of_faces(bricks: &[[u32; 3]]) -> Vec<u32> {
    let mut known: HashMap<[u32; 3], u32> = HashMap::new();
    let mut ids: Vec<u32> = (0..(bricks.len() * SAMPLES) as u32).collect();
    for (slot, index) in bricks.iter().enumerate() {
        for i in 0..SAMPLES {
            let at = place(i);
            if !at.iter().any(|k| *k == 0 || *k == SIDE - 1) {
                continue;
            }
            let at = std::array::from_fn(|axis| index[axis] * CELLS + at[axis] as u32);
            let id = (slot * SAMPLES + i) as u32;
            ids[id as usize] = *known.entry(at).or_insert(id);
        }
    }
    ids
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::viewer::grid::{Grid, sample};
    use crate::viewer::pack::Pages;
    use octobayes::geometry::{Aabb, Domain, Ray};

    /// Where the wall begins, and the decades by which log10 U grows across a cell there.
    const FACE: f64 = 0.137;
    const STEEP: f64 = 2.0;

    /// log10 U on the wall.
    fn along(x: DVec3) -> f64 {
        1.0 + 0.7 * (2.0 * x.y).sin() + 0.4 * x.z
    }

    /// Rays towards the wall, from all over the other side.
    fn rays(count: u32, seed: f64) -> Vec<SeenRay> {
        let share = |k: u32, factor: f64| (seed + f64::from(k) * factor).fract();
        (0..count)
            .map(|k| {
                let target = DVec3::new(FACE, 1.6 * share(k, 0.754_877) - 0.8, 1.6 * share(k, 0.569_840) - 0.8);
                let eye = DVec3::new(3.0, 3.0 * share(k, 0.819_172) - 1.5, 3.0 * share(k, 0.671_043) - 1.5);
                let depth = (target - eye).length();
                SeenRay {
                    ray: Ray::new(eye, target - eye),
                    opacity: 1.0,
                    log10: along(target) as f32,
                    depth,
                    span: [depth; 2],
                    most: f64::INFINITY,
                }
            })
            .collect()
    }

    #[test]
    fn a_wall_is_shown_as_it_is_seen_though_u_is_steep_across_it() {
        let bounds = Aabb::centered_cube(1.0);
        let grid = Grid::new(bounds, &Domain::Box(bounds), 42);
        let bricks = grid.all_bricks();
        let pages = Pages::new(&grid, &bricks);
        let positions: Vec<DVec3> =
            bricks.iter().flat_map(|b| (0..SAMPLES).map(|i| grid.origin + grid.edge * sample(*b, i))).collect();
        // The share of a cell around a sample that the wall fills.
        let filled = |x: &DVec3| ((FACE - x.x) / grid.edge + 0.5).clamp(0.0, 1.0);
        let matter: Vec<u8> = positions.iter().map(|x| (255.0 * filled(x).sqrt()).round() as u8).collect();
        let volume = Volume { grid: &grid, pages: &pages, matter: &matter };
        let fit = Fit::new(&volume, first_of_faces(&bricks), &rays(60_000, 0.1));

        // Other rays, through both volumes: that of values at the samples, and the fitted one.
        let at_samples: Vec<f64> =
            positions.iter().map(|x| along(*x) + STEEP * (x.x - FACE).abs() / grid.edge).collect();
        let mut off = [Vec::new(), Vec::new()];
        for seen in rays(2000, 0.7) {
            let (mut sums, mut total) = ([0.0; 2], 0.0);
            volume.march(
                &seen.ray,
                |_| true,
                |step| {
                    for (i, share) in step.corners() {
                        let weight = f64::from(step.weight * share);
                        sums[0] += weight * at_samples[i];
                        sums[1] += weight * fit.at(i).map_or(at_samples[i], f64::from);
                    }
                    total += f64::from(step.weight);
                },
            );
            assert!(total > 0.99, "the wall is opaque: {total}");
            (0..2).for_each(|k| off[k].push((sums[k] / total - f64::from(seen.log10)).abs()));
        }
        for off in &mut off {
            off.sort_unstable_by(f64::total_cmp);
        }
        let [sampled, fitted] = off.map(|off| off[off.len() * 95 / 100]);
        assert!(sampled > 0.3, "values at the samples would do: {sampled}");
        assert!(fitted <= 0.02, "{fitted}");
    }

    #[test]
    fn samples_that_bricks_share_get_one_value() {
        let ids = first_of_faces(&[[0, 0, 0], [1, 0, 0], [1, 1, 0]]);
        // The last of a row is the first of the next brick's, and corners meet across an edge.
        let at = |slot: usize, [x, y, z]: [usize; 3]| ids[slot * SAMPLES + x + SIDE * (y + SIDE * z)];
        assert_eq!(at(1, [0, 3, 2]), at(0, [7, 3, 2]));
        assert_eq!(at(2, [0, 0, 5]), at(0, [7, 7, 5]));
        assert_ne!(at(1, [1, 0, 0]), at(0, [7, 0, 0]));
    }
}
