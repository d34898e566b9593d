//! The octree posterior: sums information only where rays are sensitive, in one pass and without an initial guess.
//!
//! Rays are summed on leaves as fine as [`MaxLevels`] allows. That is the finest lattice, unless rays
//! cannot support it in some region. Only vertices touched by a sensitive sample have sums ([sparse]). At the
//! end the octree is refined around every vertex that moved from the prior by more than the tolerance. Everywhere
//! else the field equals the prior to within the tolerance, and leaves stay as coarse as 2:1 balance permits.
//! Nothing is ever accumulated at a vertex that later needs splitting, so the outcome does not depend on the
//! order in which space is discovered.
//!
//! On limited leaves a corner may be a hanging vertex. Its part of J goes to the vertices that it is interpolated
//! from, before squaring: the J of a free vertex includes what its hanging dependants would have received ([walk]).
//!
//! Threads: batches are squared in parallel ([squares], [scattered], [walk]), each into lists of contributions,
//! one list per partition ([key]). Then the partitions add their lists in parallel, each in ray order. Every sum
//! therefore receives its contributions in ray order, whatever the number of threads.

mod key;
mod pages;
mod pilot_counts;
mod refine;
mod runs;
mod scattered;
mod sparse;
mod squares;
mod touches;
mod walk;

pub use refine::{Criteria, Criterion, Refinement};
pub(super) use refine::{VERTICES_AT_ONCE, each_vertex};
pub use sparse::spare_bytes;
pub use touches::Touches;

use std::ops::{AddAssign, Range};
use std::sync::Arc;

use key::{Contributions, VertexKey};
use rayon::prelude::*;
use refine::read_groups;
use runs::Runs;
use scattered::Scattered;
use sparse::SparseSums;
use walk::LeafWalk;

use super::{Fill, Posterior, Sums, Support, VertexSums};
use crate::Result;
use crate::geometry::Lattice;
use crate::io::sorted::SortedFile;
use crate::octree::{Leaves, MaxLevels, Octree, coarseness};
use crate::render::RaySamples;

/// Lists of contributions that each thread has at once.
const AT_ONCE: usize = 2;

/// Information summed at sparse vertices: all of it, or what `S` has of it.
#[derive(Debug, Clone)]
pub struct OctreePosterior<S: Sums = VertexSums> {
    lattice: Lattice,
    limits: MaxLevels,
    sums: SparseSums<S>,
    /// Sums over earlier rays, which left memory.
    runs: Runs<S>,
}

impl OctreePosterior {
    /// Creates a posterior without information and without limits below the lattice's level.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self::limited(lattice, MaxLevels::none(lattice.level()))
    }

    /// Creates a posterior without information that sums on the leaves of `limits`.
    ///
    /// # Panics
    /// If the limits belong to another level.
    #[must_use]
    pub fn limited(lattice: Lattice, limits: MaxLevels) -> Self {
        Self::with(lattice, limits)
    }
}

impl<S: Sums> OctreePosterior<S> {
    fn with(lattice: Lattice, limits: MaxLevels) -> Self {
        assert_eq!(limits.finest(), lattice.level(), "limits belong to the lattice's level");
        Self { lattice, limits, sums: SparseSums::new(), runs: Runs::default() }
    }

    /// The maximal level of leaves, by region.
    #[must_use]
    pub fn limits(&self) -> &MaxLevels {
        &self.limits
    }

    /// The sums so far at a lattice point.
    ///
    /// # Panics
    /// If some have left memory.
    #[must_use]
    pub fn sums(&self, point: [u32; 3]) -> S {
        assert!(self.runs.is_empty(), "all sums are in memory");
        self.sums.get(VertexKey::new(point, self.coarseness(point))).copied().unwrap_or_default()
    }

    /// Every vertex that a ray touched, with its lattice point.
    ///
    /// # Panics
    /// If some sums have left memory.
    #[must_use = "iterators are lazy"]
    pub fn touched(&self) -> impl ParallelIterator<Item = ([u32; 3], &S)> {
        assert!(self.runs.is_empty(), "all sums are in memory");
        self.sums.par_iter().filter(|(_, e)| e.rays() > 0).map(|(key, e)| (key.point(), e))
    }

    /// Number of levels between the finest level and the finest leaf that has `point` as a corner.
    ///
    /// A point that is not a corner of a leaf of that level has no sums under any key.
    fn coarseness(&self, point: [u32; 3]) -> u8 {
        if self.limits.is_unlimited() {
            return 0;
        }
        coarseness(&self.limits, point)
    }

    /// Whether sums under a key would be found: its leaves are as coarse as those around its point.
    fn is_found(&self, key: VertexKey) -> bool {
        u64::from(self.coarseness(key.point())) == key.coarseness()
    }

    /// Calls `visit` for every ray of a batch, in order, with what it adds at each vertex that it touches: lattice
    /// point and sums. The sums so far do not count, and do not change.
    pub fn each_ray(&self, batch: &RaySamples, mut visit: impl FnMut(u64, &[([u32; 3], S)])) {
        let (mut all, mut touched) = (Contributions::default(), Vec::new());
        for (ray, samples) in batch.iter() {
            self.square(batch, std::iter::once(samples), &mut all);
            touched.clear();
            touched.extend(all.iter().map(|added| (added.key.point(), S::of_ray(added.square))));
            visit(ray, &touched);
        }
    }

    /// Squares every ray of a batch.
    fn contributions(&self, batch: &RaySamples) -> Contributions<S::Square> {
        // How much room they need depends on how many samples share their vertices: they grow.
        let mut all = Contributions::default();
        self.square(batch, batch.iter().map(|(_, samples)| samples), &mut all);
        all
    }

    /// Squares some rays of a batch, each given by its samples, into lists whose content is replaced.
    fn square(&self, batch: &RaySamples, rays: impl Iterator<Item = Range<usize>>, all: &mut Contributions<S::Square>) {
        let finest = self.limits.is_unlimited();
        let (mut places, mut walk) = (Vec::new(), LeafWalk::new(&self.lattice, &self.limits));
        let mut scattered = Scattered::new(&self.lattice);
        all.clear();
        for samples in rays {
            if finest && squares::locate(&self.lattice, batch, samples.clone(), &mut places) {
                squares::along::<S>(&places, batch, all);
            } else if finest {
                scattered.ray::<S>(batch, samples, all);
            } else {
                walk.ray::<S>(batch, samples, all);
            }
        }
    }
}

impl<S: Sums> AddAssign<&Self> for OctreePosterior<S> {
    /// Adds the sums over other rays on the same leaves, vertex by vertex.
    fn add_assign(&mut self, other: &Self) {
        self.sums += &other.sums;
        self.runs.extend(&other.runs);
    }
}

impl<S: Sums> Posterior for OctreePosterior<S> {
    const NAME: [&'static str; 2] = ["octree", S::NAME];
    type Sums = S;
    type Vertices = Octree;

    fn empty(lattice: Lattice, limits: &MaxLevels) -> Self {
        Self::with(lattice, limits.clone())
    }

    fn add(&mut self, batches: &[RaySamples]) {
        // A list may be several times as large as its batch, so there are only enough to keep the threads busy: threads
        // wait for each other after these.
        for some in batches.chunks(AT_ONCE * rayon::current_num_threads()) {
            let lists: Vec<_> = some.par_iter().map(|batch| self.contributions(batch)).collect();
            self.sums.add(&lists);
        }
    }

    fn add_sums(&mut self, point: [u32; 3], sums: &VertexSums) {
        self.sums.add_one(VertexKey::new(point, self.coarseness(point)), &S::narrowed(sums));
    }

    fn memory(&self) -> usize {
        self.sums.memory()
    }

    fn spill(&mut self, write: impl FnOnce(Fill<'_, S>) -> Result<SortedFile<S>>) -> Result<()> {
        let sums = std::mem::replace(&mut self.sums, SparseSums::new());
        self.runs.push(write(&|push| sums.in_order(|key, sums| push(key.bits(), sums)))?);
        Ok(())
    }

    fn merge_runs(&mut self, write: impl FnOnce(Fill<'_, S>) -> Result<SortedFile<S>>) -> Result<()> {
        let merged = write(&|push| {
            let mut all = self.runs.merged(VertexKey::from_bits(0))?;
            while let Some((key, sums)) = all.next()? {
                push(key.bits(), sums)?;
            }
            Ok(())
        })?;
        self.runs = Runs::default();
        self.runs.push(merged);
        Ok(())
    }

    fn runs(&self) -> &[Arc<SortedFile<S>>] {
        self.runs.files()
    }

    fn add_run(&mut self, run: SortedFile<S>) -> Result<bool> {
        let (mut records, mut last) = (run.cursor(0)?, None);
        while let Some(bits) = records.peek()? {
            let (sums, key) = (records.take(), VertexKey::from_bits(bits));
            let is_vertex = key.is_within(self.lattice.cells_per_axis()) && self.is_found(key);
            if !is_vertex || last >= Some(bits) || !sums.widened().is_valid() {
                return Ok(false);
            }
            last = Some(bits);
        }
        drop(records);
        self.runs.push(run);
        Ok(true)
    }

    fn vertices(&self, refinement: &Refinement) -> Result<Octree> {
        self.octree(refinement)
    }

    fn read_groups<T: Clone + Default + Send>(
        groups: &[Self],
        support: &Support,
        read: impl Fn(usize, [u32; 3], &[S]) -> T + Sync,
    ) -> Result<Vec<T>> {
        let Support::Octree(octree) = support else { panic!("an octree") };
        read_groups(groups, octree, read)
    }

    fn paired<T: Send>(
        &self,
        other: &Self,
        read: impl Fn(VertexSums, VertexSums) -> Option<T> + Send + Sync,
    ) -> Result<Vec<T>> {
        if !(self.runs.is_empty() && other.runs.is_empty()) {
            assert!(self.memory() + other.memory() == 0, "no sums are in memory beside the runs");
            return self.runs.paired(&other.runs, |a, b| read(a.widened(), b.widened()));
        }
        let both = self.touched().map(|(point, sums)| (sums.widened(), other.sums(point).widened()));
        let new = other.touched().filter(|(point, _)| self.sums(*point).rays() == 0);
        let all = both.chain(new.map(|(_, sums)| (VertexSums::default(), sums.widened())));
        Ok(all.filter_map(|(a, b)| read(a, b)).collect())
    }

    fn keys(&self) -> Vec<u64> {
        self.sums.keys().map(VertexKey::bits).collect()
    }

    fn slices(&self) -> impl Iterator<Item = &[S]> {
        self.sums.slices()
    }

    /// `None` if a key lies outside the lattice, is not that of a vertex on the leaves of `limits`, or occurs twice.
    fn restore(lattice: Lattice, limits: &MaxLevels, keys: &[u64], sums: Vec<S>) -> Option<Self> {
        if keys.len() != sums.len() {
            return None;
        }
        let sums = SparseSums::restore(lattice.cells_per_axis(), keys, sums)?;
        let restored = Self { sums, ..Self::empty(lattice, limits) };
        keys.par_iter().all(|&key| restored.is_found(VertexKey::from_bits(key))).then_some(restored)
    }
}

#[cfg(test)]
mod tests;
