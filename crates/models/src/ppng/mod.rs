//! Plenoptic PNG: a trained grid NeRF of 150 KB (Lee et al., arXiv 2409.15689), as its instant-ngp fork
//! writes it (`.ppng`).
//!
//! Letters: `x` scene position; `p` file position (instant-ngp's: the object lies in [0, 1]³); `c` = p − ½; S
//! the side of the box, 1 for objects and more for unbounded scenes. The tables are functions of q = c/S + ½
//! in the unit cube.
//!
//! ```text
//! x -> c -> sines and cosines -> tables -> 32 features -> tiny networks -> σ, colour
//!      c -> window of the occupancy grid ------------------------------------^
//! ```
//! Positions go through in blocks, in code that the compiler turns into vector instructions. AVX2 and FMA are
//! used where the processor has them. Results do not depend on that: every operation is rounded as IEEE
//! demands. (An x86 processor without FMA, older than 2013, emulates it and is slow.)

mod coordinates;
mod features;
mod file;
mod network;

pub use coordinates::Coordinates;

use std::path::Path;

use glam::{DMat3, DVec3, Vec3};
use multiversion::multiversion;

use self::features::{BLOCK, Encoding, JET, Kind, WIDTH};
use self::file::File;
use self::network::{HIDDEN, Network, OUTPUTS};
use crate::window::Window;
use octobayes::field::{Differentiable, Intrinsics, Radiance, RadianceField, RadianceJet, TrainedField};
use octobayes::geometry::{Aabb, Camera};
use octobayes::{Error, Result};

/// Default image size of the file's cameras.
const RESOLUTION: [u32; 2] = [400, 400];

/// A trained Plenoptic PNG.
///
/// The density is the network's times a continuous window: 1 in the cells that the file's occupancy grid
/// marks, 0 from one cell beyond them. The trainer sampled marked cells only; elsewhere the network is noise.
/// Colour has no window, so finite differences of colour never meet an edge.
#[derive(Debug, Clone)]
pub struct Ppng {
    coordinates: Coordinates,
    encoding: Encoding,
    size: (Kind, usize, usize),
    network: Network,
    window: Window,
    occupied_cells: Vec<u64>,
    /// Rotation (columns right, down, forward) and position in file coordinates.
    poses: Vec<(DMat3, DVec3)>,
    /// Distance between samples, file units.
    step: f64,
}

/// Buffers of one block of N points, as a structure of arrays: `[axis][point]`, with points as lanes.
struct PointBlock<const N: usize> {
    centered: [[f32; N]; 3],
    /// The window w.
    windows: [f32; N],
    /// ∇w by c. Zero in blocks without derivatives.
    ramps: [Vec3; N],
    directions: [[f32; N]; 3],
    features: [[f32; WIDTH]; BLOCK],
    hidden: [[f32; HIDDEN]; BLOCK],
    colors: [[f32; OUTPUTS]; BLOCK],
}

/// Number of points in a block with derivatives.
const JETS: usize = BLOCK / JET;

impl<const N: usize> PointBlock<N> {
    fn new() -> Self {
        Self {
            centered: [[0.0; N]; 3],
            windows: [0.0; N],
            ramps: [Vec3::ZERO; N],
            directions: [[0.0; N]; 3],
            features: [[0.0; WIDTH]; BLOCK],
            hidden: [[0.0; HIDDEN]; BLOCK],
            colors: [[0.0; OUTPUTS]; BLOCK],
        }
    }
}

impl<const N: usize> PointBlock<N> {
    /// Puts point `p` at ½ + `c`.
    fn put(&mut self, p: usize, c: Vec3, (window, ramp): (f32, Vec3)) {
        for axis in 0..3 {
            self.centered[axis][p] = c[axis];
        }
        self.windows[p] = window;
        self.ramps[p] = ramp;
    }
}

/// Fills `hidden` of the block's first `count` points. With [`JET`] rows per point, their derivatives follow.
#[multiversion(targets("x86_64+avx2+fma"))]
fn hidden_block<const N: usize, const ROWS: usize>(
    encoding: &Encoding,
    network: &Network,
    block: &mut PointBlock<N>,
    count: usize,
) {
    encoding.encode::<N, ROWS>(&block.centered, count, &mut block.features);
    network.hidden(&block.features, ROWS * count, &mut block.hidden);
}

/// Fills h₀ alone in `hidden`, as [`hidden_block`] does.
#[multiversion(targets("x86_64+avx2+fma"))]
fn log_density_block<const N: usize, const ROWS: usize>(
    encoding: &Encoding,
    network: &Network,
    block: &mut PointBlock<N>,
    count: usize,
) {
    encoding.encode::<N, ROWS>(&block.centered, count, &mut block.features);
    network.log_density(&block.features, ROWS * count, &mut block.hidden);
}

/// σ (1 / file unit, without the window) of the block's points, after [`log_density_block`] or [`hidden_block`].
#[multiversion(targets("x86_64+avx2+fma"))]
fn density_block<const N: usize>(block: &PointBlock<N>) -> [f32; N] {
    let rows = BLOCK / N;
    let mut densities = [0.0; N];
    for (p, density) in densities.iter_mut().enumerate() {
        *density = network::density(block.hidden[rows * p][0]);
    }
    densities
}

/// Fills `colors`, after [`hidden_block`].
#[multiversion(targets("x86_64+avx2+fma"))]
fn color_block(network: &Network, block: &mut PointBlock<BLOCK>, count: usize) {
    network.color(&block.hidden, &block.directions, count, &mut block.colors);
}

/// Fills `colors` and their derivatives, after [`hidden_block`].
#[multiversion(targets("x86_64+avx2+fma"))]
fn color_jet_block(network: &Network, block: &mut PointBlock<JETS>, count: usize) {
    network.color_jets(&block.hidden, &block.directions, count, &mut block.colors);
}

impl Ppng {
    /// Reads a `.ppng` file for use in the given scene coordinates.
    ///
    /// # Errors
    /// If the file cannot be read, a value is missing or outside its range, lengths contradict each other, or
    /// a number is not finite.
    pub fn read(path: &Path, coordinates: Coordinates) -> Result<Self> {
        File::read(path).map(|file| Self::new(file, coordinates))
    }

    fn new(file: File, coordinates: Coordinates) -> Self {
        let count = |cells: &Vec<bool>| cells.iter().filter(|&&cell| cell).count() as u64;
        Self {
            coordinates,
            encoding: file.encoding,
            size: file.size,
            network: file.network,
            occupied_cells: file.occupied.iter().map(count).collect(),
            window: Window::new(file.cells, file.occupied),
            poses: file.poses,
            step: file.step,
        }
    }

    /// Number of cells that the occupancy grid marks in each cascade, from the innermost.
    #[must_use]
    pub fn occupied_cells(&self) -> &[u64] {
        &self.occupied_cells
    }
}

impl RadianceField for Ppng {
    fn bounds(&self) -> Aabb {
        self.coordinates.cube(self.window.side())
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let scale = self.coordinates.scale() as f32;
        let mut block = PointBlock::<BLOCK>::new();
        for ((positions, directions), out) in
            positions.chunks(BLOCK).zip(directions.chunks(BLOCK)).zip(out.chunks_mut(BLOCK))
        {
            self.place(positions, &mut block);
            self.look(directions, &mut block);
            hidden_block::<BLOCK, 1>(&self.encoding, &self.network, &mut block, positions.len());
            let densities = density_block(&block);
            color_block(&self.network, &mut block, positions.len());
            for (p, out) in out.iter_mut().enumerate() {
                out.density = scale * block.windows[p] * densities[p];
                let [r, g, b, _] = block.colors[p];
                out.color = Vec3::new(r, g, b);
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        let scale = self.coordinates.scale() as f32;
        out.fill(0.0);
        self.gather::<BLOCK>(positions, |block, owners| {
            log_density_block::<BLOCK, 1>(&self.encoding, &self.network, block, owners.len());
            for (p, (&owner, density)) in owners.iter().zip(density_block(block)).enumerate() {
                out[owner] = scale * block.windows[p] * density;
            }
        });
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        let [a, b] = [min, max].map(|x| self.coordinates.centered(x).as_dvec3());
        (a.is_finite() && b.is_finite() && self.window.is_empty(a, b)).then_some(0.0)
    }

    fn suggested_step(&self) -> f64 {
        self.step / self.coordinates.scale()
    }

    fn memory(&self) -> usize {
        self.encoding.memory() + self.window.memory() + size_of::<Self>() + size_of_val(self.poses.as_slice())
    }
}

impl TrainedField for Ppng {
    fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        let fov_x = intrinsics.fov_x.ok_or_else(|| {
            Error::setting("angle of view", "the horizontal angle of view, which a .ppng file does not store", "none")
        })?;
        let resolution = intrinsics.resolution.unwrap_or(RESOLUTION);
        let cameras = self.poses.iter().map(|&pose| self.coordinates.camera(pose, fov_x, resolution));
        Ok(if self.poses.is_empty() { None } else { Some(cameras.collect()) })
    }

    fn describe(&self) -> String {
        let (kind, quants, rank) = self.size;
        let tables = match kind {
            Kind::Vectors => "vectors (type 1)",
            Kind::Planes => "planes (type 2)",
        };
        format!(
            "Plenoptic PNG, {tables} of {quants} points and rank {rank}, {} poses, {} coordinates",
            self.poses.len(),
            self.coordinates.name()
        )
    }
}

impl Differentiable for Ppng {
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        let scale = self.coordinates.scale() as f32;
        let mut block = PointBlock::<JETS>::new();
        for ((positions, directions), out) in
            positions.chunks(JETS).zip(directions.chunks(JETS)).zip(out.chunks_mut(JETS))
        {
            self.place(positions, &mut block);
            self.look(directions, &mut block);
            hidden_block::<JETS, JET>(&self.encoding, &self.network, &mut block, positions.len());
            let densities = density_block(&block);
            color_jet_block(&self.network, &mut block, positions.len());
            for (p, out) in out.iter_mut().enumerate() {
                let rows = &block.colors[JET * p..JET * (p + 1)];
                let [value, x, y, z] = [0, 1, 2, 3].map(|row| Vec3::new(rows[row][0], rows[row][1], rows[row][2]));
                out.value = Radiance { density: scale * block.windows[p] * densities[p], color: value };
                out.density_gradient = self.density_gradient(&block, densities[p], p);
                out.color_gradients = self.coordinates.gradient([x, y, z]);
            }
        }
    }

    fn density_jets(&self, positions: &[Vec3], densities: &mut [f32], gradients: &mut [Vec3]) {
        let scale = self.coordinates.scale() as f32;
        densities.fill(0.0);
        gradients.fill(Vec3::ZERO);
        self.gather::<JETS>(positions, |block, owners| {
            log_density_block::<JETS, JET>(&self.encoding, &self.network, block, owners.len());
            for (p, (&owner, density)) in owners.iter().zip(density_block(block)).enumerate() {
                densities[owner] = scale * block.windows[p] * density;
                gradients[owner] = self.density_gradient(block, density, p);
            }
        });
    }
}

impl Ppng {
    /// Puts up to N positions into the block.
    fn place<const N: usize>(&self, positions: &[Vec3], block: &mut PointBlock<N>) {
        for (p, &x) in positions.iter().enumerate() {
            let c = self.coordinates.centered(x);
            block.put(p, c, self.window_at::<N>(c));
        }
    }

    /// w at ½ + `c`, with ∇w in blocks with derivatives.
    #[inline]
    fn window_at<const N: usize>(&self, c: Vec3) -> (f32, Vec3) {
        if N == JETS { self.window.at_with_gradient(c) } else { (self.window.at(c), Vec3::ZERO) }
    }

    /// Puts the points' directions into the block.
    fn look<const N: usize>(&self, directions: &[Vec3], block: &mut PointBlock<N>) {
        for (p, &d) in directions.iter().enumerate() {
            let d = self.coordinates.direction(d).to_array();
            d.iter().zip(&mut block.directions).for_each(|(d, to)| to[p] = *d);
        }
    }

    /// Gathers the positions outside empty space into blocks, and calls `visit` with each block and their indices.
    ///
    /// Positions in empty space need no network.
    fn gather<const N: usize>(&self, positions: &[Vec3], mut visit: impl FnMut(&mut PointBlock<N>, &[usize])) {
        let mut block = PointBlock::<N>::new();
        let (mut owners, mut count) = ([0; N], 0);
        for (i, &x) in positions.iter().enumerate() {
            let c = self.coordinates.centered(x);
            let window = self.window_at::<N>(c);
            if window.0 > 0.0 {
                block.put(count, c, window);
                owners[count] = i;
                count += 1;
                if count == N {
                    visit(&mut block, &owners);
                    count = 0;
                }
            }
        }
        if count > 0 {
            visit(&mut block, &owners[..count]);
        }
    }

    /// ∇σ in scene units of point `p` of the block. `density` is σ without the window, per file unit.
    fn density_gradient(&self, block: &PointBlock<JETS>, density: f32, p: usize) -> Vec3 {
        let (window, ramp) = (block.windows[p], block.ramps[p]);
        let rows = &block.hidden[JET * p..JET * (p + 1)];
        let slope = window * network::density_slope(density, rows[0][0]);
        let along = ramp * density + slope * Vec3::new(rows[1][0], rows[2][0], rows[3][0]);
        let [x, y, z] = self.coordinates.gradient(along.to_array());
        self.coordinates.scale() as f32 * Vec3::new(x, y, z)
    }
}

#[cfg(test)]
mod tests;
