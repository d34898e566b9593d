//! Shrinkage: pooling that weighs the sums of a vertex against those around it by the rays behind them.
//!
//! Letters, for one diagonal entry S of a vertex's information at a time: `T` the mean with weights ¼, ½, ¼ along each
//! axis; `T^k` k such means, a kernel of binomial weights; `A_k` = T^k S; `m` the centroid of the sums under that
//! kernel, cells from the vertex along each axis; `n` the rays at a vertex that moved, 0 at others; `n_k` the mean of n
//! over those that moved under that kernel; `l` = λR, the prior's share.
//!
//! A kernel spreads what it averages, so that beside a surface A_k is too large. Information falls off from a surface
//! about exponentially. For S = exp(a·x), T^k S at x is S Π cosh²ᵏ(a/2) and m = k tanh(a/2), hence S = A_k Π (1 −
//! (m/k)²)ᵏ: the *level* t_k, which is exact for exponentials whatever their slope. The result S* is mixed from the
//! levels and from S itself, on the scale of log U, where noise is even:
//!
//! ```text
//! L = ln(t_4 + l)
//! L = L + g(13) (ln(t_1 + l) − L)             g(c) = 1 / (1 + (c / n_1)^1.5)
//! L = L + g(18) (ln(S + l) − L)
//! S* = (exp(L) − l) exp((1 − g(18)) / 2)
//! ```
//!
//! Information is distributed with heavy tails: of 16 rays at a vertex, about two make its sum. A mean of logarithms is
//! then below the logarithm of the mean, which the last factor makes up for. It and the two counts were chosen on lego,
//! Ignatius, the city and the courtyard (`experiments/speed_vs_error.md`). All vanishes as rays grow: S* tends to S,
//! relative to it by n_1^−1.5.
//!
//! Only what is [enclosed](Enclosed) by vertices that moved is pooled. Of a vertex among them that did not move, either
//! none of few rays met the surface there, or there is no surface. The more rays are around, the less likely is the
//! former. With N rays at the vertex itself, L is drawn from ln l towards itself by exp(−((n_4 / 2 + N) / 8)²). In a
//! gap, which has no neighbour that moved, that is times exp(−3 T⁴n). (At a vertex of a plane, T⁴n is half of the rays
//! at each vertex.) These numbers were chosen on the same scenes.
//!
//! Blocks of 8³ vertices are computed together, with the 4 points around them that T⁴ reaches.

use super::enclosed::Enclosed;
use super::means::{BLOCK, BlockNumbers, FIRST, FOURTH, HALO, Numbers, Order, SIDE, Slopes, mean};
use super::{Information, VertexSums, trace};

/// With so many rays around a vertex, its level weighs as much as the mixture of coarser ones: t_1, then its own sums.
const HALF_COUNTS: [f32; 2] = [13.0, 18.0];
/// How fast that weight changes with the number of rays.
const EXPONENT: f32 = 1.5;
/// ln of the last factor where there are no rays.
const SHIFT: f32 = 0.5;
/// With so many rays, or twice as many around it, a vertex that did not move is hardly at a surface.
const CERTAIN_COUNT: f32 = 8.0;
/// Rays that would have touched a vertex or its neighbours on a surface, as a multiple of T⁴n.
const EXPECTED_RAYS: f32 = 3.0;
/// Least 1 − (m/k)²: beyond the centroid lies in one corner of the kernel, and shows no slope.
const MIN_TAPER: f32 = 0.02;
/// Indices of the diagonal of the information.
const DIAGONAL: [usize; 3] = [0, 3, 5];
/// Indices of the other entries.
const OFF_DIAGONAL: [usize; 3] = [1, 2, 4];
/// The two axes of each entry of the information.
const AXES: [[usize; 2]; 6] = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

/// Shrinks blocks of one field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shrinkage {
    /// Vertices with no more information (tr S) than this have not moved: they count as never seen.
    pub floor: f64,
    /// λR.
    pub prior: f64,
}

/// What pools the information of a block's vertices.
pub struct Block {
    origin: [u32; 3],
    /// l.
    prior: f32,
    /// `None` if no ray moved any vertex that the block depends on.
    moved: Option<Moved>,
}

/// The sums in a block with their means.
struct Moved {
    enclosed: Enclosed,
    /// The six entries of the information.
    information: [Numbers; 6],
    /// Of the diagonal: A_4 and A_1, with what their levels need.
    fourth: [Slopes; 3],
    first: [Slopes; 3],
    /// T of the other entries.
    off_diagonal: [BlockNumbers; 3],
    /// n_1 and n_4; 0 where nothing moved.
    rays: [BlockNumbers; 2],
    /// T⁴n.
    spread: BlockNumbers,
}

impl Block {
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
        let place = [0, 1, 2].map(|axis| point[axis] - self.origin[axis]);
        let information = self.moved.as_ref().map(|moved| moved.shrunk(place, self.prior, rays));
        VertexSums::new(information.unwrap_or_default(), rays)
    }
}

impl Shrinkage {
    /// The block with this number of a lattice {0..`last`}³, from the `vertices` that it [depends on](Block::reach);
    /// others may be among them.
    #[must_use]
    pub fn block<'a>(
        &self,
        number: [u32; 3],
        last: u32,
        vertices: impl IntoIterator<Item = ([u32; 3], &'a VertexSums)>,
    ) -> Block {
        let origin = number.map(|i| i * BLOCK);
        let (mut information, mut rays, mut places) = ([const { Vec::new() }; 6], Vec::new(), Vec::new());
        for (point, sums) in vertices {
            let place: [u32; 3] = std::array::from_fn(|axis| (point[axis] + HALO).wrapping_sub(origin[axis]));
            let is_moved = sums.rays > 0 && trace(&sums.information) > self.floor;
            if !is_moved || place.iter().any(|i| *i >= SIDE) {
                continue;
            }
            if rays.is_empty() {
                let volume = SIDE.pow(3) as usize;
                rays.resize(volume, 0.0);
                information.iter_mut().for_each(|numbers: &mut Numbers| numbers.resize(volume, 0.0));
            }
            let i = index(place, SIDE);
            information.iter_mut().zip(sums.information).for_each(|(numbers, entry)| numbers[i] = entry as f32);
            rays[i] = sums.rays as f32;
            places.push(place);
        }
        let moved = (!places.is_empty()).then(|| {
            let enclosed = Enclosed::new(places, origin, last);
            Moved::new(enclosed, information, &rays)
        });
        Block { origin, prior: self.prior as f32, moved }
    }
}

impl Moved {
    fn new(enclosed: Enclosed, information: [Numbers; 6], rays: &Numbers) -> Self {
        let have_moved: Numbers = rays.iter().map(|n| if *n > 0.0 { 1.0 } else { 0.0 }).collect();
        let [near, spread] = [FIRST, FOURTH].map(|order| mean(rays, &order));
        let over_moved = |mut sums: BlockNumbers, order: &Order| {
            let shares = mean(&have_moved, order);
            sums.iter_mut().zip(shares).filter(|(_, share)| *share > 0.0).for_each(|(sum, share)| *sum /= share);
            sums
        };
        Self {
            enclosed,
            rays: [over_moved(near, &FIRST), over_moved(spread.clone(), &FOURTH)],
            spread,
            fourth: DIAGONAL.map(|k| Slopes::new(&information[k], &FOURTH)),
            first: DIAGONAL.map(|k| Slopes::new(&information[k], &FIRST)),
            off_diagonal: OFF_DIAGONAL.map(|k| mean(&information[k], &FIRST)),
            information,
        }
    }

    /// The pooled information at a place in the block, which `count` rays saw.
    fn shrunk(&self, place: [u32; 3], prior: f32, count: u32) -> Information {
        if !self.enclosed.has(place) {
            return Information::default();
        }
        let i = index(place, BLOCK);
        let [near, far] = self.rays.each_ref().map(|rays| rays[i]);
        let own = self.information.each_ref().map(|numbers| numbers[index(place.map(|i| i + HALO), SIDE)]);
        let weights = HALF_COUNTS.map(|half| 1.0 / (1.0 + (half / near).powf(EXPONENT)));
        let missed = if near == 0.0 { EXPECTED_RAYS * self.spread[i] } else { 0.0 };
        let present = match DIAGONAL.iter().any(|k| own[*k] > 0.0) {
            true => 1.0,
            false => (-((0.5 * far + count as f32) / CERTAIN_COUNT).powi(2) - missed).exp(),
        };
        let shift = (SHIFT * (1.0 - weights[1])).exp();
        let diagonal: [f64; 3] = std::array::from_fn(|axis| {
            let log = |s: f32| (s + prior).ln();
            let mut mixed = log(level(&self.fourth[axis], &FOURTH, i));
            mixed += weights[0] * (log(level(&self.first[axis], &FIRST, i)) - mixed);
            mixed += weights[1] * (log(own[DIAGONAL[axis]]) - mixed);
            mixed += (1.0 - present) * (log(0.0) - mixed);
            f64::from((mixed.exp() - prior).max(0.0) * shift)
        });
        // Directions are those of a mean of positive semi-definite matrices, and stay so under scaling of the axes.
        let mut means = [0.0; 6];
        DIAGONAL.iter().zip(&self.first).for_each(|(k, slopes)| means[*k] = slopes.mean[i]);
        OFF_DIAGONAL.iter().zip(&self.off_diagonal).for_each(|(k, mean)| means[*k] = mean[i]);
        let directions: [f64; 6] = std::array::from_fn(|k| f64::from(means[k] + weights[1] * (own[k] - means[k])));
        let scales: [f64; 3] = std::array::from_fn(|axis| match directions[DIAGONAL[axis]] {
            d if d > 0.0 => (diagonal[axis] / d).sqrt(),
            _ => 0.0,
        });
        std::array::from_fn(|k| match AXES[k] {
            [a, b] if a == b => diagonal[a],
            [a, b] => scales[a] * scales[b] * directions[k],
        })
    }
}

/// Where a place stands in numbers of so many places along each axis.
fn index(place: [u32; 3], side: u32) -> usize {
    let [x, y, z] = place;
    (x + side * (y + side * z)) as usize
}

/// t_k.
fn level(slopes: &Slopes, order: &Order, i: usize) -> f32 {
    let mean = slopes.mean[i];
    if mean <= 0.0 {
        return 0.0;
    }
    let taper = |differences: &BlockNumbers| (1.0 - (differences[i] / mean).powi(2)).max(MIN_TAPER);
    mean * slopes.differences.iter().map(taper).product::<f32>().powi(order.k)
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
        SHRINKAGE.block(number, last, all.iter().map(|(point, sums)| (*point, sums)))
    }

    /// The places that T^k averages, with their weights.
    fn kernel(k: i32) -> impl Iterator<Item = ([i32; 3], f64)> {
        let weight =
            move |j: i32| (0..k + j).fold(0.25_f64.powi(k), |c, i| c * f64::from(2 * k - i) / f64::from(i + 1));
        (0..(2 * k + 1).pow(3)).map(move |j| {
            let off = [0, 1, 2].map(|axis| j / (2 * k + 1).pow(axis) % (2 * k + 1) - k);
            (off, off.into_iter().map(weight).product())
        })
    }

    /// The formulas at one vertex as they stand above, in f64, with kernels written out.
    fn by_hand(at: impl Fn([i32; 3]) -> VertexSums, axis: usize, count: u32) -> f64 {
        let own = |at: VertexSums| at.information[DIAGONAL[axis]];
        let level = |k: i32| {
            let (mut total, mut moments) = (0.0, [0.0; 3]);
            for (off, weight) in kernel(k) {
                let share = weight * own(at(off));
                total += share;
                moments.iter_mut().zip(off).for_each(|(moment, j)| *moment += f64::from(j) * share);
            }
            let taper = |moment: f64| (1.0 - (moment / total / f64::from(k)).powi(2)).max(0.02);
            total * moments.map(taper).iter().product::<f64>().powi(k)
        };
        let over =
            |k: i32, of: &dyn Fn(VertexSums) -> f64| kernel(k).map(|(off, weight)| weight * of(at(off))).sum::<f64>();
        let rays = |k: i32| over(k, &|at| f64::from(at.rays));
        let moved = |k: i32| rays(k) / over(k, &|at| f64::from(u8::from(at.rays > 0))).max(1e-9);
        let (near, far) = (moved(1), moved(4));
        let gate = |half: f64| 1.0 / (1.0 + (half / near).powf(1.5));
        let log = |s: f64| (s + SHRINKAGE.prior).ln();
        let mut mixed = log(level(4));
        mixed += gate(13.0) * (log(level(1)) - mixed);
        mixed += gate(18.0) * (log(own(at([0; 3]))) - mixed);
        if at([0; 3]).rays == 0 {
            let gap = if near == 0.0 { 3.0 * rays(4) } else { 0.0 };
            let present = (-((far / 2.0 + f64::from(count)) / 8.0).powi(2) - gap).exp();
            mixed = log(0.0) + present * (mixed - log(0.0));
        }
        (mixed.exp() - SHRINKAGE.prior) * (0.5 * (1.0 - gate(18.0))).exp()
    }

    /// What gives a vertex its directions: T S and S, mixed by g(18).
    fn directions_by_hand(at: impl Fn([i32; 3]) -> VertexSums) -> [f64; 6] {
        let over = |of: &dyn Fn(VertexSums) -> f64| kernel(1).map(|(off, weight)| weight * of(at(off))).sum::<f64>();
        let near = over(&|at| f64::from(at.rays)) / over(&|at| f64::from(u8::from(at.rays > 0))).max(1e-9);
        let own = 1.0 / (1.0 + (18.0 / near).powf(1.5));
        std::array::from_fn(|k| {
            let mean = over(&|at| at.information[k]);
            mean + own * (at([0; 3]).information[k] - mean)
        })
    }

    #[test]
    fn blocks_follow_the_formulas() {
        // Lumps of very different sizes, some of them at the faces of the lattice, with few rays and many.
        let last = 19;
        let of = |point: [u32; 3]| {
            let [x, y, z] = point.map(f64::from);
            let s = (3.0 * (0.9 * x + 1.7 * y).sin() + 2.0 * (1.1 * z - 0.4 * x).cos()).exp();
            let rays = (20.0 * (1.0 + (0.7 * x - y + 0.6 * z).sin())) as u32;
            // A gap whose middle sees none, among vertices that few rays saw.
            let is_gap = point.iter().all(|i| (9..12).contains(i));
            let rays = if point.iter().all(|i| (6..15).contains(i)) { rays.min(1) } else { rays };
            let sums = sums([s, 0.3 * s + 0.1, 2.0 * s * s], rays);
            // Every other vertex is turned, so that its directions are not those of its neighbours.
            let turned = sums.information.map(f64::abs);
            match (rays == 0 || is_gap, point[0].is_multiple_of(2)) {
                (true, _) => VertexSums::default(),
                (false, true) => VertexSums::new(turned, rays),
                (false, false) => sums,
            }
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
                    let (found, expected) = (found.information[k], by_hand(near, axis, 7));
                    // Thirty roundings of f32, which a slope of the taper near its least value makes tenfold.
                    assert!((found - expected).abs() <= 2e-4 * expected + 1e-6, "{point:?}: {found} and {expected}");
                }
                // Others are in the same ratio to the diagonal as in T S, drawn to S by the rays' own weight.
                let directions = directions_by_hand(near);
                for k in OFF_DIAGONAL {
                    let [a, b] = AXES[k].map(|axis| DIAGONAL[axis]);
                    let scale = (found.information[a] * found.information[b]).sqrt();
                    let expected = scale * directions[k] / (directions[a] * directions[b]).sqrt().max(1e-300);
                    let found = found.information[k];
                    assert!((found - expected).abs() <= 1e-3 * scale + 1e-6, "{point:?}, {k}: {found} and {expected}");
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
            let few = 0.5 * (1.0 - 1.0 / (1.0 + 9_f64.powf(1.5)));
            assert!((ratio / few.exp() - 1.0).abs() < 1e-3, "{point:?}: {ratio}");
        }
    }

    /// n rays change their result by the order of n^−1.5.
    #[test]
    fn many_rays_speak_for_themselves() {
        let of = |[x, y, z]: [u32; 3], rays| sums([1.0 + f64::from((7 * x + 3 * y + 5 * z) % 11); 3], rays);
        let off = |rays: u32| {
            let block = block([0, 0, 0], 16, |point| of(point, rays));
            let apart = |p| (block.at(p, rays).information[3] / of(p, 1).information[3]).ln().abs();
            block.points(16).filter(|p| p.iter().all(|i| *i > 3)).map(apart).fold(0.0, f64::max)
        };
        assert!(off(10) > 0.3, "few are pooled: {}", off(10));
        // ln of sums that differ by up to 11, and of the last factor, times 1 − g(18); and some roundings of f32.
        assert!(off(100_000) < (11_f64.ln() + 0.5) * (18e-5_f64).powf(1.5) + 1e-6, "{}", off(100_000));
        let ratio = off(1_000) / off(100_000);
        assert!((900.0..1100.0).contains(&ratio), "{} and {}", off(1_000), off(100_000));
    }

    #[test]
    fn what_no_ray_moved_stays_unseen() {
        let block = SHRINKAGE.block([0, 0, 0], 16, [([5, 5, 5], &sums([3.0; 3], 5))]);
        for point in block.points(16) {
            // Parents that touch 4 to 6 reach from 2 to 8.
            let is_enclosed = point.iter().all(|i| (3..8).contains(i));
            let is_near = point.iter().all(|i| i.abs_diff(5) <= 1);
            let found = trace(&block.at(point, 0).information);
            assert!(found == 0.0 || is_enclosed, "{point:?}: {found}");
            assert!(found > 0.0 || !is_near, "{point:?}: {found}");
        }
    }

    /// What many rays saw beside a surface, and none moved, is empty; after few rays it may be the surface.
    #[test]
    fn what_rays_did_not_move_is_empty() {
        let of = |[_, _, z]: [u32; 3]| if z == 4 { sums([3.0; 3], 2) } else { VertexSums::default() };
        let beside = block([0, 0, 0], 16, of);
        let seen_by = [0, 8, 40].map(|rays| beside.at([5, 5, 5], rays).information[0]);
        assert!(seen_by[0] > seen_by[1] && seen_by[1] > 10.0 * seen_by[2], "{seen_by:?}");
        assert!(seen_by[2] < 1e-6, "{seen_by:?}");
    }

    /// A gap between vertices that few rays saw is not empty; one between vertices that many saw is.
    #[test]
    fn what_many_rays_missed_is_empty() {
        let pooled = |rays: u32| {
            let of = |[_, _, z]: [u32; 3]| if z % 4 == 3 { sums([3.0; 3], rays) } else { VertexSums::default() };
            block([0, 0, 0], 16, of).at([5; 3], 0).information[0]
        };
        // Planes two points away on either side: their slopes cancel.
        let (share, prior) = (56.0 / 256.0, SHRINKAGE.prior);
        let present = (-(0.5_f64 / 8.0).powi(2) - 3.0 * share).exp();
        let few = prior * (((3.0 * share + prior) / prior).powf(present) - 1.0) * 0.5_f64.exp();
        // Ten roundings of f32, in an exponent of up to 7.
        assert!((pooled(1) / few - 1.0).abs() < 1e-5, "{} and {few}", pooled(1));
        assert!(pooled(100) < 1e-6, "{}", pooled(100));
    }
}
