//! Rays that reached each part of space.

use serde_json::Value;

use super::super::file::Source;
use super::{Layer, Merge, Sections};
use crate::Result;
use crate::posterior::RayCoverage;
use crate::uncertainty::{RayCounts, UncertaintyField};

impl Layer for RayCoverage {
    const NAME: &'static str = "ray coverage";
    /// If it is not known where the rays of one field passed, it is not known of the whole.
    const MERGE: Merge<Self> = Some(|sum, part| {
        sum.zip(part).map(|(mut sum, part)| {
            sum += part;
            sum
        })
    });
    const WITHOUT: &'static str = "where rays passed is not known";

    /// The counts themselves are for what is still to be merged; otherwise a byte is enough for each.
    fn sections(&self, to_be_merged: bool) -> Sections<'_> {
        match to_be_merged {
            true => vec![("counted", Box::new(self.counts()))],
            false => vec![("ray_coverage", Box::new(self.counts().iter().copied().collect::<RayCounts>().0))],
        }
    }

    fn read(_head: Value, file: &mut Source) -> Result<Self> {
        let is_part = file.layers.is_part(&file.record);
        let counts = if file.bytes("counted") > 0 {
            if !is_part {
                return Err(file.malformed("section `counted`", "counts of a part of a run", "a whole run's"));
            }
            file.section("counted")?
        } else {
            let codes = file.section::<u8>("ray_coverage")?;
            file.expect_counts("ray_coverage", &codes)?;
            RayCounts::from(codes).iter().map(|n| n.min(u32::MAX.into()) as u32).collect()
        };
        let found = counts.len();
        Self::from_counts(&file.lattice, counts).ok_or_else(|| {
            file.malformed("section `ray_coverage`", "a count for every cell of the coarse grid", found.to_string())
        })
    }

    fn memory(&self) -> usize {
        Self::memory(self)
    }

    fn info(&self) -> String {
        format!("{:.0} % of the space was never seen", 100.0 * self.unseen_share())
    }
}

impl UncertaintyField {
    /// The same field with the rays that reached each part of space.
    ///
    /// They are kept as finely as the number of rays allows ([`RayCoverage::level_of`]), and as finely as can be in a
    /// part of a run.
    #[must_use]
    pub fn with_ray_coverage(mut self, ray_coverage: Option<RayCoverage>) -> Self {
        let level = if self.is_to_be_merged() { RayCoverage::LEVEL } else { RayCoverage::level_of(self.record.rays) };
        self.layers.ray_coverage = ray_coverage.map(|ray_coverage| ray_coverage.coarsened(level));
        self
    }

    /// Rays that reached each part of space; `None` if unknown.
    #[must_use]
    pub fn ray_coverage(&self) -> Option<&RayCoverage> {
        self.layers.ray_coverage.as_ref()
    }
}
