//! Where density can be: an upper bound of it on a coarse grid, built from the field itself.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::Result;
use crate::field::RadianceField;
use crate::geometry::Aabb;
use crate::monitor::{Monitor, check};

/// A bound σ̂ of the density in each cell of a regular grid and in the cells around it.
///
/// The field is a black box, so the bound is an estimate: the largest of the densities at a cell's corners and centre and at
/// those of its neighbours. Structures much thinner than a cell can be missed; what that changes is measured against runs
/// without occupancy. A NaN counts as infinite density, so that it is met and reported, not skipped.
#[derive(Debug, Clone)]
pub struct Occupancy {
    bounds: Aabb,
    /// Cells per axis.
    resolution: usize,
    /// `[resolution³]`, x slowest, 1 / scene unit.
    majorant: Vec<f32>,
}

impl Occupancy {
    /// Cells per axis unless told otherwise: 9.4 cm³ of a 3 m box; 4.3 million field evaluations.
    pub const DEFAULT_RESOLUTION: usize = 128;

    /// Samples `field` with `resolution` cells per axis of its box. The bound holds up to a distance `reach` (scene units) from
    /// a cell, at least one cell: finite differences look that far.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn build(field: &dyn RadianceField, resolution: usize, reach: f64, monitor: &dyn Monitor) -> Result<Self> {
        let bounds = field.bounds();
        let n = resolution;
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
        let rings = DVec3::splat(reach) / (bounds.size() / n as f64);
        let majorant = (0..3).fold(own, |grid, axis| dilate(&grid, n, axis, (rings[axis].ceil() as usize).max(1)));
        Ok(Self { bounds, resolution, majorant })
    }

    /// σ̂ at a scene point; 0 outside the box.
    #[must_use]
    pub fn majorant(&self, x: DVec3) -> f32 {
        let u = (x - self.bounds.min()) / self.bounds.size() * self.resolution as f64;
        if !u.cmpge(DVec3::ZERO).all() {
            return 0.0;
        }
        let [i, j, k] = u.to_array().map(|u| u as usize);
        let n = self.resolution;
        // The upper faces belong to the last cell; rounding may put a point of the box there.
        let last = |i: usize| if i == n { n - 1 } else { i };
        let (i, j, k) = (last(i), last(j), last(k));
        if i < n && j < n && k < n { self.majorant[(i * n + j) * n + k] } else { 0.0 }
    }

    /// Share of cells whose bound exceeds `density`.
    #[must_use]
    pub fn share_above(&self, density: f32) -> f64 {
        self.majorant.iter().filter(|&&m| m > density).count() as f64 / self.majorant.len() as f64
    }

    /// Bytes on the heap.
    #[must_use]
    pub fn memory(&self) -> usize {
        size_of_val(self.majorant.as_slice())
    }
}

/// Densities at the points `min + (index + shift) / cells · size`, `[count³]`, x slowest; NaN becomes ∞.
fn sample_lattice(
    field: &dyn RadianceField,
    count: usize,
    shift: f64,
    cells: usize,
    monitor: &dyn Monitor,
) -> Vec<f32> {
    let bounds = field.bounds();
    let mut densities = vec![0.0_f32; count * count * count];
    densities.par_chunks_mut(count * count).enumerate().for_each(|(x, slab)| {
        if monitor.interrupted() {
            return;
        }
        let positions: Vec<Vec3> = (0..count * count)
            .map(|i| {
                let index = DVec3::new(x as f64, (i / count) as f64, (i % count) as f64) + shift;
                bounds.clamp((bounds.min() + index / cells as f64 * bounds.size()).as_vec3())
            })
            .collect();
        field.densities(&positions, slab);
        for density in slab.iter_mut().filter(|d| d.is_nan()) {
            *density = f32::INFINITY;
        }
        monitor.advance(1);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::ClosedForm;
    use crate::monitor::Silent;

    #[test]
    fn bounds_the_density_of_smooth_scenes_everywhere_within_reach() {
        let field = ClosedForm::courtyard();
        let reach = 0.05;
        let occupancy = Occupancy::build(&field, 32, reach, &Silent).unwrap();
        let mut densities = vec![0.0; 4096];
        let positions: Vec<Vec3> = (0..4096)
            .map(|i| Vec3::new((i % 16) as f32, (i / 16 % 16) as f32, (i / 256) as f32) / 7.501 - 1.0)
            .collect();
        field.densities(&positions, &mut densities);
        for (x, &density) in positions.iter().zip(&densities) {
            for axis in 0..3 {
                for side in [-reach, 0.0, reach] {
                    let mut y = x.as_dvec3();
                    y[axis] += side;
                    if field.bounds().contains(y.as_vec3()) {
                        // Cells are 1/16 wide, four times the surfaces' softness: the cell's own samples see the density.
                        assert!(occupancy.majorant(y) >= 0.9 * density.min(100.0), "{density} at {x}");
                    }
                }
            }
        }
        assert!(occupancy.share_above(1.0) < 0.5);
        assert_eq!(occupancy.majorant(DVec3::new(-1.001, 0.0, 0.0)), 0.0);
        assert!(occupancy.majorant(DVec3::new(1.0, 0.0, -0.7)) > 100.0, "the upper face belongs to the last cell");
    }
}
