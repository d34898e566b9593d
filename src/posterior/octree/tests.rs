//! The octree compared with the dense grid.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::squares::{SampleJacobian, VertexJacobian};
use super::*;
use crate::geometry::Aabb;
use crate::octree::{
    Cell, Corner, Leaves, Octree, SplitSet, VertexId, around, cells_around, coarseness, masters, morton, trilinear,
};
use crate::posterior::{Covariance, DensePosterior, DiagonalSums, Information, negligible_information, trace};
use crate::render::RaySample;
use glam::{DVec3, Vec3};
use proptest::prelude::*;

/// Rays of samples with arbitrary Jacobians over many decades. Positions often lie on lattice planes, on the
/// faces of the box, or outside it. Jacobians as small as 1e-9 are far below any tolerance.
fn ray_samples() -> impl Strategy<Value = RaySamples> {
    let coordinate =
        prop_oneof![-1.1..1.1_f32, Just(-1.0_f32), Just(1.0_f32), (-4..=4_i32).prop_map(|i| i as f32 / 4.0)];
    let sample = (
        [coordinate.clone(), coordinate.clone(), coordinate],
        proptest::array::uniform9(-1.0..1.0_f32),
        -9..1_i32,
        0..3_u64,
    );
    proptest::collection::vec(sample, 0..60).prop_map(|samples| {
        let mut out = RaySamples::default();
        let mut ray = 0;
        for (position, jacobian, decade, skip) in samples {
            ray += skip;
            let scale = 10_f32.powi(decade);
            let jacobian = jacobian.map(|g| g * scale);
            out.push(ray, RaySample { position: Vec3::from_array(position), jacobian, weight: 0.5 });
        }
        out
    })
}

fn lattice(level: u8) -> Lattice {
    Lattice::new(Aabb::centered_cube(1.0), level).unwrap()
}

/// The octree, and the sums at its vertices in the order of their ids.
fn with_sums<S: Sums>(posterior: &OctreePosterior<S>, refinement: &Refinement) -> (Octree, Vec<VertexSums>) {
    let octree = posterior.octree(refinement).unwrap();
    let sums = posterior.sums_at(&octree).unwrap();
    (octree, sums)
}

fn refinement(floor: f64) -> Refinement {
    Refinement { floor: Some(floor), is_pooled: false, wanted: Vec::new() }
}

/// The basis function of vertex `id` at lattice coordinates `u`: the octree's interpolant of 1 at
/// the vertex and 0 at all others.
fn hat(octree: &Octree, id: VertexId, u: DVec3) -> f64 {
    let at = octree.locate(u);
    let value = |corner: &Corner| {
        let masters = corner.masters();
        masters.iter().filter(|&&v| v == id).count() as f64 / masters.len() as f64
    };
    at.corners.iter().zip(at.weights).map(|(corner, weight)| weight * value(corner)).sum()
}

fn dense_index(point: [u32; 3], level: u8) -> usize {
    let n = (1_usize << level) + 1;
    (point[0] as usize * n + point[1] as usize) * n + point[2] as usize
}

/// Compares sums relative to the larger trace: at most 60 rays, each with a handful of roundings.
fn assert_same(a: &VertexSums, b: &VertexSums, what: &str) {
    let scale = trace(&a.information).max(trace(&b.information));
    for k in 0..6 {
        let difference = (a.information[k] - b.information[k]).abs();
        assert!(difference <= 100.0 * f64::EPSILON * scale, "{what}: {a:?} against {b:?}");
    }
    // Both add the same rays in the same order.
    assert_eq!(a.rays, b.rays, "{what}");
}

proptest! {
    #[test]
    fn fully_refined_octree_is_the_dense_grid(samples in ray_samples(), level in 1_u8..=4) {
        let (mut dense, mut octree) = (DensePosterior::new(lattice(level)), OctreePosterior::new(lattice(level)));
        dense.add(std::slice::from_ref(&samples));
        octree.add(&[samples]);
        let m = 1_u32 << level;
        for x in 0..=m {
            for y in 0..=m {
                for z in 0..=m {
                    let point = [x, y, z];
                    assert_same(&octree.sums(point), &dense.sums()[dense_index(point, level)], "vertex");
                }
            }
        }
    }

    #[test]
    fn octree_deviates_from_dense_by_no_more_than_the_tolerance(
        samples in ray_samples(),
        tolerance in prop_oneof![Just(0.0), 1e-3..0.1_f64],
    ) {
        let (level, rays, lambda) = (4, 500, 1e-6);
        let mut dense = DensePosterior::new(lattice(level));
        let mut octree = OctreePosterior::new(lattice(level));
        dense.add(std::slice::from_ref(&samples));
        octree.add(&[samples]);
        let (octree, sums) = with_sums(&octree, &refinement(negligible_information(tolerance, rays, lambda)));
        prop_assert!(octree.validate().is_ok());
        prop_assert_eq!(sums.len(), octree.vertex_count());

        for covariance in Covariance::ALL {
            let log10 = |s: &VertexSums| covariance.deviation(s, rays, lambda).log10();
            let prior = covariance.prior(lambda).log10();
            let mut stored = std::collections::HashSet::new();
            for (point, s) in octree.vertex_positions().zip(&sums) {
                stored.insert(point);
                assert_same(s, &dense.sums()[dense_index(point, level)], "stored vertex");
            }
            let m = 1_u32 << level;
            for code in 0..(m + 1).pow(3) {
                let point = [code % (m + 1), code / (m + 1) % (m + 1), code / (m + 1) / (m + 1)];
                let moved = prior - log10(&dense.sums()[dense_index(point, level)]);
                // Every vertex that moved by more than the tolerance is stored, and its eight finest cells make
                // it exact.
                if moved > tolerance + 1e-12 {
                    prop_assert!(
                        stored.contains(&point) && octree.is_surrounded_by_finest(point),
                        "{:?} moved {}",
                        point,
                        moved
                    );
                }
            }
        }
    }

}

proptest! {
    // Each case looks around thousands of points.
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn pooling_refines_around_each_vertex_that_it_moves(
        samples in ray_samples(),
        floor in (-9..0_i32).prop_map(|decade| 10_f64.powi(decade)),
        limits in prop_oneof![Just(Vec::new()), proptest::collection::vec((0_u64..8, 1_u8..=6), 1..5)],
    ) {
        let level = 6;
        let limits = if limits.is_empty() { MaxLevels::none(level) } else { MaxLevels::balanced(level, limits) };
        let mut posterior = OctreePosterior::limited(lattice(level), limits.clone());
        posterior.add(&[samples]);

        let last = 1 << level;
        let touched: BTreeMap<[u32; 3], VertexSums> = posterior.touched().map(|(point, sums)| (point, *sums)).collect();
        let moved = |point: [u32; 3]| touched.get(&point).is_some_and(|sums| trace(&sums.information) > floor);
        let finest = |point: [u32; 3]| coarseness(&limits, point) == 0;
        let mut wanted = SplitSet::new(level);
        let near: BTreeSet<[u32; 3]> = touched.keys().flat_map(|&at| around(at, last).map(|(near, _)| near)).collect();
        for point in near {
            let is_beside = || around(point, last).any(|(near, _)| finest(near) && moved(near));
            if moved(point) || finest(point) && is_beside() {
                cells_around(point, level).for_each(|cell| wanted.cell(limits.leaf(cell)));
            }
        }
        let found = posterior.octree(&Refinement { floor: Some(floor), is_pooled: true, wanted: Vec::new() }).unwrap();
        let expected = Octree::from_split_set(wanted);
        prop_assert_eq!(found.cells(), expected.cells());
    }
}

proptest! {
    // Each case walks all 262,144 finest cells.
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    #[ignore = "slow: several seconds"]
    fn on_limited_leaves_sums_are_those_of_the_conforming_basis(
        samples in ray_samples(), wanted in proptest::collection::vec((0_u64..8, 1_u8..=6), 1..5),
    ) {
        // Regions of level 1 in a lattice of level 6. Adjacent regions have leaves of different sizes, with
        // hanging vertices.
        let lattice = lattice(6);
        let limits = MaxLevels::balanced(6, wanted);
        let mut posterior = OctreePosterior::limited(lattice, limits.clone());
        posterior.add(std::slice::from_ref(&samples));
        // The same leaves as an explicit octree.
        let leaves = (0..1_u64 << 18).map(|code| limits.leaf(morton::decode(code)));
        let mut leaves: Vec<Cell> = leaves.collect();
        leaves.dedup();
        let octree = Octree::refined(6, leaves.iter().copied());
        let stats = octree.validate().unwrap();
        let mut unique = leaves;
        unique.sort_unstable();
        unique.dedup();
        prop_assert_eq!(stats.leaves(), unique.len() as u64);

        let mut seen = 0;
        for (id, point) in (0..).map(VertexId).zip(octree.vertex_positions()) {
            let found = posterior.sums(point);
            seen += u64::from(found.rays);
            if found.rays == 0 && id.0 % 97 > 0 {
                continue;
            }
            let mut expected = [0.0; 6];
            for (_, range) in samples.iter() {
                let mut j = [0.0; 9];
                for i in range {
                    let Some(u) = lattice.coordinates(samples.positions[i]) else { continue };
                    let weight = hat(&octree, id, u);
                    j.iter_mut().zip(samples.jacobians[i]).for_each(|(j, g)| *j += weight * f64::from(g));
                }
                expected.iter_mut().zip(VertexSums::square(&j)).for_each(|(s, v)| *s += v);
            }
            let scale = trace(&found.information).max(trace(&expected));
            for k in 0..6 {
                prop_assert!(
                    (found.information[k] - expected[k]).abs() <= 1e-13 * scale,
                    "{:?}: {:?} against {:?}",
                    point,
                    found,
                    expected
                );
            }
        }
        // No sums lie at points that are not vertices.
        let total: u64 = posterior.touched().map(|(_, e)| u64::from(e.rays)).sum();
        prop_assert_eq!(seen, total);
        // Next to leaves coarser than the limits, nothing is lost.
        let (coarse, sums) = with_sums(&posterior, &refinement(0.0));
        for (point, sum) in coarse.vertex_positions().zip(&sums) {
            let as_limited = |cell| coarse.cells().leaf(cell) == limits.leaf(cell);
            prop_assert!(cells_around(point, 6).all(as_limited) || trace(&sum.information) == 0.0, "{:?}", point);
        }
    }
}

proptest! {
    #[test]
    fn batches_and_threads_do_not_change_a_bit(samples in ray_samples(), cut in 0_usize..20) {
        // Compares the rays in one batch on one thread with the same rays in two batches on two threads.
        let mut parts = [RaySamples::default(), RaySamples::default()];
        for (n, (ray, range)) in samples.iter().enumerate() {
            for i in range {
                parts[usize::from(n >= cut)].push(ray, samples.sample(i));
            }
        }
        let run = |batches: &[RaySamples], threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut posterior = OctreePosterior::new(lattice(4));
            pool.install(|| posterior.add(batches));
            pool.install(|| with_sums(&posterior, &refinement(negligible_information(0.01, 500, 1e-6))))
        };
        prop_assert_eq!(run(&[samples], 1), run(&parts, 2));
    }
}

/// Sums of both parts of some rays: the first are what a checkpoint of them restores.
fn sums_of_parts<S: Sums>(parts: &[RaySamples; 2], limits: &MaxLevels) -> [OctreePosterior<S>; 2] {
    let [first, second] = parts.each_ref().map(|part| {
        let mut posterior = OctreePosterior::<S>::empty(lattice(limits.finest()), limits);
        posterior.add(std::slice::from_ref(part));
        posterior
    });
    let saved = first.slices().flatten().copied().collect();
    let restored = OctreePosterior::restore(first.lattice, limits, &first.keys(), saved);
    [restored.unwrap(), second]
}

/// The bits of what both kinds of sums have.
fn bits(sums: &VertexSums) -> ([u64; 3], u32) {
    ([0, 3, 5].map(|k| sums.information[k].to_bits()), sums.rays)
}

proptest! {
    #[test]
    #[ignore = "slow: several seconds"]
    fn a_diagonal_alone_has_the_bits_of_all_sums(
        samples in ray_samples(),
        wanted in prop_oneof![Just(Vec::new()), proptest::collection::vec((0_u64..8, 1_u8..=5), 1..5)],
        cut in 0_usize..20,
    ) {
        let limits = if wanted.is_empty() { MaxLevels::none(5) } else { MaxLevels::balanced(5, wanted) };
        let mut parts = [RaySamples::default(), RaySamples::default()];
        for (n, (ray, range)) in samples.iter().enumerate() {
            range.for_each(|i| parts[usize::from(n >= cut)].push(ray, samples.sample(i)));
        }
        let mut whole = sums_of_parts::<VertexSums>(&parts, &limits);
        let mut diagonal = sums_of_parts::<DiagonalSums>(&parts, &limits);

        let sorted = |pairs: Vec<(VertexSums, VertexSums)>| {
            let mut pairs: Vec<_> = pairs.iter().map(|(a, b)| (bits(a), bits(b))).collect();
            pairs.sort_unstable();
            pairs
        };
        let all = |a, b| Some((a, b));
        let [whole_pairs, diagonal_pairs] = [whole[0].paired(&whole[1], all), diagonal[0].paired(&diagonal[1], all)];
        prop_assert_eq!(sorted(whole_pairs.unwrap()), sorted(diagonal_pairs.unwrap()));

        let ([whole, more], [diagonal, more_of_diagonal]) = (&mut whole, &mut diagonal);
        *whole += more;
        *diagonal += more_of_diagonal;
        // Three numbers of 8 bytes fewer at each vertex; what finds them is the same. Both are whole pages.
        prop_assert_eq!(size_of::<VertexSums>() - size_of::<DiagonalSums>(), 24);
        prop_assert!(diagonal.memory() <= whole.memory());
        for floor in [Refinement::EVERYTHING, 1e-6] {
            let (octree, sums) = with_sums(whole, &refinement(floor));
            let (same, diagonals) = with_sums(diagonal, &refinement(floor));
            prop_assert_eq!(octree.cells(), same.cells());
            prop_assert!(sums.iter().map(bits).eq(diagonals.iter().map(bits)));
            for covariance in [Covariance::Diagonal, Covariance::Trace] {
                let deviation = |sums: &VertexSums| covariance.deviation(sums, 500, 1e-6).to_bits();
                prop_assert!(sums.iter().map(deviation).eq(diagonals.iter().map(deviation)));
            }
        }
    }
}

/// (vertex, sample index, weight). A stable sort groups the samples of a vertex in ray order.
type Touch = (VertexKey, usize, f64);

impl OctreePosterior {
    /// Visits the vertices that a sample touches, with their weights: the corners of its leaf,
    /// with hanging vertices resolved.
    fn for_each_vertex(&self, x: Vec3, mut visit: impl FnMut(VertexKey, f64)) {
        let Some(u) = self.lattice.coordinates(x) else { return };
        let leaf = self.limits.leaf(self.lattice.cell(u).0);
        let (origin, edge) = leaf.extent(self.limits.finest());
        let offset = (u - DVec3::from(origin.map(f64::from))) / f64::from(edge);
        for (c, weight) in trilinear(offset).into_iter().enumerate() {
            let corner = std::array::from_fn(|axis| origin[axis] + edge * (c as u32 >> axis & 1));
            let masters = masters(&self.limits, corner);
            let weight = weight / masters.points().len() as f64;
            masters.points().iter().for_each(|&point| visit(VertexKey::new(point, self.coarseness(point)), weight));
        }
    }

    /// Squares one ray on any leaves, slowly, by sorting what its samples touch by vertex.
    fn gather(&self, batch: &RaySamples, samples: Range<usize>) -> BTreeMap<VertexKey, Vec<VertexSums>> {
        let mut touched: Vec<Touch> = Vec::new();
        for i in samples {
            self.for_each_vertex(batch.positions[i], |key, weight| touched.push((key, i, weight)));
        }
        touched.sort_by_key(|touch| touch.0);
        let square = |group: &[Touch]| {
            let mut partial = VertexJacobian::default();
            group.iter().for_each(|&(_, sample, weight)| partial.add(weight, &SampleJacobian::new(batch, sample)));
            (group[0].0, vec![VertexSums::of_ray(partial.squared::<VertexSums>())])
        };
        touched.chunk_by(|a, b| a.0 == b.0).map(square).collect()
    }
}

/// The contributions of one ray by vertex.
fn by_vertex(contributions: &Contributions<Information>) -> BTreeMap<VertexKey, Vec<VertexSums>> {
    let mut found: BTreeMap<VertexKey, Vec<VertexSums>> = BTreeMap::new();
    let all = (0..key::PARTITIONS).flat_map(|s| contributions.partition(s));
    all.for_each(|c| found.entry(c.key).or_default().push(VertexSums::of_ray(c.square)));
    found
}

proptest! {
    #[test]
    fn walking_from_cell_to_cell_gives_the_squares_of_sorting(
        from in (-1.0..1.0_f32, Just(0.25_f32), -1.0..1.0_f32),
        to in (-1.0..1.0_f32, prop_oneof![Just(0.25_f32), -1.0..1.0_f32], -1.0..1.0_f32),
        steps in proptest::collection::vec(0.0..0.2_f32, 1..40),
        rows in proptest::collection::vec(proptest::array::uniform9(-1.0..1.0_f32), 40),
    ) {
        let mut batch = RaySamples::default();
        let (from, to) = (Vec3::from(from), Vec3::from(to));
        let mut t = 0.0;
        for (step, &jacobian) in steps.iter().zip(&rows) {
            t += step;
            let position = from + t * (to - from);
            batch.push(0, RaySample { position, jacobian, weight: 0.5 });
        }
        let posterior = OctreePosterior::new(lattice(4));
        let range = 0..batch.positions.len();
        let sorted = posterior.gather(&batch, range.clone());
        let (mut places, mut walked) = (Vec::new(), Contributions::default());
        // Rounded positions on a straight line do not turn back, because f32 products and sums are monotone.
        prop_assert!(squares::locate(&posterior.lattice, &batch, range, &mut places));
        squares::along::<VertexSums>(&places, &batch, &mut walked);
        prop_assert_eq!(by_vertex(&walked), sorted);
    }

    #[test]
    fn walking_from_leaf_to_leaf_gives_the_squares_of_sorting(
        samples in ray_samples(), straight in proptest::array::uniform2(proptest::array::uniform3(-1.0..1.0_f32)),
        wanted in proptest::collection::vec((0_u64..64, 2_u8..=7), 0..9), unlimited in proptest::bool::weighted(0.2),
    ) {
        // 4³ regions with leaves of up to six sizes. Some rays jump to and fro; one is straight
        // and has many samples per leaf.
        let limits = if unlimited { MaxLevels::none(7) } else { MaxLevels::balanced(7, wanted) };
        let posterior = OctreePosterior::limited(lattice(7), limits);
        let mut samples = samples;
        let [from, to] = straight.map(Vec3::from);
        for i in 0..200_u8 {
            let position = from + f32::from(i) / 199.0 * (to - from);
            let row = std::array::from_fn(|k| (f32::from(i) * 0.1 + k as f32).sin());
            samples.push(1000, RaySample { position, jacobian: row, weight: 0.5 });
        }
        // One walk for all rays: no state may remain from the previous ray.
        let mut walk = LeafWalk::new(&posterior.lattice, &posterior.limits);
        for (_, range) in samples.iter() {
            let mut walked = Contributions::default();
            walk.ray::<VertexSums>(&samples, range.clone(), &mut walked);
            prop_assert_eq!(by_vertex(&walked), posterior.gather(&samples, range));
        }
    }

    #[test]
    fn rays_that_jump_from_cell_to_cell_give_the_squares_of_sorting(samples in ray_samples()) {
        let posterior = OctreePosterior::new(lattice(7));
        // One batch for all rays: nothing but places may remain from the previous ray.
        let mut scattered = Scattered::new(&posterior.lattice);
        for (_, range) in samples.iter() {
            let mut found = Contributions::default();
            scattered.ray::<VertexSums>(&samples, range.clone(), &mut found);
            prop_assert_eq!(by_vertex(&found), posterior.gather(&samples, range));
        }
    }
}

#[test]
fn a_ray_that_turns_back_is_squared_once() {
    let mut batch = RaySamples::default();
    for x in [0.1, 0.3, 0.6, 0.3] {
        let position = Vec3::new(x, 0.1, 0.1);
        batch.push(0, RaySample { position, jacobian: [1.0; 9], weight: 0.5 });
    }
    let posterior = OctreePosterior::new(lattice(3));
    assert!(!squares::locate(&posterior.lattice, &batch, 0..4, &mut Vec::new()));
    // Both samples in the cell from ¼ to ½ enter one square: (Σ φ)² rather than the sum of two squares.
    let mut whole = posterior.clone();
    whole.add(&[batch.clone()]);
    let weight: f64 =
        [0.1, 0.3, 0.6, 0.3].iter().map(|&x| (1.0 - 4.0 * (f64::from(x as f32) - 0.25).abs()).max(0.0)).sum();
    let across = (1.0 - 4.0 * f64::from(0.1_f32)).powi(2);
    let found = whole.sums([5, 4, 4]).information[0];
    // Three channels of 1, in f64.
    assert!((found / (3.0 * (weight * across).powi(2)) - 1.0).abs() < 1e-12, "{found}");
}
