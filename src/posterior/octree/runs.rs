//! Sums that left memory: runs of vertices in the order of their keys, each the sums over other rays.
//!
//! A vertex may be in any number of runs; its sums are theirs, added in the order in which the runs were written. That
//! is another order of additions than in memory: of n rays, sums differ by n ε at most.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::key::{BlockCode, VertexKey};
use crate::Result;
use crate::io::sorted::{Cursor, SortedFile};
use crate::posterior::Sums;

/// Pages that are merged by one thread at a time, for each run: it reads one of each beside them.
const PAGES_OF_RUN: usize = 4;

/// Runs, the oldest first.
#[derive(Debug, Clone)]
pub struct Runs<S>(Vec<Arc<SortedFile<S>>>);

impl<S> Default for Runs<S> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<S: Sums> Runs<S> {
    pub fn push(&mut self, run: SortedFile<S>) {
        self.0.push(Arc::new(run));
    }

    /// Those of other rays, behind its own.
    pub fn extend(&mut self, others: &Self) {
        self.0.extend(others.0.iter().cloned());
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn files(&self) -> &[Arc<SortedFile<S>>] {
        &self.0
    }

    /// For every block, its code and a mask of the vertices whose sums satisfy `condition`; in parallel, in lists of
    /// blocks that are near each other.
    pub fn par_masks(
        &self,
        condition: impl Fn(&S) -> bool + Send + Sync,
    ) -> impl ParallelIterator<Item = Result<Vec<(BlockCode, u64)>>> {
        ranges(&[self]).into_par_iter().map(move |blocks| self.masks(&blocks, &condition))
    }

    /// What `read` makes of the sums of these runs and of others, at every vertex of either, leaving out what is
    /// `None`.
    pub fn paired<T: Send>(&self, others: &Self, read: impl Fn(S, S) -> Option<T> + Sync) -> Result<Vec<T>> {
        let lists = ranges(&[self, others]).into_par_iter().map(|blocks| {
            let first = BlockCode::of(blocks.start).vertex(0);
            let (mut mine, mut theirs) = (self.merged(first)?, others.merged(first)?);
            let (mut a, mut b) = (mine.next_in(&blocks)?, theirs.next_in(&blocks)?);
            let mut all = Vec::new();
            while let Some(key) = [a, b].iter().flatten().map(|(key, _)| *key).min() {
                let [of_a, of_b] = [&mut a, &mut b].map(|next| next.take_if(|(own, _)| *own == key));
                let [x, y] = [of_a, of_b].map(|of| of.map_or(S::default(), |(_, sums)| sums));
                all.extend(read(x, y));
                if of_a.is_some() {
                    a = mine.next_in(&blocks)?;
                }
                if of_b.is_some() {
                    b = theirs.next_in(&blocks)?;
                }
            }
            Ok(all)
        });
        Ok(lists.collect::<Result<Vec<Vec<T>>>>()?.into_iter().flatten().collect())
    }

    /// The masks of these blocks.
    fn masks(&self, blocks: &Range<u64>, condition: impl Fn(&S) -> bool) -> Result<Vec<(BlockCode, u64)>> {
        let (mut masks, mut merged) =
            (Vec::<(BlockCode, u64)>::new(), self.merged(BlockCode::of(blocks.start).vertex(0))?);
        while let Some((key, sums)) = merged.next_in(blocks)? {
            let bit = u64::from(condition(&sums)) << (key.bits() & 63);
            match masks.last_mut() {
                Some((code, mask)) if *code == key.block() => *mask |= bit,
                _ => masks.push((key.block(), bit)),
            }
        }
        Ok(masks)
    }

    /// All vertices from this key on, in the order of their keys.
    pub fn merged(&self, from: VertexKey) -> Result<Merged<'_, S>> {
        let cursors = self.0.iter().map(|run| run.cursor(from.bits()));
        Ok(Merged(cursors.collect::<Result<_>>()?))
    }

    /// A reader for looking up vertices, soonest in the order of their keys.
    pub fn reader(&self) -> RunsReader<'_, S> {
        RunsReader { runs: self, cursors: Vec::new() }
    }
}

/// Ranges of bits of blocks which together are all blocks of these runs, each for one thread at a time.
fn ranges<S: Sums>(of: &[&Runs<S>]) -> Vec<Range<u64>> {
    let runs = || of.iter().flat_map(|runs| &runs.0);
    let first_keys = runs().flat_map(|run| run.first_keys());
    let mut starts: Vec<u64> = first_keys.map(|&key| VertexKey::from_bits(key).block().bits()).collect();
    starts.par_sort_unstable();
    let mut starts: Vec<u64> = starts.into_iter().step_by(PAGES_OF_RUN * runs().count().max(4)).collect();
    starts.dedup();
    let ends: Vec<u64> = starts.iter().skip(1).copied().chain([u64::MAX]).collect();
    starts.into_iter().zip(ends).map(|(start, end)| start..end).collect()
}

/// The vertices of all runs, one after the other.
pub struct Merged<'a, S>(Vec<Cursor<'a, S>>);

impl<S: Sums> Merged<'_, S> {
    /// The next vertex with its sums over all runs.
    pub fn next(&mut self) -> Result<Option<(VertexKey, S)>> {
        let mut least = None;
        for cursor in &mut self.0 {
            least = [least, cursor.peek()?].into_iter().flatten().min();
        }
        let Some(least) = least else { return Ok(None) };
        let mut sums = S::default();
        for cursor in &mut self.0 {
            if cursor.peek()? == Some(least) {
                sums += &cursor.take();
            }
        }
        Ok(Some((VertexKey::from_bits(least), sums)))
    }

    /// The next vertex, if its block is one of these.
    fn next_in(&mut self, blocks: &Range<u64>) -> Result<Option<(VertexKey, S)>> {
        Ok(self.next()?.filter(|(key, _)| key.block().bits() < blocks.end))
    }
}

/// Looks up vertices in all runs.
pub struct RunsReader<'a, S> {
    runs: &'a Runs<S>,
    /// Of each run, once anything was looked up.
    cursors: Vec<Cursor<'a, S>>,
}

impl<S: Sums> RunsReader<'_, S> {
    /// The sums of a vertex over all runs; zeros if it is in none.
    pub fn find(&mut self, key: VertexKey) -> Result<S> {
        if self.cursors.is_empty() {
            self.cursors = self.runs.merged(key)?.0;
        }
        let mut sums = S::default();
        for cursor in &mut self.cursors {
            if let Some(own) = cursor.find(key.bits())? {
                sums += &own;
            }
        }
        Ok(sums)
    }
}
