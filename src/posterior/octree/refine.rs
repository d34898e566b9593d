//! From sums to an octree: finds where its leaves must be as fine as the sums.

use std::fmt;

use rayon::iter::Either;
use rayon::prelude::*;

use super::OctreePosterior;
use super::key::{BlockCode, VertexKey};
use super::runs::RunsReader;
use super::sparse::Reader;
use crate::Result;
use crate::choices::Choice;
use crate::octree::{Cell, Leaves, MaskSet, Octree, SplitSet, cells_around};
use crate::posterior::{Reading, Sums, VertexSums};

/// Vertices whose sums are gathered together.
pub const VERTICES_AT_ONCE: usize = 64;
/// Groups of these that one thread gathers at least. It reads a page of every run first.
const GROUPS_TOGETHER: usize = 64;
/// Blocks of a list.
const BLOCKS_TOGETHER: usize = 1 << 12;

/// A single criterion that requires refinement or limits it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Criterion {
    /// Around vertices whose displacement would change some pixel
    Sensitivity,
    /// Wherever there is density, seen or not
    Density,
    /// No finer than the rays support: about 4 rays per vertex
    RayCount,
    /// Everywhere: the vertices of the dense grid, for comparisons
    #[serde(skip)]
    Uniform,
}

impl Choice for Criterion {
    const CHOICES: &'static [Self] = &[Self::Sensitivity, Self::Density, Self::RayCount];

    fn name(self) -> &'static str {
        match self {
            Self::Sensitivity => "sensitivity",
            Self::Density => "density",
            Self::RayCount => "ray-count",
            Self::Uniform => "uniform",
        }
    }

    fn help(self) -> &'static str {
        match self {
            Self::Sensitivity => "Around vertices whose displacement would change some pixel",
            Self::Density => "Wherever there is density, seen or not",
            Self::RayCount => "No finer than the rays support: about 4 rays per vertex",
            Self::Uniform => "Everywhere",
        }
    }
}

/// A combination of criteria: refine where any of the first three requires it, but no finer than the rays support.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct Criteria {
    /// [`Criterion::Sensitivity`].
    pub sensitivity: bool,
    /// [`Criterion::Density`].
    pub density: bool,
    /// [`Criterion::Uniform`].
    pub uniform: bool,
    /// [`Criterion::RayCount`].
    pub ray_count: bool,
}

impl Default for Criteria {
    fn default() -> Self {
        Self::from_iter([Criterion::Sensitivity])
    }
}

impl FromIterator<Criterion> for Criteria {
    fn from_iter<T: IntoIterator<Item = Criterion>>(criteria: T) -> Self {
        let mut all = Self { sensitivity: false, density: false, uniform: false, ray_count: false };
        for criterion in criteria {
            match criterion {
                Criterion::Sensitivity => all.sensitivity = true,
                Criterion::Density => all.density = true,
                Criterion::RayCount => all.ray_count = true,
                Criterion::Uniform => all.uniform = true,
            }
        }
        // The ray count only limits. By itself it limits refinement by sensitivity.
        all.sensitivity |= !all.density && !all.uniform;
        all
    }
}

impl fmt::Display for Criteria {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = [
            (self.sensitivity, Criterion::Sensitivity),
            (self.density, Criterion::Density),
            (self.uniform, Criterion::Uniform),
            (self.ray_count, Criterion::RayCount),
        ];
        let names: Vec<&str> = all.into_iter().filter(|(on, _)| *on).map(|(_, criterion)| criterion.name()).collect();
        write!(f, "{}", names.join(", "))
    }
}

/// Whether a ray touched the vertex and its information exceeds `floor`.
fn moves(sums: &impl Sums, floor: f64) -> bool {
    sums.rays() > 0 && sums.trace() > floor
}

/// Says where an octree is refined.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// Refine around touched vertices with more information (tr S) than this; `None` does not refine by sensitivity.
    pub floor: Option<f64>,
    /// Also refine around vertices that move by pooling.
    pub is_pooled: bool,
    /// Cells that must exist for other reasons; limits apply to them too.
    pub wanted: Vec<Cell>,
}

impl Refinement {
    /// A floor below all information: refines around every vertex that a ray touched.
    pub const EVERYTHING: f64 = f64::NEG_INFINITY;

    /// Where `criteria` require it: around vertices with more information than `floor`, for deviations read by
    /// `reading`, and for `wanted`.
    #[must_use]
    pub fn above(floor: f64, reading: &Reading, criteria: Criteria, wanted: Vec<Cell>) -> Self {
        Self { floor: criteria.sensitivity.then_some(floor), is_pooled: reading.pooling.is_on(), wanted }
    }
}

impl<S: Sums> OctreePosterior<S> {
    /// Builds the octree.
    ///
    /// Around every vertex selected by `refinement`, its leaves are as fine as those of the sums. A floor of 0
    /// keeps every vertex that any ray moved. At vertices surrounded by leaves at their own limit, the sums are
    /// exact; on the finest lattice they equal those of the dense grid. At all other vertices the information is
    /// negligible with respect to the floor.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    pub fn octree(&self, refinement: &Refinement) -> Result<Octree> {
        let finest = self.lattice.level();
        let mut wanted = match refinement.floor {
            None => SplitSet::new(finest),
            Some(floor) if refinement.is_pooled => {
                let moved = self.moved(floor).collect::<Result<Vec<Vec<_>>>>()?.concat();
                let beside: Vec<_> = self.moved_by_pooling(&moved).collect();
                self.wanted_around([moved, beside].concat().par_chunks(BLOCKS_TOGETHER).map(|some| Ok(some.to_vec())))?
            }
            Some(floor) => self.wanted_around(self.moved(floor))?,
        };
        for &cell in &refinement.wanted {
            let (origin, _) = cell.extent(finest);
            let limit = self.limits.leaf(origin);
            wanted.cell(if limit.level < cell.level { limit } else { cell });
        }
        Ok(Octree::from_split_set(wanted))
    }

    /// The sums at the vertices of an octree, in the order of their ids, with zeros for what is not summed.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    pub fn sums_at(&self, octree: &Octree) -> Result<Vec<VertexSums>> {
        read_groups(std::slice::from_ref(self), octree, |_, _, sums| sums[0].widened())
    }

    /// The vertices with more information than `floor`, block by block, in lists.
    fn moved(&self, floor: f64) -> impl ParallelIterator<Item = Result<Vec<(BlockCode, u64)>>> {
        if self.runs.is_empty() {
            Either::Left(self.sums.par_masks(move |sums| moves(sums, floor)).map(Ok))
        } else {
            assert!(self.sums.memory() == 0, "no sums are in memory beside the runs");
            Either::Right(self.runs.par_masks(move |sums| moves(sums, floor)))
        }
    }

    /// The leaves around vertices of these blocks.
    fn wanted_around(&self, lists: impl ParallelIterator<Item = Result<Vec<(BlockCode, u64)>>>) -> Result<SplitSet> {
        let none = || SplitSet::new(self.lattice.level());
        let each = lists.try_fold(none, |mut wanted, blocks| {
            for (code, vertices) in blocks? {
                if self.limits.is_unlimited() {
                    // A block of keys here is a brick of the octree's masks.
                    wanted.around_points(code.bits(), vertices);
                } else {
                    for point in members(code, vertices) {
                        let around = cells_around(point, self.lattice.level());
                        around.for_each(|cell| wanted.cell(self.limits.leaf(cell)));
                    }
                }
            }
            Ok(wanted)
        });
        each.try_reduce(none, |a, b| Ok(a | b))
    }

    /// Vertices of the finest leaves that move by pooling alone and are next to one of those that `moved` by their own
    /// sums. Those that shrinkage moves in gaps have finest leaves around them then.
    fn moved_by_pooling(&self, moved: &[(BlockCode, u64)]) -> impl ParallelIterator<Item = (BlockCode, u64)> {
        let last = self.lattice.cells_per_axis();
        let finest = moved.par_iter().filter(|(code, _)| code.is_finest());
        let moved = finest.fold(MaskSet::default, |mut moved, (code, vertices)| {
            moved.insert_mask(code.bits(), *vertices);
            moved
        });
        let moved = moved.reduce(MaskSet::default, |mut a, b| {
            a |= b;
            a
        });
        let near: Vec<(u64, u64)> = moved.dilated(last).bricks().collect();
        near.into_par_iter().map(move |(brick, vertices)| {
            let (code, beside) = (BlockCode::of(brick), vertices & !moved.mask(brick));
            let of = |i: &u64| beside >> i & 1 == 1 && self.coarseness(code.vertex(*i).point()) == 0;
            (code, (0..64).filter(of).fold(0, |all, i| all | 1 << i))
        })
    }
}

/// `[vertices]`: what `read` makes of the number of every vertex of an octree, its lattice point, and its sums in each
/// of these `groups` of rays.
pub fn read_groups<S: Sums, T: Clone + Default + Send>(
    groups: &[OctreePosterior<S>],
    octree: &Octree,
    read: impl Fn(usize, [u32; 3], &[S]) -> T + Sync,
) -> Result<Vec<T>> {
    let mut all = vec![T::default(); octree.vertex_count()];
    let some = all.par_chunks_mut(VERTICES_AT_ONCE);
    each_vertex(groups, octree, some, |some, v, point, sums| some[v % VERTICES_AT_ONCE] = read(v, point, sums))?;
    Ok(all)
}

/// Calls `visit` with the number of every vertex of an octree, its lattice point and its sums in each of these `groups`
/// of rays. Each [`VERTICES_AT_ONCE`] vertices have one of `places` to write to.
pub fn each_vertex<S: Sums, O: Send>(
    groups: &[OctreePosterior<S>],
    octree: &Octree,
    places: impl IndexedParallelIterator<Item = O>,
    visit: impl Fn(&mut O, usize, [u32; 3], &[S]) + Sync,
) -> Result<()> {
    let points = octree.par_vertex_positions().chunks(VERTICES_AT_ONCE).with_min_len(GROUPS_TOGETHER);
    let lookups = || groups.iter().map(Lookup::new).collect::<Vec<_>>();
    let visit_some = |lookups: &mut Vec<Lookup<S>>, (n, (points, mut place)): (usize, (Vec<[u32; 3]>, O))| {
        let of_groups = lookups.iter_mut().map(|lookup| lookup.at(&points)).collect::<Result<Vec<_>>>()?;
        let mut sums = Vec::with_capacity(groups.len());
        for (i, point) in points.into_iter().enumerate() {
            sums.clear();
            sums.extend(of_groups.iter().map(|group| group[i]));
            visit(&mut place, VERTICES_AT_ONCE * n + i, point, &sums);
        }
        Ok(())
    };
    points.zip(places).enumerate().map_init(lookups, visit_some).collect()
}

/// Looks up the sums of vertices that are near each other.
struct Lookup<'a, S: Sums> {
    posterior: &'a OctreePosterior<S>,
    reader: Reader<'a, S>,
    runs: RunsReader<'a, S>,
}

impl<'a, S: Sums> Lookup<'a, S> {
    fn new(posterior: &'a OctreePosterior<S>) -> Self {
        Self { posterior, reader: posterior.sums.reader(), runs: posterior.runs.reader() }
    }

    fn at(&mut self, points: &[[u32; 3]]) -> Result<Vec<S>> {
        let keys = points.iter().map(|&point| VertexKey::new(point, self.posterior.coarseness(point)));
        if !self.posterior.runs.is_empty() {
            return keys.map(|key| self.runs.find(key)).collect();
        }
        // All of them are found before the sums of any are read, so that their cache misses overlap.
        let found: Vec<_> = keys.map(|key| self.reader.find(key)).collect();
        Ok(found.into_iter().map(|sums| sums.copied().unwrap_or_default()).collect())
    }
}

/// Lattice points of the vertices of a block.
fn members(code: BlockCode, vertices: u64) -> impl Iterator<Item = [u32; 3]> {
    (0..64).filter(move |i| vertices >> i & 1 == 1).map(move |i| code.vertex(i).point())
}
