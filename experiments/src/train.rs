//! Models that are trained where they are studied.

use octobayes::Result;
use octobayes::geometry::Domain;
use octobayes_models::HashGrid;
use octobayes_train::{Shot, TrainSettings, Trainer};

/// A hash grid trained on these images for so many steps.
pub fn hash_grid(settings: TrainSettings, domain: Domain, shots: &[Shot], steps: u64) -> Result<HashGrid> {
    let mut trainer = Trainer::new(settings, domain, shots)?;
    while trainer.steps() < steps {
        trainer.step(trainer.steps() as f64 / steps as f64);
    }
    Ok(trainer.field(serde_json::Value::Null))
}
