//! The models that are cleaned up.

use glam::Vec3;
use octobayes::Result;
use octobayes::field::{TrainedField, VoxelGrid};
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes_models::{HashGrid, HashGridConfig, NerfMlp};
use octobayes_train::{Budget, Run, TrainSettings, Trainer};

use crate::data::Dataset;
use common::program::Program;

pub const STEPS: u64 = 1200;
const LOG2_HASHMAP_SIZE: u32 = 15;
/// Points of voxel grids along an axis.
const VOXELS: usize = 192;

/// What is cleaned up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Architecture {
    /// A hash grid trained on the scene's views.
    HashGrid,
    /// The same, baked into voxels.
    Baked,
    /// The pretrained MLP of the data folder (lego, all 100 views).
    Mlp,
}

impl Architecture {
    /// The model of this architecture.
    pub fn model(self, data: &Dataset) -> Result<Box<dyn TrainedField>> {
        Ok(match self {
            Self::HashGrid => Box::new(hash_grid(data)?),
            // From above: what a voxel shows does not depend on the direction.
            Self::Baked => Box::new(VoxelGrid::bake(&hash_grid(data)?, [VOXELS; 3], Vec3::NEG_Z)),
            Self::Mlp => Box::new(NerfMlp::read(&Program::data()?.join("nerf-mlp-pretrained/lego.safetensors"))?),
        })
    }
}

fn hash_grid(data: &Dataset) -> Result<HashGrid> {
    let config = HashGridConfig::default().log2_hashmap_size(LOG2_HASHMAP_SIZE);
    let settings = TrainSettings::default().config(config);
    let mut trainer = Trainer::new(settings, Domain::Box(data.files.bounds), &data.training)?;
    let run = Run { budget: Budget::Steps(STEPS), held_out: &[], pixels: 0, looks: 0, state: None };
    run.train(&mut trainer, 0.0, &Silent, |_| {})?;
    Ok(trainer.field(serde_json::Value::Null))
}
