//! Adds up the sums of different rays.

use super::parts::{Head, Part};
use crate::octree::VertexId;
use crate::posterior::{DensePosterior, OctreePosterior, Reading, Refinement, VertexSums};
use crate::rays::RaySet;
use crate::uncertainty::layers::Layers;
use crate::uncertainty::{RunRecord, Support, UncertaintyField};
use crate::{Error, Result};

/// Adds the parts of these numbers, one after the other.
pub fn add(parts: &[impl Part], heads: &[Head], order: &[usize]) -> Result<UncertaintyField> {
    let of: Vec<&Head> = order.iter().map(|&i| &heads[i]).collect();
    let ray_sets = ray_sets(&of);
    let record = record(&of, &ray_sets);
    let first = of[0];
    let (mut layers, mut most) = (None::<Layers>, 0);
    let mut wanted = Vec::new();
    let mut dense = first.is_dense.then(|| DensePosterior::new(first.lattice).into_sums());
    let mut posterior = OctreePosterior::new(first.lattice);
    for &i in order {
        let part = parts[i].field()?;
        let kept = part.sums().ok_or_else(|| {
            Error::setting("kept sums", "fields that keep their sums", format!("{}, which does not", heads[i].name))
        })?;
        match &mut layers {
            None => {
                posterior = OctreePosterior::limited(first.lattice, part.limits());
                layers = Some(part.layers.to_merge());
            }
            Some(layers) if layers.limits != part.layers.limits => {
                let expected = format!("those of {}", first.name);
                return Err(Error::setting(format!("limits to refinement of {}", heads[i].name), expected, "others"));
            }
            Some(layers) => layers.merge(&part.layers),
        }
        most = most.max(part.surface().len());
        match (&part.support, &mut dense) {
            (Support::Octree(octree), None) => {
                // What was refined for reasons other than information stays refined.
                if record.criteria.density || record.criteria.uniform {
                    octree.cells().for_each_leaf(|leaf| wanted.push(leaf));
                }
                octree.vertex_positions().zip(kept).for_each(|(point, sums)| posterior.add_sums_at(point, sums));
            }
            (_, Some(sums)) => sums.iter_mut().zip(kept).for_each(|(sum, more)| *sum += more),
            (Support::Dense, None) => unreachable!("the grids were compared"),
        }
    }
    let mut field = match dense {
        Some(sums) => UncertaintyField::new(record, first.lattice, Support::Dense, sums),
        None => {
            let octree = posterior.octree(&Refinement::above(
                floor(&of, &ray_sets),
                &record.reading(),
                record.criteria,
                wanted,
            ))?;
            UncertaintyField::on_octree(record, first.lattice, posterior, octree, true)?
        }
    };
    let mut layers = layers.unwrap_or_default();
    if let Some(surface) = &mut layers.surface {
        surface.truncate(most);
    }
    let (sums, ray_coverage) = (field.layers.sums.take(), layers.ray_coverage.take());
    field.layers = Layers { sums, ..layers };
    Ok(field.with_ray_coverage(ray_coverage))
}

/// The rays of all parts; unknown if those of one part are.
fn ray_sets(of: &[&Head]) -> Vec<RaySet> {
    if of.iter().any(|head| head.ray_sets.is_empty()) {
        return Vec::new();
    }
    RaySet::joined(of.iter().flat_map(|head| &head.ray_sets).copied())
}

/// The sums of `part` at the vertices of `whole`.
pub fn sums_at(whole: &UncertaintyField, part: &UncertaintyField) -> Vec<VertexSums> {
    let own = part.sums().unwrap_or_default();
    match (&whole.support, &part.support) {
        (Support::Octree(whole), Support::Octree(octree)) => {
            let vertex = |point| octree.vertex(point).map_or(VertexSums::default(), |VertexId(v)| own[v as usize]);
            whole.vertex_positions().map(vertex).collect()
        }
        _ => own.to_vec(),
    }
}

/// The information that may still be left out where octrees are joined: together with what the parts left out,
/// it is negligible for all rays.
///
/// Shards lack nothing, and nothing is left out as long as some shards are missing. A vertex that the octree of a
/// whole run lacks may have lost what was negligible for the rays of that run. Every vertex considered here
/// belongs to some part, whose sums are complete there.
fn floor(of: &[&Head], ray_sets: &[RaySet]) -> f64 {
    if ray_sets.iter().any(RaySet::is_part) {
        return Refinement::EVERYTHING;
    }
    let of_shards = of.iter().flat_map(|head| &head.ray_sets).filter(|ray_set| ray_set.is_part());
    let complete = of_shards.fold(0_u64, |sum, ray_set| sum.saturating_add(ray_set.shard.own_rays()));
    let runs = of.iter().map(|head| head.record.rays);
    let rays = if complete > 0 { complete } else { runs.min().unwrap_or(0) };
    Reading { rays, ..of[0].record.reading() }.floor()
}

/// The record of the joined run of these sets. It is a whole run again if all its shards are present.
fn record(of: &[&Head], ray_sets: &[RaySet]) -> RunRecord {
    let records = || of.iter().map(|head| &head.record);
    let first = &of[0].record;
    let one_seed = first.seed.filter(|_| records().all(|p| p.seed == first.seed));
    let whole = match ray_sets {
        [ray_set] if one_seed == Some(ray_set.seed) => Some(ray_set.shard),
        _ => None,
    };
    let mut sources: Vec<&str> = records().map(|p| p.source.as_str()).collect();
    sources.dedup();
    RunRecord {
        source: sources.join(" + "),
        rays: records().fold(0, |sum, p| sum.saturating_add(p.rays)),
        dropped: records().fold(0, |sum, p| sum.saturating_add(p.dropped)),
        seed: one_seed,
        shard: whole,
        ..first.clone()
    }
}
