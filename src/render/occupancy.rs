//! Occupancy grid: an upper bound of the density on a coarse grid, built from the field itself.

mod bounded;
mod pyramid;
mod sampled;

use std::sync::OnceLock;

use glam::DVec3;

use self::bounded::Bounder;
use self::pyramid::{Above, BRICK, Pyramid, blocks};
use crate::Result;
use crate::field::RadianceField;
use crate::geometry::{Aabb, Ray};
use crate::monitor::{Monitor, check};

/// An upper bound σ̂ of the density in each cell of a regular grid and in the space around it.
///
/// Where a field bounds its density ([`RadianceField::density_bound`]), σ̂ is certain. Elsewhere it is an estimate:
/// the largest density at the corners and the centre of a cell and of its neighbours. Structures much thinner than
/// a cell can be missed; the effect is measured against runs without an occupancy grid. A NaN counts as infinite
/// density, so that it is met and reported instead of skipped.
#[derive(Debug, Clone)]
pub struct Occupancy {
    bounds: Aabb,
    /// Cells per axis.
    resolution: usize,
    /// Cells per scene unit.
    per_unit: DVec3,
    /// σ̂, 1 / scene unit.
    majorant: Pyramid,
    /// Marks of the cells above the density of the first request.
    above: OnceLock<Above>,
    /// True if the field bounded all of it, so that nothing was sampled.
    is_certain: bool,
}

/// A block of 2^level cells along each axis; `cell` is one of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct SkipBlock {
    cell: [usize; 3],
    level: usize,
}

/// Distances along a ray to the planes between cells: of plane i of an axis, `origin + i · per_cell`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Crossings {
    origin: DVec3,
    per_cell: DVec3,
}

impl Crossings {
    /// Distance at which the ray leaves a block that it is in, up to rounding.
    #[inline]
    pub fn exit(&self, block: SkipBlock) -> f64 {
        let mut exit = f64::INFINITY;
        for axis in 0..3 {
            let per_cell = self.per_cell[axis];
            let face = ((block.cell[axis] >> block.level) + usize::from(per_cell > 0.0)) << block.level;
            // NaN on an axis along which the ray does not move: the other axes decide.
            let at = self.origin[axis] + face as f64 * per_cell;
            if at < exit {
                exit = at;
            }
        }
        exit
    }
}

/// The space around a point, compared with a density.
pub(super) enum Space {
    /// Outside the box.
    Outside,
    /// σ̂ does not exceed the density in this block, the largest such block around the point.
    Low(SkipBlock),
    /// σ̂ exceeds the density in this block, which need not be the largest.
    Matter(SkipBlock),
}

impl Occupancy {
    /// Default number of cells per axis: cells of 2.3 cm in a box of 3 m, 4.2 million
    /// evaluations of a field without bounds.
    pub const DEFAULT_RESOLUTION: usize = 128;

    /// Builds a grid of `resolution` cells per axis over the box of `field`, from its bounds or from samples.
    ///
    /// The bound holds up to a distance of `reach` (scene units) from a cell, because finite differences look that
    /// far; if it is sampled, up to at least one cell.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn build(field: &dyn RadianceField, resolution: usize, reach: f64, monitor: &dyn Monitor) -> Result<Self> {
        let bounds = field.bounds();
        // Positions are rounded to f32, and rounded again for the differences around them.
        // So is the box that is queried.
        let rounding = 2.0 * f64::from(f32::EPSILON) * bounds.min().abs().max(bounds.max().abs()).max_element();
        let bounder = Bounder { field, bounds, cells: resolution, pad: reach + rounding, monitor };
        monitor.begin("occupancy", (blocks(resolution, BRICK) as u64).pow(3));
        let mut bricks = bounder.bricks();
        monitor.end();
        check(monitor)?;
        let is_certain = !bricks.iter().any(|(_, cells)| cells.contains(&f32::INFINITY));
        if !is_certain {
            let rings = DVec3::splat(reach) / (bounds.size() / resolution as f64);
            let rings = rings.to_array().map(|rings| (rings.ceil() as usize).max(1));
            let grid = sampled::sample(field, resolution, rings, monitor)?;
            for (index, cells) in &mut bricks {
                let sampled = sampled::brick(&grid, resolution, *index);
                cells.iter_mut().zip(sampled).filter(|(cell, _)| cell.is_infinite()).for_each(|(cell, s)| *cell = s);
            }
        }
        Ok(Self {
            bounds,
            resolution,
            per_unit: resolution as f64 / bounds.size(),
            majorant: Pyramid::new(resolution, bricks),
            above: OnceLock::new(),
            is_certain,
        })
    }

    /// Cell of a scene point; `None` outside the box. Its indices never fall as the point's
    /// coordinates rise, even with rounding.
    fn cell(&self, x: DVec3) -> Option<[usize; 3]> {
        let u = (x - self.bounds.min()) * self.per_unit;
        if !u.cmpge(DVec3::ZERO).all() {
            return None;
        }
        let n = self.resolution;
        // The upper faces belong to the last cell. Rounding may put a point of the box there.
        let cell = u.to_array().map(|u| u as usize).map(|i| if i == n { n - 1 } else { i });
        cell.iter().all(|&i| i < n).then_some(cell)
    }

    /// σ̂ at a scene point; 0 outside the box.
    #[must_use]
    pub fn majorant(&self, x: DVec3) -> f32 {
        self.cell(x).map_or(0.0, |cell| self.majorant.value(0, cell))
    }

    /// Compares σ̂ at a point with `density`, and returns the block within which the result is valid.
    pub(super) fn space(&self, x: DVec3, density: f32) -> Space {
        let Some(cell) = self.cell(x) else { return Space::Outside };
        // The rays of a run all ask for the same density.
        let above = self.above.get_or_init(|| self.majorant.above(density));
        let found = if above.density() == density {
            self.majorant.largest_low(above, cell)
        } else {
            self.majorant.largest_low_by_values(density, cell)
        };
        match found {
            Ok(level) => Space::Low(SkipBlock { cell, level }),
            Err(level) => Space::Matter(SkipBlock { cell, level }),
        }
    }

    /// Returns true if a point is in the block.
    pub(super) fn is_in(&self, x: DVec3, block: SkipBlock) -> bool {
        let same = |cell: [usize; 3]| (0..3).all(|axis| cell[axis] >> block.level == block.cell[axis] >> block.level);
        self.cell(x).is_some_and(same)
    }

    /// Where a ray crosses the faces of cells.
    pub(super) fn crossings(&self, ray: &Ray) -> Crossings {
        let per_cell = 1.0 / (ray.direction * self.per_unit);
        Crossings { origin: (self.bounds.min() - ray.origin) / ray.direction, per_cell }
    }

    /// Returns true if the field bounds its density everywhere, so that nothing had to be estimated.
    #[must_use]
    pub fn is_certain(&self) -> bool {
        self.is_certain
    }

    /// Cells per axis.
    #[must_use]
    pub fn resolution(&self) -> usize {
        self.resolution
    }

    /// Centres of the cells whose bound exceeds `density`, in scene units.
    pub fn cells_above(&self, density: f32) -> impl Iterator<Item = DVec3> + '_ {
        let n = self.resolution;
        let cells = (0..n * n * n).map(move |i| [i / (n * n), i / n % n, i % n]);
        let above = cells.filter(move |&cell| self.majorant.value(0, cell) > density);
        above.map(move |cell| {
            let u = (DVec3::from(cell.map(|i| i as f64)) + 0.5) / n as f64;
            self.bounds.min() + u * self.bounds.size()
        })
    }

    /// Bytes on the heap.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.majorant.memory() + self.above.get().map_or(0, Above::memory)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::closed_form::{Primitive, Shape, Texture};
    use crate::field::{ClosedForm, Radiance};
    use crate::monitor::Silent;
    use glam::Vec3;

    /// A field without a density bound.
    struct BlackBox(ClosedForm);

    impl RadianceField for BlackBox {
        fn bounds(&self) -> Aabb {
            self.0.bounds()
        }

        fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
            self.0.evaluate(positions, directions, out);
        }

        fn suggested_step(&self) -> f64 {
            self.0.suggested_step()
        }

        fn memory(&self) -> usize {
            self.0.memory()
        }
    }

    #[test]
    fn estimates_the_density_of_smooth_scenes_everywhere_within_reach() {
        let field = ClosedForm::courtyard();
        let reach = 0.05;
        let occupancy = Occupancy::build(&BlackBox(field.clone()), 32, reach, &Silent).unwrap();
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
                        // Cells are 1/16 wide, four times the softness of surfaces:
                        // the cell's own samples see the density.
                        assert!(occupancy.majorant(y) >= 0.9 * density.min(100.0), "{density} at {x}");
                    }
                }
            }
        }
        assert!(share_above(&occupancy, 1.0) < 0.5);
        assert_eq!(occupancy.majorant(DVec3::new(-1.001, 0.0, 0.0)), 0.0);
        assert!(occupancy.majorant(DVec3::new(1.0, 0.0, -0.7)) > 100.0, "the upper face belongs to the last cell");
    }

    /// Share of the cells whose bound exceeds `density`.
    fn share_above(occupancy: &Occupancy, density: f32) -> f64 {
        let n = occupancy.resolution;
        let cells = (0..n * n * n).map(|i| [i / (n * n), i / n % n, i % n]);
        cells.filter(|&cell| occupancy.majorant.value(0, cell) > density).count() as f64 / (n * n * n) as f64
    }

    /// A post 100 times thinner than a cell of a grid with 32 cells per axis, placed between the sampled points.
    fn post() -> ClosedForm {
        let shape = Shape::Box { center: Vec3::new(0.02, 0.04, 0.0), half: Vec3::new(3e-4, 3e-4, 0.5) };
        let post = Primitive { shape, peak: 9e3, softness: 1e-4, texture: Texture::Plain(Vec3::ONE) };
        ClosedForm::new("post", vec![post], Aabb::centered_cube(1.0), 1e-4)
    }

    #[test]
    fn a_field_that_knows_its_bound_is_bounded_with_certainty() {
        let (n, reach) = (19, 0.013);
        for field in [post(), ClosedForm::courtyard(), ClosedForm::floater()] {
            let occupancy = Occupancy::build(&field, n, reach, &Silent).unwrap();
            let edge = 2.0 / n as f64;
            for i in 0..n * n * n {
                // Reference: every cell by itself, straight from the definition.
                let low = DVec3::new((i / (n * n)) as f64, (i / n % n) as f64, (i % n) as f64) * edge - 1.0;
                let ask =
                    |grown: f64| field.density_bound((low - grown).as_vec3(), (low + edge + grown).as_vec3()).unwrap();
                let found = occupancy.majorant(low + 0.5 * edge);
                // The rounding pad is 2 · 2^-23. f32 moves the queried box by 2^-25. A larger box has a larger
                // bound, up to the rounding of the ramp, 1e-5.
                let (least, most) = (ask(reach) * (1.0 - 1e-5), ask(reach + 4e-7) * (1.0 + 1e-5));
                assert!((least..=most).contains(&found), "{found} in cell {i}, not from {least} to {most}");
            }
        }
        let center = DVec3::new(0.02, 0.04, 0.1);
        let certain = Occupancy::build(&post(), 32, 0.0, &Silent).unwrap();
        assert!(certain.is_certain() && certain.majorant(center) > 8e3);
        let estimate = Occupancy::build(&BlackBox(post()), 32, 0.0, &Silent).unwrap();
        assert!(!estimate.is_certain());
        assert_eq!(estimate.majorant(center), 0.0, "the test's premise: samples miss the post");
    }

    #[test]
    fn share_counts_cells() {
        // The slab |x| < ½ cuts 12 cells across [-1, 1] into 3, 6, 3.
        // Its neighbours touch it within the rounding pad.
        let occupancy = Occupancy::build(&ClosedForm::slab(4.0), 12, 0.0, &Silent).unwrap();
        assert_eq!(share_above(&occupancy, 0.0), 8.0 / 12.0);
        assert_eq!(share_above(&occupancy, 5.0), 0.0);
    }
}
