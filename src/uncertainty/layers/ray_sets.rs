//! Which rays were summed.

use serde_json::{Value, json};

use super::super::file::Source;
use super::{Layer, Merge};
use crate::Result;
use crate::rays::{MAX_RAYS, RaySet};
use crate::uncertainty::UncertaintyField;

impl Layer for Vec<RaySet> {
    const NAME: &'static str = "ray sets";
    /// The rays of both; unknown if those of one are.
    const MERGE: Merge<Self> =
        Some(|sum, part| sum.zip(part).map(|(sum, part)| RaySet::joined(sum.iter().chain(part).copied())));
    const WITHOUT: &'static str = "which rays were summed is not known";

    fn head(&self) -> Value {
        json!(self)
    }

    fn read(head: Value, file: &mut Source) -> Result<Self> {
        let head: Self = file.head(Self::NAME, head)?;
        let is_possible = |RaySet { shard, .. }: &RaySet| shard.is_valid() && shard.rays <= MAX_RAYS;
        if !head.iter().all(is_possible) || !RaySet::are_disjoint(head.iter().copied()) {
            let found = "an empty part, one of more than 2^53 rays, or two that may have rays in common";
            return Err(file.malformed("header, ray sets", "parts of runs, each ray in one of them", found));
        }
        Ok(head)
    }

    fn memory(&self) -> usize {
        self.capacity() * size_of::<RaySet>()
    }

    fn info(&self) -> String {
        match self.as_slice() {
            [RaySet { seed, shard }] if shard.of == 1 => format!("all {} rays of seed {seed}", shard.rays),
            [RaySet { seed, shard }] => format!("part {} of {} of seed {seed}", shard.index, shard.of),
            several => format!("{} sequences of pixels", several.len()),
        }
    }
}

impl UncertaintyField {
    /// The same field with the rays of several sets. A record alone names only one.
    ///
    /// # Panics
    /// If two of them may have rays in common.
    #[must_use]
    pub fn with_ray_sets(mut self, ray_sets: Vec<RaySet>) -> Self {
        assert!(RaySet::are_disjoint(ray_sets.iter().copied()), "a ray is counted once");
        self.layers.ray_sets = Some(ray_sets).filter(|ray_sets| !ray_sets.is_empty());
        self
    }

    /// The rays that were summed, by sequence of pixels.
    ///
    /// Empty if they are unknown: they come from a samples file or another program.
    #[must_use]
    pub fn ray_sets(&self) -> &[RaySet] {
        self.layers.ray_sets.as_deref().unwrap_or_default()
    }
}
