//! A field on a regular grid, into which any NeRF can be baked.
//!
//! Values sit on grid points, which include all faces of the box. They are trilinear in between; outside the box the
//! density is zero.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{Differentiable, Radiance, RadianceField, RadianceJet, TrainedField};
use crate::geometry::Aabb;
use crate::monitor::{Monitor, Silent, check};
use crate::octree::trilinear;
use crate::{Error, Result};

/// Density and colour at the grid points of a box, trilinear in between.
///
/// ```
/// use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField, VoxelGrid};
/// use octobayes::glam::Vec3;
///
/// // Any field can be baked, as seen from one direction.
/// let scene = ClosedForm::ball();
/// let grid = VoxelGrid::bake(&scene, [33; 3], Vec3::Z);
/// let x = [Vec3::ZERO];
/// let mut values = [[Radiance::default()]; 2];
/// scene.evaluate(&x, &[Vec3::Z], &mut values[0]);
/// grid.evaluate(&x, &[Vec3::Z], &mut values[1]);
/// // The centre is a grid point.
/// assert_eq!(values[0][0].density, values[1][0].density);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct VoxelGrid {
    bounds: Aabb,
    /// Grid points per axis, at least 2.
    shape: [usize; 3],
    /// `[X, Y, Z]`, C order: red, green, blue, density.
    values: Vec<[f32; 4]>,
}

impl VoxelGrid {
    /// A grid of these `values` (`[X, Y, Z]`, z fastest: red, green, blue in `[0, 1]`, density ≥ 0).
    ///
    /// # Errors
    /// If an axis has fewer than 2 grid points, if their number is another, or if a value is out of range.
    pub fn new(bounds: Aabb, shape: [usize; 3], values: Vec<[f32; 4]>) -> Result<Self> {
        if shape.iter().any(|&n| n < 2) {
            return Err(Error::setting("grid", "at least 2 grid points per axis", format!("{shape:?}")));
        }
        if Some(values.len()) != shape.iter().try_fold(1_usize, |product, &n| product.checked_mul(n)) {
            return Err(Error::setting("grid", format!("values for {shape:?}"), format!("{} values", values.len())));
        }
        let is_in_range = |[r, g, b, density]: &[f32; 4]| {
            [r, g, b].iter().all(|v| (0.0..=1.0).contains(*v)) && *density >= 0.0 && density.is_finite()
        };
        if let Some(found) = values.iter().find(|value| !is_in_range(value)) {
            return Err(Error::setting("grid", "colours from 0 to 1, finite densities >= 0", format!("{found:?}")));
        }
        Ok(Self { bounds, shape, values })
    }

    /// Grid points per axis.
    #[must_use]
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// `[X, Y, Z]`, z fastest: red, green, blue, density.
    #[must_use]
    pub fn values(&self) -> &[[f32; 4]] {
        &self.values
    }

    /// Samples another field at the grid points along direction `view`, because a grid has no view
    /// dependence.
    ///
    /// # Panics
    /// If `shape` has fewer than 2 points along an axis.
    #[must_use]
    pub fn bake(field: &dyn RadianceField, shape: [usize; 3], view: Vec3) -> Self {
        Self::baked(field, shape, |_| view, &Silent).expect("nothing interrupts")
    }

    /// [`VoxelGrid::bake`] with each point seen from the nearest of `eyes`. At least one is needed.
    ///
    /// # Errors
    /// [`Error::Interrupted`], or if the field is not finite or a colour out of range.
    ///
    /// # Panics
    /// If there is none, or as [`VoxelGrid::bake`].
    pub fn bake_from(
        field: &dyn RadianceField,
        shape: [usize; 3],
        eyes: &[Vec3],
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let nearest = |x: Vec3| {
            let by_distance = |a: &Vec3, b: &Vec3| a.distance_squared(x).total_cmp(&b.distance_squared(x));
            eyes.iter().copied().min_by(by_distance).expect("an eye")
        };
        let grid = Self::baked(field, shape, |x| (x - nearest(x)).try_normalize().unwrap_or(Vec3::Z), monitor)?;
        Self::new(grid.bounds, grid.shape, grid.values)
    }

    fn baked(
        field: &dyn RadianceField,
        shape: [usize; 3],
        view: impl Fn(Vec3) -> Vec3 + Sync,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        assert!(shape.iter().all(|&n| n >= 2), "a grid needs at least 2 points per axis, got {shape:?}");
        let grid = Self { bounds: field.bounds(), shape, values: Vec::new() };
        let mut values = vec![[0.0; 4]; shape.iter().product()];
        monitor.begin("voxel grid", (shape[0] * shape[1]) as u64);
        let fill = |(row, values): (usize, &mut [[f32; 4]])| {
            check(monitor)?;
            let positions: Vec<Vec3> = (row * shape[2]..(row + 1) * shape[2]).map(|i| grid.point(i)).collect();
            let views: Vec<Vec3> = positions.iter().map(|&x| view(x)).collect();
            let mut radiance = vec![Radiance::default(); shape[2]];
            field.evaluate(&positions, &views, &mut radiance);
            let numbers = radiance.into_iter().map(|r| [r.color.x, r.color.y, r.color.z, r.density]);
            values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number);
            monitor.advance(1);
            Ok(())
        };
        values.par_chunks_exact_mut(shape[2]).enumerate().try_for_each(fill)?;
        monitor.end();
        Ok(Self { values, ..grid })
    }

    /// Grid point `i` of [`VoxelGrid::values`], scene units.
    #[must_use]
    pub fn point(&self, i: usize) -> Vec3 {
        let [_, ny, nz] = self.shape;
        let index = DVec3::new((i / nz / ny) as f64, (i / nz % ny) as f64, (i % nz) as f64);
        let last = DVec3::from(self.shape.map(|n| (n - 1) as f64));
        self.bounds.clamp((self.bounds.min() + index / last * self.bounds.size()).as_vec3())
    }

    /// The grid without the density of some points.
    #[must_use]
    pub fn without(mut self, is_removed: impl Fn(Vec3) -> bool) -> Self {
        for i in 0..self.values.len() {
            if self.values[i][3] > 0.0 && is_removed(self.point(i)) {
                self.values[i][3] = 0.0;
            }
        }
        self
    }

    /// The eight values around a point in the order of cell corners (bit 0 is x), and the offset between
    /// them; `None` outside the box.
    fn around(&self, x: Vec3) -> Option<([[f32; 4]; 8], DVec3)> {
        if !self.bounds.contains(x) {
            return None;
        }
        let unit = (x.as_dvec3() - self.bounds.min()) / self.bounds.size();
        let mut low = [0; 3];
        let mut offset = DVec3::ZERO;
        for axis in 0..3 {
            let u = unit[axis] * (self.shape[axis] - 1) as f64;
            low[axis] = (u as usize).min(self.shape[axis] - 2);
            offset[axis] = u - low[axis] as f64;
        }
        let values = std::array::from_fn(|c| {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|axis| low[axis] + (c >> axis & 1));
            self.values[(x * self.shape[1] + y) * self.shape[2] + z]
        });
        Some((values, offset))
    }

    fn at(&self, x: Vec3) -> Radiance {
        let Some((values, offset)) = self.around(x) else { return Radiance::default() };
        radiance(weighted(&values, &trilinear(offset)))
    }

    fn jet(&self, x: Vec3) -> RadianceJet {
        let Some((values, offset)) = self.around(x) else { return RadianceJet::default() };
        let cells = DVec3::from(self.shape.map(|n| (n - 1) as f64)) / self.bounds.size();
        let slopes = [0, 1, 2].map(|axis| {
            // The derivative of a weight is the difference between the two sides.
            let [mut up, mut down] = [offset; 2];
            (up[axis], down[axis]) = (1.0, 0.0);
            let (up, down) = (trilinear(up), trilinear(down));
            let slope: [f64; 8] = std::array::from_fn(|c| cells[axis] * (up[c] - down[c]));
            radiance(weighted(&values, &slope))
        });
        RadianceJet {
            value: radiance(weighted(&values, &trilinear(offset))),
            density_gradient: Vec3::from_array(slopes.map(|s| s.density)),
            color_gradients: slopes.map(|s| s.color),
        }
    }
}

/// Σ weight · value.
fn weighted(values: &[[f32; 4]; 8], weights: &[f64; 8]) -> [f64; 4] {
    let mut sum = [0.0; 4];
    for (value, weight) in values.iter().zip(weights) {
        for (sum, v) in sum.iter_mut().zip(value) {
            *sum += weight * f64::from(*v);
        }
    }
    sum
}

fn radiance([r, g, b, density]: [f64; 4]) -> Radiance {
    Radiance { density: density as f32, color: Vec3::new(r as f32, g as f32, b as f32) }
}

impl Differentiable for VoxelGrid {
    fn jets(&self, positions: &[Vec3], _directions: &[Vec3], out: &mut [RadianceJet]) {
        for (out, &x) in out.iter_mut().zip(positions) {
            *out = self.jet(x);
        }
    }
}

impl RadianceField for VoxelGrid {
    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn evaluate(&self, positions: &[Vec3], _directions: &[Vec3], out: &mut [Radiance]) {
        for (out, &x) in out.iter_mut().zip(positions) {
            *out = self.at(x);
        }
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn suggested_step(&self) -> f64 {
        // Half the shortest edge of a voxel gives two samples in every cell that a ray crosses along an axis.
        let cells = DVec3::from(self.shape.map(|n| (n - 1) as f64));
        0.5 * (self.bounds.size() / cells).min_element()
    }

    fn memory(&self) -> usize {
        size_of_val(self.values.as_slice())
    }
}

impl TrainedField for VoxelGrid {
    fn describe(&self) -> String {
        let [x, y, z] = self.shape;
        format!("voxel grid of {x} x {y} x {z} points")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::ClosedForm;

    #[test]
    fn values_sit_on_grid_points() {
        let ball = ClosedForm::ball();
        let grid = VoxelGrid::bake(&ball, [9, 8, 7], Vec3::Z);

        let points = [Vec3::new(0.25, 1.0, -1.0 / 3.0), Vec3::new(-1.0, -1.0, 0.0), Vec3::new(0.0, 1.0 / 7.0, 1.0)];
        let (mut expected, mut found) = ([Radiance::default(); 3], [Radiance::default(); 3]);
        ball.evaluate(&points, &[Vec3::Z; 3], &mut expected);
        grid.evaluate(&points, &[Vec3::Z; 3], &mut found);
        for (e, f) in expected.iter().zip(&found) {
            // Positions are grid points up to f32 rounding, and the density slope is below 1000 per unit.
            assert!((e.density - f.density).abs() < 1e-3 && (e.color - f.color).abs().max_element() < 1e-3);
        }
        assert_eq!(grid.at(Vec3::new(0.0, 0.0, 1.001)).density, 0.0);
    }

    #[test]
    fn points_are_seen_from_the_nearest_eye_and_may_be_emptied() {
        /// As bright as its view direction goes along x.
        struct Lamp;
        impl RadianceField for Lamp {
            fn bounds(&self) -> Aabb {
                Aabb::centered_cube(1.0)
            }
            fn evaluate(&self, _positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
                for (d, out) in directions.iter().zip(out) {
                    *out = Radiance { density: 3.0, color: Vec3::splat(0.5 + 0.5 * d.x) };
                }
            }
            fn suggested_step(&self) -> f64 {
                0.1
            }
        }
        let eyes = [Vec3::X * -2.0, Vec3::X * 3.0];
        let grid = VoxelGrid::bake_from(&Lamp, [5, 3, 2], &eyes, &Silent).unwrap().without(|x| x.y > 0.5);
        for (i, &[red, .., density]) in grid.values().iter().enumerate() {
            let x = grid.point(i);
            // Nearer to the first eye up to x = 0.5, where both are as far away, the first counts.
            let eye = eyes[usize::from(x.distance(eyes[1]) < x.distance(eyes[0]))];
            assert!((red - (0.5 + 0.5 * (x - eye).normalize().x)).abs() < 1e-6, "{x}");
            assert_eq!(density == 0.0, x.y > 0.5, "{x}");
        }
        assert_eq!([grid.point(0), grid.point(29)], [Vec3::NEG_ONE, Vec3::ONE]);
    }

    #[test]
    fn values_out_of_range_and_of_another_number_are_refused() {
        let new = |shape, values| VoxelGrid::new(Aabb::centered_cube(1.0), shape, values);
        let gray = [0.5, 0.5, 0.5, 1.0];
        assert!(new([2; 3], vec![gray; 8]).is_ok());
        assert!(new([2; 3], vec![gray; 7]).is_err() && new([1, 2, 4], vec![gray; 8]).is_err());
        assert!(new([usize::MAX, usize::MAX, 2], vec![gray; 8]).is_err());
        for wrong in
            [[1.1, 0.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0, f32::INFINITY]]
        {
            let mut values = vec![gray; 8];
            values[5] = wrong;
            assert!(new([2; 3], values).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn jets_are_the_slopes_of_the_cell() {
        let grid = VoxelGrid::bake(&ClosedForm::courtyard(), [9, 12, 7], Vec3::Z);
        let mut steep = 0;
        for i in 0..300 {
            let golden = [0.819_172_5_f32, 0.671_043_6, 0.549_700_5];
            let x = Vec3::from_array(golden.map(|g| 1.9 * (i as f32 * g).fract() - 0.95));
            let jet = grid.jet(x);
            assert_eq!(jet.value, grid.at(x));
            for axis in 0..3 {
                let h = 1e-3;
                let [up, down] = [h, -h].map(|h| grid.at(x + h * Vec3::AXES[axis]));
                let slope = |side: Radiance, h: f32| (side.density - jet.value.density) / h;
                let (right, left) = (slope(up, h), slope(down, -h));
                // Linear along an axis, except for a grid plane in between. f32 densities up to 120 leave
                // 1e-5 over h.
                let off = (jet.density_gradient[axis] - 0.5 * (right + left)).abs();
                assert!(
                    off <= 0.5 * (right - left).abs() + 0.05,
                    "{} not from {left} to {right}",
                    jet.density_gradient
                );
                let color = (up.color - down.color) / (2.0 * h);
                let bend = (up.color + down.color - 2.0 * jet.value.color).length() / h;
                assert!((jet.color_gradients[axis] - color).length() <= 0.5 * bend + 1e-3);
                steep += usize::from(right.abs() > 10.0 && (right - left).abs() < 0.1);
            }
        }
        assert!(steep > 50, "{steep}");
        assert_eq!(grid.jet(Vec3::splat(2.0)), RadianceJet::default());
    }

    #[test]
    fn trilinear_between_grid_points() {
        let bounds = Aabb::centered_cube(1.0);
        let values = (0..8).map(|i| [0.1 * i as f32, 0.5, 0.0, i as f32]).collect();
        let grid = VoxelGrid { bounds, shape: [2; 3], values };
        let middle = grid.at(Vec3::ZERO);
        assert!((middle.density - 3.5).abs() < 1e-6 && (middle.color.x - 0.35).abs() < 1e-6);
        // z is the fastest index: at x = y = -1 the density goes from 0 to 1 along z.
        assert!((grid.at(Vec3::new(-1.0, -1.0, 0.5)).density - 0.75).abs() < 1e-6);
    }
}
