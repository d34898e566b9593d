//! Coarsens a finished octree field with the guarantee |Δ log10 U| ≤ ε everywhere.
//!
//! Eight sibling leaves merge as long as the interpolant of their parent's corners stays within ε/2 of the
//! original field. This is checked at every corner of every original leaf inside the parent, including its
//! boundary, for the following reason. On each original leaf both fields are trilinear, so their ratio at a point
//! is a weighted mean of the ratios at the leaf's corners, and a bound at the corners holds between them. A corner
//! of the parent may itself become a hanging vertex on a merged leaf of twice the size. Its ends are free and
//! unchanged, so it moves by at most ε/2, and what the parent interpolates from it moves by at most ε/2 + ε/2.

use rayon::prelude::*;

use super::{StandardDeviations, Store, Support, UncertaintyField};
use crate::octree::{Cell, Octree, VertexId, morton, trilinear};
use crate::posterior::Covariance;
use crate::{Error, Result};

/// Margin in log10 for the rounding of deviations to f32.
const ROUNDING: f64 = 1e-7;

impl UncertaintyField {
    /// Merges leaves as long as log10 U changes by at most `epsilon` anywhere. The result keeps deviations only,
    /// and its tolerance grows by `epsilon`.
    ///
    /// # Errors
    /// If the field is a dense grid, has error bars, or its covariance is `trace`. The interpolation of `trace`
    /// is not trilinear, so bounds at vertices would not hold between them.
    pub fn coarsened(&self, epsilon: f64) -> Result<Self> {
        let Support::Octree(octree) = &self.support else {
            return Err(Error::setting("field to coarsen", "an octree", "a dense grid"));
        };
        if self.error_bars.is_some() {
            let expected = "one without error bars: those of the vertices that go would be lost";
            return Err(Error::setting("field to coarsen", expected, "one with error bars"));
        }
        if self.protocol.covariance == Covariance::Trace {
            let expected = "`diagonal` or `block`, which are trilinear between vertices";
            return Err(Error::setting("covariance of the field to coarsen", expected, "trace"));
        }
        let bound = 0.5 * epsilon - ROUNDING;
        let finest = octree.finest();
        let split = octree.cells().split();
        let mut kept = vec![Vec::new(); split.len()];
        for level in (0..split.len()).rev() {
            let finer = kept.get(level + 1).map_or(&[][..], Vec::as_slice);
            let stays = |code: u64| {
                let has_split_child = (0..8).any(|c| finer.binary_search(&(code << 3 | c)).is_ok());
                let cell = Cell { level: level as u8, index: morton::decode(code) };
                has_split_child || self.merge_error(octree, &split, cell) > bound
            };
            let remaining: Vec<u64> = split[level].par_iter().copied().filter(|&code| stays(code)).collect();
            kept[level] = remaining;
        }
        let wanted = kept.iter().enumerate().flat_map(|(level, codes)| {
            codes.iter().map(move |&code| Cell { level: level as u8, index: morton::decode(code) }.child(0))
        });
        let coarse = Octree::refined(finest, wanted);
        // A free vertex of the coarser octree was free before. Had it hung on a leaf, that leaf would only have grown.
        let mut deviations = Vec::with_capacity(coarse.vertex_count());
        deviations.extend(coarse.vertex_positions().map(|point| {
            let VertexId(v) = octree.vertex(point).expect("vertices of a coarser octree are a subset");
            self.deviations.get(v as usize) as f32
        }));
        let mut protocol = self.protocol.clone();
        protocol.tolerance += epsilon;
        Ok(Self {
            protocol,
            lattice: self.lattice,
            support: Support::Octree(coarse),
            limits: self.limits.clone(),
            deviations: StandardDeviations::F32(deviations),
            sums: None,
            error_bars: None,
            surface: self.surface.clone(),
            draws: self.draws.clone(),
        })
    }

    /// Coarsens the field and stores it in `store`; `epsilon` includes the rounding.
    ///
    /// # Errors
    /// As [`UncertaintyField::coarsened`], or if the rounding alone exceeds `epsilon`.
    pub fn coarsened_in(&self, store: Store, epsilon: f64) -> Result<Self> {
        if store == Store::F32 {
            return self.coarsened(epsilon);
        }
        let rounding = self.deviations.f16_rounding(self.prior());
        if epsilon <= rounding {
            let expected = format!("more than {rounding:.1e}, the rounding of f16 here");
            return Err(Error::setting("coarsening bound", expected, epsilon.to_string()));
        }
        // The tolerances add up to epsilon.
        self.coarsened(epsilon - rounding).map(Self::in_f16)
    }

    /// The largest |Δ log10 U| at the corners of the original leaves inside `cell` if it became one leaf.
    fn merge_error(&self, octree: &Octree, split: &[Vec<u64>], cell: Cell) -> f64 {
        let finest = octree.finest();
        let (origin, edge) = cell.extent(finest);
        let corner = |origin: [u32; 3], edge: u32, c: u32| {
            std::array::from_fn::<u32, 3, _>(|axis| origin[axis] + edge * (c >> axis & 1))
        };
        let ends: [f64; 8] = std::array::from_fn(|c| self.at_corner(octree, corner(origin, edge, c as u32)));
        let mut largest = 0.0_f64;
        for_each_leaf_within(split, finest, cell, &mut |leaf| {
            let (leaf_origin, leaf_edge) = leaf.extent(finest);
            for c in 0..8 {
                let point = corner(leaf_origin, leaf_edge, c);
                let offset = glam::DVec3::from(std::array::from_fn(|axis| {
                    f64::from(point[axis] - origin[axis]) / f64::from(edge)
                }));
                let merged: f64 = ends.iter().zip(trilinear(offset)).map(|(e, w)| e * w).sum();
                largest = largest.max((merged / self.at_corner(octree, point)).log10().abs());
            }
        });
        largest
    }

    /// U at a corner of a leaf.
    fn at_corner(&self, octree: &Octree, point: [u32; 3]) -> f64 {
        let corner = octree.corner(point);
        let values = corner.masters().iter().map(|&VertexId(v)| self.deviations.get(v as usize));
        self.protocol.covariance.mean(values)
    }
}

/// Visits the leaves inside a cell, given the split cells of each level in Morton order.
fn for_each_leaf_within(split: &[Vec<u64>], finest: u8, cell: Cell, visit: &mut impl FnMut(Cell)) {
    let is_split =
        cell.level < finest && split[usize::from(cell.level)].binary_search(&morton::encode(cell.index)).is_ok();
    if is_split {
        (0..8).for_each(|c| for_each_leaf_within(split, finest, cell.child(c), visit));
    } else {
        visit(cell);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Lattice};
    use crate::octree::MaxLevels;
    use crate::octree::arbitrary::octrees;
    use crate::uncertainty::Protocol;
    use glam::Vec3;
    use proptest::prelude::*;

    /// A field on an octree, whose deviations are smooth in places and jump in others.
    fn field(octree: Octree, roughness: f64) -> UncertaintyField {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), octree.finest()).unwrap();
        let m = f64::from(lattice.cells_per_axis());
        let deviations = octree
            .vertex_positions()
            .map(|p| {
                let [x, y, z] = p.map(|i| f64::from(i) / m);
                let noise = (f64::from(p[0] * 7919 + p[1] * 104_729 + p[2] * 1_299_709) * 0.618_034).fract();
                let rough = if x > 0.5 { roughness } else { 0.01 * roughness };
                10_f64.powf((3.0 * x + y).sin() + z + rough * noise) as f32
            })
            .collect();
        let protocol = Protocol::unstated("test".into(), 1, 1.0, Covariance::Diagonal);
        UncertaintyField {
            protocol,
            lattice,
            limits: MaxLevels::none(octree.finest()),
            support: Support::Octree(octree),
            deviations: StandardDeviations::F32(deviations),
            sums: None,
            error_bars: None,
            surface: vec![],
            draws: vec![],
        }
    }

    proptest! {
        #[test]
        fn the_bound_holds_everywhere(octree in octrees(), roughness in 0.0..0.5_f64, epsilon in 1e-3..0.5_f64,
                                      points in proptest::collection::vec(proptest::array::uniform3(-1.0..=1.0_f32), 100)) {
            let original = field(octree, roughness);
            let coarse = original.coarsened(epsilon).unwrap();
            prop_assert!(coarse.validate().is_ok());
            prop_assert!(coarse.deviations.len() <= original.deviations.len());
            let half = original.coarsened_in(Store::F16, epsilon + 0.01).unwrap();
            prop_assert_eq!(half.deviations.store(), Store::F16);
            for x in points {
                let x = Vec3::from_array(x);
                let change = (half.log10(x) - original.log10(x)).abs();
                prop_assert!(change <= epsilon + 0.01, "{} at {} in f16", change, x);
                let change = (coarse.log10(x) - original.log10(x)).abs();
                prop_assert!(change <= epsilon, "{} at {}", change, x);
            }
        }
    }

    #[test]
    fn smooth_fields_shrink_and_rough_ones_do_not() {
        let all = |level: u8| (0..1_u64 << (3 * level)).map(move |code| Cell { level, index: morton::decode(code) });
        let vertices = |roughness, epsilon| {
            let original = field(Octree::refined(4, all(4)), roughness);
            original.coarsened(epsilon).unwrap().deviations.len()
        };
        assert_eq!(vertices(3.0, 1e-3), 4913, "nothing can merge where neighbours differ by decades");
        assert!(vertices(0.0, 0.05) < 4913 / 2, "{}", vertices(0.0, 0.05));
        assert!(vertices(0.0, 10.0) == 8, "everything merges into one cell");
    }

    #[test]
    fn dense_grids_and_trace_are_refused() {
        let mut trace = field(Octree::refined(2, []), 0.0);
        trace.protocol.covariance = Covariance::Trace;
        assert!(trace.coarsened(0.1).unwrap_err().to_string().contains("trilinear"));
        let dense = UncertaintyField { support: Support::Dense, ..field(Octree::refined(2, []), 0.0) };
        assert!(dense.coarsened(0.1).unwrap_err().to_string().contains("dense"));
    }
}
