//! Models that are trained on few views of meshes: splats, which are kept, and hash grids.

use std::path::PathBuf;

use glam::{DVec3, Vec3};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_data::Hemisphere;
use octobayes_models::HashGrid;
use octobayes_splats::Splats;
use octobayes_synth::{DatasetSettings, MeshScene, Surface, Up, write_dataset};
use octobayes_train::{Budget, DatasetFiles, Run, Shot, SplatSettings, SplatTrainer, TrainSettings, Trainer, Training};
use rayon::prelude::*;

use common::meshes;
use common::surface::{self, Place};
use common::work::Work;

use crate::judge::{TrueView, Truth};
use crate::methods::Judged;

/// Side of the images, pixels; samples along a pixel's side; steps of the training of splats and of hash grids.
pub const SIDE: u32 = 160;
const SAMPLES: u32 = 3;
pub const STEPS: u64 = 1500;
pub const GRID_STEPS: u64 = 1000;
/// A part is at the surface if it is no farther from it than this part of the mesh's length.
pub const SLACK: f64 = 0.02;
/// Held-out views.
pub const HELD_OUT: u32 = 10;

/// Which views a model is trained on.
#[derive(Debug, Clone, Copy)]
pub struct Views {
    pub name: &'static str,
    pub count: u32,
    pub is_half: bool,
}

pub const VIEWS: [Views; 3] = [
    Views { name: "8 views", count: 8, is_half: false },
    Views { name: "12 views", count: 12, is_half: false },
    Views { name: "12 of one side", count: 12, is_half: true },
];

/// Images of a mesh, and what is known of it.
pub struct Scene {
    pub shots: Vec<Shot>,
    bounds: Aabb,
    mesh: MeshScene,
    pub truth: Truth,
}

impl Scene {
    /// Makes the images, or reads those that were made before, of whatever part.
    pub fn new(work: &Work, mesh: &str, up: Up, views: Views, seed: u64) -> Result<Self> {
        let folder = models(work)?.join(name(mesh, views, seed));
        if !folder.exists() {
            let half = views.is_half.then_some(Hemisphere::Left);
            let settings = DatasetSettings::default().up(up).views(views.count).test_views(HELD_OUT).hemisphere(half);
            let settings = settings.resolution([SIDE; 2]).samples_per_side(SAMPLES).seed(seed);
            write_dataset(&meshes::file(mesh)?, &folder, &settings, &Silent)?;
        }
        let files = DatasetFiles::read(&folder)?;
        let [shots, held_out] = files.load(&Silent)?;
        let mesh = meshes::read(mesh, up)?;
        let length = meshes::length(&mesh);
        let held_out = held_out.iter().map(|shot| true_view(&mesh, shot)).collect();
        let truth = Truth { held_out, slack: SLACK * length, length };
        Ok(Self { shots, bounds: files.bounds, mesh, truth })
    }

    /// The cameras of the training.
    pub fn cameras(&self) -> Vec<Camera> {
        self.shots.iter().map(|shot| shot.camera).collect()
    }

    /// Where points are.
    pub fn places(&self, points: &[Vec3]) -> Vec<Place> {
        let points: Vec<DVec3> = points.iter().map(|x| x.as_dvec3()).collect();
        surface::places(&self.mesh, &points, self.truth.slack)
    }

    /// Trains a hash grid.
    pub fn hash_grid(&self, seed: u64) -> Result<HashGrid> {
        let settings = TrainSettings::default().seed(seed);
        let mut trainer = Trainer::new(settings, Domain::Box(self.bounds), &self.shots)?;
        let run = Run { budget: Budget::Steps(GRID_STEPS), held_out: &[], pixels: 0, looks: 0, state: None };
        run.train(&mut trainer, 0.0, &Silent, |_| {})?;
        Ok(trainer.field(serde_json::Value::Null))
    }
}

fn models(work: &Work) -> Result<PathBuf> {
    let models = work.folder().with_file_name("models");
    std::fs::create_dir_all(&models).map_err(Error::io(&models, "cannot create the folder"))?;
    Ok(models)
}

fn name(mesh: &str, views: Views, seed: u64) -> String {
    format!("{mesh}_{}{}_{seed}", views.count, if views.is_half { "half" } else { "" })
}

/// Trains splats of a mesh, or reads those that were trained before, of whatever part.
pub fn judged(work: &Work, mesh: &str, up: Up, views: Views, seed: u64) -> Result<Judged> {
    let scene = Scene::new(work, mesh, up, views, seed)?;
    let name = name(mesh, views, seed);
    let file = models(work)?.join(format!("{name}.ply"));
    if !file.exists() {
        train(&scene.shots, scene.bounds, seed)?.write(&file)?;
        eprintln!("{name} is trained");
    }
    let splats = Splats::read(&file)?;
    let (places, cameras) = (scene.places(splats.means()), scene.cameras());
    Ok(Judged { splats, cameras, places, truth: scene.truth })
}

fn train(shots: &[Shot], bounds: Aabb, seed: u64) -> Result<Splats> {
    let settings = SplatSettings::default().most(SplatSettings::most_for(shots)).seed(seed);
    let mut trainer = SplatTrainer::new(settings, bounds, &[], shots)?;
    while trainer.steps() < STEPS {
        trainer.step(trainer.steps() as f64 / STEPS as f64);
    }
    trainer.splats()
}

fn true_view(scene: &MeshScene, shot: &Shot) -> TrueView {
    let [width, height] = shot.camera.resolution;
    let pixels: Vec<[u32; 2]> = (0..height).flat_map(|y| (0..width).map(move |x| [x, y])).collect();
    let hit = |at: &[u32; 2]| scene.nearest(&shot.camera.ray(f64::from(at[0]) + 0.5, f64::from(at[1]) + 0.5));
    let hits: Vec<_> = pixels.par_iter().map(hit).collect();
    TrueView {
        camera: shot.camera,
        colors: (0..pixels.len()).map(|i| shot.image.over(i, DVec3::ONE)).collect(),
        distances: hits.iter().map(|hit| hit.map_or(f64::INFINITY, |hit| hit.t)).collect(),
        is_object: hits.iter().map(|hit| hit.is_some_and(|hit| matches!(hit.surface, Surface::Face { .. }))).collect(),
    }
}
