//! `info`: what a file holds.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::report;
use crate::error::printable;
use crate::uncertainty::UncertaintyField;
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

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        if self.file.extension().is_some_and(|e| e == "oct") { self.field(&self.file) } else { self.model() }
    }

    fn field(&self, path: &Path) -> Result<()> {
        let field = UncertaintyField::read(path)?;
        let stats = field
            .validate()
            .map_err(|defect| Error::malformed(path, "octree", "a sound octree", defect.to_string()))?;
        let memory = field.memory();
        if self.json {
            let mut value = report::protocol_json(&field);
            value["summary"] = json!(field.summary());
            value["surfaces"] = report::surfaces_json(&field);
            value["octree"] = json!(stats);
            value["memory"] = memory.iter().map(|&(part, bytes)| (part.to_string(), json!(bytes))).collect();
            say!("{value}")?;
            return Ok(());
        }
        say!("{}\n{}", path.display(), report::protocol(&field))?;
        say!("field\n  {}{}", report::summary(&field.summary()), report::surfaces(&field))?;
        if let Some(stats) = stats {
            say!("  sound octree: {} leaves, {} hanging corners", stats.leaves(), stats.hanging_corners)?;
        }
        if let Some(visits) = field.visits() {
            say!("  {:.0} % of the space was never seen", 100.0 * visits.unseen_share())?;
        }
        say!("  prior U {:.4e} (log10 {:.4})", field.prior(), field.prior().log10())?;
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
        let name = self.file.to_string_lossy();
        let field = crate::open::open(&name)?;
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
            say!("{name}\n  {}", field.describe())?;
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
