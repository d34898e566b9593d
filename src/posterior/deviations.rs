//! From sums to deviations: pools the sums, makes leaves of different sizes comparable, and reads σ off them.

use std::borrow::Cow;

use rayon::prelude::*;

use super::means::BLOCK;
use super::octree::{VERTICES_AT_ONCE, each_vertex};
use super::pooling::{MIN_CHANGE, Pooling};
use super::shrinkage::{Block, Shrinkage};
use super::{Covariance, OctreePosterior, Scale, Sums, VertexSums, negligible_information};
use crate::Result;
use crate::geometry::Lattice;
use crate::octree::{MaxLevels, Octree, mean_volume};

/// How sums are read: what σ depends on beside them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Definition of the standard deviation.
    pub covariance: Covariance,
    /// What U is a deviation of.
    pub scale: Scale,
    /// Prior precision λ, 1 / scene unit².
    pub lambda: f64,
    /// R, the number of rays drawn.
    pub rays: u64,
    /// How sums are pooled.
    pub pooling: Pooling,
    /// Largest change of log10 U that is negligible.
    pub tolerance: f64,
}

impl Reading {
    /// σ_v in scene units, from the `sums` of a vertex.
    #[must_use]
    pub fn deviation(&self, sums: &VertexSums) -> f64 {
        self.scale.factor(self.covariance) * self.covariance.deviation(sums, self.rays, self.lambda)
    }

    /// σ_v in scene units where nothing was seen.
    #[must_use]
    pub fn prior(&self) -> f64 {
        self.deviation(&VertexSums::default())
    }

    /// Information (tr S) that is negligible compared with the prior, so that an octree needs no vertex for it.
    #[must_use]
    pub fn floor(&self) -> f64 {
        negligible_information(self.tolerance.min(self.pooling.largest_change(self.tolerance)), self.rays, self.lambda)
    }

    /// What pools sums, if anything does.
    #[must_use]
    pub fn shrinkage(&self) -> Option<Shrinkage> {
        let floor = negligible_information(MIN_CHANGE, self.rays, self.lambda);
        let shrinkage = Shrinkage { floor, prior: self.lambda * self.rays as f64 };
        self.pooling.is_on().then_some(shrinkage)
    }

    /// The same without pooling: every vertex has the sums of its own rays.
    #[must_use]
    pub fn unpooled(self) -> Self {
        Self { pooling: Pooling::Off, ..self }
    }

    /// σ of a vertex from its pooled and comparable sums, as fields store it.
    fn stored(&self, sums: &VertexSums) -> f32 {
        (self.deviation(sums) as f32).max(f32::MIN_POSITIVE)
    }

    /// σ of the vertex at `point`, without pooling, which needs the sums of neighbours.
    #[must_use]
    pub fn deviation_at(&self, limits: &MaxLevels, point: [u32; 3], sums: VertexSums) -> f32 {
        self.stored(&comparable(limits, point, sums))
    }
}

/// The vertices that carry values.
#[derive(Debug, Clone, PartialEq)]
pub enum Support {
    /// All (M + 1)³ lattice points, x slowest.
    Dense,
    /// The free vertices of an octree.
    Octree(Octree),
}

impl Support {
    /// Number of vertices.
    #[must_use]
    pub fn vertices(&self, lattice: &Lattice) -> u64 {
        match self {
            Self::Dense => lattice.dense_vertices(),
            Self::Octree(octree) => octree.vertex_count() as u64,
        }
    }
}

/// The sums at a lattice point, comparable with those of the finest lattice: divided by the volume of the leaves around
/// it, in finest cells.
///
/// The hat function of a leaf k levels coarser is crossed by 4ᵏ times as many rays. Along each of them 2ᵏ times as
/// many samples add to J; as far as these differ in sign, their square grows by another factor of 2ᵏ. Both depend on
/// the scene; `experiments/coarse_leaves.md` has what U shifts by.
#[must_use]
pub fn comparable(limits: &MaxLevels, point: [u32; 3], mut sums: VertexSums) -> VertexSums {
    if !limits.is_unlimited() {
        let volume = mean_volume(limits, point);
        sums.information.iter_mut().for_each(|s| *s /= volume);
    }
    sums
}

impl<S: Sums> OctreePosterior<S> {
    /// What queries need of every vertex of `octree`, σ and a code of its number of rays, without a copy of the sums,
    /// and without pooling.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    pub(crate) fn values<C: Copy + Default + Send>(
        &self,
        reading: &Reading,
        octree: &Octree,
        code: impl Fn(u32) -> C + Sync,
    ) -> Result<(Vec<f32>, Vec<C>)> {
        let count = octree.vertex_count();
        let (mut deviations, mut rays) = (vec![0.0; count], vec![C::default(); count]);
        let values = deviations.par_chunks_mut(VERTICES_AT_ONCE).zip(rays.par_chunks_mut(VERTICES_AT_ONCE));
        each_vertex(std::slice::from_ref(self), octree, values, |(deviations, rays), v, point, sums| {
            deviations[v % VERTICES_AT_ONCE] = reading.deviation_at(self.limits(), point, sums[0].widened());
            rays[v % VERTICES_AT_ONCE] = code(sums[0].rays());
        })?;
        Ok((deviations, rays))
    }
}

/// What is read off each vertex: its pooled and comparable sums.
pub struct LocalSums<'a> {
    limits: MaxLevels,
    /// As they are, or shrunk.
    sums: Cow<'a, [VertexSums]>,
    /// `[vertices]` of an octree with limits.
    points: Vec<[u32; 3]>,
}

impl<'a> LocalSums<'a> {
    /// Of `sums`, one entry per vertex of `support`, gathered on the leaves of `limits`.
    #[must_use]
    pub fn new(
        reading: &Reading,
        lattice: &'a Lattice,
        support: &'a Support,
        limits: &MaxLevels,
        sums: &'a [VertexSums],
    ) -> Self {
        let points = match support {
            Support::Octree(octree) if !limits.is_unlimited() => octree.par_vertex_positions().collect(),
            _ => Vec::new(),
        };
        let sums = match (reading.shrinkage(), support) {
            (None, _) => Cow::Borrowed(sums),
            (Some(by), Support::Dense) => Cow::Owned(shrunk_on_grid(&by, lattice, sums)),
            (Some(by), Support::Octree(octree)) => Cow::Owned(shrunk_on_octree(&by, octree, sums)),
        };
        Self { limits: limits.clone(), sums, points }
    }

    /// The sums of a vertex, pooled and comparable with those of the finest lattice.
    #[must_use]
    pub fn at(&self, v: usize) -> VertexSums {
        match self.points.get(v) {
            Some(&point) => comparable(&self.limits, point, self.sums[v]),
            None => self.sums[v],
        }
    }

    /// `[vertices]`: σ_v of each.
    fn deviations(&self, reading: &Reading) -> Vec<f32> {
        (0..self.sums.len()).into_par_iter().map(|v| reading.stored(&self.at(v))).collect()
    }
}

/// `[vertices]`: σ_v of `sums`, as [`LocalSums::new`] takes them, without a copy of those of an octree.
#[must_use]
pub fn deviations(
    reading: &Reading,
    lattice: &Lattice,
    support: &Support,
    limits: &MaxLevels,
    sums: &[VertexSums],
) -> Vec<f32> {
    let local = |reading: &Reading| LocalSums::new(reading, lattice, support, limits, sums).deviations(reading);
    match (reading.shrinkage(), support) {
        (Some(shrinkage), Support::Octree(octree)) => {
            let mut deviations = local(&reading.unpooled());
            // Leaves around what is pooled are finest, so that its sums are comparable as they are.
            pool(&shrinkage, octree, sums, &mut deviations, |sums| reading.stored(&sums));
            deviations
        }
        _ => local(reading),
    }
}

/// The sums of a dense grid, shrunk.
fn shrunk_on_grid(shrinkage: &Shrinkage, lattice: &Lattice, sums: &[VertexSums]) -> Vec<VertexSums> {
    let last = lattice.cells_per_axis();
    let mut all = sums.to_vec();
    // Planes of a block along x, which is slowest.
    let plane = lattice.dense_index([1, 0, 0]);
    all.par_chunks_mut(BLOCK as usize * plane).enumerate().for_each(|(i, slab)| {
        for (j, k) in (0..=last / BLOCK).flat_map(|j| (0..=last / BLOCK).map(move |k| (j, k))) {
            let number = [i as u32, j, k];
            let near = Block::reach(number, last).map(|point| (point, &sums[lattice.dense_index(point)]));
            let block = shrinkage.block(number, last, near);
            for point in block.points(last) {
                let v = lattice.dense_index(point);
                slab[v - i * BLOCK as usize * plane] = block.at(point, sums[v].rays);
            }
        }
    });
    all
}

/// The sums at the vertices of an octree, shrunk.
fn shrunk_on_octree(shrinkage: &Shrinkage, octree: &Octree, sums: &[VertexSums]) -> Vec<VertexSums> {
    let mut all = sums.to_vec();
    pool(shrinkage, octree, sums, &mut all, |sums| sums);
    all
}

/// Replaces those of `all` whose vertices are pooled by what `value` makes of the pooled sums. Vertices of coarser
/// leaves have no neighbours on the finest lattice and have larger hats, so they are left alone, and have no part in
/// others.
fn pool<T: Send>(
    shrinkage: &Shrinkage,
    octree: &Octree,
    sums: &[VertexSums],
    all: &mut [T],
    value: impl Fn(VertexSums) -> T + Sync,
) {
    let (mut rest, mut blocks) = (all, Vec::new());
    for (code, ids) in octree.finest_blocks() {
        let (own, others) = rest.split_at_mut(ids.len());
        blocks.push((code, own));
        rest = others;
    }
    blocks.into_par_iter().for_each(|(code, own)| {
        let vertices = octree.finest_block(code);
        let around = vertices.around().map(|(point, v)| (point, &sums[v]));
        let block = shrinkage.block(vertices.number(), 1 << octree.finest(), around);
        for ((point, v), pooled) in vertices.own().zip(own) {
            if vertices.is_surrounded(point) {
                *pooled = value(block.at(point, sums[v].rays));
            }
        }
    });
}
