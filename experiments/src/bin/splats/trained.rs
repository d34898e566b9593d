//! Splats that `train --splats` fits to few views of meshes: which of them float in the air, which did no camera see?

use glam::DVec3;
use octobayes::Result;
use octobayes::monitor::Silent;
use octobayes::posterior::DataScale;
use octobayes_evaluation::metrics::Detection;
use octobayes_synth::{DatasetSettings, write_dataset};
use octobayes_train::{DatasetFiles, SplatSettings, SplatTrainer, Training};
use serde::{Deserialize, Serialize};

use crate::scores::{self, LEVEL, NAMES};
use common::meshes::{self, MESHES, SIDES};
use common::recall::recall_at;
use common::surface::{self, Place};
use common::table::{Table, mean};
use common::work::Work;

/// Side of the images, pixels; samples along a pixel's side; views.
const SIDE: u32 = 128;
const SAMPLES: u32 = 3;
const VIEWS: u32 = 12;
const STEPS: u64 = 1000;
/// A splat is at the surface if it is no farther from it than this part of the mesh's length.
const SLACK: f64 = 0.02;
/// Share of floaters among those that a score marks, at which it is asked how many it finds.
const PRECISION: f64 = 0.95;
/// A splat is hidden if something stands in front of it by more than this part of the length.
const HIDDEN: f64 = 0.01;

/// The figures of one score.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Figures {
    /// AUROC of floaters, and the share of them that are found at [`PRECISION`].
    floats: f64,
    found: f64,
    inside: f64,
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
    /// Shares of the judged splats that are in the air and inside, of all that are not judged and that no camera saw.
    shares: [f64; 4],
    /// `[NAMES]`.
    scores: Vec<Figures>,
}

pub fn settings() -> String {
    format!(
        "{VIEWS} views of {SIDE} × {SIDE} pixels, {STEPS} steps, seed 0; every pixel, level {LEVEL}, `--scale data` \
         with the error of the training images. A splat is at the surface if its centre is within {:.0} % of the mesh's \
         length of it, else in the air or inside. Those at or under the ground and outside the box are not judged.",
        100.0 * SLACK
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
    let head = ["model", "splats", "training images, dB", "in the air", "inside", "not judged", "never seen"];
    let mut models = Table::new(&head);
    for (name, row) in &rows {
        let shares = row.shares.map(|share| format!("{share:.3}"));
        models.row(&[vec![name.clone(), row.splats.to_string(), format!("{:.1}", row.psnr)], shares.to_vec()].concat());
    }
    let figures: [Shown; 4] = [
        ("AUROC of splats in the air", |f| f.floats),
        ("share of them found at a precision of 0.95", |f| f.found),
        ("AUROC of splats inside the mesh", |f| f.inside),
        ("AUROC of splats that no camera saw", |f| f.never_seen),
    ];
    let names = rows.iter().map(|(name, _)| name.as_str());
    let mut scores = Table::new(&["figure", "score"].into_iter().chain(names).chain(["mean"]).collect::<Vec<_>>());
    for (title, figure) in figures {
        for (s, name) in NAMES.iter().enumerate() {
            let values: Vec<f64> = rows.iter().map(|(_, row)| figure(&row.scores[s])).collect();
            let cells = values.iter().copied().chain([mean(&values)]).map(|value| format!("{value:.3}"));
            scores.row(&[title.to_string(), name.to_string()].into_iter().chain(cells).collect::<Vec<_>>());
        }
    }
    Ok(format!("{}\n{}", models.text(), scores.text()))
}

fn measure(mesh: &str, settings: &DatasetSettings) -> Result<Row> {
    let folder = meshes::folder()?;
    write_dataset(&meshes::file(mesh)?, folder.path(), settings, &Silent)?;
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

    let truth = meshes::read(mesh, settings.up)?;
    let length = meshes::length(&truth);
    let centres: Vec<DVec3> = splats.means().iter().map(|x| x.as_dvec3()).collect();
    let places = surface::places(&truth, &centres, SLACK * length);
    let judged: Vec<usize> = (0..splats.len()).filter(|&i| places[i] != Place::Elsewhere).collect();
    let are = |place: Place| judged.iter().map(|&i| places[i] == place).collect::<Vec<bool>>();
    let [in_air, inside] = [Place::Air, Place::Inside].map(are);
    let sightings = surface::sightings(&truth, &cameras, &centres, HIDDEN * length);
    let unseen: Vec<bool> = sightings.iter().map(|cameras| *cameras == 0).collect();
    let area = |score: &[f64], truth: &[bool]| Detection::new(score, truth).map_or(f64::NAN, |found| found.auroc);
    let figures = |score: &Vec<f64>| {
        let of_judged: Vec<f64> = judged.iter().map(|&i| score[i]).collect();
        Figures {
            floats: area(&of_judged, &in_air),
            found: recall_at(PRECISION, &of_judged, &in_air),
            inside: area(&of_judged, &inside),
            never_seen: area(score, &unseen),
        }
    };
    let scores = scores::all(&splats, &cameras, files.bounds, DataScale::noise_of(psnr))?;
    let share = |of: &[bool]| of.iter().filter(|is| **is).count() as f64 / of.len() as f64;
    Ok(Row {
        splats: splats.len(),
        psnr,
        shares: [share(&in_air), share(&inside), 1.0 - judged.len() as f64 / splats.len() as f64, share(&unseen)],
        scores: scores.iter().map(figures).collect(),
    })
}
