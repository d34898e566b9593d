//! Splats that `train --splats` fits to few views of meshes: which of them are far from the surface, and which did no
//! camera see?

use glam::DVec3;
use octobayes::Result;
use octobayes::monitor::Silent;
use octobayes::posterior::DataScale;
use octobayes_evaluation::metrics::{Detection, spearman};
use octobayes_synth::{DatasetSettings, write_dataset};
use octobayes_train::{DatasetFiles, SplatSettings, SplatTrainer, Training};
use serde::{Deserialize, Serialize};

use crate::scene::{self, MESHES, SIDES};
use crate::scores::{self, LEVEL, NAMES};
use crate::surface;
use common::table::{Table, mean};
use common::work::Work;

/// Side of the images, pixels; samples along a pixel's side; views.
const SIDE: u32 = 128;
const SAMPLES: u32 = 3;
const VIEWS: u32 = 12;
const STEPS: u64 = 1000;
/// A splat farther from the surface than this part of the mesh's length, outside or inside, is far.
const FAR: f64 = 0.02;
/// A splat is hidden if something stands in front of it by more than this part of the length.
const HIDDEN: f64 = 0.01;

/// The figures of one score.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Figures {
    far: f64,
    /// Spearman's ρ with the distance from the surface.
    rank: f64,
    never_seen: f64,
}

/// A figure by its name.
type Shown = (&'static str, fn(&Figures) -> f64);

/// One trained model.
#[derive(Serialize, Deserialize)]
struct Row {
    splats: usize,
    /// Of the training images, dB.
    psnr: f64,
    /// Shares of splats that are far, and that no camera saw.
    shares: [f64; 2],
    /// `[NAMES]`.
    scores: Vec<Figures>,
}

pub fn settings() -> String {
    format!(
        "{VIEWS} views of {SIDE} × {SIDE} pixels, {STEPS} steps, seed 0; every pixel, level {LEVEL}, `--scale data` \
         with the error of the training images. A splat is far if its centre is farther than {:.0} % of the mesh's \
         length from the surface, outside or inside.",
        100.0 * FAR
    )
}

pub fn tables(work: &Work) -> Result<String> {
    let mut rows = Vec::new();
    for (side, half) in SIDES {
        for (mesh, up) in MESHES {
            let row = work.row((mesh, side, STEPS, SIDE), || {
                let settings = DatasetSettings::default().up(up).views(VIEWS).test_views(1).hemisphere(half);
                measure(mesh, &settings.resolution([SIDE; 2]).samples_per_side(SAMPLES))
            });
            rows.push((format!("{mesh}, {side}"), row?));
        }
    }
    let mut models = Table::new(&["model", "splats", "training images, dB", "far", "never seen"]);
    for (name, row) in &rows {
        let [far, unseen] = row.shares.map(|share| format!("{share:.3}"));
        models.row(&[name.clone(), row.splats.to_string(), format!("{:.1}", row.psnr), far, unseen]);
    }
    let figures: [Shown; 3] = [
        ("AUROC of splats far from the surface", |f| f.far),
        ("Spearman's ρ with the distance from the surface", |f| f.rank),
        ("AUROC of splats that no camera saw", |f| f.never_seen),
    ];
    let table = |(title, figure): &(&str, fn(&Figures) -> f64)| {
        let names = rows.iter().map(|(name, _)| name.as_str());
        let head: Vec<&str> = ["score"].into_iter().chain(names).chain(["mean"]).collect();
        let mut table = Table::new(&head);
        for (s, name) in NAMES.iter().enumerate() {
            let values: Vec<f64> = rows.iter().map(|(_, row)| figure(&row.scores[s])).collect();
            let cells = values.iter().copied().chain([mean(&values)]).map(|value| format!("{value:.3}"));
            table.row(&[name.to_string()].into_iter().chain(cells).collect::<Vec<_>>());
        }
        format!("{title}\n\n{}", table.text())
    };
    let others: Vec<String> = figures.iter().map(table).collect();
    Ok(format!("{}\n{}", models.text(), others.join("\n")))
}

fn measure(mesh: &str, settings: &DatasetSettings) -> Result<Row> {
    let folder = scene::folder()?;
    write_dataset(&scene::file(mesh)?, folder.path(), settings, &Silent)?;
    let files = DatasetFiles::read(folder.path())?;
    let [shots, _] = files.load(&Silent)?;
    let most = SplatSettings::most_for(&shots);
    let mut trainer = SplatTrainer::new(SplatSettings::default().most(most), files.bounds, &[], &shots)?;
    while trainer.steps() < STEPS {
        trainer.step(trainer.steps() as f64 / STEPS as f64);
    }
    let pixels = shots.iter().map(|shot| shot.camera.pixels() as usize).sum();
    let psnr = trainer.look(&shots, pixels, None).map_or(f64::NAN, |quality| quality.psnr);
    let splats = trainer.splats()?;
    let cameras: Vec<_> = shots.iter().map(|shot| shot.camera).collect();

    let truth = scene::read(mesh, settings.up)?;
    let length = scene::length(&truth);
    let centres: Vec<DVec3> = splats.means().iter().map(|x| x.as_dvec3()).collect();
    let distances = surface::distances(&truth, &centres);
    let is_far: Vec<bool> = distances.iter().map(|d| *d > FAR * length).collect();
    let sightings = surface::sightings(&truth, &cameras, &centres, HIDDEN * length);
    let unseen: Vec<bool> = sightings.iter().map(|cameras| *cameras == 0).collect();
    let area = |score: &[f64], truth: &[bool]| Detection::new(score, truth).map_or(f64::NAN, |found| found.auroc);
    let figures = |score: &Vec<f64>| Figures {
        far: area(score, &is_far),
        rank: spearman(score, &distances).unwrap_or(0.0),
        never_seen: area(score, &unseen),
    };
    let scores = scores::all(&splats, &cameras, files.bounds, DataScale::noise_of(psnr))?;
    let share = |of: &[bool]| of.iter().filter(|is| **is).count() as f64 / of.len() as f64;
    Ok(Row {
        splats: splats.len(),
        psnr,
        shares: [share(&is_far), share(&unseen)],
        scores: scores.iter().map(figures).collect(),
    })
}
