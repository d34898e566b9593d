//! Joins fields of different rays with the same box, level and record, as if one run had drawn all of the rays.

mod alike;
mod parts;
mod shards;

pub(super) use parts::Head;

use std::path::PathBuf;

use self::parts::{Part, heads};
use super::UncertaintyField;
use crate::posterior::overflow::MOST_RUNS;
use crate::posterior::{DensePosterior, DiagonalSums, Entries, OctreePosterior};
use crate::rays::RaySet;
use crate::{Error, Result};

/// How fields of different rays are joined.
///
/// Information adds up. Shards of one run keep all of theirs. Joined, they have the vertices of a run over all rays, at
/// any tolerance. The sums differ only by the order of f64 additions, a relative n ε for n rays at a vertex. The order
/// of the parts does not matter, bit for bit. (Sums within n ε of the negligible limit may fall on either side. With
/// criterion `density`, the shards' leaves stay, so there may be more vertices.)
///
/// Runs with other seeds left out what was negligible for their own R rays, where their octrees are coarse. The
/// total stays negligible for the sum of the R, and nothing beyond that is left out here. log10 U is within the
/// tolerance of the dense grid of all rays. Error bars of the parts are dropped, because the sums of their groups
/// are no longer available.
///
/// Memory does not grow with the number of parts or with their sums: those of files are read vertex by vertex, and what
/// 256 MB have no room for goes to disk, as in a run under a [budget](crate::estimate::GridSettings::memory). Beside
/// it, there are the octree of one part, and the joined field. With error bars, dense grids of all parts stay in
/// memory, and pooled fields take 8 bytes for every vertex and part while their errors are computed.
#[derive(Debug, Clone)]
#[must_use]
pub struct Merging {
    keep_sums: bool,
    error_bars: bool,
    scratch: PathBuf,
    /// Bytes that sums may take in memory.
    room: usize,
}

impl Default for Merging {
    fn default() -> Self {
        Self { keep_sums: true, error_bars: false, scratch: std::env::temp_dir(), room: 256_000_000 }
    }
}

impl Merging {
    /// Sets whether the joined field keeps its sums, as it does by default, and while shards are missing.
    pub fn keep_sums(self, keep_sums: bool) -> Self {
        Self { keep_sums, ..self }
    }

    /// Sets whether the joined field has error bars. The parts are the groups of rays that the jackknife compares,
    /// whether or not they have error bars themselves.
    pub fn error_bars(self, error_bars: bool) -> Self {
        Self { error_bars, ..self }
    }

    /// Sets the folder of temporary files. The default is the system's, which may be memory itself.
    pub fn scratch(self, folder: impl Into<PathBuf>) -> Self {
        Self { scratch: folder.into(), ..self }
    }

    /// Joins `parts`, fields or paths of their files, into the field of all their rays.
    ///
    /// # Errors
    /// If there are fewer than two parts, a part has no sums, parts differ in model, cameras or a setting that
    /// affects a sum, two of them may count the same rays, or a file cannot be read or written. With error bars also if
    /// two parts are shards of one low-discrepancy sequence. They complement each other, so their differences would
    /// overstate the error.
    pub fn join(&self, parts: &[impl Part]) -> Result<UncertaintyField> {
        let heads = heads(parts)?;
        let Some(first) = heads.first().filter(|_| heads.len() > 1) else {
            let found = if heads.is_empty() { "none" } else { "one" };
            return Err(Error::setting("fields to merge", "two or more", found));
        };
        alike::check(&heads)?;
        if self.error_bars {
            alike::check_independent(&heads)?;
            if heads.len() > MOST_RUNS {
                let expected = format!("at most {MOST_RUNS} fields, whose sums are read side by side");
                return Err(Error::setting("fields to compare", expected, heads.len().to_string()));
            }
        }
        let joining = shards::Joining::new(self, parts, &heads, &in_one_order(&heads));
        match (first.is_dense, joining.entries()) {
            (true, _) => joining.join::<DensePosterior>(),
            (false, Entries::All) => joining.join::<OctreePosterior>(),
            (false, Entries::Diagonal) => joining.join::<OctreePosterior<DiagonalSums>>(),
        }
    }
}

/// Joins fields as [`Merging`] does by default.
///
/// # Errors
/// As [`Merging::join`].
pub fn merge(parts: &[impl Part]) -> Result<UncertaintyField> {
    Merging::default().join(parts)
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
