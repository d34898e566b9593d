//! Counts the vertices that a pilot's rays touch, without sums, and predicts the number that a run will touch.
//!
//! Vertices, bricks and split cells of the octree are *species*, rays are catches ([`SpeciesCounts`] estimates). They
//! are counted on the leaves of every coarseness that limits may require, because a coarse leaf is touched by more rays
//! than its part of the finest ones. Cells are counted level by level, as if every ray had an octree of its own. The
//! octree of all rays splits what the octree of any ray splits, because balance is a rule from one cell to its
//! neighbours.
//!
//! A census of millions would itself take the memory that it is to plan. [`Sample`] therefore keeps those species whose
//! hash ends in enough zeros (Wegman's adaptive sampling, Flajolet 1990), so that they are at most a fixed number.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::pilot_counts::{Counts, PilotCounts};
use super::sparse::{BLOCK_BYTES, BRICK_BYTES, spare_bytes};
use crate::geometry::Lattice;
use crate::io::mix;
use crate::octree::{Leaves, MaxLevels, SplitSet, morton};
use crate::posterior::Entries;
use crate::render::RaySamples;

/// Split cells are counted for one ray in this many, because they take longer than bricks.
const OF_CELLS: u64 = 8;

/// Number of free vertices per leaf. Measured: 0.62 where rays are far apart on the lattice, 0.9 on closed surfaces.
const VERTICES_PER_LEAF: f64 = 0.8;

/// How often species were caught.
///
/// Letters: `d` species caught, `f1`, `f2`, `f3` of them once, twice and three times, `t` catches, `s` catches of the
/// run per catch of the pilot. If the rates of species have a gamma distribution of shape r (Efron & Thisted 1976),
/// 2 f2/f1 = (r + 1) θ and 3 f3/f2 = (r + 2) θ with θ = β/(1 + β), and the run finds
///
/// ```text
/// d + N ((1 + β)^−r − (1 + β s)^−r),  N = f1 (1 + β)^(r+1) / (r β)
/// ```
///
/// species. Rates are far apart where cameras are: what is distant is rarely hit. Rates that are all alike, r → ∞,
/// give Chao's lower bound V = d + f1 (f1 − 1) / (2 (f2 + 1)), and the run finds V (1 − exp(−t s / V)) of these. The
/// larger number counts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct SpeciesCounts {
    counts: Counts,
    /// f1, f2, f3.
    few: [f64; 3],
}

impl SpeciesCounts {
    /// Smallest f2 and f3 from which the spread of rates can be estimated.
    const MIN_COUNTS: [f64; 2] = [20.0, 5.0];
    /// Bounds on θ and r, beyond which the rates are not those of one gamma distribution.
    const MOST_THETA: f64 = 0.95;
    const LEAST_SHAPE: f64 = 0.02;

    pub(super) fn add(mut self, rays: u32) -> Self {
        self.counts = self.counts.add(Counts::of(rays));
        if let Some(f) = self.few.get_mut((rays as usize).wrapping_sub(1)) {
            *f += 1.0;
        }
        self
    }

    /// Expected number of species in the run.
    pub(super) fn expected(&self, s: f64) -> f64 {
        if self.counts.distinct == 0.0 {
            return 0.0;
        }
        let alike = self.counts.vertices(s);
        let [f1, f2, f3] = self.few;
        let theta = 3.0 * f3 / f2 - 2.0 * f2 / f1;
        if f2 < Self::MIN_COUNTS[0] || f3 < Self::MIN_COUNTS[1] || theta <= 0.0 {
            return alike;
        }
        let theta = theta.min(Self::MOST_THETA);
        let r = (2.0 * f2 / f1 / theta - 1.0).max(Self::LEAST_SHAPE);
        let beta = theta / (1.0 - theta);
        let n = f1 * (1.0 + beta).powf(r + 1.0) / (r * beta);
        let new = n * ((1.0 + beta).powf(-r) - (1.0 + beta * s).powf(-r));
        alike.max(self.counts.distinct + new)
    }
}

/// A sample of the species that rays touched, with the number of rays of each.
#[derive(Debug, Clone)]
struct Sample {
    rays: FxHashMap<u64, u32>,
    /// Trailing zeros that a species' hash must have.
    zeros: u32,
    /// Maximal number of species.
    most: usize,
}

impl Sample {
    fn new(most: usize) -> Self {
        Self { rays: FxHashMap::default(), zeros: 0, most }
    }

    /// Whether a species belongs to the sample.
    fn admits(&self, code: u64) -> bool {
        mix(code).trailing_zeros() >= self.zeros
    }

    /// Counts one ray.
    fn add(&mut self, code: u64) {
        if !self.admits(code) {
            return;
        }
        *self.rays.entry(code).or_default() += 1;
        while self.rays.len() > self.most {
            self.zeros += 1;
            let mut rays = std::mem::take(&mut self.rays);
            rays.retain(|&code, _| self.admits(code));
            self.rays = rays;
        }
    }

    /// Expected number of species of `scale` times the rays, among those whose code fulfils `condition`.
    fn expected(&self, scale: f64, condition: impl Fn(u64) -> bool) -> f64 {
        let rays = self.rays.iter().filter(|(code, _)| condition(**code)).map(|(_, &rays)| rays);
        // Sums of integers are the same in any order.
        rays.fold(SpeciesCounts::default(), SpeciesCounts::add).expected(scale) * f64::from(self.zeros).exp2()
    }
}

/// What single rays touched: lists of codes, each code once per ray.
struct Touched {
    /// By coarseness.
    vertices: Vec<Vec<u64>>,
    /// By coarseness.
    bricks: Vec<Vec<u64>>,
    /// By level.
    split: Vec<Vec<u64>>,
}

/// What a run will touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Needs {
    /// Number of vertices that will have sums.
    pub sums: f64,
    /// Number of bricks that find them.
    pub bricks: f64,
    /// Number of vertices of the finished octree.
    pub vertices: f64,
}

impl Needs {
    /// Bytes of the sums, and of what finds them, without what is spare.
    #[must_use]
    pub fn summing(&self, entries: Entries) -> f64 {
        entries.vertex_bytes() as f64 * self.sums + (BLOCK_BYTES + BRICK_BYTES) * self.bricks
    }

    /// Expected room beside them that is taken and not used, bytes.
    #[must_use]
    pub fn spare(&self) -> f64 {
        spare_bytes(self.sums, self.bricks)
    }
}

/// What the rays of a pilot touched.
#[derive(Debug, Clone)]
pub struct SpeciesEstimate {
    lattice: Lattice,
    /// By coarseness of the leaves; of the finest alone if there will be no limits.
    vertices: Vec<Sample>,
    /// By coarseness of the leaves.
    bricks: Vec<Sample>,
    /// By level of the cell.
    split: Vec<Sample>,
    /// Largest number of vertices that a batch of rays touched.
    longest: usize,
}

impl SpeciesEstimate {
    /// Counts nothing yet. Every sample has at most `most` species. Coarser leaves than the finest are looked at if
    /// there may be limits.
    #[must_use]
    pub fn new(lattice: Lattice, most: usize, has_limits: bool) -> Self {
        let finest = lattice.level();
        let depth = if has_limits { finest - MaxLevels::none(finest).region_level() } else { 0 };
        Self {
            lattice,
            vertices: vec![Sample::new(most); usize::from(depth) + 1],
            bricks: vec![Sample::new(most); usize::from(depth) + 1],
            split: vec![Sample::new(most); usize::from(finest)],
            longest: 0,
        }
    }

    /// Counts rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        for some in batches.chunks(rayon::current_num_threads()) {
            let touched: Vec<Touched> = some.par_iter().map(|batch| self.touched(batch)).collect();
            for Touched { vertices, bricks, split } in touched {
                self.longest = self.longest.max(vertices[0].len());
                let by_coarseness = self.vertices.iter_mut().zip(vertices).chain(self.bricks.iter_mut().zip(bricks));
                let lists = by_coarseness.chain(self.split.iter_mut().zip(split));
                lists.for_each(|(sample, codes)| codes.into_iter().for_each(|code| sample.add(code)));
            }
        }
    }

    /// Largest number of vertices that a batch of rays touched.
    #[must_use]
    pub fn longest_batch(&self) -> usize {
        self.longest
    }

    fn touched(&self, batch: &RaySamples) -> Touched {
        let mut touched = Touched {
            vertices: vec![Vec::new(); self.vertices.len()],
            bricks: vec![Vec::new(); self.bricks.len()],
            split: vec![Vec::new(); self.split.len()],
        };
        for (ray, samples) in batch.iter() {
            let located = batch.positions[samples].iter().filter_map(|&x| self.lattice.coordinates(x));
            let mut cells: Vec<u64> = located.map(|u| morton::encode(self.lattice.cell(u).0)).collect();
            cells.sort_unstable();
            let lists = touched.vertices.iter_mut().zip(&mut touched.bricks);
            for (coarseness, (all, bricks)) in lists.enumerate() {
                cells.dedup();
                let mut vertices: Vec<u64> = cells.iter().flat_map(|&cell| corners(cell)).collect();
                vertices.sort_unstable();
                vertices.dedup();
                if coarseness == 0 && is_asked_for_cells(ray) {
                    self.split_for(&vertices, &mut touched.split);
                }
                all.extend(&vertices);
                vertices.iter_mut().for_each(|code| *code >>= 3);
                vertices.dedup();
                bricks.extend(vertices);
                // The parents, still sorted.
                cells.iter_mut().for_each(|code| *code >>= 3);
            }
        }
        touched
    }

    /// The cells that the octree of a ray splits, by level, given the sorted codes of the vertices that it touched.
    fn split_for(&self, vertices: &[u64], split: &mut [Vec<u64>]) {
        let mut wanted = SplitSet::new(self.lattice.level());
        for block in vertices.chunk_by(|a, b| a >> 6 == b >> 6) {
            let mask = block.iter().fold(0, |mask, code| mask | 1 << (code & 63));
            wanted.around_points(block[0] >> 6, mask);
        }
        for (codes, of_ray) in split.iter_mut().zip(wanted.balanced().codes()) {
            codes.extend(of_ray);
        }
    }

    /// The counts by region, from which limits are made.
    #[must_use]
    pub fn counts(&self) -> PilotCounts {
        let each = self.vertices.iter().map(|sample| {
            let rays = sample.rays.iter().map(|(&code, &rays)| (code, rays));
            (rays, f64::from(sample.zeros).exp2())
        });
        PilotCounts::new(self.lattice.level(), each)
    }

    /// What `scale` times the pilot's rays need on the leaves of `limits`.
    ///
    /// # Panics
    /// If there are limits, and the census was made for runs without.
    #[must_use]
    pub fn needs(&self, scale: f64, limits: &MaxLevels) -> Needs {
        let (finest, region) = (limits.finest(), limits.region_level());
        let knows_coarser = self.vertices.len() > usize::from(finest - region);
        assert!(limits.is_unlimited() || knows_coarser, "a census for runs without limits");
        let last = self.lattice.cells_per_axis() - 1;
        let on_limit = |coarseness: u8, code: u64| {
            let vertex = morton::decode(code).map(|i| (i << coarseness).min(last));
            is_on_limit(limits, coarseness, vertex)
        };
        let bricks = (0..).zip(&self.bricks);
        let bricks = bricks.map(|(coarseness, sample)| sample.expected(scale, |code| on_limit(coarseness, code << 3)));
        let touched = (0..).zip(&self.vertices);
        let touched = touched.map(|(coarseness, sample)| sample.expected(scale, |code| on_limit(coarseness, code)));
        let is_split = |level: u8, code: u64| level < region || level < limits.level(code >> (3 * (level - region)));
        let split = (0..).zip(&self.split).map(|(level, sample)| {
            // A cell is split or it is not: all of them is the most there can be.
            let most = f64::from(3 * u32::from(level)).exp2();
            sample.expected(scale * OF_CELLS as f64, |code| is_split(level, code)).min(most)
        });
        let leaves = 1.0 + 7.0 * split.sum::<f64>();
        Needs { sums: touched.sum(), bricks: bricks.sum(), vertices: VERTICES_PER_LEAF * leaves }
    }

    /// Bytes on the heap.
    #[must_use]
    pub fn memory(&self) -> usize {
        let samples = self.bricks.iter().chain(&self.split).chain(&self.vertices);
        samples.map(|sample| sample.rays.capacity() * 8 / 7 * (1 + size_of::<(u64, u32)>())).sum()
    }
}

/// Whether leaves around a cell have this coarseness.
fn is_on_limit(limits: &MaxLevels, coarseness: u8, cell: [u32; 3]) -> bool {
    limits.level(limits.region_of(cell)) + coarseness == limits.finest()
}

/// The corners of a cell, by Morton codes.
fn corners(cell: u64) -> impl Iterator<Item = u64> {
    let at = morton::decode(cell);
    (0..8_u32).map(move |c| morton::encode(std::array::from_fn(|axis| at[axis] + (c >> axis & 1))))
}

/// One ray in [`OF_CELLS`], by chance: neighbours in the sequence of pixels have much in common.
fn is_asked_for_cells(ray: u64) -> bool {
    mix(ray).is_multiple_of(OF_CELLS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    /// Catches of 20,000 species whose rates fall off as their number to the power `fall`.
    fn catches(n: usize, fall: f64) -> Vec<u64> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        // The inverse of the rates' cumulative distribution.
        (0..n).map(|_| (20_000.0 * rng.random::<f64>().powf(1.0 / (1.0 - fall))) as u64).collect()
    }

    #[test]
    fn few_catches_foresee_what_many_find_whether_or_not_rates_are_alike() {
        for (fall, tolerance) in [(0.0, 0.1), (0.5, 0.25), (0.8, 0.5)] {
            let all = catches(640_000, fall);
            let mut pilot = Sample::new(usize::MAX);
            all[..10_000].iter().for_each(|&code| pilot.add(code));
            for scale in [4, 16, 64] {
                let mut run = Sample::new(usize::MAX);
                all[..10_000 * scale].iter().for_each(|&code| run.add(code));
                let (expected, found) = (pilot.expected(scale as f64, |_| true), run.rays.len() as f64);
                assert!((expected / found - 1.0).abs() < tolerance, "{fall}, {scale}: {expected} for {found}");
            }
        }
    }

    proptest! {
        #[test]
        fn a_sample_is_the_same_in_any_order_and_stands_for_all(seed: u64, most in 200_usize..400) {
            let mut codes: Vec<u64> = (0..6000_u64).map(|i| i % 3000 + seed % 1000).collect();
            let of = |codes: &[u64]| {
                let mut sample = Sample::new(most);
                codes.iter().for_each(|&code| sample.add(code));
                sample
            };
            let (forwards, backwards) = (of(&codes), { codes.reverse(); of(&codes) });
            prop_assert_eq!((&forwards.rays, forwards.zeros), (&backwards.rays, backwards.zeros));
            prop_assert!(forwards.rays.len() <= most && forwards.rays.values().all(|&rays| rays == 2));
            // 100 or more of 3000 kept: a standard error of at most a tenth, five of which chance does not reach.
            let estimate = forwards.expected(1.0, |_| true);
            prop_assert!((estimate / 3000.0 - 1.0).abs() < 0.5, "{} of 3000", estimate);
        }
    }
}
