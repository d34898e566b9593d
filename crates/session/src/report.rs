//! A finished run: its field, the file, and what is reported of it.

use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};

use super::memory::peak;
use octobayes::Result;
use octobayes::estimate::{Checkpoint, ErrorBudget, facts};
use octobayes::posterior::RayCoverage;
use octobayes::uncertainty::UncertaintyField;
use octobayes_evaluation::ImageCheck;

/// Percentages of the visible surfaces at which log10 U is reported.
pub const PERCENTS: [f64; 5] = [1.0, 10.0, 50.0, 90.0, 99.0];

/// What a run came to.
pub struct Finished {
    /// The field.
    pub field: UncertaintyField,
    /// How far log10 U is from its limit.
    pub errors: ErrorBudget,
    /// Time from the first check to the field.
    pub elapsed: Duration,
    /// Largest size of the sums in memory, bytes.
    pub sums_bytes: usize,
    /// Size of the sums that left memory, bytes on disk.
    pub disk_bytes: u64,
    /// How well the model shows the images beside the cameras, if there are any.
    pub images: Option<ImageCheck>,
    pub(super) checkpoint: Option<(Checkpoint, Option<u16>)>,
}

impl Finished {
    /// Writes the field, and removes the checkpoint, which has served.
    ///
    /// # Errors
    /// If the file cannot be written, or the checkpoint not removed.
    pub fn save(&self, path: &Path) -> Result<()> {
        self.field.write(path)?;
        self.remove_checkpoint()
    }

    /// Removes the checkpoint of a run whose result is in good hands.
    ///
    /// # Errors
    /// If it cannot be removed.
    pub fn remove_checkpoint(&self) -> Result<()> {
        self.checkpoint.as_ref().map_or(Ok(()), |(checkpoint, groups)| checkpoint.remove(*groups, &self.field))
    }

    /// The [description](described) of the field, with the run's threads, seconds, memory and errors.
    #[must_use]
    pub fn report(&self) -> Value {
        let mut value = described(&self.field);
        value["threads"] = json!(rayon::current_num_threads());
        value["seconds"] = json!(self.elapsed.as_secs_f64());
        value["peak_bytes"] = json!(peak());
        value["posterior_bytes"] = json!(self.sums_bytes);
        value["disk_bytes"] = json!(self.disk_bytes);
        value["errors"] = json!(self.errors);
        value["images"] = json!(self.images.as_ref().map(ImageCheck::report));
        value
    }
}

/// Everything that a finished field reports of itself, as JSON: [`facts`], its summary, and log10 U on visible
/// surfaces.
#[must_use]
pub fn described(field: &UncertaintyField) -> Value {
    let mut value = facts(field);
    value["summary"] = json!(field.summary());
    value["surfaces"] = json!({
        "percent": PERCENTS,
        "log10_uncertainty": field.surface_quantiles(PERCENTS.map(|percent| 0.01 * percent)),
        "prior": field.prior().log10(),
        "unseen_share": field.ray_coverage().map(RayCoverage::unseen_share),
    });
    value
}
