//! Sample positions along a training ray: only in occupied cells, at constant steps, longer
//! where space is contracted.

use super::occupancy::OccupancyGrid;
use octobayes::geometry::{Domain, Ray};
use octobayes_models::hash_grid::Space;

/// One sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Distance along the ray, scene units.
    pub t: f64,
    /// Length of its interval, scene units.
    pub delta: f64,
    /// Position in the unit cube.
    pub u: [f32; 3],
}

/// A ray while it is sampled.
#[derive(Debug, Clone)]
pub struct Walk {
    ray: Ray,
    t: f64,
    exit: f64,
}

impl Walk {
    /// Starts where the ray enters the space; `jitter` in `[0, 1)` shifts samples by that share of a step.
    #[must_use]
    pub fn new(space: &Space, ray: Ray, jitter: f64) -> Self {
        let (entry, exit) = space.bounds.clip(&ray).unwrap_or_default();
        Self { ray, t: entry + jitter * space.step(), exit }
    }

    /// Returns the next sample in an occupied cell.
    pub fn next(&mut self, space: &Space, grid: &OccupancyGrid) -> Option<Sample> {
        while self.t < self.exit {
            let t = self.t;
            let x = self.ray.at(t).as_vec3();
            let delta = space.step() * space.domain.stretch(x);
            // Rounding may put a point just outside.
            let x = space.bounds.clamp(x);
            match space.unit(x).map(|u| (u, grid.at(u))) {
                Some((u, Ok(()))) => {
                    self.t += delta;
                    return Some(Sample { t, delta, u });
                }
                Some((u, Err(cells))) => self.t += self.leap(space, grid, u, cells, delta),
                None => self.t += delta,
            }
        }
        None
    }

    /// Distance to the first candidate behind an empty block of `cells` cells around `u`.
    ///
    /// It is a whole number of steps, so that samples keep their places.
    fn leap(&self, space: &Space, grid: &OccupancyGrid, u: [f32; 3], cells: usize, delta: f64) -> f64 {
        let Domain::Box(bounds) = space.domain else { return delta };
        let size = bounds.size();
        let block = cells as f64 / grid.resolution() as f64;
        let mut exit = f64::INFINITY;
        for axis in 0..3 {
            let speed = self.ray.direction[axis] / size[axis];
            let index = (f64::from(u[axis]) / block).floor();
            let face = if speed > 0.0 { (index + 1.0) * block } else { index * block };
            if speed != 0.0 {
                exit = exit.min((face - f64::from(u[axis])) / speed);
            }
        }
        (exit / delta).ceil().clamp(1.0, 1e6) * delta
    }
}
