//! Joins fields of different rays with the same box, level and record, as if one run had drawn all of the rays.

mod alike;
mod parts;
mod shards;

pub(super) use parts::Head;

use self::parts::{Part, heads};
use super::UncertaintyField;
use crate::posterior::VertexSums;
use crate::rays::RaySet;
use crate::{Error, Result};

/// Joins `parts`, fields or paths of their files, into the field of all their rays. Only one file is in memory at a
/// time, beside what it is added to.
///
/// Information adds up. Shards of one run keep all of theirs. Joined, they have the vertices of a run over all rays, at
/// any tolerance. The sums differ only by the order of f64 additions, a relative n ε for n rays at a vertex. The order
/// of the parts does not matter, bit for bit. (Sums within n ε of the negligible limit may fall on either side. With
/// criterion `density`, the shards' leaves stay, so there may be more vertices.)
///
/// Runs with other seeds left out what was negligible for their own R rays, where their octrees are coarse. The
/// total stays negligible for the sum of the R, and nothing beyond that is left out here. log10 U is within the
/// tolerance of the dense grid of all rays. Error bars of the parts are dropped, because the sums of their groups
/// are no longer available ([`merge_with_error_bars`]).
///
/// # Errors
/// If there are fewer than two parts, a part has no sums, parts differ in model, cameras or a setting that
/// affects a sum, two of them may count the same rays, or a file cannot be read.
pub fn merge(parts: &[impl Part]) -> Result<UncertaintyField> {
    let heads = heads(parts)?;
    if heads.len() < 2 {
        let found = if heads.is_empty() { "none" } else { "one" };
        return Err(Error::setting("fields to merge", "two or more", found));
    }
    alike::check(&heads)?;
    shards::add(parts, &heads, &in_one_order(&heads))
}

/// Same as [`merge`], with error bars, for which all parts are in memory. The parts are the groups of rays that the
/// jackknife compares, whether or not they have error bars themselves.
///
/// # Errors
/// As [`merge`], or if two parts are shards of one low-discrepancy sequence. They complement each other, so their
/// differences would overstate the error.
pub fn merge_with_error_bars(parts: &[impl Part]) -> Result<UncertaintyField> {
    let heads = heads(parts)?;
    let merged = merge(parts)?;
    for (i, head) in heads.iter().enumerate() {
        let is_of_seed = |other: &&Head| head.ray_sets.iter().any(|a| other.ray_sets.iter().any(|b| a.seed == b.seed));
        if let Some(other) = heads[..i].iter().find(is_of_seed) {
            let expected = "different seeds: shards of one seed are not independent";
            let found = format!("{} and {} of one seed", other.name, head.name);
            return Err(Error::setting("fields to compare", expected, found));
        }
    }
    let order = in_one_order(&heads);
    let sums = |&i: &usize| parts[i].field().map(|part| shards::sums_at(&merged, &part));
    let groups = order.iter().map(sums).collect::<Result<Vec<Vec<VertexSums>>>>()?;
    let rays: Vec<u64> = order.iter().map(|&i| heads[i].record.rays).collect();
    Ok(merged.with_error_bars(&groups, &rays))
}

/// The parts by seed and shard, so that what is joined does not depend on the order in which they are given, bit for
/// bit: f64 additions do not commute over three summands.
fn in_one_order(heads: &[Head]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..heads.len()).collect();
    let key = |ray_set: &RaySet| (ray_set.seed, ray_set.shard.rays, ray_set.shard.of, ray_set.shard.index);
    order.sort_by(|&a, &b| {
        let [a, b] = [&heads[a], &heads[b]];
        let by_ray_sets = a.ray_sets.iter().map(key).cmp(b.ray_sets.iter().map(key));
        by_ray_sets.then_with(|| a.record.source.cmp(&b.record.source))
    });
    order
}

#[cfg(test)]
mod tests;
