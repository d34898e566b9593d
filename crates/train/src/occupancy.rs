//! instant-ngp's occupancy grid (Müller et al. 2022, App. E.2): where sampling is worthwhile during training.
//!
//! n³ cells of the unit cube, x fastest. A cell keeps the largest of its recent density samples, which decays
//! every few steps. It is occupied if this density would make one march step more than 1 % opaque. Cells that no
//! camera sees stay empty.

use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use octobayes::geometry::Camera;
use octobayes_models::hash_grid::{BLOCK, N_GEOMETRY, N_NEURONS, Parameters, Space, WIDTH, density_pass};

/// Steps between two updates.
pub const INTERVAL: u64 = 16;
/// Share of its density that a cell keeps from one sample to the next.
const DECAY: f32 = 0.95;
/// One in this many of the empty cells is sampled in an update. Occupied cells are all sampled.
const TURNS: u64 = 16;
/// Number of first updates that sample all cells, so that first guesses are soon replaced.
const FULL_UPDATES: u64 = 4;
/// Optical thickness of one march step above which a cell is occupied.
const OPTICAL_THICKNESS: f64 = 0.01;
/// Side of a brick of cells that rays skip when it is empty.
const BRICK: usize = 4;

/// Occupancy grid of a field in training.
#[derive(Debug, Clone, PartialEq)]
pub struct OccupancyGrid {
    n: usize,
    /// `[n³]`: density per unit length of the space; −1 where no camera looks.
    pub densities: Vec<f32>,
    occupied: Vec<bool>,
    /// `[(n / 4)³]`: true if a cell of the brick is occupied.
    bricks: Vec<bool>,
    threshold: f32,
}

impl OccupancyGrid {
    /// A grid in which every cell that a camera sees is occupied.
    #[must_use]
    pub fn new(n: usize, space: &Space, cameras: &[Camera]) -> Self {
        let densities: Vec<f32> = (0..n * n * n)
            .into_par_iter()
            .map(|cell| {
                let u = |shift: f64| (DVec3::from(coordinates(cell, n).map(|i| i as f64)) + shift) / n as f64;
                let x = space.domain.to_scene(u(0.5));
                // From the centre of a cell to its corners, stretched by Φ⁻¹.
                let reach = 0.87 / n as f64 * space.unit_length() * space.domain.stretch(x.as_vec3()).powi(2);
                if cameras.iter().any(|camera| sees(camera, x, reach)) { f32::INFINITY } else { -1.0 }
            })
            .collect();
        // Densities start at infinity: above any threshold, and replaced by the first sample.
        let threshold = (OPTICAL_THICKNESS * space.unit_length() / space.step()) as f32;
        Self::from_densities(n, densities, threshold)
    }

    /// Restores a grid from saved densities.
    #[must_use]
    pub fn restore(n: usize, space: &Space, densities: Vec<f32>) -> Self {
        Self::from_densities(n, densities, (OPTICAL_THICKNESS * space.unit_length() / space.step()) as f32)
    }

    fn from_densities(n: usize, densities: Vec<f32>, threshold: f32) -> Self {
        let mut grid = Self { n, densities, occupied: Vec::new(), bricks: Vec::new(), threshold };
        grid.mark();
        grid
    }

    /// Marks the cells that the window of a finished field reaches: occupied cells and their neighbours.
    #[must_use]
    pub fn reached(n: usize, space: &Space, occupied: &[bool]) -> Self {
        let mut densities = vec![0.0; n * n * n];
        for (cell, _) in occupied.iter().enumerate().filter(|(_, occupied)| **occupied) {
            let [xs, ys, zs] = coordinates(cell, n).map(|i| i.saturating_sub(1)..=(i + 1).min(n - 1));
            for z in zs {
                for y in ys.clone() {
                    densities[(z * n + y) * n + xs.start()..=(z * n + y) * n + xs.end()].fill(f32::INFINITY);
                }
            }
        }
        Self::restore(n, space, densities)
    }

    /// `[n³]`: true for occupied cells.
    #[must_use]
    pub fn occupied(&self) -> &[bool] {
        &self.occupied
    }

    /// Checks whether the cell of a position in the unit cube is occupied. If not, the error is the size in cells
    /// of the empty block around it.
    #[inline]
    pub fn at(&self, u: [f32; 3]) -> Result<(), usize> {
        let cell = u.map(|u| ((u * self.n as f32) as usize).min(self.n - 1));
        let b = self.n / BRICK;
        let [x, y, z] = cell.map(|i| i / BRICK);
        if !self.bricks[(z * b + y) * b + x] {
            return Err(BRICK);
        }
        if self.occupied[(cell[2] * self.n + cell[1]) * self.n + cell[0]] { Ok(()) } else { Err(1) }
    }

    /// Cells per axis.
    #[must_use]
    pub fn resolution(&self) -> usize {
        self.n
    }

    /// Samples the occupied cells and a part of the others, each at a random point; `update` counts from 0.
    pub fn update(&mut self, parameters: &Parameters, seed: u64, update: u64) {
        let n = self.n;
        let looks: Vec<u32> = (0..n * n * n)
            .filter(|&cell| {
                let due = update < FULL_UPDATES || self.occupied[cell] || cell as u64 % TURNS == update % TURNS;
                due && self.densities[cell] >= 0.0
            })
            .map(|cell| cell as u32)
            .collect();
        let found: Vec<f32> = looks
            .par_chunks(16 * BLOCK)
            .enumerate()
            .flat_map_iter(|(part, cells)| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0cc0);
                rng.set_stream(update << 32 | part as u64);
                let point =
                    |cell: &u32| coordinates(*cell as usize, n).map(|i| (i as f32 + rng.random::<f32>()) / n as f32);
                let u: Vec<[f32; 3]> = cells.iter().map(point).collect();
                let mut f = vec![[0.0; WIDTH]; u.len()];
                let (mut a, mut g) = (vec![[0.0; N_NEURONS]; u.len()], vec![[0.0; N_GEOMETRY]; u.len()]);
                let mut sigma = vec![0.0; u.len()];
                density_pass(parameters, &u, &mut f, &mut a, &mut g, &mut sigma);
                sigma
            })
            .collect();
        for (&cell, density) in looks.iter().zip(found) {
            let kept = &mut self.densities[cell as usize];
            *kept = if kept.is_finite() { density.max(DECAY * *kept) } else { density };
        }
        self.mark();
    }

    /// Updates which cells are occupied.
    fn mark(&mut self) {
        let n = self.n;
        // While everything is thin fog, the cells above its mean density are occupied.
        let seen = self.densities.iter().filter(|d| **d >= 0.0);
        let (sum, count) = seen.fold((0.0_f64, 0_u64), |(sum, count), d| (sum + f64::from(*d), count + 1));
        let threshold = self.threshold.min((sum / count.max(1) as f64) as f32);
        self.occupied = self.densities.iter().map(|d| *d > threshold).collect();
        let b = n / BRICK;
        self.bricks = vec![false; b * b * b];
        for (cell, _) in self.occupied.iter().enumerate().filter(|(_, occupied)| **occupied) {
            let [x, y, z] = coordinates(cell, n).map(|i| i / BRICK);
            self.bricks[(z * b + y) * b + x] = true;
        }
    }
}

/// Indices of a cell along x, y and z.
fn coordinates(cell: usize, n: usize) -> [usize; 3] {
    [cell % n, cell / n % n, cell / (n * n)]
}

/// Returns true if a ball around a scene point may be in a camera's picture.
fn sees(camera: &Camera, x: DVec3, radius: f64) -> bool {
    if camera.position.distance(x) <= radius {
        return true;
    }
    camera.project(x).is_some_and(|([i, j], depth)| {
        let margin = [0, 1].map(|k| camera.focal[k] * 2.0 * radius / depth);
        let inside = |v: f64, k: usize| v >= -margin[k] && v <= f64::from(camera.resolution[k]) + margin[k];
        inside(i, 0) && inside(j, 1)
    })
}
