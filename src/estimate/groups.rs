//! Groups of rays with sums of their own, so that it can be told how far they agree.
//!
//! Every group has as many rays and its own, independent pixels. (Parts of one low-discrepancy sequence would complement each other: their
//! differences say too much.) The groups' rays together are a little worse than as many of one sequence; that is the price.

use super::{FieldBuilder, Provenance};
use crate::rays::{Draw, Purpose, RayStream, RunProgress, Shard};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// One group of a run: which rays, through which pixels.
pub struct RayGroup<'a> {
    /// Seed of its pixels and jitter.
    pub seed: u64,
    /// Its rays.
    pub stream: RayStream<'a>,
    /// All of them.
    pub shard: Shard,
}

impl RayGroup<'_> {
    /// What it draws.
    #[must_use]
    pub fn draw(&self) -> Draw {
        self.stream.draw(self.shard)
    }
}

/// `rays` rays of `stream`'s settings in `count` independent groups, whose numbers of rays differ by one at most.
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
    /// The field of all groups' rays together, with error bars. Each builder holds the sums of one group; all have the same settings and
    /// limits, and `progress` says what each was made of. The whole needs as much memory as one more group.
    ///
    /// # Errors
    /// As [`FieldBuilder::want_density`].
    ///
    /// # Panics
    /// If there are fewer than two groups, or not as many entries of progress.
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
