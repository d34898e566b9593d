//! The octree against the dense grid.

use super::*;
use crate::geometry::Aabb;
use crate::posterior::{Covariance, DensePosterior};
use crate::render::RaySample;
use glam::Vec3;
use proptest::prelude::*;

/// Rays of samples with arbitrary Jacobians over many decades; positions are often on lattice planes, on the box's faces, or
/// outside. Jacobians as small as 1e-9 are far below any tolerance.
fn ray_samples() -> impl Strategy<Value = RaySamples> {
    let coordinate =
        prop_oneof![-1.1..1.1_f32, Just(-1.0_f32), Just(1.0_f32), (-4..=4_i32).prop_map(|i| i as f32 / 4.0)];
    let sample = (
        [coordinate.clone(), coordinate.clone(), coordinate],
        proptest::array::uniform9(-1.0..1.0_f32),
        [-1.0..1.0_f32, -1.0..1.0, -1.0..1.0],
        -9..1_i32,
        0..3_u64,
    );
    proptest::collection::vec(sample, 0..60).prop_map(|samples| {
        let mut out = RaySamples::default();
        let mut ray = 0;
        for (position, jacobian, gradient, decade, skip) in samples {
            ray += skip;
            let scale = 10_f32.powi(decade);
            let jacobian = jacobian.map(|g| g * scale);
            out.push(ray, RaySample { position: Vec3::from_array(position), jacobian, weight: 0.5, gradient });
        }
        out
    })
}

fn lattice(level: u8) -> Lattice {
    Lattice::new(Aabb::centered_cube(1.0), level).unwrap()
}

fn dense_index(point: [u32; 3], level: u8) -> usize {
    let n = (1_usize << level) + 1;
    (point[0] as usize * n + point[1] as usize) * n + point[2] as usize
}

/// Largest difference relative to the larger trace: sums of at most 60 rays, each with a handful of roundings.
fn assert_same(a: &Evidence, b: &Evidence, what: &str) {
    let scale = trace(&a.information).max(trace(&b.information));
    for k in 0..6 {
        let difference = (a.information[k] - b.information[k]).abs();
        assert!(difference <= 100.0 * f64::EPSILON * scale, "{what}: {a:?} against {b:?}");
    }
    // Both add the same rays in the same order.
    assert_eq!((a.rays, a.gradient), (b.rays, b.gradient), "{what}");
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
                    assert_same(&octree.evidence(point), &dense.sums()[dense_index(point, level)], "vertex");
                }
            }
        }
    }

    #[test]
    fn octree_deviates_from_dense_by_no_more_than_the_tolerance(samples in ray_samples(), tolerance in prop_oneof![Just(0.0), 1e-3..0.1_f64]) {
        let (level, rays, lambda) = (4, 500, 1e-6);
        let mut dense = DensePosterior::new(lattice(level));
        let mut octree = OctreePosterior::new(lattice(level));
        dense.add(std::slice::from_ref(&samples));
        octree.add(&[samples]);
        let (octree, sums) = octree.into_octree(rays, lambda, tolerance);
        prop_assert!(octree.validate().is_ok());
        prop_assert_eq!(sums.len(), octree.vertex_count());

        for covariance in Covariance::ALL {
            let log10 = |s: &Evidence| covariance.deviation(s, rays, lambda).log10();
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
                // Whatever moved by more than the tolerance is stored, and exact through its eight finest cells.
                if moved > tolerance + 1e-12 {
                    prop_assert!(stored.contains(&point) && octree.is_surrounded_by_finest(point), "{:?} moved {}", point, moved);
                }
            }
        }
    }

    #[test]
    fn batches_and_threads_do_not_change_a_bit(samples in ray_samples(), cut in 0_usize..20) {
        // The same rays in one batch and one thread, and in two batches and two threads.
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
            let (octree, sums) = pool.install(|| posterior.into_octree(500, 1e-6, 0.01));
            (octree, sums)
        };
        prop_assert_eq!(run(&[samples], 1), run(&parts, 2));
    }
}
