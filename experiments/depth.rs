//! Question: do depth errors lie within the deviations that a field of the data's scale gives them?
//!
//! Hash grids trained on few views of meshes that are ray-traced here, with exact depth; the deviation of depth of
//! [`UncertaintyField::depth_posterior`] and that of the ray's weights alone, against the error of the median depth on
//! held-out views all around. No constant is fitted. Writes the blocks of `experiments/depth.md`.

mod common;

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::dataset::{DepthEncoding, DepthKind, Frame, Hemisphere, Views};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::evaluate::{
    Baseline, DepthError, DepthFiles, EvaluatedView, Evaluator, Measure, Reading, Score, TrueView,
};
use octobayes::field::{HashGrid, RadianceField};
use octobayes::geometry::{Camera, Domain};
use octobayes::metrics::{ErrorKind, PROBABILITIES};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{GradientMethod, RayAverage};
use octobayes::synth::{DEPTH_PNG_SCALE, DatasetSettings, Up, write_dataset};
use octobayes::train::{DatasetFiles, Selection, TrainSettings, Trainer, quality};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use common::knot::knot;
use common::program::{Needs, Program};
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread};
use common::work::Work;

const SEEDS: [u64; 3] = [0, 1, 2];
const STEPS: u64 = 1000;
/// Side of the images, pixels.
const SIDE: u32 = 200;
/// Views around a mesh, of which a scene takes some.
const VIEWS: u32 = 40;
const TEST_VIEWS: u32 = 20;
/// Every so many pixels of a held-out view are compared, along x and y.
const STRIDE: u32 = 2;
/// Pixels of training images by which their noise is measured, about.
const PIXELS: usize = 20_000;

/// Which views of a mesh a model is trained on.
#[derive(Clone, Copy)]
enum Seen {
    Few(usize),
    Half,
}

/// A mesh, which way up it stands, and what was seen of it.
type Case = (&'static str, Up, Seen);

fn main() -> Result<()> {
    let program = Program::start("depth", &[("built-in", Needs::Nothing), ("meshes", Needs::Data)])?;
    program.part("built-in", |work| study(work, &[("knot", Up::Z, Seen::Few(8)), ("knot", Up::Z, Seen::Half)]))?;
    program.part("meshes", |work| {
        let cases = [
            ("spot", Up::Y, Seen::Few(8)),
            ("spot", Up::Y, Seen::Half),
            ("armadillo", Up::Y, Seen::Few(8)),
            ("stanford-bunny", Up::Y, Seen::Half),
            ("nefertiti", Up::Z, Seen::Few(8)),
        ];
        study(work, &cases)
    })
}

/// One deviation of depth.
#[derive(Serialize, Deserialize)]
struct Bar {
    /// Shares of errors within the intervals of [`PROBABILITIES`].
    held: [f64; 4],
    auce: f64,
    /// Student's t: with the deviations as they are, and with the best common scale.
    nll: [f64; 2],
}

/// One model.
#[derive(Serialize, Deserialize)]
struct Row {
    psnr: f64,
    /// Median error of depth, scene units.
    error: f64,
    /// Of the posterior, and of the ray's weights alone.
    bars: [Bar; 2],
    /// AUSE by mean absolute error: `spread`, the deviation, the ray's weights alone, chance.
    ause: [f64; 4],
}

fn grid() -> GridSettings {
    GridSettings::default().level(7).covariance(Covariance::Block)
}

fn rays() -> RaySettings {
    RaySettings::default().rays(480_000).gradient(GradientMethod::Auto)
}

fn study(work: &Work, cases: &[Case]) -> Result<(String, String)> {
    let mut table = Table::new(&[
        "scene",
        "PSNR, dB",
        "median error",
        "deviation",
        "50 %",
        "68 %",
        "90 %",
        "95 %",
        "AUCE",
        "NLL, Student",
        "best scale",
        "AUSE (MAE)",
        "`spread`",
        "chance",
    ]);
    let mut all: Vec<Vec<Row>> = Vec::new();
    for case in cases {
        let name = name(case);
        let of = |seed| work.row((&name, seed), || measure(case, seed));
        all.push(SEEDS.into_iter().map(of).collect::<Result<_>>()?);
        add(&mut table, &name, &all[all.len() - 1].iter().collect::<Vec<_>>());
    }
    if cases.len() > 2 {
        // The seeds' means over the scenes.
        add(&mut table, "all", &all.iter().flatten().collect::<Vec<_>>());
    }
    let described = describe(&rays(), &grid(), &[]);
    let images =
        format!("{SIDE} × {SIDE} pixels, {STEPS} steps; every {STRIDE}nd pixel of {TEST_VIEWS} held-out views.");
    Ok((format!("{images} {described} {}", seeds(&SEEDS)), table.text().into()))
}

/// Two rows: the posterior's deviation, and that of the weights.
fn add(table: &mut Table, name: &str, rows: &[&Row]) {
    for (b, deviation) in ["posterior and weights", "weights alone"].into_iter().enumerate() {
        let of =
            |value: &dyn Fn(&Row) -> f64, digits| spread(&rows.iter().map(|r| value(r)).collect::<Vec<_>>(), digits);
        let held: Vec<String> = (0..PROBABILITIES.len()).map(|p| of(&|row| 100.0 * row.bars[b].held[p], 1)).collect();
        let first = |text: String| if b == 0 { text } else { String::new() };
        let mut cells =
            vec![first(name.into()), first(of(&|row| row.psnr, 2)), first(of(&|row| row.error, 4)), deviation.into()];
        cells.extend(held);
        cells.extend([
            of(&|row| row.bars[b].auce, 3),
            of(&|row| row.bars[b].nll[0], 2),
            of(&|row| row.bars[b].nll[1], 2),
            of(&|row| row.ause[1 + b], 3),
            first(of(&|row| row.ause[0], 3)),
            first(of(&|row| row.ause[3], 3)),
        ]);
        table.row(&cells);
    }
}

fn name(&(mesh, _, seen): &Case) -> String {
    match seen {
        Seen::Few(views) => format!("{mesh}, {views} views"),
        Seen::Half => format!("{mesh}, left half"),
    }
}

/// A folder of its own with the images of a mesh.
fn images(folder: &Path, mesh: &str, up: Up) -> Result<()> {
    let file = if mesh == "knot" {
        let file = folder.with_extension("obj");
        std::fs::write(&file, knot()).map_err(Error::io(&file, "cannot write"))?;
        file
    } else {
        Program::data()?.join(format!("meshes/{mesh}.obj"))
    };
    let settings = DatasetSettings::default().up(up).views(VIEWS).test_views(TEST_VIEWS).resolution([SIDE; 2]);
    write_dataset(&file, folder, &settings.samples_per_side(2), &Silent)?;
    Ok(())
}

fn measure(&(mesh, up, seen): &Case, seed: u64) -> Result<Row> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let folder = folder.path().join("images");
    images(&folder, mesh, up)?;
    let mut files = DatasetFiles::read(&folder)?;
    match seen {
        Seen::Few(views) => files.select(&Selection::Count(views), None)?,
        Seen::Half => files.select(&Selection::All, Some(Hemisphere::Left))?,
    }
    let [shots, _] = files.load(&Silent)?;
    let domain = Domain::Box(files.bounds);
    let mut trainer = Trainer::new(TrainSettings::default().seed(seed), domain, &shots)?;
    while trainer.steps() < STEPS {
        trainer.step(trainer.steps() as f64 / STEPS as f64);
    }
    let field: HashGrid = trainer.field(serde_json::Value::Null);
    let psnr = quality(&field, &shots, Vec3::ONE, PIXELS).map_or(f64::NAN, |quality| quality.psnr);
    let cameras: Vec<Camera> = shots.iter().map(|shot| shot.camera).collect();
    let data = DataScale::from_cameras(&cameras, DataScale::noise_of(psnr), &domain)?;
    let grid = grid().scale(Scale::Data(data));
    let estimation = Estimation::new(&field, &cameras).rays(rays().seed(seed)).grid(grid);
    let uncertainty = estimation.run()?.field;
    judge(&field, &folder, uncertainty)
}

/// The errors on held-out views, and what was said of them.
fn judge(field: &HashGrid, folder: &Path, uncertainty: UncertaintyField) -> Result<Row> {
    let settings = RaySettings::for_images();
    let differentiation = settings.differentiation(field, uncertainty.lattice())?;
    let readings = [Reading { name: "block".into(), field: uncertainty, averages: vec![RayAverage::Spread] }];
    let evaluator = Evaluator {
        tracer: settings.tracer(field, 0.0, &Silent)?,
        readings: &readings,
        differentiation: Some(differentiation),
        members: Vec::new(),
    };
    let encoding = DepthEncoding { offset: 0.0, scale: DEPTH_PNG_SCALE, kind: DepthKind::Euclidean };
    let depth = DepthFiles { folder: folder.join("depth"), pattern: "{}.png".into(), encoding };
    let frames: Vec<Frame> = Views::read(&folder.join("transforms_test.json"), None)?.frames;
    let evaluate = |(seed, frame): (u64, &Frame)| {
        let truth = TrueView::read(frame, Some(&depth), DVec3::ONE, field.pixel_offset(), STRIDE)?;
        evaluator.evaluate(&truth, seed, &Silent)
    };
    let views = (0..).zip(&frames).map(evaluate).collect::<Result<Vec<EvaluatedView>>>()?;
    let measures = evaluator.measures();
    let index = |measure| measures.iter().position(|found| *found == measure).expect("a measure of this evaluator");
    let [posterior, weights] = [Measure::DepthDeviation(0), Measure::Baseline(Baseline::RayVariance)].map(index);
    let nothing = || Error::malformed(folder, "views", "errors of depth, and finite deviations", "none");
    let bar = |m| -> Result<Bar> {
        let found = evaluator.calibration(&views, m).ok_or_else(nothing)?;
        let nll = [found.nll[2], found.nll_best_scale[2]];
        Ok(Bar { held: found.coverage.map(|[_, share]| share), auce: found.auce, nll })
    };
    let area = |m| Score::new(&views, m).map(|score| score.area(ErrorKind::Mae)).ok_or_else(nothing);
    let chance = index(Measure::Baseline(Baseline::Random));
    let first = index(Measure::Reading(0, RayAverage::Spread));
    Ok(Row {
        psnr: mean(&views.iter().map(|view| view.psnr).collect::<Vec<_>>()),
        error: DepthError::new(&views).ok_or_else(nothing)?.median,
        bars: [bar(posterior)?, bar(weights)?],
        ause: [area(first)?, area(posterior)?, area(weights)?, area(chance)?],
    })
}
