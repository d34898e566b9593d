//! Plenoptic PNG: a trained grid NeRF of 150 KB (Lee et al., arXiv 2409.15689), as written by its instant-ngp fork (`.ppng`).
//!
//! Letters: `x` scene position, `p` file position (instant-ngp's: the object lies in [0, 1]³), `c` = p − ½, S the side of
//! the box, 1 for objects and more for unbounded scenes; q = c/S + ½ in the unit cube is what the tables know.
//!
//! ```text
//! x -> c -> sines and cosines -> tables -> 32 features -> tiny networks -> σ, colour
//!      c -> window of the occupancy grid ------------------------------------^
//! ```
//! Positions go through in blocks of points, in code that the compiler turns into vector instructions; where the processor has
//! AVX2 and FMA they are used. Results do not depend on that: every operation is rounded as IEEE says. (An x86 processor without FMA, older
//! than 2013, emulates it and is slow.)

mod coordinates;
mod features;
mod file;
mod network;

pub use coordinates::Coordinates;

use std::path::Path;

use glam::{DMat3, DVec3, Vec3};
use multiversion::multiversion;

use self::features::{BLOCK, Encoding, Kind, WIDTH};
use self::file::File;
use self::network::{HIDDEN, LOG_DENSITY_LIMIT, Network, OUTPUTS};
use super::window::Window;
use super::{Intrinsics, Radiance, RadianceField};
use crate::geometry::{Aabb, Camera};
use crate::{Error, Result};

/// Image size of the file's cameras unless told otherwise.
const RESOLUTION: [u32; 2] = [400, 400];

/// A trained Plenoptic PNG.
///
/// The density is the network's times a continuous window: 1 in the cells that the file's occupancy grid marks, 0 from one cell
/// beyond them. The trainer sampled marked cells only; what the network says elsewhere is noise. Colour has no window: a
/// finite difference of it never meets an edge.
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
    /// File units.
    step: f64,
}

/// Buffers of one block: structure of arrays, `[axis][point]`, where points are lanes.
struct Block {
    centered: [[f32; BLOCK]; 3],
    directions: [[f32; BLOCK]; 3],
    features: [[f32; WIDTH]; BLOCK],
    hidden: [[f32; HIDDEN]; BLOCK],
    densities: [f32; BLOCK],
    colors: [[f32; OUTPUTS]; BLOCK],
}

impl Block {
    fn new() -> Self {
        Self {
            centered: [[0.0; BLOCK]; 3],
            directions: [[0.0; BLOCK]; 3],
            features: [[0.0; WIDTH]; BLOCK],
            hidden: [[0.0; HIDDEN]; BLOCK],
            densities: [0.0; BLOCK],
            colors: [[0.0; OUTPUTS]; BLOCK],
        }
    }
}

/// Fills `hidden` and `densities` (1 / file unit, without the window) of the block's first `count` points.
#[multiversion(targets("x86_64+avx2+fma"))]
fn density_block(encoding: &Encoding, network: &Network, block: &mut Block, count: usize) {
    encoding.encode(&block.centered, count, &mut block.features);
    network.hidden(&block.features, count, &mut block.hidden);
    for (density, hidden) in block.densities.iter_mut().zip(&block.hidden) {
        *density = network::density(hidden[0]);
    }
}

/// Fills `colors`, behind [`density_block`].
#[multiversion(targets("x86_64+avx2+fma"))]
fn color_block(network: &Network, block: &mut Block, count: usize) {
    network.color(&block.hidden, &block.directions, count, &mut block.colors);
}

impl Ppng {
    /// Reads a `.ppng` file, to be used in the given scene coordinates.
    ///
    /// # Errors
    /// If the file cannot be read, a value is missing or outside its range, lengths contradict each other, or a number is not
    /// finite.
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

    /// Cells that the occupancy grid marks, per cascade, from the innermost.
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
        let mut block = Block::new();
        for ((positions, directions), out) in
            positions.chunks(BLOCK).zip(directions.chunks(BLOCK)).zip(out.chunks_mut(BLOCK))
        {
            let mut windows = [0.0; BLOCK];
            for (p, (&x, &d)) in positions.iter().zip(directions).enumerate() {
                let (c, d) = (self.coordinates.centered(x), self.coordinates.direction(d));
                windows[p] = self.window.at(c);
                for axis in 0..3 {
                    block.centered[axis][p] = c[axis];
                    block.directions[axis][p] = d[axis];
                }
            }
            density_block(&self.encoding, &self.network, &mut block, positions.len());
            color_block(&self.network, &mut block, positions.len());
            for (p, out) in out.iter_mut().enumerate() {
                out.density = scale * windows[p] * block.densities[p];
                let [r, g, b, _] = block.colors[p];
                out.color = Vec3::new(r, g, b);
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        let scale = self.coordinates.scale() as f32;
        let mut block = Block::new();
        // Points in empty space need no network: the others are gathered into full blocks.
        let (mut owners, mut windows, mut count) = ([0; BLOCK], [0.0; BLOCK], 0);
        let flush = |block: &mut Block, owners: &[usize], windows: &[f32], out: &mut [f32]| {
            density_block(&self.encoding, &self.network, block, owners.len());
            for ((&owner, &window), &density) in owners.iter().zip(windows).zip(&block.densities) {
                out[owner] = scale * window * density;
            }
        };
        for (i, &x) in positions.iter().enumerate() {
            let c = self.coordinates.centered(x);
            let window = self.window.at(c);
            if window == 0.0 {
                out[i] = 0.0;
                continue;
            }
            for axis in 0..3 {
                block.centered[axis][count] = c[axis];
            }
            (owners[count], windows[count]) = (i, window);
            count += 1;
            if count == BLOCK {
                flush(&mut block, &owners, &windows, out);
                count = 0;
            }
        }
        flush(&mut block, &owners[..count], &windows[..count], out);
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        let [a, b] = [min, max].map(|x| self.coordinates.centered(x).as_dvec3());
        if !(a.is_finite() && b.is_finite()) {
            return None;
        }
        let bound = self.coordinates.scale() as f32 * network::density(LOG_DENSITY_LIMIT);
        Some(if self.window.is_empty(a, b) { 0.0 } else { bound })
    }

    fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        let fov_x = intrinsics.fov_x.ok_or_else(|| {
            Error::setting("--fov", "the horizontal angle of view, which a .ppng file does not tell", "none")
        })?;
        let resolution = intrinsics.resolution.unwrap_or(RESOLUTION);
        let cameras = self.poses.iter().map(|&pose| self.coordinates.camera(pose, fov_x, resolution));
        Ok(if self.poses.is_empty() { None } else { Some(cameras.collect()) })
    }

    fn suggested_step(&self) -> f64 {
        self.step / self.coordinates.scale()
    }

    fn memory(&self) -> usize {
        self.encoding.memory() + self.window.memory() + size_of::<Self>() + size_of_val(self.poses.as_slice())
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

#[cfg(test)]
mod tests;
