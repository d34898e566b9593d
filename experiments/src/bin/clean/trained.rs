//! Splats that are trained on few views of meshes, and kept.

use glam::DVec3;
use octobayes::geometry::Aabb;
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_data::Hemisphere;
use octobayes_splats::Splats;
use octobayes_synth::{DatasetSettings, MeshScene, Surface, Up, write_dataset};
use octobayes_train::{DatasetFiles, Shot, SplatSettings, SplatTrainer, Training};
use rayon::prelude::*;

use common::meshes;
use common::surface;
use common::work::Work;

use crate::judge::{Judged, TrueView};

/// Side of the images, pixels; samples along a pixel's side; steps of the training.
pub const SIDE: u32 = 160;
const SAMPLES: u32 = 3;
pub const STEPS: u64 = 1500;
/// A splat is at the surface if it is no farther from it than this part of the mesh's length.
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

/// Trains a model of a mesh, or reads the one that was trained before, of whatever part.
pub fn judged(work: &Work, mesh: &str, up: Up, views: Views, seed: u64) -> Result<Judged> {
    let name = format!("{mesh}_{}{}_{seed}", views.count, if views.is_half { "half" } else { "" });
    let models = work.folder().with_file_name("models");
    let (folder, file) = (models.join(&name), models.join(format!("{name}.ply")));
    std::fs::create_dir_all(&models).map_err(Error::io(&models, "cannot create the folder"))?;
    if !folder.exists() {
        let half = views.is_half.then_some(Hemisphere::Left);
        let settings = DatasetSettings::default().up(up).views(views.count).test_views(HELD_OUT).hemisphere(half);
        let settings = settings.resolution([SIDE; 2]).samples_per_side(SAMPLES).seed(seed);
        write_dataset(&meshes::file(mesh)?, &folder, &settings, &Silent)?;
    }
    let files = DatasetFiles::read(&folder)?;
    let [shots, held_out] = files.load(&Silent)?;
    if !file.exists() {
        train(&shots, files.bounds, seed)?.write(&file)?;
        eprintln!("{name} is trained");
    }
    let splats = Splats::read(&file)?;
    let truth = meshes::read(mesh, up)?;
    let length = meshes::length(&truth);
    let centres: Vec<DVec3> = splats.means().iter().map(|x| x.as_dvec3()).collect();
    let places = surface::places(&truth, &centres, SLACK * length);
    let cameras = shots.iter().map(|shot| shot.camera).collect();
    let held_out = held_out.iter().map(|shot| true_view(&truth, shot)).collect();
    Ok(Judged { splats, cameras, places, held_out, slack: SLACK * length, length })
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
