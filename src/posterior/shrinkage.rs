//! Shrinkage: pooling that weighs the sums of a vertex against those around it by the rays behind them.
//!
//! Letters, for one diagonal entry S of a vertex's information at a time: `T` the mean with weights ¼, ½, ¼ along each
//! axis; `T^k` k such means, a kernel of binomial weights; `A_k` = T^k S; `m` the centroid of the sums under that
//! kernel, cells from the vertex along each axis; `n` the rays at a vertex that moved, 0 at others; `l` = λR, the
//! prior's share.
//!
//! A kernel spreads what it averages, so that beside a surface A_k is too large. Information falls off from a surface
//! about exponentially. For S = exp(a·x), T^k S at x is S Π cosh²ᵏ(a/2) and m = k tanh(a/2), hence S = A_k Π (1 −
//! (m/k)²)ᵏ: the *level* t_k, which is exact for exponentials whatever their slope. The result S* is mixed from the
//! levels and from S itself, on the scale of log U, where noise is even:
//!
//! ```text
//! L = ln(t_4 + l)
//! L = L + g(12) (ln(t_1 + l) − L)             g(c) = 1 / (1 + (c / Tn)^1.5)
//! L = L + g(16) (ln(S + l) − L)
//! S* = (exp(L) − l) exp(8 / (16 + Tn))
//! ```
//!
//! Information is distributed with heavy tails: of 16 rays at a vertex, about two make its sum. A mean of logarithms is
//! then below the logarithm of the mean, which the last factor makes up for. It and the two counts were chosen on lego
//! and Ignatius (`experiments/speed_vs_error.md`). All vanishes as rays grow: S* tends to S, relative to it by Tn^−1.
//!
//! Blocks of 8³ vertices are computed together, with the 4 points around them that T⁴ reaches.

use multiversion::multiversion;

use super::{Information, VertexSums, trace};
use crate::octree::around;

/// Vertices of a block along an axis.
pub const BLOCK: u32 = 8;
/// Points around a block that its levels depend on.
const HALO: u32 = 4;
/// Points along an axis of what a block is computed from.
const SIDE: usize = (BLOCK + 2 * HALO) as usize;
const VOLUME: usize = SIDE * SIDE * SIDE;
/// From a point to the next along x, y and z.
const STRIDES: [usize; 3] = [1, SIDE, SIDE * SIDE];
/// Order of the coarser level.
const COARSE: i32 = 4;
/// With so many rays around a vertex, its level weighs as much as the mixture of coarser ones: t_1, then its own sums.
const HALF_COUNTS: [f32; 2] = [12.0, 16.0];
/// How fast that weight changes with the number of rays.
const EXPONENT: f32 = 1.5;
/// ln of the last factor where there are no rays.
const SHIFT: f32 = 0.5;
/// Least 1 − (m/k)²: beyond the centroid lies in one corner of the kernel, and says nothing of a slope.
const MIN_TAPER: f32 = 0.02;
/// Indices of the diagonal of the information.
const DIAGONAL: [usize; 3] = [0, 3, 5];
/// The two axes of each entry of the information.
const AXES: [[usize; 2]; 6] = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

const MEAN: [f32; 3] = [0.25, 0.5, 0.25];
const DIFFERENCE: [f32; 3] = [-0.25, 0.0, 0.25];

/// One number at every point of a block and of its halo, x fastest. Sums along an axis are wrong at the ends, and each
/// makes one more layer wrong: four of them never reach the block.
type Cube = Vec<f32>;

/// Shrinks blocks of one field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shrinkage {
    /// Vertices with no more information (tr S) than this have not moved: they count as never seen.
    pub floor: f64,
    /// λR.
    pub prior: f64,
}

/// The pooled information of a block's vertices.
pub struct Block {
    origin: [u32; 3],
    /// `[8³]`, x fastest; empty if no ray moved any vertex that the block depends on.
    information: Vec<Information>,
}

impl Block {
    /// The number of the block around a lattice point: its vertices have the same.
    #[must_use]
    pub fn number(point: [u32; 3]) -> [u32; 3] {
        point.map(|i| i / BLOCK)
    }

    /// The numbers of the blocks on which one depends, itself included, on a lattice {0..`last`}³.
    pub fn near(number: [u32; 3], last: u32) -> impl Iterator<Item = [u32; 3]> {
        around(number, last / BLOCK).map(|(number, _)| number)
    }

    /// The lattice points on which a block depends, on a lattice {0..`last`}³.
    pub fn reach(number: [u32; 3], last: u32) -> impl Iterator<Item = [u32; 3]> {
        let side = |axis: usize| {
            let from = number[axis] * BLOCK;
            move || from.saturating_sub(HALO)..(from + BLOCK + HALO).min(last + 1)
        };
        let [x, y, z] = [side(0), side(1), side(2)];
        x().flat_map(move |x| y().flat_map(move |y| z().map(move |z| [x, y, z])))
    }

    /// The lattice points of the block, up to {`last`}³.
    pub fn points(&self, last: u32) -> impl Iterator<Item = [u32; 3]> + use<> {
        let [x, y, z] = self.origin.map(|from| move || from..(from + BLOCK).min(last + 1));
        x().flat_map(move |x| y().flat_map(move |y| z().map(move |z| [x, y, z])))
    }

    /// The pooled sums at a vertex of the block, which has these `rays`.
    #[must_use]
    pub fn at(&self, point: [u32; 3], rays: u32) -> VertexSums {
        let [x, y, z] = std::array::from_fn(|axis| (point[axis] - self.origin[axis]) as usize);
        let edge = BLOCK as usize;
        let information = self.information.get(x + edge * (y + edge * z));
        VertexSums::new(information.copied().unwrap_or_default(), rays)
    }
}

impl Shrinkage {
    /// The pooled sums of the block with this number, from the `vertices` of its [near](Block::near) blocks; others may
    /// be among them.
    #[must_use]
    pub fn block<'a>(&self, number: [u32; 3], vertices: impl IntoIterator<Item = ([u32; 3], &'a VertexSums)>) -> Block {
        let origin = number.map(|i| i * BLOCK);
        let mut cubes: [Cube; 7] = std::array::from_fn(|_| Vec::new());
        for (point, sums) in vertices {
            let offset: [u32; 3] = std::array::from_fn(|axis| (point[axis] + HALO).wrapping_sub(origin[axis]));
            // Most are too far away, and their sums are not read.
            if offset.iter().any(|o| *o >= SIDE as u32) || sums.rays == 0 || trace(&sums.information) <= self.floor {
                continue;
            }
            if cubes[0].is_empty() {
                cubes.iter_mut().for_each(|cube| cube.resize(VOLUME, 0.0));
            }
            let i = offset[0] as usize + SIDE * (offset[1] as usize + SIDE * offset[2] as usize);
            let numbers = sums.information.into_iter().chain([f64::from(sums.rays)]);
            cubes.iter_mut().zip(numbers).for_each(|(cube, number)| cube[i] = number as f32);
        }
        let information = if cubes[0].is_empty() { Vec::new() } else { self.shrunk(&cubes) };
        Block { origin, information }
    }

    /// The pooled information of the block among cubes of the six entries of the information, and of the rays.
    fn shrunk(&self, cubes: &[Cube; 7]) -> Vec<Information> {
        let means: [Cube; 7] = std::array::from_fn(|k| mean(&cubes[k]));
        let levels = DIAGONAL.map(|k| {
            let coarse = (2..COARSE).fold(means[k].clone(), |cube, _| mean(&cube));
            [level(&coarse, COARSE), level(&cubes[k], 1)]
        });
        let prior = self.prior as f32;
        let at = |i: usize| {
            let rays = means[6][i];
            if rays == 0.0 {
                return Information::default();
            }
            let weights = HALF_COUNTS.map(|half| 1.0 / (1.0 + (half / rays).powf(EXPONENT)));
            let shift = (SHIFT * HALF_COUNTS[1] / (HALF_COUNTS[1] + rays)).exp();
            let diagonal: [f64; 3] = std::array::from_fn(|axis| {
                let log = |s: f32| (s + prior).ln();
                let mut mixed = log(levels[axis][0][i]);
                mixed += weights[0] * (log(levels[axis][1][i]) - mixed);
                mixed += weights[1] * (log(cubes[DIAGONAL[axis]][i]) - mixed);
                f64::from((mixed.exp() - prior).max(0.0) * shift)
            });
            // Directions are those of a mean of positive semi-definite matrices, and stay so under scaling of the axes.
            let directions: [f64; 6] =
                std::array::from_fn(|k| f64::from(means[k][i] + weights[1] * (cubes[k][i] - means[k][i])));
            let scales: [f64; 3] = std::array::from_fn(|axis| match directions[DIAGONAL[axis]] {
                d if d > 0.0 => (diagonal[axis] / d).sqrt(),
                _ => 0.0,
            });
            std::array::from_fn(|k| match AXES[k] {
                [a, b] if a == b => diagonal[a],
                [a, b] => scales[a] * scales[b] * directions[k],
            })
        };
        core().map(at).collect()
    }
}

/// The vertices of the block among the points of a cube.
fn core() -> impl Iterator<Item = usize> {
    let inner = || HALO as usize..(HALO + BLOCK) as usize;
    let rows = inner().flat_map(move |z| inner().map(move |y| STRIDES[1] * y + STRIDES[2] * z));
    rows.flat_map(move |row| inner().map(move |x| row + x))
}

/// T of a cube.
fn mean(cube: &Cube) -> Cube {
    let [x, y, z] = STRIDES;
    along(&along(&along(cube, x, MEAN), y, MEAN), z, MEAN)
}

/// t_k of what was averaged k − 1 times.
fn level(cube: &Cube, order: i32) -> Cube {
    let [x, y, z] = STRIDES;
    let of_x = along(cube, x, MEAN);
    let of_xy = along(&of_x, y, MEAN);
    let mut level = along(&of_xy, z, MEAN);
    let differences = [
        along(&along(&along(cube, x, DIFFERENCE), y, MEAN), z, MEAN),
        along(&along(&of_x, y, DIFFERENCE), z, MEAN),
        along(&of_xy, z, DIFFERENCE),
    ];
    for i in core() {
        let mean = level[i];
        if mean > 0.0 {
            let taper = |difference: &Cube| (1.0 - (difference[i] / mean).powi(2)).max(MIN_TAPER);
            level[i] *= differences.iter().map(taper).product::<f32>().powi(order);
        }
    }
    level
}

/// Three weights along an axis.
#[multiversion(targets("x86_64+avx2+fma"))]
fn along(cube: &Cube, stride: usize, weights: [f32; 3]) -> Cube {
    let [before, own, after] = weights;
    let inner = VOLUME - 2 * stride;
    let [a, b, c] = [0, stride, 2 * stride].map(|from| &cube[from..from + inner]);
    let mut sums = Vec::with_capacity(VOLUME);
    sums.resize(stride, 0.0);
    sums.extend(a.iter().zip(b).zip(c).map(|((a, b), c)| before * a + own * b + after * c));
    sums.resize(VOLUME, 0.0);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHRINKAGE: Shrinkage = Shrinkage { floor: 1e-9, prior: 1e-3 };

    fn sums(diagonal: [f64; 3], rays: u32) -> VertexSums {
        let [x, y, z] = diagonal;
        VertexSums::new([x, 0.5 * (x * y).sqrt(), -0.3 * (x * z).sqrt(), y, 0.2 * (y * z).sqrt(), z], rays)
    }

    fn block(number: [u32; 3], last: u32, of: impl Fn([u32; 3]) -> VertexSums) -> Block {
        let all = (0..=last).flat_map(|x| (0..=last).flat_map(move |y| (0..=last).map(move |z| [x, y, z])));
        let all: Vec<([u32; 3], VertexSums)> = all.map(|point| (point, of(point))).collect();
        SHRINKAGE.block(number, all.iter().map(|(point, sums)| (*point, sums)))
    }

    /// The formulas at one vertex as they stand above, in f64, with kernels written out.
    fn by_hand(at: impl Fn([i32; 3]) -> VertexSums, axis: usize) -> f64 {
        let own = |at: VertexSums| at.information[DIAGONAL[axis]];
        let level = |k: i32| {
            let weight = |j: i32| (0..k + j).fold(0.25_f64.powi(k), |c, i| c * f64::from(2 * k - i) / f64::from(i + 1));
            let (mut total, mut moments) = (0.0, [0.0; 3]);
            for j in 0..(2 * k + 1).pow(3) {
                let off = [0, 1, 2].map(|axis| j / (2 * k + 1).pow(axis) % (2 * k + 1) - k);
                let share = off.iter().map(|j| weight(*j)).product::<f64>() * own(at(off));
                total += share;
                moments.iter_mut().zip(off).for_each(|(moment, j)| *moment += f64::from(j) * share);
            }
            let taper = |moment: f64| (1.0 - (moment / total / f64::from(k)).powi(2)).max(0.02);
            total * moments.map(taper).iter().product::<f64>().powi(k)
        };
        let mut rays = 0.0;
        for j in 0..27 {
            let off = [j % 3 - 1, j / 3 % 3 - 1, j / 9 - 1];
            rays += off.iter().map(|j| [0.25, 0.5, 0.25][(j + 1) as usize]).product::<f64>() * f64::from(at(off).rays);
        }
        let gate = |half: f64| 1.0 / (1.0 + (half / rays).powf(1.5));
        let log = |s: f64| (s + SHRINKAGE.prior).ln();
        let mut mixed = log(level(4));
        mixed += gate(12.0) * (log(level(1)) - mixed);
        mixed += gate(16.0) * (log(own(at([0; 3]))) - mixed);
        (mixed.exp() - SHRINKAGE.prior) * (8.0 / (16.0 + rays)).exp()
    }

    #[test]
    fn blocks_follow_the_formulas() {
        // Lumps of very different sizes, some of them at the faces of the lattice, with few rays and many.
        let last = 19;
        let of = |point: [u32; 3]| {
            let [x, y, z] = point.map(f64::from);
            let s = (3.0 * (0.9 * x + 1.7 * y).sin() + 2.0 * (1.1 * z - 0.4 * x).cos()).exp();
            let rays = (20.0 * (1.0 + (0.7 * x - y + 0.6 * z).sin())) as u32;
            if rays == 0 { VertexSums::default() } else { sums([s, 0.3 * s + 0.1, 2.0 * s * s], rays) }
        };
        for number in [[0, 0, 0], [1, 0, 2], [1, 1, 1]] {
            let block = block(number, last, of);
            for point in block.points(last) {
                let near = |off: [i32; 3]| {
                    let place = [0, 1, 2].map(|axis| point[axis].checked_add_signed(off[axis]).filter(|p| *p <= last));
                    match place {
                        [Some(x), Some(y), Some(z)] => of([x, y, z]),
                        _ => VertexSums::default(),
                    }
                };
                let found = block.at(point, 7);
                assert_eq!(found.rays, 7);
                for (axis, k) in DIAGONAL.into_iter().enumerate() {
                    let (found, expected) = (found.information[k], by_hand(near, axis));
                    // Thirty roundings of f32, which a slope of the taper near its least value makes tenfold.
                    assert!((found - expected).abs() <= 2e-4 * expected + 1e-6, "{point:?}: {found} and {expected}");
                }
                assert!(found.is_valid(), "{point:?}: {found:?}");
            }
        }
    }

    /// What falls off exponentially is found whatever the rays, but for the factor of few rays.
    #[test]
    fn exponentials_pass_as_they_are() {
        let of = |[x, y, z]: [u32; 3]| {
            let s = (0.8 * f64::from(x) - 0.5 * f64::from(y) + 0.3 * f64::from(z)).exp();
            sums([s; 3], 2)
        };
        let block = block([1, 1, 1], 24, of);
        for point in block.points(24) {
            let ratio = block.at(point, 2).information[0] / of(point).information[0];
            assert!((ratio / (8.0_f64 / 18.0).exp() - 1.0).abs() < 1e-3, "{point:?}: {ratio}");
        }
    }

    /// n rays change what they say by the order of 1 / n.
    #[test]
    fn many_rays_speak_for_themselves() {
        let of = |[x, y, z]: [u32; 3], rays| sums([1.0 + f64::from((7 * x + 3 * y + 5 * z) % 11); 3], rays);
        let off = |rays: u32| {
            let block = block([0, 0, 0], 16, |point| of(point, rays));
            let apart = |p| (block.at(p, rays).information[3] / of(p, 1).information[3]).ln().abs();
            block.points(16).filter(|p| p.iter().all(|i| *i > 3)).map(apart).fold(0.0, f64::max)
        };
        assert!(off(10) > 0.3, "few are pooled: {}", off(10));
        assert!(off(100_000) < 2e-4 && off(100_000) > 1e-5, "{}", off(100_000));
    }

    #[test]
    fn what_no_ray_moved_stays_unseen() {
        let block = SHRINKAGE.block([0, 0, 0], [([4, 4, 4], &sums([3.0; 3], 5))]);
        for point in block.points(16) {
            let is_near = point.iter().all(|i| i.abs_diff(4) <= 1);
            assert_eq!(trace(&block.at(point, 0).information) > 0.0, is_near, "{point:?}");
        }
    }
}
