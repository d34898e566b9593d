//! The part of a run that one process draws, and how far it has come.

use std::collections::{HashMap, HashSet};
use std::iter::Sum;
use std::ops::Add;

/// Rays per batch. Batch b starts at ray b · 512, and any batch can be drawn by itself.
pub(super) const BATCH: u64 = 512;
/// Most rays that a file may name: f64 counts that many exactly.
pub const MAX_RAYS: u64 = 1 << 53;

/// A part of a run of `rays` rays. In every round of `of` batches, it draws one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct Shard {
    /// Number of rays in the whole run.
    pub rays: u64,
    /// Index of this part, from 0.
    pub index: u64,
    /// Number of parts.
    pub of: u64,
}

impl Shard {
    /// Part `index` of `of` parts of a run.
    #[must_use]
    pub fn new(rays: u64, index: u64, of: u64) -> Self {
        Self { rays, index, of }
    }

    /// The whole of a run.
    #[must_use]
    pub fn whole(rays: u64) -> Self {
        Self::new(rays, 0, 1)
    }

    /// The place of this part's batch among the `of` batches of round `n`.
    ///
    /// The turn moves on from round to round by a Weyl sequence: fractions of multiples of the golden ratio fill [0, 1)
    /// evenly, together with any period of n. So a part's batches fall evenly on the cameras, whatever the period in
    /// which these take turns. With every n-th batch, a part would never see some of them if that period shares a
    /// divisor with n.
    fn place(&self, n: u64) -> u64 {
        // The golden ratio's fraction, times 2^64.
        const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;
        let turn = (u128::from(n.wrapping_mul(GOLDEN)) * u128::from(self.of)) >> 64;
        ((u128::from(self.index) + turn) % u128::from(self.of)) as u64
    }

    /// Number of batches in this part: one of each full round, and perhaps one of the last.
    pub(super) fn batches(&self) -> u64 {
        let batches = self.rays.div_ceil(BATCH);
        let (rounds, rest) = (batches / self.of, batches % self.of);
        rounds + u64::from(self.place(rounds) < rest)
    }

    /// Index, within the whole run, of this part's n-th batch.
    pub(super) fn batch(&self, n: u64) -> u64 {
        n * self.of + self.place(n)
    }

    /// Number of rays in a batch of the whole run.
    pub(super) fn rays_of(&self, batch: u64) -> u64 {
        BATCH.min(self.rays - batch * BATCH)
    }

    /// Checks whether a run of this part can have this `progress`.
    #[must_use]
    pub fn admits(&self, progress: &RunProgress) -> bool {
        progress.batches <= self.batches() && progress.rays <= self.own_rays() && progress.dropped <= progress.rays
    }

    /// Checks that there is at least one ray and one part, and that the index is below the number of parts.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.rays > 0 && self.of > 0 && self.index < self.of
    }

    /// Number of rays in this part.
    #[must_use]
    pub fn own_rays(&self) -> u64 {
        // Only the run's last batch can be short, and that is the last of its part.
        self.batches().checked_sub(1).map_or(0, |last| last * BATCH + self.rays_of(self.batch(last)))
    }
}

/// Identifies summed rays by their seed and shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct RaySet {
    /// Seed of the sequence's pixels and jitter.
    pub seed: u64,
    /// The part of the sequence.
    pub shard: Shard,
}

impl RaySet {
    /// Whether these rays are only a part of a run.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.shard.of > 1
    }

    /// Checks that no two of these sets can have a ray in common.
    ///
    /// Batch b of a seed is the same in every run, whatever the run's length. For one seed, therefore, only
    /// different parts of the same run are disjoint.
    #[must_use]
    pub fn are_disjoint(ray_sets: impl IntoIterator<Item = Self>) -> bool {
        let mut split = HashMap::new();
        let mut parts = HashSet::new();
        ray_sets.into_iter().all(|ray_set| {
            let run = ray_set.run();
            *split.entry(ray_set.seed).or_insert(run) == run && parts.insert(ray_set)
        })
    }

    /// What the parts of one run have in common: seed, rays and number of parts.
    pub(super) fn run(&self) -> (u64, u64, u64) {
        let Shard { rays, of, .. } = self.shard;
        (self.seed, rays, of)
    }

    /// The same rays in as few sets as possible, sorted. If all parts of a run are present, they become one set.
    #[must_use]
    pub fn joined(ray_sets: impl IntoIterator<Item = Self>) -> Vec<Self> {
        let mut ray_sets: Vec<Self> = ray_sets.into_iter().collect();
        ray_sets.sort_unstable_by_key(|ray_set| (ray_set.run(), ray_set.shard.index));
        let join = |parts: &[Self]| {
            let Self { seed, shard } = parts[0];
            let are_all = parts.iter().map(|part| part.shard.index).eq(0..shard.of);
            if are_all { vec![Self { seed, shard: Shard::whole(shard.rays) }] } else { parts.to_vec() }
        };
        ray_sets.chunk_by(|a, b| a.run() == b.run()).flat_map(join).collect()
    }
}

/// Counts of a run so far, without the samples themselves. A run can be resumed from here.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct RunProgress {
    /// Completed batches of the shard.
    pub batches: u64,
    /// R, the number of rays drawn.
    pub rays: u64,
    /// Number of samples with a Jacobian.
    pub samples: u64,
    /// Number of rays dropped because the field was not finite.
    pub dropped: u64,
    /// Position of the first sample where the field was not finite.
    pub first_invalid: Option<[f32; 3]>,
}

impl Add for RunProgress {
    type Output = Self;

    /// The progress of both runs together.
    fn add(self, other: Self) -> Self {
        Self {
            batches: self.batches + other.batches,
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
            dropped: self.dropped + other.dropped,
            first_invalid: self.first_invalid.or(other.first_invalid),
        }
    }
}

impl Sum for RunProgress {
    fn sum<I: Iterator<Item = Self>>(runs: I) -> Self {
        runs.fold(Self::default(), Self::add)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shares_split_a_run_without_overlap(rays in 1_u64..20_000, of in 1_u64..7) {
            let mut batches: Vec<u64> = Vec::new();
            let mut drawn = 0;
            for index in 0..of {
                let shard = Shard::new(rays, index, of);
                batches.extend((0..shard.batches()).map(|n| shard.batch(n)));
                drawn += shard.own_rays();
                let of_batches = (0..shard.batches()).map(|n| shard.rays_of(shard.batch(n)));
                prop_assert_eq!(shard.own_rays(), of_batches.sum::<u64>());
            }
            batches.sort_unstable();
            prop_assert_eq!(drawn, rays);
            prop_assert_eq!(batches, (0..rays.div_ceil(BATCH)).collect::<Vec<_>>());
        }

        /// Sets with a common batch of one seed are never called disjoint; parts of one run always are.
        #[test]
        fn disjoint_draws_have_no_batch_in_common(
            ray_sets in proptest::collection::vec((0_u64..2, 1_u64..3, 1_u64..4, 0_u64..3), 0..5)
        ) {
            let ray_sets: Vec<RaySet> = ray_sets
                .into_iter()
                .map(|(seed, rays, of, index)| RaySet { seed, shard: Shard::new(4000 * rays, index % of, of) })
                .collect();
            let batches = |ray_set: &RaySet| -> Vec<(u64, u64)> {
                let RaySet { seed, shard } = *ray_set;
                (0..shard.batches()).map(|n| (seed, shard.batch(n))).collect()
            };
            let mut all: Vec<(u64, u64)> = ray_sets.iter().flat_map(batches).collect();
            let drawn = all.len();
            all.sort_unstable();
            if RaySet::are_disjoint(ray_sets.iter().copied()) {
                let joined = RaySet::joined(ray_sets.iter().copied());
                let mut again: Vec<(u64, u64)> = joined.iter().flat_map(batches).collect();
                again.sort_unstable();
                prop_assert_eq!(&again, &all);
                prop_assert!(joined.len() <= ray_sets.len());
                all.dedup();
                prop_assert_eq!(all.len(), drawn);
            } else {
                let same_run = |a: &RaySet, b: &RaySet| (a.shard.rays, a.shard.of) == (b.shard.rays, b.shard.of);
                let doubtful = |i: usize| ray_sets[..i].iter().any(|a| {
                    let b = &ray_sets[i];
                    a.seed == b.seed && (a == b || !same_run(a, b))
                });
                prop_assert!((0..ray_sets.len()).any(doubtful));
            }
        }
    }

    /// Cameras of equal size take turns, ray by ray. A part of N batches of a run should see each `period`-th batch
    /// N / period times. The golden ratio's multiples deviate by a few terms of ln N; 10 is beyond what any of the 384
    /// cases comes to, while every n-th batch misses some cameras altogether.
    #[test]
    fn every_part_sees_all_cameras() {
        let counts = |shard: Shard, period: u64| {
            let mut counts = vec![0_u64; period as usize];
            (0..shard.batches()).for_each(|n| counts[(shard.batch(n) % period) as usize] += 1);
            counts
        };
        let cases = [2, 3, 4, 8, 12, 64].map(|of| [2, 3, 4, 6, 8, 16].map(|period| (of, period)));
        for (of, period) in cases.into_iter().flatten() {
            for index in 0..of.min(16) {
                let shard = Shard::new(1600 * of * BATCH, index, of);
                let fair = shard.batches() as f64 / period as f64;
                for count in counts(shard, period) {
                    assert!((count as f64 - fair).abs() <= 10.0, "{shard:?}, {period}: {count} for {fair}");
                }
            }
        }
    }

    #[test]
    fn the_parts_of_a_run_are_the_run() {
        let part = |index| RaySet { seed: 7, shard: Shard::new(5000, index, 3) };
        let other = RaySet { seed: 1, shard: Shard::whole(10) };
        let whole = RaySet { seed: 7, shard: Shard::whole(5000) };
        assert_eq!(RaySet::joined([part(2), other, part(0), part(1)]), [other, whole]);
        assert_eq!(RaySet::joined([part(2), part(0)]), [part(0), part(2)]);
    }

    #[test]
    fn all_counts_add_up_and_the_first_invalid_sample_stays_the_first() {
        let run = |n: u64, first_invalid| RunProgress {
            batches: n,
            rays: 10 * n,
            samples: 100 * n,
            dropped: 1000 * n,
            first_invalid,
        };
        let runs = [run(1, None), run(2, Some([1.0; 3])), run(4, Some([2.0; 3]))];
        assert_eq!(runs.into_iter().sum::<RunProgress>(), run(7, Some([1.0; 3])));
        assert_eq!(runs[2] + runs[0], run(5, Some([2.0; 3])));
    }
}
