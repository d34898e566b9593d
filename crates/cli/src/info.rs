//! `info`: what a file holds.

use std::path::{Path, PathBuf};

use glam::Vec3;
use serde_json::{Value, json};

use super::options::UTF_8;
use super::report;
use octobayes::error::printable;
use octobayes::estimate::ErrorBudget;
use octobayes::uncertainty::{Support, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_session::described;
use octobayes_splats::{QUANTILES, Splats, Summary};

/// Show what a field or model file holds, and its memory by part
#[derive(clap::Args)]
pub struct Args {
    /// `.oct` field, Gaussian splats (`.ply`, `.splat`, `.spz`), or a model (`.safetensors`, `.ppng`, `.npz`,
    /// `scene:NAME`)
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

/// What a field can answer, and one line on each of its layers; errors are what it lacks.
fn answers(field: &UncertaintyField) -> Vec<(&'static str, std::result::Result<String, &'static str>)> {
    let known = |is_known: bool, yes: &str, no| if is_known { Ok(yes.to_string()) } else { Err(no) };
    let mut answers = vec![
        ("U at points", Ok(format!("by `{}`", field.record().covariance.name()))),
        ("ray counts", known(!field.rays().is_empty(), "at every vertex", "the file has none")),
        ("its model", known(field.record().model_checksum.is_some(), "known by its checksum", "not known")),
    ];
    answers.extend(field.layers());
    answers
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        if self.file.extension().is_some_and(|e| e == "oct") {
            self.field(&self.file)
        } else if Splats::is_splat_file(&self.file) {
            self.splats(&self.file)
        } else {
            self.model()
        }
    }

    fn field(&self, path: &Path) -> Result<()> {
        let field = UncertaintyField::read(path)?;
        let memory = field.memory();
        if self.json {
            let mut value = described(&field);
            value["octree"] = match field.support() {
                Support::Octree(_) => json!({ "leaves_per_level": field.summary().leaves_per_level }),
                Support::Dense => Value::Null,
            };
            value["answers"] =
                answers(&field).iter().map(|(what, found)| (what.to_string(), json!(found.is_ok()))).collect();
            value["memory"] = memory.iter().map(|&(part, bytes)| (part.to_string(), json!(bytes))).collect();
            say!("{value}")?;
            return Ok(());
        }
        say!("{}\n{}record\n{}", path.display(), report::surfaces(&field), report::record(&field))?;
        say!("{}", report::errors(&ErrorBudget::of_field(&field)))?;
        say!("field\n  {}", report::summary(&field.summary()))?;
        say!("  {}", histogram(&field))?;
        say!("  prior U {:.4e} (log10 {:.4})", field.prior(), field.prior().log10())?;
        say!("answers")?;
        for (what, found) in answers(&field) {
            match found {
                Ok(words) => say!("  {what:<16} {words}")?,
                Err(without) => say!("  {what:<16} no: {without}")?,
            }
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

    fn splats(&self, path: &Path) -> Result<()> {
        let splats = Splats::read(path)?;
        let Summary { count, degree, mode, means, largest_scales, smallest_scales, opacities, extras, memory } =
            &splats.summary();
        if self.json {
            let mut value = json!(splats.summary());
            value["quantiles"] = json!(QUANTILES);
            value["comments"] = json!(splats.comments());
            value["notes"] = json!(splats.notes());
            say!("{value}")?;
            return Ok(());
        }
        say!("{}\n  {count} splats, spherical harmonics of degree {degree}, drawn as {mode}", path.display())?;
        let heads = QUANTILES.map(|share| format!("{:>10} %", 100.0 * share)).concat();
        say!("  quantiles      {heads}")?;
        let rows = [("x", &means[0]), ("y", &means[1]), ("z", &means[2])];
        let others = [("largest scale", largest_scales), ("smallest scale", smallest_scales), ("opacity", opacities)];
        for (name, values) in rows.into_iter().chain(others) {
            say!("  {name:<14} {}", values.map(|v| format!("{v:>12.4e}")).concat())?;
        }
        if !extras.is_empty() {
            say!("  properties     {}", printable(&extras.join(", ")))?;
        }
        for comment in splats.comments() {
            say!("  comment        {}", printable(comment))?;
        }
        for note in splats.notes() {
            say!("  note           {note}")?;
        }
        say!("  memory         {}", report::bytes(*memory))
    }

    fn model(&self) -> Result<()> {
        let refused = || Error::setting("FILE", UTF_8, self.file.display().to_string());
        let field = octobayes_models::open(self.file.to_str().ok_or_else(refused)?, None)?;
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
            if let Some(noise) = field.training_noise() {
                say!("  noise        {noise:.4}, the error of colours that training left, for --scale data")?;
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
