//! Against a dense inverse of its own, and against the blocks.

use approx::assert_relative_eq;
use octobayes::geometry::Aabb;
use octobayes::octree::trilinear;
use octobayes::posterior::{Covariance, DataScale, DensePosterior, Posterior, Scale};
use octobayes::render::{DepthVariance, RaySample};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::*;

const RAYS: u64 = 40;

fn scale() -> DataScale {
    DataScale::new(3000, 0.05, 0.3).unwrap()
}

fn lattice() -> Lattice {
    Lattice::new(Aabb::centered_cube(1.0), 1).unwrap()
}

/// Rays of a few samples, anywhere in the cube, or at lattice points only.
fn samples(seed: u64, at_points: bool) -> RaySamples {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut samples = RaySamples::default();
    for ray in 0..RAYS {
        for _ in 0..if at_points { 1 } else { 3 } {
            let mut coordinate = || {
                if at_points { random.random_range(-1..=1) as f32 } else { random.random_range(-1.0..1.0_f32) }
            };
            let position = Vec3::new(coordinate(), coordinate(), coordinate().abs());
            let jacobian = std::array::from_fn(|_| random.random_range(-1.0..1.0_f32));
            samples.push(ray, RaySample { position, jacobian, weight: 1.0 });
        }
    }
    samples
}

fn full(samples: &RaySamples) -> FullPosterior {
    let mut full = FullPosterior::new(lattice());
    full.add(std::slice::from_ref(samples));
    full
}

/// P of all 27 lattice points, from its definition.
fn precision(samples: &RaySamples) -> Vec<Vec<f64>> {
    let (lattice, scale) = (lattice(), scale());
    let mut precision = vec![vec![0.0; 81]; 81];
    for (_, range) in samples.iter() {
        for channel in 0..3 {
            let mut row = [0.0; 81];
            for i in range.clone() {
                let (cell, offset) = lattice.cell(lattice.coordinates(samples.positions[i]).unwrap());
                for (corner, weight) in trilinear(offset).into_iter().enumerate() {
                    let point = std::array::from_fn(|axis| cell[axis] + (corner as u32 >> axis & 1));
                    for axis in 0..3 {
                        let j = f64::from(samples.jacobians[i][3 * channel + axis]);
                        row[3 * lattice.dense_index(point) + axis] += weight * j;
                    }
                }
            }
            let share = scale.pixels as f64 / (RAYS as f64 * scale.noise.powi(2));
            for i in 0..81 {
                for j in 0..81 {
                    precision[i][j] += share * row[i] * row[j];
                }
            }
        }
    }
    for (i, row) in precision.iter_mut().enumerate() {
        row[i] += scale.prior_deviation.powi(-2);
    }
    precision
}

/// The inverse by Gauss and Jordan, with pivots.
fn inverse(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let n = a.len();
    for (i, row) in a.iter_mut().enumerate() {
        row.extend((0..n).map(|j| if i == j { 1.0 } else { 0.0 }));
    }
    for i in 0..n {
        let pivot = (i..n).max_by(|&p, &q| a[p][i].abs().total_cmp(&a[q][i].abs())).unwrap();
        a.swap(i, pivot);
        let factor = a[i][i];
        a[i].iter_mut().for_each(|v| *v /= factor);
        let own = a[i].clone();
        for (_, row) in a.iter_mut().enumerate().filter(|(j, _)| *j != i) {
            let factor = row[i];
            row.iter_mut().zip(&own).for_each(|(v, own)| *v -= factor * own);
        }
    }
    a.into_iter().map(|row| row[n..].to_vec()).collect()
}

fn points() -> impl Iterator<Item = [u32; 3]> {
    (0..27).map(|i| [i / 9, i / 3 % 3, i % 3])
}

/// A ray whose depth answers to some points of the cube, and of the outside.
fn depth() -> Vec<DepthSample> {
    let sample = |x, y, z, g| DepthSample { position: Vec3::new(x, y, z), gradient: g };
    vec![
        sample(0.2, 0.3, 0.1, DVec3::new(0.5, -0.2, 0.1)),
        sample(0.4, 0.1, 0.7, DVec3::new(0.1, 0.3, -0.6)),
        sample(-0.4, 0.3, -0.8, DVec3::new(0.2, 0.0, 0.1)),
        sample(2.0, 0.0, 0.0, DVec3::new(0.0, 0.1, 0.2)),
    ]
}

/// gᵀ C g with a whole C, and the outside by the prior.
fn depth_variance(covariance: &[Vec<f64>]) -> f64 {
    let (lattice, mut g, mut outside) = (lattice(), vec![0.0; 81], 0.0);
    for DepthSample { position, gradient } in depth() {
        let Some(u) = lattice.coordinates(position) else {
            outside += gradient.length_squared();
            continue;
        };
        let (cell, offset) = lattice.cell(u);
        for (corner, weight) in trilinear(offset).into_iter().enumerate() {
            let point = std::array::from_fn(|axis| cell[axis] + (corner as u32 >> axis & 1));
            for axis in 0..3 {
                g[3 * lattice.dense_index(point) + axis] += weight * gradient[axis];
            }
        }
    }
    let quadratic: f64 = (0..81).map(|i| (0..81).map(|j| g[i] * covariance[i][j] * g[j]).sum::<f64>()).sum();
    quadratic + scale().prior_deviation.powi(2) * outside
}

#[test]
fn the_inverse_is_that_of_the_definition() {
    for seed in 0..4 {
        let samples = samples(seed, false);
        let expected = inverse(precision(&samples));
        let full = full(&samples);
        // The lower half of the cube is never sampled below its middle layer.
        assert!(full.vertices() <= 18, "{}", full.vertices());
        let exact = full.exact(RAYS, scale()).unwrap();
        // Largest entry of P over the prior's: 3000 / (40 · 0.0025) · 40 · 0.09 = 1e5; rounding of J to f32 is 6e-8.
        let least = 1e-6 * scale().prior_deviation.powi(2);
        for (a, p) in points().enumerate() {
            for (b, q) in points().enumerate() {
                let found = exact.covariance(p, q);
                for (x, y) in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 1), (2, 2)] {
                    let expected = expected[3 * a + x][3 * b + y];
                    assert!(
                        (found[x][y] - expected).abs() < least + 1e-4 * expected.abs(),
                        "{} {expected}",
                        found[x][y]
                    );
                }
            }
        }
        assert_relative_eq!(exact.variance(&depth()), depth_variance(&expected), max_relative = 1e-4);
    }
}

#[test]
fn draws_have_the_covariance_of_the_inverse() {
    let samples = samples(5, false);
    let full = full(&samples);
    let exact = full.exact(RAYS, scale()).unwrap();
    let draws = Draws { number: 4000, seed: 3, residual: 1e-8, iterations: 500 };
    let drawn = full.draw(RAYS, scale(), draws).unwrap();
    // Five standard deviations of a variance from so many draws.
    let limit = 5.0 * (2.0 / draws.number as f64).sqrt();
    for point in points() {
        let ratio = (drawn.deviation(point) / exact.deviation(point)).powi(2);
        assert!((ratio - 1.0).abs() < limit, "{point:?}: {ratio}");
    }
    let ratio = drawn.variance(&depth()) / exact.variance(&depth());
    assert!((ratio - 1.0).abs() < limit, "{ratio}");
    // The same again, whatever the number of threads; and others with another seed.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let few = Draws { number: 2, ..draws };
    // More draws than unknowns span the whole space at once; two have to search it.
    let iterations = |draws| full.draw(RAYS, scale(), draws).unwrap().iterations;
    assert!(drawn.iterations == 1 && (4..=200).contains(&iterations(few)), "{}", iterations(few));
    let variance = |draws| full.draw(RAYS, scale(), draws).unwrap().variance(&depth());
    assert_eq!(variance(few).to_bits(), pool.install(|| variance(few)).to_bits());
    assert!(variance(few) != variance(Draws { seed: 4, ..few }));
}

/// Where every ray touches one vertex, nothing is correlated: the blocks are exact.
#[test]
fn without_correlations_it_is_the_blocks() {
    let samples = samples(7, true);
    let full = full(&samples);
    let exact = full.exact(RAYS, scale()).unwrap();
    let mut dense = DensePosterior::new(lattice());
    dense.add(std::slice::from_ref(&samples));
    let factor = Scale::Data(scale()).factor(Covariance::Block);
    for (sums, point) in dense.sums().iter().zip(points()) {
        let block = factor * Covariance::Block.deviation(sums, RAYS, scale().lambda());
        assert_relative_eq!(exact.deviation(point), block, max_relative = 1e-6);
    }
    // Correlated rays know less of each vertex than a block claims, which holds the others fixed.
    let samples = self::samples(8, false);
    let exact = self::full(&samples).exact(RAYS, scale()).unwrap();
    let mut dense = DensePosterior::new(lattice());
    dense.add(std::slice::from_ref(&samples));
    for (sums, point) in dense.sums().iter().zip(points()) {
        let block = factor * Covariance::Block.deviation(sums, RAYS, scale().lambda());
        assert!(exact.deviation(point) >= block * (1.0 - 1e-6), "{point:?}: {} {block}", exact.deviation(point));
    }
}

#[test]
fn what_cannot_be_done_is_said() {
    let full = full(&samples(9, false));
    let short = Draws { number: 2, seed: 0, residual: 1e-12, iterations: 1 };
    let said = full.draw(RAYS, scale(), short).unwrap_err().to_string();
    assert!(said.contains("iterations") && said.contains("NoConvergence"), "{said}");
}
