//! Which parts of a run are missing.

use std::fmt;
use std::ops::RangeInclusive;

use super::shard::{RaySet, Shard};

/// The parts of a run that nobody summed, although its other parts were.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct MissingShards {
    /// Seed of the run.
    pub seed: u64,
    /// Number of rays in the whole run.
    pub rays: u64,
    /// Number of parts that the run was split into.
    pub of: u64,
    /// Indices of the missing parts, first and last of each gap.
    pub indices: Vec<RangeInclusive<u64>>,
}

impl MissingShards {
    /// What is missing beside these sets, by run. Nothing is, if they are of whole runs only.
    #[must_use]
    pub fn beside(ray_sets: &[RaySet]) -> Vec<Self> {
        let mut parts: Vec<&RaySet> = ray_sets.iter().filter(|ray_set| ray_set.is_part()).collect();
        parts.sort_unstable_by_key(|ray_set| (ray_set.run(), ray_set.shard.index));
        let missing = parts.chunk_by(|a, b| a.run() == b.run()).map(|run| {
            let RaySet { seed, shard: Shard { rays, of, .. } } = *run[0];
            // The end of a run stands for one more part. Runs may be split into more parts than can be listed.
            let mut indices = Vec::new();
            let mut next = 0;
            for index in run.iter().map(|ray_set| ray_set.shard.index).chain([of]) {
                if next < index {
                    indices.push(next..=index - 1);
                }
                next = index.saturating_add(1);
            }
            Self { seed, rays, of, indices }
        });
        missing.filter(|run| !run.indices.is_empty()).collect()
    }
}

/// As `parts 1 and 4 to 6 of 8 (seed 0)`.
impl fmt::Display for MissingShards {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let texts: Vec<String> = self
            .indices
            .iter()
            .map(|gap| match gap.end() - gap.start() {
                0 => gap.start().to_string(),
                _ => format!("{} to {}", gap.start(), gap.end()),
            })
            .collect();
        let is_one = self.indices.len() == 1 && self.indices[0].start() == self.indices[0].end();
        let parts = if is_one { "part" } else { "parts" };
        write!(f, "{parts} {} of {} (seed {})", texts.join(", "), self.of, self.seed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_named() {
        let part = |seed, of, index| RaySet { seed, shard: Shard::new(5000, index, of) };
        let said = |ray_sets: &[RaySet]| -> Vec<String> {
            MissingShards::beside(ray_sets).iter().map(ToString::to_string).collect()
        };
        assert_eq!(said(&[part(0, 3, 2), part(0, 3, 0)]), ["part 1 of 3 (seed 0)"]);
        assert_eq!(said(&[part(7, 9, 2), part(7, 9, 8)]), ["parts 0 to 1, 3 to 7 of 9 (seed 7)"]);
        assert_eq!(said(&[part(1, 2, 0), part(0, 2, 1)]), ["part 0 of 2 (seed 0)", "part 1 of 2 (seed 1)"]);
        assert!(said(&[part(0, 2, 0), part(0, 2, 1), part(3, 1, 0)]).is_empty() && said(&[]).is_empty());
        let last = u64::MAX - 1;
        assert_eq!(said(&[part(0, u64::MAX, last)]), [format!("parts 0 to {} of {} (seed 0)", last - 1, u64::MAX)]);
    }
}
