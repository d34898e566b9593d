//! Models and their uncertainties, made once and kept.

use std::path::Path;

use glam::Vec3;
use octobayes::estimate::{Estimation, GridSettings, Outcome, RaySettings};
use octobayes::field::{HashGrid, HashGridConfig, NerfMlp, RadianceField, VoxelGrid};
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::render::GradientMethod;
use octobayes::train::{Budget, Run, TrainSettings, Trainer, quality};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use crate::common::clock::{Clock, Time};
use crate::common::program::Program;
use crate::common::work::{keep, kept};
use crate::data::Dataset;
use crate::plan::{Architecture, Plan, Scene};

/// What a training took and reached.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Training {
    pub time: Time,
    /// On training images, dB.
    pub psnr: f64,
}

fn settings(plan: &Plan, seed: u64) -> TrainSettings {
    let config = HashGridConfig::default().log2_hashmap_size(plan.log2_hashmap_size);
    TrainSettings::default().config(config).seed(seed)
}

/// The hash grid of a scene's views with this seed.
pub fn hash_grid(scene: &Scene, plan: &Plan, data: &Dataset, folder: &Path, seed: u64) -> Result<(HashGrid, Training)> {
    let (model, about) =
        (folder.join(format!("member-{seed}.safetensors")), folder.join(format!("member-{seed}.json")));
    let settings = settings(plan, seed);
    let views = serde_json::json!([scene.data, scene.views, scene.half, plan.resolution, plan.train_views]);
    let key = serde_json::json!([env!("CARGO_PKG_VERSION"), views, settings, plan.steps]);
    if let Some(training) = kept(&about, &key) {
        return Ok((HashGrid::read(&model)?, training));
    }
    eprintln!("  training member {seed} on {} views", data.train.len());
    let clock = Clock::start();
    let mut trainer = Trainer::new(settings, Domain::Box(data.files.bounds), &data.train)?;
    let run = Run { budget: Budget::Steps(plan.steps), held_out: &[], pixels: 0, looks: 0, state: None };
    run.train(&mut trainer, 0.0, &Silent, |_| {})?;
    let field = trainer.field(key.clone());
    let time = clock.elapsed();
    let psnr = quality(&field, &data.train, Vec3::ONE, 20_000).map_or(f64::NAN, |q| q.psnr);
    field.write(&model)?;
    let training = Training { time, psnr };
    keep(&about, &key, training)?;
    Ok((field, training))
}

/// The model that a scene judges, with what its training took, if it was trained here.
pub fn judged(
    scene: &Scene,
    plan: &Plan,
    data: &Dataset,
    work: &Path,
) -> Result<(Box<dyn RadianceField>, Option<Training>)> {
    let folder = folder(work, &scene.slug())?;
    match scene.architecture {
        Architecture::HashGrid => {
            let (field, training) = hash_grid(scene, plan, data, &folder, 0)?;
            Ok((Box::new(field), Some(training)))
        }
        Architecture::BakedFrom(name) => {
            let source = plan.scenes().into_iter().find(|s| s.name == name).expect("a scene of the plan");
            let (field, _) = hash_grid(&source, plan, data, &self::folder(work, &source.slug())?, 0)?;
            // From above: what a voxel shows does not depend on the direction.
            Ok((Box::new(VoxelGrid::bake(&field, [plan.baked; 3], Vec3::NEG_Z)), None))
        }
        Architecture::Mlp => {
            Ok((Box::new(NerfMlp::read(&Program::data()?.join("nerf-mlp-pretrained/lego.safetensors"))?), None))
        }
    }
}

/// A folder of the work folder.
pub fn folder(work: &Path, name: &str) -> Result<std::path::PathBuf> {
    let folder = work.join(name);
    std::fs::create_dir_all(&folder).map_err(Error::io(&folder, "cannot create the folder"))?;
    Ok(folder)
}

/// What an uncertainty took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spent {
    pub time: Time,
    /// Most that the sums held.
    pub summing_bytes: usize,
    /// For queries.
    pub query_bytes: usize,
    pub vertices: usize,
}

/// The uncertainties at some levels, each with λ = its factor times the default. All are gathered from the same ray
/// samples: those of one level's finite-difference step, on which only samples of hardly any weight depend if the field
/// differentiates itself.
pub fn uncertainties(
    plan: &Plan,
    wanted: &[(u8, f64)],
    field: &dyn RadianceField,
    cameras: &[Camera],
    folder: &Path,
    model: &serde_json::Value,
) -> Result<Vec<(UncertaintyField, Spent)>> {
    let about = folder.join("uncertainties.json");
    let oct = |level: u8| folder.join(format!("level-{level}.oct"));
    let key = serde_json::json!([model, wanted, plan.rays]);
    if let Some(estimations) = kept::<Vec<Spent>>(&about, &key) {
        let read = |(&(level, _), estimation)| Ok((UncertaintyField::read(&oct(level))?, estimation));
        return wanted.iter().zip(estimations).map(read).collect();
    }
    eprintln!("  uncertainty");
    let clock = Clock::start();
    let domain = Domain::Box(field.bounds());
    let rays = RaySettings::default().rays(plan.rays).gradient(GradientMethod::Auto);
    let grids: Vec<GridSettings> = wanted
        .iter()
        .map(|&(level, factor)| {
            let grid = GridSettings::default().level(level);
            Ok(grid.lambda(Some(factor * grid.prior_precision(&grid.lattice(domain)?))))
        })
        .collect::<Result<_>>()?;
    let outcomes = Estimation::new(field, cameras).rays(rays).grid(grids[0]).prepare()?.finish_on(&grids)?;
    let whole = clock.elapsed();
    // Sums of a grid take as many cores as the rays do: processor time is divided as time is.
    let share = |part: f64| Time { cpu: whole.cpu * part / whole.wall, wall: part };
    let summing: f64 = outcomes.iter().map(|outcome| outcome.summing.as_secs_f64()).sum();
    let mut out = Vec::new();
    for (Outcome { field, sums_bytes, summing: own, .. }, &(level, _)) in outcomes.into_iter().zip(wanted) {
        let estimation = Spent {
            // As if it had been made alone.
            time: share(whole.wall - summing + own.as_secs_f64()),
            summing_bytes: sums_bytes,
            query_bytes: field.query_memory(),
            vertices: field.deviations().len(),
        };
        field.write(&oct(level))?;
        out.push((field, estimation));
    }
    keep(&about, &key, out.iter().map(|(_, estimation)| *estimation).collect::<Vec<_>>())?;
    Ok(out)
}
