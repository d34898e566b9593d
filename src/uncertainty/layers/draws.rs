//! Which rays were summed.

use serde_json::{Value, json};

use super::super::file::Source;
use super::{Layer, Merge};
use crate::Result;
use crate::rays::Draw;
use crate::uncertainty::UncertaintyField;

impl Layer for Vec<Draw> {
    const NAME: &'static str = "draws";
    /// The rays of both; unknown if those of one are.
    const MERGE: Merge<Self> =
        Some(|sum, part| sum.zip(part).map(|(sum, part)| Draw::joined(sum.iter().chain(part).copied())));
    const WITHOUT: &'static str = "which rays were summed is not known";

    fn head(&self) -> Value {
        json!(self)
    }

    fn read(head: Value, file: &mut Source) -> Result<Self> {
        let head: Self = file.head(Self::NAME, head)?;
        if !head.iter().all(|draw| draw.shard.is_valid()) || !Draw::are_disjoint(head.iter().copied()) {
            let found = "an empty part, or two that may have rays in common";
            return Err(file.malformed("header, draws", "parts of runs, each ray in one of them", found));
        }
        Ok(head)
    }

    fn memory(&self) -> usize {
        self.capacity() * size_of::<Draw>()
    }

    fn info(&self) -> String {
        match self.as_slice() {
            [Draw { seed, shard }] if shard.of == 1 => format!("all {} rays of seed {seed}", shard.rays),
            [Draw { seed, shard }] => format!("part {} of {} of seed {seed}", shard.index, shard.of),
            several => format!("{} sequences of pixels", several.len()),
        }
    }
}

impl UncertaintyField {
    /// The same field with the rays of several draws. A protocol alone names only one.
    ///
    /// # Panics
    /// If two of them may have rays in common.
    #[must_use]
    pub fn with_draws(mut self, draws: Vec<Draw>) -> Self {
        assert!(Draw::are_disjoint(draws.iter().copied()), "a ray is counted once");
        self.layers.draws = Some(draws).filter(|draws| !draws.is_empty());
        self
    }

    /// The rays that were summed, by sequence of pixels.
    ///
    /// Empty if they are unknown: they come from a samples file or another program.
    #[must_use]
    pub fn draws(&self) -> &[Draw] {
        self.layers.draws.as_deref().unwrap_or_default()
    }
}
