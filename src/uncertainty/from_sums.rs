//! From sums to deviations: pools the sums, makes leaves of different sizes comparable, and applies the local prior.

use rayon::prelude::*;

use super::{Protocol, RayCounts, StandardDeviations, Support, ray_counts};
use crate::geometry::Lattice;
use crate::octree::{MaxLevels, Octree, VertexId};
use crate::posterior::{OctreePosterior, Prior, VertexSums};

/// σ of one vertex from its own or pooled sums, as the field stores it.
fn stored(protocol: &Protocol, sums: &VertexSums, lambda: f64) -> f32 {
    (protocol.deviation(sums, lambda) as f32).max(f32::MIN_POSITIVE)
}

/// The sums at a lattice point, in the units of the finest lattice.
fn comparable(limits: &MaxLevels, point: [u32; 3], mut sums: VertexSums) -> VertexSums {
    let footprint = limits.footprint(point);
    sums.information.iter_mut().for_each(|s| *s /= footprint);
    sums
}

/// What queries need of every vertex of `octree`, without a copy of the sums, and without pooling, which needs the sums
/// of neighbours.
pub fn values_without_sums(
    protocol: &Protocol,
    octree: &Octree,
    posterior: &OctreePosterior,
) -> (StandardDeviations, RayCounts) {
    let (mut deviations, mut rays) = (Vec::new(), Vec::new());
    let value = |(point, sums): ([u32; 3], VertexSums)| {
        let lambda = protocol.prior.at(protocol.lambda, octree, point);
        let sums = comparable(posterior.limits(), point, sums);
        (stored(protocol, &sums, lambda), ray_counts::encode(sums.rays))
    };
    posterior.each_at(octree).map(value).unzip_into_vecs(&mut deviations, &mut rays);
    (StandardDeviations(deviations), RayCounts(rays))
}

/// Computes σ_v of every vertex from its pooled sums and the local prior.
///
/// The hat function of a leaf k levels coarser than the finest lattice has 4ᵏ times the footprint on a surface,
/// so 4ᵏ times as many rays move its vertex. Its information is divided by that factor, which gives it the
/// meaning that it has on the finest lattice.
pub fn deviations_from_sums(
    protocol: &Protocol,
    lattice: &Lattice,
    support: &Support,
    limits: &MaxLevels,
    sums: &[VertexSums],
) -> StandardDeviations {
    let Protocol { lambda, prior, .. } = *protocol;
    let pooling = protocol.pooling();
    let last = lattice.cells_per_axis();
    let one = |e: &VertexSums, lambda: f64| stored(protocol, e, lambda);
    StandardDeviations(match support {
        _ if !pooling.is_on() && prior == Prior::Uniform && limits.is_unlimited() => {
            sums.par_iter().map(|e| one(e, lambda)).collect()
        }
        Support::Dense => {
            let at = |point| Some(sums[lattice.dense_index(point)]);
            let pooled = |i: usize| pooling.pooled(lattice.dense_point(i), last, at);
            (0..sums.len()).into_par_iter().map(|i| one(&pooled(i), lambda)).collect()
        }
        Support::Octree(octree) => {
            let points: Vec<[u32; 3]> = octree.vertex_positions().collect();
            let at = |p| octree.vertex(p).map(|VertexId(v)| sums[v as usize]);
            // Vertices of coarser leaves have no neighbours on the finest lattice and have larger hats, so they
            // are not pooled.
            let pooled = |v: usize| match pooling.is_on() && octree.is_surrounded_by_finest(points[v]) {
                true => pooling.pooled(points[v], last, at),
                false => sums[v],
            };
            let deviation = |v: usize| {
                let sums = comparable(limits, points[v], pooled(v));
                one(&sums, prior.at(lambda, octree, points[v]))
            };
            (0..points.len()).into_par_iter().map(deviation).collect()
        }
    })
}
