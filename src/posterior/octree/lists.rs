//! What rays add, in lists by shard: each shard reads its own from beginning to end.

use super::bricks::{SHARDS, shard_of};
use crate::posterior::VertexSums;

/// What one ray adds to one vertex.
#[derive(Clone, Copy)]
pub struct Contribution {
    pub key: u64,
    pub sums: VertexSums,
}

/// What the rays of a batch add, by shard, in ray order in each.
pub struct Contributions(Vec<Vec<Contribution>>);

impl Contributions {
    /// None yet, with room for about `expected`.
    pub fn new(expected: usize) -> Self {
        Self((0..SHARDS).map(|_| Vec::with_capacity(expected / SHARDS)).collect())
    }

    /// Appends what the next ray adds to a vertex, or the same ray to another one.
    #[inline(always)]
    pub fn push(&mut self, key: u64, sums: VertexSums) {
        self.0[shard_of(key)].push(Contribution { key, sums });
    }

    /// The list of one shard.
    pub fn of_shard(&self, s: usize) -> &[Contribution] {
        &self.0[s]
    }
}
