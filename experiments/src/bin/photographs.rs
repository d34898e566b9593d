//! Question: does U rank the error of colours on photographs, seen from few and from many views?
//!
//! Hash grids trained on instant-ngp's photographs of a fox, in the box of its camera file, judged on the photographs
//! that are held out. Beside U: the angle to the nearest training camera, which needs no model. Writes the block of
//! `experiments/photographs.md`.

use glam::DVec3;
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Camera, Domain};
use octobayes::metrics::psnr;
use octobayes::monitor::Silent;
use octobayes::render::{GradientMethod, Probe, RayAverage, render_view};
use octobayes_evaluation::metrics::spearman;
use octobayes_train::{DatasetFiles, Selection, Shot, TrainSettings, Trainer};
use serde::{Deserialize, Serialize};

use common::program::{Needs, Program};
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread};
use common::work::Work;

const SEEDS: [u64; 2] = [0, 1];
const STEPS: u64 = 2000;
/// Training views: few, and all that are not held out.
const VIEWS: [Selection; 2] = [Selection::Count(12), Selection::All];
/// Every so many pixels of a held-out photograph are compared, along x and y.
const STRIDE: u32 = 24;
const AVERAGES: [RayAverage; 2] = [RayAverage::WeightedMean, RayAverage::USpreadPerRootRay];
const ANGLE: &str = "angle to the nearest training view";

fn main() -> Result<()> {
    let program = Program::start("photographs", &[("fox", Needs::Data)])?;
    program.part("fox", |work| {
        let described = describe(&rays(), &grid(), &[]);
        let of = seeds(&SEEDS);
        let pixels = format!("1080 × 1920 pixels, one in {STRIDE} along x and y");
        let words = format!("{pixels}; {STEPS} steps. {described} {of}");
        Ok((words, table(work)?))
    })
}

fn rays() -> RaySettings {
    RaySettings::default().rays(100_000).gradient(GradientMethod::Auto)
}

fn grid() -> GridSettings {
    GridSettings::default().level(6)
}

/// Rank correlation of a measure with the error of colours: of all pixels together, and the mean over photographs.
#[derive(Serialize, Deserialize)]
struct Ranked {
    name: String,
    together: f64,
    by_view: f64,
}

/// One model.
#[derive(Serialize, Deserialize)]
struct Row {
    views: usize,
    held_out: usize,
    /// Of the held-out photographs, mean over them, dB.
    psnr: f64,
    ranked: Vec<Ranked>,
}

fn table(work: &Work) -> Result<String> {
    let mut table = Table::new(&[
        "training views",
        "measure",
        "rank correlation with the error of colours",
        "mean over photographs",
        "PSNR held out, dB",
        "photographs held out",
    ]);
    let mut all: [Vec<Row>; VIEWS.len()] = Default::default();
    // Seeds outside: if it is interrupted, whole seeds are done.
    for seed in SEEDS {
        for (views, rows) in VIEWS.iter().zip(&mut all) {
            rows.push(work.row((format!("{views:?}"), STEPS, seed), || measure(views, seed))?);
        }
    }
    for rows in all {
        let of = |value: &dyn Fn(&Row) -> f64, digits| spread(&rows.iter().map(value).collect::<Vec<f64>>(), digits);
        for m in 0..rows[0].ranked.len() {
            table.row(&[
                rows[0].views.to_string(),
                rows[0].ranked[m].name.clone(),
                of(&|row| row.ranked[m].together, 2),
                of(&|row| row.ranked[m].by_view, 2),
                of(&|row| row.psnr, 2),
                rows[0].held_out.to_string(),
            ]);
        }
    }
    Ok(table.text().into())
}

/// Trains a model on some of the photographs, and judges it on those that are held out.
fn measure(views: &Selection, seed: u64) -> Result<Row> {
    let mut files = DatasetFiles::read(&Program::data()?.join("fox"))?;
    files.select(views, None)?;
    let [train, held_out] = files.load(&Silent)?;
    let mut trainer = Trainer::new(TrainSettings::default().seed(seed), Domain::Box(files.bounds), &train)?;
    while trainer.steps() < STEPS {
        trainer.step(trainer.steps() as f64 / STEPS as f64);
    }
    let model = trainer.field(serde_json::Value::Null);
    let cameras: Vec<Camera> = train.iter().map(|shot| shot.camera).collect();
    let field = Estimation::new(&model, &cameras).rays(rays().seed(seed)).grid(grid()).run()?.field;
    let settings = RaySettings::for_images();
    let (tracer, offset) = (settings.tracer(&model, 0.0, &Silent)?, settings.offset_for(&model));
    let mut psnrs = Vec::new();
    // By photograph: errors, and the values of each measure.
    let mut all: Vec<(Vec<f64>, [Vec<f64>; AVERAGES.len() + 1])> = Vec::new();
    for shot in &held_out {
        let camera = shot.camera.strided(STRIDE, offset);
        let probe = Probe { field: &field, averages: &AVERAGES };
        let view = render_view(&tracer, &camera, offset, &[probe], &Silent)?;
        let truth = colors(shot, camera.resolution);
        let shown: Vec<DVec3> = view.pixels.iter().map(|pixel| pixel.color).collect();
        psnrs.push(psnr(&shown, &truth));
        let seen: Vec<usize> = (0..truth.len()).filter(|&i| view.pixels[i].opacity > 0.0).collect();
        let errors = seen.iter().map(|&i| (shown[i] - truth[i]).abs().element_sum() / 3.0).collect();
        let average = |a: usize| seen.iter().map(|&i| view.log10_uncertainty[a][i]).collect();
        let width = camera.resolution[0] as usize;
        let at = |i: usize| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + offset);
            camera.ray(x, y).at(view.pixels[i].expected_depth)
        };
        let angles = seen.iter().map(|&i| nearest(&cameras, at(i), camera.position)).collect();
        all.push((errors, [average(0), average(1), angles]));
    }
    let errors: Vec<f64> = all.iter().flat_map(|(errors, _)| errors).copied().collect();
    let names = AVERAGES.iter().map(|average| format!("log10 U, {}", average.name())).chain([ANGLE.into()]);
    let ranked = names.enumerate().map(|(m, name)| {
        let values: Vec<f64> = all.iter().flat_map(|(_, measures)| &measures[m]).copied().collect();
        let by_view = all.iter().filter_map(|(errors, measures)| spearman(&measures[m], errors));
        let by_view = by_view.collect::<Vec<_>>();
        let together = spearman(&values, &errors).unwrap_or(f64::NAN);
        Ranked { name, together, by_view: mean(&by_view) }
    });
    let ranked = ranked.collect();
    Ok(Row { views: train.len(), held_out: held_out.len(), psnr: mean(&psnrs), ranked })
}

/// The true colours of the pixels that are compared.
fn colors(shot: &Shot, [width, height]: [u32; 2]) -> Vec<DVec3> {
    let full = |row: u32, column: u32| ((row * shot.camera.resolution[0] + column) * STRIDE) as usize;
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| full(row, column)));
    pixels.map(|i| shot.image.over(i, DVec3::ONE)).collect()
}

/// The angle at a point between the way to `eye` and that to the nearest training camera with the point in its
/// picture, radians; π if none has.
fn nearest(cameras: &[Camera], x: DVec3, eye: DVec3) -> f64 {
    let shows = |camera: &&Camera| camera.project_inside(x).is_some();
    let angle = |camera: &Camera| (eye - x).angle_between(camera.position - x);
    cameras.iter().filter(shows).map(angle).fold(std::f64::consts::PI, f64::min)
}
