//! From sums to deviations: pools the sums, makes leaves of different sizes comparable, and applies the local prior.

use rayon::prelude::*;

use super::{Protocol, RayCounts, StandardDeviations, Support, ray_counts};
use crate::geometry::Lattice;
use crate::octree::{MaxLevels, Octree, VertexId, mean_volume};
use crate::posterior::{OctreePosterior, Pooling, Prior, TOGETHER, VertexSums};

/// σ of one vertex from its own or pooled sums, as the field stores it.
fn stored(protocol: &Protocol, sums: &VertexSums, lambda: f64) -> f32 {
    (protocol.deviation(sums, lambda) as f32).max(f32::MIN_POSITIVE)
}

/// The sums at a lattice point, comparable with those of the finest lattice: divided by the volume of the leaves around
/// it, in finest cells.
///
/// The hat function of a leaf k levels coarser is crossed by 4ᵏ times as many rays. Along each of them 2ᵏ times as
/// many samples add to J; as far as these differ in sign, their square grows by another factor of 2ᵏ. Both depend on
/// the scene; `experiments/coarse_leaves.md` has what U shifts by.
fn comparable(limits: &MaxLevels, point: [u32; 3], mut sums: VertexSums) -> VertexSums {
    if !limits.is_unlimited() {
        let volume = mean_volume(limits, point);
        sums.information.iter_mut().for_each(|s| *s /= volume);
    }
    sums
}

/// What queries need of a vertex: its deviation, and the code of its ray count.
pub fn value(protocol: &Protocol, octree: &Octree, limits: &MaxLevels, point: [u32; 3], sums: VertexSums) -> (f32, u8) {
    let lambda = protocol.prior.at(protocol.lambda, octree, point);
    let sums = comparable(limits, point, sums);
    (stored(protocol, &sums, lambda), ray_counts::encode(sums.rays))
}

/// What queries need of every vertex of `octree`, without a copy of the sums, and without pooling, which needs the sums
/// of neighbours.
pub fn values_without_sums(
    protocol: &Protocol,
    octree: &Octree,
    posterior: &OctreePosterior,
) -> (StandardDeviations, RayCounts) {
    let count = octree.vertex_count();
    let (mut deviations, mut rays) = (vec![0.0; count], vec![0; count]);
    let values = deviations.par_chunks_mut(TOGETHER).zip(rays.par_chunks_mut(TOGETHER));
    posterior.groups_at(octree).zip(values).for_each(|(group, (deviations, rays))| {
        for ((point, sums), (deviation, count)) in group.into_iter().zip(deviations.iter_mut().zip(rays)) {
            (*deviation, *count) = value(protocol, octree, posterior.limits(), point, sums);
        }
    });
    (StandardDeviations(deviations), RayCounts(rays))
}

/// Computes σ_v of every vertex from its pooled and comparable sums and the local prior.
pub fn deviations_from_sums(
    protocol: &Protocol,
    lattice: &Lattice,
    support: &Support,
    limits: &MaxLevels,
    sums: &[VertexSums],
) -> StandardDeviations {
    let local = LocalSums::new(protocol, lattice, support, limits, sums);
    let deviation = |v: usize| {
        let (sums, lambda) = local.at(v);
        stored(protocol, &sums, lambda)
    };
    StandardDeviations((0..sums.len()).into_par_iter().map(deviation).collect())
}

/// What is read off each vertex: its pooled and comparable sums, and its prior.
pub struct LocalSums<'a> {
    lambda: f64,
    prior: Prior,
    pooling: Pooling,
    lattice: &'a Lattice,
    support: &'a Support,
    limits: &'a MaxLevels,
    sums: &'a [VertexSums],
    /// `[vertices]` of an octree, if they are needed.
    points: Vec<[u32; 3]>,
}

impl<'a> LocalSums<'a> {
    /// Of `sums`, one entry per vertex.
    pub fn new(
        protocol: &Protocol,
        lattice: &'a Lattice,
        support: &'a Support,
        limits: &'a MaxLevels,
        sums: &'a [VertexSums],
    ) -> Self {
        let Protocol { lambda, prior, .. } = *protocol;
        let pooling = protocol.pooling();
        let is_plain = !pooling.is_on() && prior == Prior::Uniform && limits.is_unlimited();
        let points = match support {
            Support::Octree(octree) if !is_plain => octree.vertex_positions().collect(),
            _ => Vec::new(),
        };
        Self { lambda, prior, pooling, lattice, support, limits, sums, points }
    }

    /// The sums of a vertex, pooled and comparable with those of the finest lattice, and its prior precision.
    pub fn at(&self, v: usize) -> (VertexSums, f64) {
        let last = self.lattice.cells_per_axis();
        match self.support {
            Support::Dense if self.pooling.is_on() => {
                let at = |point| Some(self.sums[self.lattice.dense_index(point)]);
                (self.pooling.pooled(self.lattice.dense_point(v), last, at), self.lambda)
            }
            Support::Octree(octree) if !self.points.is_empty() => {
                let point = self.points[v];
                let at = |p| octree.vertex(p).map(|VertexId(v)| self.sums[v as usize]);
                // Vertices of coarser leaves have no neighbours on the finest lattice and have larger hats, so they
                // are not pooled.
                let sums = match self.pooling.is_on() && octree.is_surrounded_by_finest(point) {
                    true => self.pooling.pooled(point, last, at),
                    false => self.sums[v],
                };
                (comparable(self.limits, point, sums), self.prior.at(self.lambda, octree, point))
            }
            _ => (self.sums[v], self.lambda),
        }
    }
}
