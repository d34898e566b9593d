//! A field whose leaves have their corners' values beside each other: more memory, faster answers.
//!
//! An octree's vertices are shared by leaves, and hanging corners have no values of their own. So a query has to find
//! up to eight vertices, and more for hanging corners. Here every leaf has all that a query needs in one line of the
//! cache.

use std::hint::black_box;
use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::observability::at_shares;
use super::{Estimate, Support, UncertaintyField};
use crate::octree::{Cell, LeafTable, trilinear};

/// Points whose leaves are found before the values of any are read, so that the memory works on many at a time.
const POINTS_AT_ONCE: usize = 32;

/// The number of the leaf around a point, its level, and the weights of its corners.
type Found = (usize, u8, [f64; 8]);

/// The values of a leaf, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Corners {
    /// σ, scene units.
    deviations: [f32; 8],
    /// Numbers of rays.
    rays: [f32; 8],
}

/// A field and the values at the corners of its leaves: 64 bytes a leaf on top of it.
///
/// Answers are those of the field but for rounding to f32, 6e-8 of U and of ray counts. A dense grid, and a field with
/// error bars, answer as they are.
pub struct BakedField<'a> {
    field: &'a UncertaintyField,
    baked: Option<(LeafTable, Vec<Corners>)>,
}

impl<'a> BakedField<'a> {
    /// Gathers the values at the corners of all leaves of `field`: about half a microsecond of a core for each.
    #[must_use]
    pub fn new(field: &'a UncertaintyField) -> Self {
        Self::within(usize::MAX, field)
    }

    /// The same if the values take at most `room` bytes; otherwise the field answers as it is.
    #[must_use]
    pub fn within(room: usize, field: &'a UncertaintyField) -> Self {
        let octree = match &field.support {
            Support::Octree(octree) if field.error_bars().is_none() => octree,
            _ => return Self::unbaked(field),
        };
        let leaves: u64 = octree.cells().leaves_per_level().iter().sum();
        if leaves > LeafTable::MAX_LEAVES || leaves as usize * size_of::<Corners>() > room {
            return Self::unbaked(field);
        }
        let table = LeafTable::new(octree.cells());
        let mut leaves: Vec<Cell> = vec![Cell { level: 0, index: [0; 3] }; table.len()];
        octree.cells().for_each_leaf(|leaf| leaves[table.find(leaf.extent(octree.finest()).0).1] = leaf);
        let corners = |cursor: &mut crate::octree::Cursor, leaf: &Cell| {
            cursor.seek(leaf.extent(octree.finest()).0.map(|i| f64::from(i) + 0.5).into());
            let values = field.leaf_values(cursor);
            let rays = values.rays.unwrap_or([f64::NAN; 8]).map(|rays| rays as f32);
            Corners { deviations: values.deviations.map(|deviation| deviation as f32), rays }
        };
        let corners = leaves.par_iter().map_init(|| octree.cursor(), corners).collect();
        Self { field, baked: Some((table, corners)) }
    }

    /// The field as it is, where too few questions are to come for anything else.
    #[must_use]
    pub fn unbaked(field: &'a UncertaintyField) -> Self {
        Self { field, baked: None }
    }

    /// The field itself.
    #[must_use]
    pub fn field(&self) -> &'a UncertaintyField {
        self.field
    }

    /// Bytes on the heap beside the field.
    #[must_use]
    pub fn memory(&self) -> usize {
        let of = |(table, corners): &(LeafTable, Vec<Corners>)| {
            table.heap_bytes() + corners.capacity() * size_of::<Corners>()
        };
        self.baked.as_ref().map_or(0, of)
    }

    /// U at one scene point: [`UncertaintyField::query`].
    #[must_use]
    pub fn query(&self, x: Vec3) -> Estimate {
        let Some((table, corners)) = &self.baked else { return self.field.query(x) };
        let found = self.leaf(table, x);
        self.estimate(corners, found)
    }

    /// log10 U at one scene point.
    #[must_use]
    pub fn log10(&self, x: Vec3) -> f64 {
        self.query(x).uncertainty.log10()
    }

    /// U at many scene points, in parallel.
    #[must_use]
    pub fn query_all(&self, points: &[Vec3]) -> Vec<Estimate> {
        let Some((table, corners)) = &self.baked else { return self.field.query_all(points) };
        // The points that come next, and their leaves.
        let none = || (0..0, [None; POINTS_AT_ONCE]);
        let one = |(ahead, found): &mut (Range<usize>, [Option<Found>; POINTS_AT_ONCE]), i: usize| {
            if !ahead.contains(&i) {
                *ahead = i..i + POINTS_AT_ONCE;
                for (found, &x) in found.iter_mut().zip(&points[i..]) {
                    *found = self.leaf(table, x);
                }
                // Touches all lines first, so that their cache misses overlap.
                let numbers = found.iter().flatten().map(|found| found.0);
                black_box(numbers.fold(0, |any, number| any | corners[number].deviations[0].to_bits()));
            }
            self.estimate(corners, found[i - ahead.start])
        };
        (0..points.len()).into_par_iter().with_min_len(32 * POINTS_AT_ONCE).map_init(none, one).collect()
    }

    /// log10 U at these shares of the points on visible surfaces: [`UncertaintyField::surface_quantiles`].
    #[must_use]
    pub fn surface_quantiles<const N: usize>(&self, shares: [f64; N]) -> Option<[f64; N]> {
        let points: Vec<Vec3> = self.field.surface().iter().copied().map(Vec3::from_array).collect();
        at_shares(&self.query_all(&points), shares)
    }

    /// The number of the leaf around a point, its level, and the weights of its corners; `None` outside.
    #[inline(always)]
    fn leaf(&self, table: &LeafTable, x: Vec3) -> Option<Found> {
        let lattice = &self.field.lattice;
        let u = lattice.coordinates(x)?;
        let (leaf, number) = table.find(lattice.cell(u).0);
        let (origin, edge) = leaf.extent(lattice.level());
        let offset = (u - glam::DVec3::from(origin.map(f64::from))) / f64::from(edge);
        Some((number, leaf.level, trilinear(offset)))
    }

    #[inline(always)]
    fn estimate(&self, corners: &[Corners], found: Option<Found>) -> Estimate {
        let Some((number, level, weights)) = found else { return self.field.outside() };
        let Corners { deviations, rays } = &corners[number];
        let uncertainty = self.field.record.covariance.interpolate(&deviations.map(f64::from), &weights);
        let rays: f64 = rays.iter().zip(weights).map(|(rays, w)| w * f64::from(*rays)).sum();
        Estimate { uncertainty, log10_error: None, rays: (!rays.is_nan()).then_some(rays), level, inside: true }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Estimation, GridKind, GridSettings, RaySettings};
    use crate::field::ClosedForm;
    use crate::posterior::Covariance;

    #[test]
    #[ignore = "slow: several seconds"]
    fn answers_are_those_of_the_field_but_for_rounding() {
        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(5, [64, 48]));
        let golden = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];
        let unit = |i: usize| glam::DVec3::from(golden.map(|g| (i as f64 * g).fract()));
        for (covariance, kind, level) in [
            (Covariance::Diagonal, GridKind::Octree, 8),
            (Covariance::Trace, GridKind::Octree, 5),
            (Covariance::Block, GridKind::Dense, 4),
        ] {
            let grid = GridSettings::default().level(level).covariance(covariance).grid(kind);
            let rays = RaySettings::default().rays(20_000).occupancy(48);
            let field = Estimation::new(&scene, &cameras).rays(rays).grid(grid).run().unwrap().field;
            let baked = BakedField::new(&field);
            // Everywhere, a part of them outside; on faces of cells and of the box; where rays were.
            let domain = field.lattice().domain();
            let mut points: Vec<Vec3> = (0..40_000).map(|i| domain.to_scene(1.1 * unit(i) - 0.05).as_vec3()).collect();
            points.extend((0..5_000).map(|i| domain.to_scene((unit(i) * 64.0).round() / 64.0).as_vec3()));
            points.extend(field.surface().iter().map(|&x| Vec3::from_array(x)));
            points.extend([Vec3::NAN, Vec3::splat(1e9)]);
            let (found, expected) = (baked.answers(&points), field.answers(&points));
            // The mean of hanging corners is rounded to f32, by 2^-24 of itself; then come a few operations in f64.
            let near = |a: f64, b: f64| (a - b).abs() <= 2_f64.powi(-23) * b;
            for ((x, a), b) in points.iter().zip(&found).zip(&expected) {
                let (found, other) = (a.estimate, b.estimate);
                let rays = found.rays.zip(other.rays).map_or(found.rays == other.rays, |(a, b)| near(a, b));
                let same = (found.level, found.inside) == (other.level, other.inside);
                assert!(same && rays && near(found.uncertainty, other.uncertainty), "{x}: {found:?}, {other:?}");
                assert_eq!(
                    (a.ray_coverage, a.observability, baked.query(*x)),
                    (b.ray_coverage, b.observability, found),
                    "{x}"
                );
            }
            assert!(found.iter().filter(|answer| !answer.estimate.inside).count() > 1000);
            for few in [0, 1, POINTS_AT_ONCE - 1, POINTS_AT_ONCE, POINTS_AT_ONCE + 1] {
                assert_eq!(
                    baked.query_all(&points[..few]),
                    found[..few].iter().map(|a| a.estimate).collect::<Vec<_>>()
                );
            }
            assert_eq!(baked.memory() > 64 * 100, kind == GridKind::Octree);
            let [enough, short] = [baked.memory(), 64 * 100];
            assert_eq!([enough, short].map(|room| BakedField::within(room, &field).memory()), [enough, 0]);
        }
    }
}
