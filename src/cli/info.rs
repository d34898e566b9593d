//! `info`: what a file holds.

use std::path::{Path, PathBuf};

use glam::Vec3;
use serde_json::{Value, json};

use super::options::UTF_8;
use super::report;
use crate::error::printable;
use crate::posterior::Covariance;
use crate::uncertainty::{Support, UncertaintyField};
use crate::{Error, Result};

/// Show what a field or model file holds, and its memory by part
#[derive(clap::Args)]
pub struct Args {
    /// `.oct` field, or a model (`.safetensors`, `.ppng`, `.npz`, `scene:NAME`)
    file: PathBuf,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Bars of the histogram.
const BARS: usize = 40;

/// How log10 U is distributed, in one line: over visible surfaces if the field holds points on them, else over
/// vertices.
fn histogram(field: &UncertaintyField) -> String {
    let points: Vec<Vec3> = field.surface().iter().copied().map(Vec3::from_array).collect();
    let (of, log10): (_, Vec<f64>) = if points.is_empty() {
        ("vertices", field.deviations().iter().map(f64::log10).collect())
    } else {
        ("visible surfaces", field.query_all(&points).iter().map(|found| found.uncertainty.log10()).collect())
    };
    let high = field.prior().log10();
    let low = log10.iter().copied().fold(high - 0.5, f64::min);
    let mut counts = [0_u64; BARS];
    for u in log10 {
        counts[(((u - low) / (high - low) * BARS as f64) as usize).min(BARS - 1)] += 1;
    }
    format!("log10 U of {of}: {low:.2} {} {high:.2} (the prior)", bars(&counts))
}

/// Counts as bars of eight heights; what is not 0 shows.
fn bars(counts: &[u64]) -> String {
    const HEIGHTS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let most = counts.iter().copied().max().unwrap_or(0).max(1);
    let bar = |&n: &u64| if n == 0 { ' ' } else { HEIGHTS[(n * 7).div_ceil(most) as usize] };
    counts.iter().map(bar).collect()
}

/// A question, and whether a file answers it.
struct Answer {
    what: &'static str,
    is_known: bool,
    /// What it answers, or what of `uncertainty` would make it.
    words: String,
}

/// What a field can answer, and what it cannot.
fn answers(field: &UncertaintyField) -> Vec<Answer> {
    let answer = |what, is_known: bool, yes: String, no: &str| {
        let words = if is_known { yes } else { no.to_string() };
        Answer { what, is_known, words }
    };
    let covariance = field.protocol().covariance.name();
    let has_sums = field.sums().is_some();
    let of_sums = format!("only `{covariance}`; uncertainty --keep-sums keeps what the others need");
    let names: Vec<&str> = Covariance::ALL.iter().map(|covariance| covariance.name()).collect();
    let points = field.surface().len();
    vec![
        answer("U at points", true, format!("by `{covariance}`"), ""),
        answer("covariances", has_sums, names.join(", "), &of_sums),
        answer(
            "merging",
            has_sums,
            "with fields of other rays".into(),
            "its sums were not kept (uncertainty --keep-sums)",
        ),
        answer("ray counts", !field.rays().is_empty(), "at every vertex".into(), "the file does not say"),
        answer("never seen", field.visits().is_some(), "told from free space".into(), "where rays passed is not known"),
        answer("error bars", field.error_bars().is_some(), "of log10 U".into(), "uncertainty --error-bars makes them"),
        answer("surfaces", points > 0, format!("{points} points for compare and --threshold 99%"), "no points on them"),
        answer("its model", field.protocol().origin.model.is_some(), "known by its checksum".into(), "not known"),
    ]
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        if self.file.extension().is_some_and(|e| e == "oct") { self.field(&self.file) } else { self.model() }
    }

    fn field(&self, path: &Path) -> Result<()> {
        let field = UncertaintyField::read(path)?;
        let memory = field.memory();
        if self.json {
            let mut value = report::protocol_json(&field);
            value["summary"] = json!(field.summary());
            value["surfaces"] = report::surfaces_json(&field);
            value["octree"] = match field.support() {
                Support::Octree(_) => json!({ "leaves_per_level": field.summary().leaves_per_level }),
                Support::Dense => Value::Null,
            };
            value["answers"] = answers(&field).iter().map(|a| (a.what.to_string(), json!(a.is_known))).collect();
            value["memory"] = memory.iter().map(|&(part, bytes)| (part.to_string(), json!(bytes))).collect();
            say!("{value}")?;
            return Ok(());
        }
        say!("{}\n{}", path.display(), report::protocol(&field))?;
        say!("field\n  {}{}", report::summary(&field.summary()), report::surfaces(&field)?)?;
        if let Some(tile) = field.tile() {
            say!("  tile {} of {}: all else is as if never seen", tile.index, tile.of)?;
        }
        say!("  {}", histogram(&field))?;
        if let Some(visits) = field.visits() {
            say!("  {:.0} % of the space was never seen", 100.0 * visits.unseen_share())?;
        }
        say!("  prior U {:.4e} (log10 {:.4})", field.prior(), field.prior().log10())?;
        say!("answers")?;
        for Answer { what, is_known, words } in answers(&field) {
            say!("  {what:<16} {}{words}", if is_known { "" } else { "no: " })?;
        }
        say!("memory")?;
        for (part, bytes) in &memory {
            say!(
                "  {part:<16} {:>12} B  {:>8.3} B per vertex",
                bytes,
                *bytes as f64 / field.deviations().len().max(1) as f64
            )?;
        }
        Ok(())
    }

    fn model(&self) -> Result<()> {
        let refused = || Error::setting("FILE", UTF_8, self.file.display().to_string());
        let field = crate::open::open(self.file.to_str().ok_or_else(refused)?)?;
        let bounds = field.bounds();
        let cameras = field.training_cameras();
        if self.json {
            let value = json!({
                "model": field.describe(),
                "box": { "min": bounds.min().to_array(), "max": bounds.max().to_array() },
                "suggested_march_step": field.suggested_step(),
                "pixel_offset": field.pixel_offset(),
                "memory": field.memory(),
                "domain": field.natural_domain(),
                "training_cameras": cameras,
            });
            say!("{value}")?;
        } else {
            say!("{}\n  {}", self.file.display(), field.describe())?;
            say!("  box          {} to {}", bounds.min(), bounds.max())?;
            if let Some((first, last)) = cameras.first().zip(cameras.last()) {
                let [first, last] = [first, last].map(|camera| printable(&camera.name));
                say!("  cameras      {} that it was trained on, {first} to {last}", cameras.len())?;
            }
            say!("  march step   {:.6} scene units", field.suggested_step())?;
            say!("  pixel offset {}", field.pixel_offset())?;
            say!("  memory       {}", report::bytes(field.memory()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_are_seen_beside_many() {
        assert_eq!(bars(&[0, 1, 500, 1000]), " ▂▅█");
        assert_eq!(bars(&[0, 0]), "  ");
    }
}
