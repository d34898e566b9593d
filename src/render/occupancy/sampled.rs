//! Occupancy of a black box, estimated from samples.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::pyramid::{BRICK, CELLS, EDGE, blocks};
use crate::Result;
use crate::field::RadianceField;
use crate::monitor::{Monitor, check};

/// Largest density at the corners and the centre of each of `n`³ cells and of the cells up to `rings` away along each
/// axis, `[n³]`, x slowest.
///
/// # Errors
/// [`crate::Error::Interrupted`] only.
pub fn sample(field: &dyn RadianceField, n: usize, rings: [usize; 3], monitor: &dyn Monitor) -> Result<Vec<f32>> {
    monitor.begin("occupancy", 2 * n as u64 + 1);
    let corners = sample_lattice(field, n + 1, 0.0, n, monitor);
    let centers = sample_lattice(field, n, 0.5, n, monitor);
    monitor.end();
    check(monitor)?;

    let mut own = vec![0.0_f32; n * n * n];
    own.par_chunks_mut(n * n).enumerate().for_each(|(x, slab)| {
        for (i, cell) in slab.iter_mut().enumerate() {
            let (y, z) = (i / n, i % n);
            *cell = (0..8)
                .map(|c| corners[((x + (c & 1)) * (n + 1) + y + (c >> 1 & 1)) * (n + 1) + z + (c >> 2)])
                .fold(centers[(x * n + y) * n + z], f32::max);
        }
    });
    drop((corners, centers));
    Ok((0..3).fold(own, |grid, axis| dilate(&grid, n, axis, rings[axis])))
}

/// One brick of an `[n³]` grid, zero where it sticks out of the grid.
pub fn brick(grid: &[f32], n: usize, index: usize) -> [f32; CELLS] {
    let b = blocks(n, BRICK);
    let [x0, y0, z0] = [index / (b * b), index / b % b, index % b].map(|i| EDGE * i);
    let mut brick = [0.0; CELLS];
    for x in x0..(x0 + EDGE).min(n) {
        for y in y0..(y0 + EDGE).min(n) {
            for z in z0..(z0 + EDGE).min(n) {
                brick[((x - x0) * EDGE + y - y0) * EDGE + z - z0] = grid[(x * n + y) * n + z];
            }
        }
    }
    brick
}

/// Densities at the points `min + (index + shift) / cells · size`, `[count³]`, x slowest. NaN becomes ∞.
fn sample_lattice(
    field: &dyn RadianceField,
    count: usize,
    shift: f64,
    cells: usize,
    monitor: &dyn Monitor,
) -> Vec<f32> {
    let bounds = field.bounds();
    let mut densities = vec![0.0_f32; count * count * count];
    // A field with a large batch gets several slabs.
    let slabs = field.batch().div_ceil(count * count).max(1);
    densities.par_chunks_mut(slabs * count * count).enumerate().for_each(|(chunk, densities)| {
        if monitor.interrupted() {
            return;
        }
        let first = chunk * slabs;
        let positions: Vec<Vec3> = (0..densities.len())
            .map(|i| {
                let (x, y, z) = (first + i / (count * count), i / count % count, i % count);
                let index = DVec3::new(x as f64, y as f64, z as f64) + shift;
                bounds.clamp((bounds.min() + index / cells as f64 * bounds.size()).as_vec3())
            })
            .collect();
        field.densities(&positions, densities);
        for density in densities.iter_mut().filter(|d| d.is_nan()) {
            *density = f32::INFINITY;
        }
        monitor.advance((densities.len() / (count * count)) as u64);
    });
    densities
}

/// Maximum over `rings` cells to both sides along one axis of an `[n³]` grid.
fn dilate(grid: &[f32], n: usize, axis: usize, rings: usize) -> Vec<f32> {
    let stride = [n * n, n, 1][axis];
    (0..grid.len())
        .into_par_iter()
        .map(|i| {
            let at = i / stride % n;
            let (low, high) = (at.saturating_sub(rings), (at + rings).min(n - 1));
            (low..=high).map(|j| grid[i + j * stride - at * stride]).fold(0.0, f32::max)
        })
        .collect()
}
