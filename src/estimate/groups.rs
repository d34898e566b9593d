//! Groups of rays with separate sums, whose disagreement can be measured.
//!
//! Every group has the same number of rays and its own, independent pixels. (Parts of one low-discrepancy
//! sequence complement each other, so their differences would overstate the error.) All groups together are
//! slightly less accurate than the same number of rays from one sequence.

use super::{FieldBuilder, Provenance};
use crate::rays::{Draw, Purpose, RayStream, RunProgress, Shard};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// One group of rays in a run.
pub struct RayGroup<'a> {
    /// Seed of its pixels and jitter.
    pub seed: u64,
    /// The stream of its rays.
    pub stream: RayStream<'a>,
    /// Its shard: all rays of the stream.
    pub shard: Shard,
}

impl RayGroup<'_> {
    /// The draw of this group.
    #[must_use]
    pub fn draw(&self) -> Draw {
        self.stream.draw(self.shard)
    }
}

/// Splits `rays` rays with `stream`'s settings into `count` independent groups, whose sizes differ by at most one.
///
/// # Errors
/// If there are fewer than two groups, or fewer rays than groups.
pub fn ray_groups<'a>(stream: &RayStream<'a>, count: u16, rays: u64) -> Result<Vec<RayGroup<'a>>> {
    let groups = u64::from(count);
    if groups < 2 || rays < groups {
        return Err(Error::setting("groups of rays", format!("2 to {rays}, the number of rays"), groups.to_string()));
    }
    let group = |g: u16| {
        let own = rays / groups + u64::from(u64::from(g) < rays % groups);
        let stream = stream.for_purpose(Purpose::Group(g));
        RayGroup { seed: stream.pixels.seed(), stream, shard: Shard::whole(own) }
    };
    Ok((0..count).map(group).collect())
}

impl FieldBuilder {
    /// Computes the field from the rays of all groups, with error bars.
    ///
    /// Each builder holds the sums of one group. All have the same settings and limits, and `progress` has one
    /// entry per group. This takes the memory of one more group.
    ///
    /// # Errors
    /// As [`FieldBuilder::want_density`].
    ///
    /// # Panics
    /// If there are fewer than two groups, or the number of entries in `progress` differs.
    pub fn finish_groups(
        groups: Vec<Self>,
        progress: &[RunProgress],
        provenance: &Provenance,
    ) -> Result<UncertaintyField> {
        assert!(groups.len() == progress.len() && groups.len() >= 2, "one progress for each of two groups or more");
        let mut whole = groups[0].emptied();
        groups.iter().for_each(|group| whole += group);
        if let Some(stream) = provenance.stream {
            whole.want_density(stream)?;
        }
        let field = whole.finish(&Provenance { progress: progress.iter().copied().sum(), ..provenance.clone() });
        let rays: Vec<u64> = progress.iter().map(|p| p.rays).collect();
        let sums: Vec<_> = groups.into_iter().map(|group| group.sums_at(field.support())).collect();
        Ok(field.with_error_bars(&sums, &rays))
    }
}
