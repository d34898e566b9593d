//! Joins fields with the same box, level and record: of different rays, as if one run had drawn all of them, and of
//! different tiles, as if one process had summed all of space.

mod alike;
mod parts;
mod shards;
mod tiles;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(super) use parts::Head;

use self::parts::{Part, heads};
use super::{TiledField, UncertaintyField};
use crate::octree::Tile;
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
/// Tiles give the field of the run without tiles, bit for bit, except that its points on surfaces are others. Shards of
/// tiles are joined tile by tile. The result has no sums: together they would take the memory that tiles avoid. Rays
/// that were dropped are counted in the tile that has the most of them.
///
/// # Errors
/// If there are fewer than two parts, a part has no sums, parts differ in model, cameras or a setting that
/// affects a sum, two of them may count the same rays, some but not all tiles of a run are given, or a file cannot be
/// read.
pub fn merge(parts: &[impl Part]) -> Result<UncertaintyField> {
    let heads = heads(parts)?;
    let groups = groups(&heads)?;
    if let [all] = groups.as_slice() {
        return shards::add(parts, &heads, all);
    }
    let tiles = || groups.iter().map(|shards| tile(parts, &heads, shards));
    tiles::Survey::read(tiles())?.join(tiles())
}

/// Makes of the files of all tiles of a run as many files that answer queries, in `folder`: `tile-000-of-008.oct` and
/// so on, which [`TiledField`] opens as one field. No more than the sums of one tile, those that tiles need of each
/// other, and the octree of the whole are ever in memory. Every file is read three times.
///
/// # Errors
/// As [`merge`], if the files are not of tiles, if the folder has fields other than finished tiles of these rays, or if
/// a file cannot be written.
pub fn finish_tiles(parts: &[PathBuf], folder: &Path) -> Result<()> {
    let heads = heads(parts)?;
    let groups = groups(&heads)?;
    if groups.len() < 2 {
        return Err(Error::setting("tiles to merge", "all tiles of a run", "fields of all of space, or of one tile"));
    }
    check_folder(folder, &heads, &groups)?;
    let tiles = || groups.iter().map(|shards| tile(parts, &heads, shards));
    let mut survey = tiles::Survey::read(tiles())?;
    survey.read_seams(tiles())?;
    for part in tiles() {
        let field = survey.finish(&part?)?;
        let Some(Tile { index, of, .. }) = field.tile() else { continue };
        field.write(&folder.join(format!("tile-{index:03}-of-{of:03}.oct")))?;
    }
    Ok(())
}

/// Refuses to write among other fields, which would be replaced or be taken for tiles of this run.
fn check_folder(folder: &Path, heads: &[Head], groups: &[Vec<usize>]) -> Result<()> {
    let of: Vec<&Head> = groups[0].iter().map(|&i| &heads[i]).collect();
    let (lattice, ray_sets) = (of[0].lattice, shards::ray_sets(&of));
    let is_own = |path: &PathBuf| {
        UncertaintyField::read_head(path).is_ok_and(|head| {
            head.tile.is_some() && !head.has_sums && head.lattice == lattice && head.ray_sets == ray_sets
        })
    };
    match TiledField::files(folder)?.into_iter().find(|path| !is_own(path)) {
        None => Ok(()),
        Some(path) => {
            let expected = "no `.oct` but finished tiles of these rays; choose another folder";
            Err(Error::malformed(&path, "file in --output", expected, "another field"))
        }
    }
}

/// The numbers of the parts that are added up, tile by tile.
fn groups(heads: &[Head]) -> Result<Vec<Vec<usize>>> {
    if heads.len() < 2 {
        let found = if heads.is_empty() { "none" } else { "one" };
        return Err(Error::setting("fields to merge", "two or more", found));
    }
    alike::check(heads)?;
    let mut by_tile = BTreeMap::<Option<Tile>, Vec<usize>>::new();
    for i in in_one_order(heads) {
        by_tile.entry(heads[i].tile).or_default().push(i);
    }
    if by_tile.len() > 1 {
        let heads = |group: &[usize]| group.iter().map(|&i| &heads[i]).collect();
        let of = |(tile, group): (&Option<Tile>, &Vec<usize>)| Some(((*tile)?, heads(group)));
        tiles::check(&by_tile.iter().filter_map(of).collect::<Vec<_>>())?;
    }
    Ok(by_tile.into_values().collect())
}

/// One tile of all its shards.
fn tile(parts: &[impl Part], heads: &[Head], shards: &[usize]) -> Result<UncertaintyField> {
    match shards {
        [one] => parts[*one].field().map(Cow::into_owned),
        shards => shards::add(parts, heads, shards),
    }
}

/// Same as [`merge`], with error bars, for which all parts are in memory. The parts are the groups of rays that the
/// jackknife compares, whether or not they have error bars themselves.
///
/// # Errors
/// As [`merge`], if the parts are tiles, or if two parts are shards of one low-discrepancy sequence. They complement
/// each other, so their differences would overstate the error.
pub fn merge_with_error_bars(parts: &[impl Part]) -> Result<UncertaintyField> {
    let heads = heads(parts)?;
    if heads.iter().any(|head| head.tile.is_some()) {
        return Err(Error::setting("fields to compare", "fields of all of space", "tiles"));
    }
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
