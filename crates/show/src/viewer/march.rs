//! The shader's way through the volume, on the CPU: `web/march.glsl` step by step.

use glam::{DVec3, Vec3};

use super::grid::{CELLS, Grid, SAMPLES, SIDE};
use super::pack::Pages;
use octobayes::geometry::{Domain, Norm, Ray};

/// Of a cell.
const STEP: f64 = 0.5;
/// Transmittance at which a ray ends.
const MIN_TRANSMITTANCE: f64 = 0.003;
/// What absorbs less along a cell is taken for nothing: codes of √α.
const MIN_ALPHA_CODE: f64 = 0.002 * 255.0;

/// A volume with matter.
pub struct Volume<'a> {
    pub grid: &'a Grid,
    pub pages: &'a Pages,
    /// `[bricks][SAMPLES]`: codes of √α.
    pub matter: &'a [u8],
}

/// A place on a ray where light is lost.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Among the samples of all bricks: the lower corner of the cell.
    pub base: u32,
    /// Place in the cell.
    pub part: [f32; 3],
    /// What is lost of the ray's light.
    pub weight: f32,
}

/// Where a ray ends.
#[derive(Debug, Clone, Copy)]
pub struct Passed {
    pub transmittance: f64,
    /// Distance at which half of the light is lost; 0 if it is not.
    pub depth: f64,
}

impl Step {
    /// The samples around, with their shares in what is interpolated.
    pub fn corners(self) -> impl Iterator<Item = (usize, f32)> {
        let [fx, fy, fz] = self.part;
        (0..8_usize).map(move |c| {
            let share = |axis: usize, f: f32| if c >> axis & 1 == 1 { f } else { 1.0 - f };
            let offset = (c & 1) + SIDE * ((c >> 1 & 1) + SIDE * (c >> 2));
            (self.base as usize + offset, share(0, fx) * share(1, fy) * share(2, fz))
        })
    }
}

impl Volume<'_> {
    /// Follows a ray. Matter is removed where it is not to be kept.
    pub fn march(&self, ray: &Ray, keeps: impl Fn(Vec3) -> bool, mut visit: impl FnMut(Step)) -> Passed {
        let grid = self.grid;
        let is_folded = matches!(grid.domain, Domain::Contracted { .. });
        let (cells_per_brick, last) = (f64::from(CELLS), grid.bricks.map(|n| n - 1));
        // A direction along an axis would divide by zero.
        let d = DVec3::from(ray.direction.to_array().map(|v| if v.abs() < 1e-7 { 1e-7 } else { v }));
        let ray = Ray { direction: d, ..*ray };
        let mut passed = Passed { transmittance: 1.0, depth: 0.0 };
        let Some((mut t, end)) = grid.bounds.clip(&ray) else { return passed };
        let mut is_long = false;
        for _ in 0..4096 {
            if t >= end || passed.transmittance <= MIN_TRANSMITTANCE {
                break;
            }
            let p = ray.at(t);
            let g = grid.folded(p);
            let brick: [u32; 3] =
                std::array::from_fn(|axis| ((g[axis] / cells_per_brick).floor().max(0.0) as u32).min(last[axis]));
            let low = DVec3::from(brick.map(|k| f64::from(k) * cells_per_brick));
            let speed = speed(grid, p, d);
            let slot = match self.pages.find(brick) {
                Ok(slot) => slot,
                Err(distance) => {
                    let room = f64::from(distance) * cells_per_brick;
                    let (from, to) = (low - room + cells_per_brick, low + room);
                    if is_folded {
                        let room = (g - from).min(to - g).min_element();
                        let straight = 0.5 * room.max(0.0) / speed;
                        let (reach, radius) = reach(grid, p);
                        t += straight.min((0.3 * reach + 0.3) * radius).max(STEP / speed);
                    } else {
                        let walk = d / grid.edge;
                        let leaves = DVec3::from_array(std::array::from_fn(|axis| {
                            ((if walk[axis] >= 0.0 { to[axis] } else { from[axis] }) - g[axis]) / walk[axis]
                        }));
                        t += leaves.min_element().max(0.0) + 0.01 * grid.edge;
                        is_long = false;
                    }
                    continue;
                }
            };
            let advance = (STEP / speed).min(end - t + 1e-6 * grid.edge);
            let inside = (g - low).clamp(DVec3::ZERO, DVec3::splat(cells_per_brick));
            let cell = inside.floor().min(DVec3::splat(cells_per_brick - 1.0));
            let [x, y, z] = cell.to_array().map(|k| k as usize);
            let base = slot * SAMPLES + x + SIDE * (y + SIDE * z);
            let mut step = Step { base: base as u32, part: (inside - cell).as_vec3().to_array(), weight: 0.0 };
            let code: f32 = step.corners().map(|(i, share)| share * f32::from(self.matter[i])).sum();
            if f64::from(code) <= MIN_ALPHA_CODE {
                t += 2.0 * advance;
                is_long = true;
                continue;
            }
            if is_long {
                t -= advance;
                is_long = false;
                continue;
            }
            if !keeps(p.as_vec3()) {
                t += advance;
                continue;
            }
            let alpha = (f64::from(code) / 255.0).powi(2);
            let lost = -(1.0 - alpha).max(0.001).ln() * advance / grid.length(p.as_vec3());
            let before = passed.transmittance;
            passed.transmittance *= (-lost).exp();
            if before > 0.5 && passed.transmittance <= 0.5 {
                passed.depth = t + advance * ((2.0 * before).ln() / lost - 0.5);
            }
            step.weight = (before - passed.transmittance) as f32;
            visit(step);
            t += advance;
        }
        passed
    }
}

/// Distance from the middle of a contraction in units of its radius, and that.
fn reach(grid: &Grid, p: DVec3) -> (f64, f64) {
    match &grid.domain {
        Domain::Contracted { center, radius, norm } => {
            let y = (p - DVec3::from(*center)) / *radius;
            (norm.length(y), *radius)
        }
        _ => (0.0, 1.0),
    }
}

/// Lattice cells that a ray crosses per scene unit.
fn speed(grid: &Grid, p: DVec3, d: DVec3) -> f64 {
    let Domain::Contracted { center, radius, norm } = &grid.domain else { return 1.0 / grid.edge };
    let (r, _) = reach(grid, p);
    if r <= 1.0 {
        return 1.0 / grid.edge;
    }
    let y = (p - DVec3::from(*center)) / *radius;
    let (k, slope) = ((2.0 - 1.0 / r) / r, (2.0 / r - 2.0) / (r * r));
    let outwards = match norm {
        Norm::L2 => y / r,
        Norm::Linf => {
            let axis = y.abs().max_position();
            let mut unit = DVec3::ZERO;
            unit[axis] = y[axis].signum();
            unit
        }
    };
    ((k * d + slope * outwards.dot(d) * y).length() / grid.edge).max(1e-6 / grid.edge)
}
