//! Corners that hang on larger leaves, against brute force: every leaf is tried, no look-up of the octree is used.

use std::collections::BTreeMap;

use rand::rngs::ChaCha8Rng;
use rand::{Rng, RngExt, SeedableRng};

use super::*;
use crate::octree::{Cell, Leaves};

/// All leaves: lower corner and edge, in finest cells.
struct Slow(Vec<([u32; 3], u32)>);

impl Slow {
    fn of_octree(octree: &Octree) -> Self {
        let mut leaves = Vec::new();
        octree.cells().for_each_leaf(|leaf| leaves.push(leaf.extent(octree.finest())));
        Self(leaves)
    }

    fn of_limits(limits: &MaxLevels) -> Self {
        let n = 1_u32 << limits.finest();
        let cells = (0..n).flat_map(|x| (0..n).flat_map(move |y| (0..n).map(move |z| [x, y, z])));
        let mut leaves: Vec<_> = cells.map(|cell| limits.leaf(cell).extent(limits.finest())).collect();
        leaves.sort_unstable();
        leaves.dedup();
        Self(leaves)
    }

    /// The leaf around a place, if that lies below the upper faces of the box.
    fn around(&self, u: DVec3) -> Option<([u32; 3], u32)> {
        let is_in = |(origin, edge): &&([u32; 3], u32)| {
            (0..3).all(|axis| (0.0..f64::from(*edge)).contains(&(u[axis] - f64::from(origin[axis]))))
        };
        self.0.iter().find(is_in).copied()
    }

    /// Corners of the leaf around a place, with their trilinear weights.
    fn corners(&self, u: DVec3) -> Vec<([u32; 3], f64)> {
        let (origin, edge) = self.around(u).expect("a place below the upper faces");
        let corner = |c: u32| {
            let upper = [c & 1, c >> 1 & 1, c >> 2 & 1];
            let along = |axis: usize| (u[axis] - f64::from(origin[axis])) / f64::from(edge);
            let weight = |axis: usize| if upper[axis] == 1 { along(axis) } else { 1.0 - along(axis) };
            ([0, 1, 2].map(|axis| origin[axis] + edge * upper[axis]), weight(0) * weight(1) * weight(2))
        };
        (0..8).map(corner).collect()
    }

    /// The free vertices that a leaf's corner has its value from, with equal shares.
    fn masters(&self, corner: [u32; 3]) -> Vec<[u32; 3]> {
        let ends = |(origin, edge): &([u32; 3], u32)| {
            let of_axis = |axis: usize| match corner[axis].checked_sub(origin[axis])? {
                0 => Some(vec![corner[axis]]),
                offset if offset == *edge => Some(vec![corner[axis]]),
                offset if offset < *edge => Some(vec![origin[axis], origin[axis] + edge]),
                _ => None,
            };
            let [x, y, z] = [of_axis(0)?, of_axis(1)?, of_axis(2)?];
            let all = x.iter().flat_map(|&x| y.iter().flat_map(move |&y| [(x, y)]));
            Some(all.flat_map(|(x, y)| z.iter().map(move |&z| [x, y, z])).collect::<Vec<_>>())
        };
        // The corner is one of two leaves' edge or face, or of none.
        self.0.iter().filter_map(ends).max_by_key(Vec::len).expect("a corner of some leaf")
    }

    /// The values at a place of the functions that are 1 at one free vertex and 0 at all others.
    fn functions(&self, u: DVec3) -> BTreeMap<[u32; 3], f64> {
        let mut all = BTreeMap::new();
        for (corner, weight) in self.corners(u) {
            let masters = self.masters(corner);
            for master in &masters {
                *all.entry(*master).or_default() += weight / masters.len() as f64;
            }
        }
        all
    }
}

/// Sums of vertices that have nothing in common with those of their neighbours, over six decades.
fn arbitrary_sums(count: usize, random: &mut impl Rng) -> Vec<VertexSums> {
    let sums = |_| {
        let size = 10_f64.powf(random.random_range(-3.0..3.0));
        let [a, b] = [0; 2].map(|_| [0; 3].map(|_| size * random.random_range(-1.0..1.0)));
        let product = |i: usize, j: usize| a[i] * a[j] + b[i] * b[j];
        let information = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(i, j)| product(i, j));
        VertexSums::new(information, random.random_range(4..60))
    };
    (0..count).map(sums).collect()
}

fn field(covariance: Covariance, random: &mut impl Rng) -> UncertaintyField {
    let lattice = Lattice::new(Aabb::centered_cube(1.0), 4).unwrap();
    let finest = [[0, 0, 0], [9, 4, 6], [15, 15, 2], [5, 12, 11]];
    let octree = Octree::refined(4, finest.map(|index| Cell { level: 4, index }));
    let sums = arbitrary_sums(octree.vertex_count(), random);
    UncertaintyField::new(record(&lattice, covariance, 20), lattice, Support::Octree(octree), sums)
}

/// The field with error bars, unknown at every 23rd vertex.
fn with_arbitrary_bars(field: UncertaintyField) -> UncertaintyField {
    let sums = field.sums().unwrap().to_vec();
    let group = |g: usize| {
        let part = |(v, sums): (usize, &VertexSums)| {
            let share = [0.2, 0.5, 0.3][(g + v) % 3] + [0.0, 0.01 * (v % 7) as f64, -0.01 * (v % 7) as f64][g];
            let is_seen = v % 23 != 0 || g == 0;
            let share = if is_seen { share } else { 0.0 };
            VertexSums::new(sums.information.map(|s| share * s), u32::from(is_seen) * sums.rays)
        };
        sums.iter().enumerate().map(part).collect()
    };
    barred(field, [0, 1, 2].map(group), &[7, 7, 6])
}

#[test]
fn queries_are_those_of_brute_force() {
    let random = &mut ChaCha8Rng::seed_from_u64(5);
    for covariance in Covariance::ALL {
        let field = with_arbitrary_bars(field(covariance, random));
        let Support::Octree(octree) = field.support() else { unreachable!() };
        let slow = Slow::of_octree(octree);
        let vertices: BTreeMap<[u32; 3], usize> = octree.vertex_positions().zip(0..).collect();
        let points: Vec<Vec3> = (0..3000).map(|_| Vec3::from([0; 3].map(|_| random.random_range(-1.0..1.0)))).collect();
        let together = field.query_all(&points);
        let matrices = field.covariances(&points, covariance).unwrap();
        let mut plain = field.clone();
        plain.layers.error_bars = None;
        let baked = BakedField::new(&plain).query_all(&points);
        let bars = field.error_bars().unwrap();
        // What is interpolated, and how a mean of it is turned back.
        let power = if covariance == Covariance::Trace { 2 } else { 1 };
        let (mut hanging, mut known) = (0, 0);
        for (i, &x) in points.iter().enumerate() {
            let corners = slow.corners(field.lattice().coordinates(x).unwrap());
            let (mut sum, mut total, mut rays) = (0.0, 0.0, 0.0);
            let (mut error, mut of_error) = (Some(0.0), 0.0);
            let mut matrix = [0.0; 6];
            for &(corner, weight) in &corners {
                let masters: Vec<usize> = slow.masters(corner).iter().map(|point| vertices[point]).collect();
                let n = masters.len() as f64;
                hanging += usize::from(masters.len() > 1);
                let values = masters.iter().map(|&v| field.deviations().get(v).powi(power)).sum::<f64>() / n;
                sum += weight.powi(power) * values;
                total += weight.powi(power);
                rays += weight * masters.iter().map(|&v| field.rays().get(v) as f64).sum::<f64>() / n;
                for &v in &masters {
                    // Shares of what is interpolated: they would move with it.
                    let share = weight.powi(power) * field.deviations().get(v).powi(power) / n;
                    error = error.zip(bars.get(v)).map(|(sum, error)| sum + share * error);
                    of_error += share;
                    let of_vertex = covariance.matrix(&field.sums().unwrap()[v], 20, field.record().lambda);
                    matrix.iter_mut().zip(of_vertex).for_each(|(sum, entry)| *sum += weight / n * entry);
                }
            }
            let expected = (sum / total).powf(1.0 / f64::from(power));
            // A few roundings of f64.
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b.abs();
            for found in [together[i], field.query(x)] {
                assert!(near(found.uncertainty, expected), "{covariance:?} {x}: {} {expected}", found.uncertainty);
                assert!(near(found.rays.unwrap(), rays), "{covariance:?} {x}: {:?} {rays}", found.rays);
                let expected = error.map(|sum| sum / of_error);
                let is_same = found.log10_error.zip(expected).is_none_or(|(found, expected)| near(found, expected));
                assert!(found.log10_error.is_some() == expected.is_some() && is_same, "{found:?} {expected:?}");
                known += usize::from(expected.is_some());
            }
            // Corners are rounded to f32.
            let near_f32 = |a: f64, b: f64| (a - b).abs() <= 2_f64.powi(-23) * b;
            assert!(near_f32(baked[i].uncertainty, expected) && near_f32(baked[i].rays.unwrap(), rays), "{x}");
            let scale = expected * expected / trace(&matrix);
            for (found, entry) in matrices[i].iter().zip(matrix) {
                assert!((found - scale * entry).abs() <= 1e-12 * expected * expected, "{x}: {found} {}", scale * entry);
            }
        }
        assert!(hanging > 1000 && known > 1000, "{hanging} corners hang, {known} errors are known");
    }
}

/// On leaves that are limited a point moves with the functions of free vertices, too. Those outside the octree have the
/// prior's variance.
#[test]
fn correlations_are_those_of_brute_force() {
    let random = &mut ChaCha8Rng::seed_from_u64(6);
    let lattice = Lattice::new(Aabb::centered_cube(1.0), 6).unwrap();
    // Eight regions of leaves of levels 2, 3 and 4.
    let limits = MaxLevels::balanced(6, [(0, 4), (3, 3), (5, 4), (6, 2)]);
    let slow = Slow::of_limits(&limits);
    let edges: std::collections::BTreeSet<u32> = slow.0.iter().map(|(_, edge)| *edge).collect();
    assert!(edges.len() > 1, "{edges:?}");
    // Not all leaves: in a part of the box the octree is coarser than its limits.
    let wanted = slow.0.iter().filter(|(origin, _)| origin[0] + origin[1] < 90);
    let cell =
        |(origin, edge): &([u32; 3], u32)| Cell { level: 6 - edge.ilog2() as u8, index: origin.map(|i| i / edge) };
    let octree = Octree::refined(6, wanted.map(cell));
    let sums = arbitrary_sums(octree.vertex_count(), random);
    let vertices: BTreeMap<[u32; 3], usize> = octree.vertex_positions().zip(0..).collect();
    let support = Support::Octree(octree);
    let record = record(&lattice, Covariance::Block, 20);
    let field = UncertaintyField::on_leaves(record, lattice, support, limits.clone(), sums);
    let (mut shared, mut without, mut correlated) = (0, 0, 0);
    for _ in 0..500 {
        let a = Vec3::from([0; 3].map(|_| random.random_range(-1.05..1.05)));
        let b = a + Vec3::from([0; 3].map(|_| random.random_range(-0.2..0.2)));
        let expected = match [a, b].map(|x| lattice.coordinates(x)) {
            [Some(a), Some(b)] => {
                let [a, b] = [a, b].map(|u| slow.functions(u));
                let mut covariances = [0.0; 3];
                let points: std::collections::BTreeSet<_> = a.keys().chain(b.keys()).collect();
                for point in points {
                    let vertex = vertices.get(point);
                    without += usize::from(vertex.is_none());
                    let variance = vertex.map_or(field.prior(), |&v| field.deviations().get(v)).powi(2);
                    let [of_a, of_b] = [&a, &b].map(|of| of.get(point).copied().unwrap_or(0.0));
                    shared += usize::from(of_a > 0.0 && of_b > 0.0);
                    let products = [of_a * of_b, of_a * of_a, of_b * of_b];
                    covariances.iter_mut().zip(products).for_each(|(sum, product)| *sum += product * variance);
                }
                covariances[0] / (covariances[1] * covariances[2]).sqrt()
            }
            _ => 0.0,
        };
        let found = field.correlation(a, b);
        assert!((found - expected).abs() < 1e-12, "{a} {b}: {found} {expected}");
        assert!((field.correlation(b, a) - found).abs() < 1e-15);
        correlated += usize::from(found > 0.1 && found < 0.9);
    }
    assert!(shared > 100 && without > 100 && correlated > 50, "{shared} {without} {correlated}");
}

/// A field whose sums are not kept is made by other code, and has the same values.
#[test]
fn values_made_without_sums_are_those_made_with_them() {
    let lattice = Lattice::new(Aabb::centered_cube(1.0), 6).unwrap();
    for limits in [MaxLevels::none(6), MaxLevels::balanced(6, [(0, 4), (3, 3), (5, 5)])] {
        let fields = [true, false].map(|keeps_sums| {
            let record = record(&lattice, Covariance::Diagonal, 20);
            let mut posterior = OctreePosterior::limited(lattice, limits.clone());
            posterior.add(&[samples(1.0)]);
            let octree = posterior.octree(&refinement(&record)).unwrap();
            UncertaintyField::on_octree(record, lattice, posterior, octree, keeps_sums).unwrap()
        });
        let [kept, bare] = &fields;
        assert!(kept.sums().is_some() && bare.sums().is_none() && kept.support() == bare.support());
        assert!(kept.deviations() == bare.deviations() && kept.rays() == bare.rays());
        let moved = kept.deviations().iter().filter(|deviation| *deviation < 0.9 * kept.prior()).count();
        assert!(moved > 20, "{moved} vertices moved");
    }
}
