//! Question: which photograph should be taken next, and does a log det of the Hessian know it better than counts do?
//!
//! From three images on, each strategy takes two more after every training, up to nine. All share one trainer, the same
//! start and the same candidates. Writes the block of `experiments/next_view.md`.

mod cup;
mod scene;
mod strategy;

use std::cell::OnceCell;

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::RaySettings;
use octobayes::field::TrainedField;
use octobayes::geometry::{Camera, Domain};
use octobayes::metrics::psnr;
use octobayes::monitor::Silent;
use octobayes::render::{Renderer, VolumeRenderer};
use octobayes_evaluation::metrics::ssim;
use octobayes_models::HashGrid;
use octobayes_train::{Shot, TrainSettings, quality};
use serde::{Deserialize, Serialize};

use common::program::{Needs, Program};
use common::table::{Table, deviation, mean};
use common::train::hash_grid;
use common::visibility::{NEAR, is_seen};
use common::work::Work;
use scene::{Held, Images, SCENES, Scene, VIEWS};
use strategy::{Choice, FISHER_PIXELS, LEVEL, OCCUPANCY, PIXELS, RAYS, STRATEGIES, Strategy, TAKE, farthest};

const SEEDS: [u64; 4] = [0, 1, 2, 3];
const START: usize = 3;
const END: usize = 9;
/// Trainings of a row after the first.
const STAGES: usize = (END - START) / TAKE;
const STEPS: u64 = 300;
/// Pixels of training images by which their noise is measured, about.
const NOISE_PIXELS: usize = 10_000;
/// Most that one pixel counts as an error of depth, scene units; also where the model shows nothing.
const CLIPPED: f64 = 0.2;

fn main() -> Result<()> {
    let program = Program::start("next_view", &[("strategies", Needs::Data)])?;
    program.part("strategies", |work| {
        let words = format!(
            "{START} to {END} of {VIEWS} images (of lego 34), {TAKE} more after each training of {STEPS} steps; \
             200 × 200 pixels; field at level {LEVEL} from {RAYS} rays, `--scale data` with the noise of training; \
             {PIXELS} pixels a candidate, {FISHER_PIXELS} for FisherRF. Seeds 0 to {}.",
            SEEDS.len() - 1,
        );
        Ok((words, tables(&Runs::all(work)?)))
    })
}

/// How good a model is.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Quality {
    psnr: f64,
    ssim: f64,
    /// Mean absolute error of the median depth, each clipped, scene units.
    depth: f64,
    /// Share of the true surface in held-out views that no image taken shows, if that is known.
    unseen: Option<f64>,
}

/// Images that one strategy took, by their numbers, and what the models reached that were trained on them.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    taken: Vec<usize>,
    reached: Vec<Quality>,
}

/// `[seeds][scenes][strategies]`.
struct Runs(Vec<Vec<Vec<Row>>>);

impl Runs {
    fn all(work: &Work) -> Result<Self> {
        let images: Vec<OnceCell<Images>> = SCENES.iter().map(|_| OnceCell::new()).collect();
        let of_scene = |scene: &Scene, images: &OnceCell<Images>, seed: u64| -> Result<Vec<Row>> {
            let first = OnceCell::new();
            let row = |strategy: &Strategy| {
                let key = (scene.name, seed, strategy, STEPS, PIXELS);
                work.row(key, || run(*strategy, lazily(images, || scene.images())?, &first, seed))
            };
            STRATEGIES.iter().map(row).collect()
        };
        // Seeds are outermost, so that a run that is stopped has whole ones.
        let of_seed = |&seed: &u64| {
            SCENES.iter().zip(&images).map(|(scene, images)| of_scene(scene, images, seed)).collect::<Result<_>>()
        };
        Ok(Self(SEEDS.iter().map(of_seed).collect::<Result<_>>()?))
    }
}

/// The value of a cell, made if it is the first to ask.
fn lazily<T>(cell: &OnceCell<T>, make: impl FnOnce() -> Result<T>) -> Result<&T> {
    match cell.get() {
        Some(value) => Ok(value),
        None => {
            let value = make()?;
            Ok(cell.get_or_init(|| value))
        }
    }
}

/// A model of some images.
struct Model {
    taken: Vec<usize>,
    field: HashGrid,
    /// Of the training images, dB.
    psnr: f64,
}

impl Model {
    fn train(images: &Images, taken: Vec<usize>, seed: u64) -> Result<Self> {
        let shots: Vec<Shot> = taken.iter().map(|&i| images.shots[i].clone()).collect();
        let settings = TrainSettings::default().seed(seed);
        let field = hash_grid(settings, Domain::Box(images.bounds), &shots, STEPS)?;
        let psnr = quality(&field, &shots, Vec3::ONE, NOISE_PIXELS).map_or(f64::NAN, |quality| quality.psnr);
        Ok(Self { taken, field, psnr })
    }
}

/// Takes images by a strategy. `first` is the model of the start, the same for all.
fn run(strategy: Strategy, images: &Images, first: &OnceCell<Model>, seed: u64) -> Result<Row> {
    let cameras: Vec<Camera> = images.shots.iter().map(|shot| shot.camera).collect();
    let start = || {
        // The first image by the seed, the others as far away as can be.
        let any = (seed as usize * 17 + 5) % cameras.len();
        let mut taken = vec![any];
        taken.extend(farthest(vec![cameras[any]], &cameras, START - 1));
        Model::train(images, taken, seed)
    };
    let mut model = lazily(first, start)?;
    let (mut next, mut reached) = (None, Vec::new());
    for _ in 0..STAGES {
        let left: Vec<usize> = (0..cameras.len()).filter(|i| !model.taken.contains(i)).collect();
        let [before, candidates] =
            [&model.taken, &left].map(|which| which.iter().map(|&i| cameras[i]).collect::<Vec<_>>());
        let choice = Choice {
            model: &model.field,
            domain: Domain::Box(images.bounds),
            psnr: model.psnr,
            taken: &before,
            candidates: &candidates,
            seed,
        };
        let mut taken = model.taken.clone();
        taken.extend(strategy.choose(&choice)?.into_iter().map(|i| left[i]));
        model = next.insert(Model::train(images, taken, seed)?);
        reached.push(judge(images, model, &cameras)?);
    }
    Ok(Row { taken: model.taken.clone(), reached })
}

/// How good a model is on the held-out images.
fn judge(images: &Images, model: &Model, cameras: &[Camera]) -> Result<Quality> {
    let tracer = RaySettings::for_images().occupancy(OCCUPANCY).tracer(&model.field, 0.0, &Silent)?;
    let renderer = VolumeRenderer { tracer, differentiation: None };
    let (mut psnrs, mut ssims, mut errors, mut unseen) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for Held { camera, colors, distance } in &images.held_out {
        let view = renderer.image(camera, model.field.pixel_offset(), &[], &Silent)?;
        let found: Vec<DVec3> = view.pixels.iter().map(|pixel| pixel.color.clamp(DVec3::ZERO, DVec3::ONE)).collect();
        psnrs.push(psnr(&found, colors));
        ssims.extend(ssim(camera.resolution, &found, colors));
        let width = camera.resolution[0] as usize;
        for (i, (pixel, distance)) in view.pixels.iter().zip(distance).enumerate() {
            let Some(distance) = distance else { continue };
            let error = if pixel.opacity > 0.5 { (pixel.median_depth - distance).abs() } else { CLIPPED };
            errors.push(error.min(CLIPPED));
            if let Some(mesh) = &images.mesh {
                let x = camera.ray((i % width) as f64 + 0.5, (i / width) as f64 + 0.5).at(*distance);
                let is_unseen = !model.taken.iter().any(|&i| is_seen(mesh, &cameras[i], x, NEAR));
                unseen.push(f64::from(u8::from(is_unseen)));
            }
        }
    }
    let unseen = (!unseen.is_empty()).then(|| mean(&unseen));
    Ok(Quality { psnr: mean(&psnrs), ssim: mean(&ssims), depth: mean(&errors), unseen })
}

/// A measure in words, how it is read, and its digits behind the point.
type Shown = (&'static str, fn(&Quality) -> Option<f64>, usize);

const SHOWN: [Shown; 4] = [
    ("PSNR, dB", |q| Some(q.psnr), 2),
    ("SSIM", |q| Some(q.ssim), 3),
    ("error of depth, scene units", |q| Some(q.depth), 4),
    ("never seen, %", |q| q.unseen.map(|share| 100.0 * share), 2),
];

/// Student's factor of the interval of 95 % of a mean of `count` values, rounded up between tabulated numbers.
fn student(count: usize) -> f64 {
    let factors = [(24, 2.069), (20, 2.093), (15, 2.145), (12, 2.201), (10, 2.262), (6, 2.571), (5, 2.776), (3, 4.303)];
    factors.into_iter().find(|(least, _)| count >= *least).map_or(f64::INFINITY, |(_, factor)| factor)
}

fn tables(runs: &Runs) -> String {
    let mut out = String::new();
    for (name, value, digits) in SHOWN {
        out += &format!(
            "**{name}** at {END} images. The last two columns are means over scenes: at {END} \
            images, and what log det gains on it there, paired by scene and seed, with the interval of 95 %.\n\n"
        );
        let mut head = vec!["strategy".to_owned()];
        head.extend(SCENES.iter().map(|scene| scene.name.to_owned()));
        head.extend(["mean".to_owned(), "log det less this".to_owned()]);
        let mut table = Table::new(&head.iter().map(String::as_str).collect::<Vec<_>>());
        let of = |strategy: usize, scene: usize| -> Option<Vec<f64>> {
            runs.0.iter().map(|seed| seed[scene][strategy].reached.last().and_then(value)).collect()
        };
        let log_det = STRATEGIES.iter().position(|s| *s == Strategy::LogDet).expect("one of them");
        for (s, strategy) in STRATEGIES.iter().enumerate() {
            let scenes: Vec<Option<Vec<f64>>> = (0..SCENES.len()).map(|scene| of(s, scene)).collect();
            let mut cells = vec![strategy.name().to_owned()];
            cells.extend(
                scenes
                    .iter()
                    .map(|values| values.as_ref().map_or(String::new(), |values| format!("{:.digits$}", mean(values)))),
            );
            let all: Vec<f64> = scenes.iter().flatten().flatten().copied().collect();
            let own: Vec<f64> = (0..SCENES.len()).filter_map(|scene| of(log_det, scene)).flatten().collect();
            let paired: Vec<f64> = own.iter().zip(&all).map(|(own, other)| own - other).collect();
            let half = student(paired.len()) * deviation(&paired) / (paired.len() as f64).sqrt();
            cells.push(format!("{:.digits$}", mean(&all)));
            cells.push(if s == log_det {
                String::new()
            } else {
                format!("{:+.digits$} ± {half:.digits$}", mean(&paired))
            });
            table.row(&cells);
        }
        out += table.text();
        out += "\n";
    }
    out += "**PSNR by the number of images**, mean over scenes and seeds.\n\n";
    let mut head = vec!["strategy".to_owned()];
    head.extend((1..=STAGES).map(|stage| (START + TAKE * stage).to_string()));
    let mut table = Table::new(&head.iter().map(String::as_str).collect::<Vec<_>>());
    for (s, strategy) in STRATEGIES.iter().enumerate() {
        let mut cells = vec![strategy.name().to_owned()];
        cells.extend((0..STAGES).map(|stage| {
            let all: Vec<f64> = runs.0.iter().flatten().map(|rows| rows[s].reached[stage].psnr).collect();
            format!("{:.2}", mean(&all))
        }));
        table.row(&cells);
    }
    out + table.text()
}
