//! The contributions of rays, in one list per partition, which that partition reads from beginning to end.

use super::key::{PARTITIONS, VertexKey};
use crate::posterior::VertexSums;

/// The contribution of one ray to one vertex.
#[derive(Clone, Copy)]
pub struct Contribution {
    pub key: VertexKey,
    pub sums: VertexSums,
}

/// The contributions of a batch of rays, by partition, each in ray order.
pub struct Contributions(Vec<Vec<Contribution>>);

impl Contributions {
    /// Creates empty lists with room for about `expected` contributions.
    pub fn new(expected: usize) -> Self {
        Self((0..PARTITIONS).map(|_| Vec::with_capacity(expected / PARTITIONS)).collect())
    }

    /// Appends a contribution of the current ray or the next one.
    #[inline(always)]
    pub fn push(&mut self, key: VertexKey, sums: VertexSums) {
        self.0[key.partition()].push(Contribution { key, sums });
    }

    /// Keeps the contributions to some vertices.
    pub fn retain(&mut self, condition: impl Fn(VertexKey) -> bool) {
        self.0.iter_mut().for_each(|list| list.retain(|contribution| condition(contribution.key)));
    }

    /// The list of one partition.
    pub fn partition(&self, s: usize) -> &[Contribution] {
        &self.0[s]
    }
}
