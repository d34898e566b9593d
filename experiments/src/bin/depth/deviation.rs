//! The deviation of `depth`: fitted on two meshes, judged on others, on lego and on photographs of a room, for volumes
//! and splats, on held-out views and on those of the training, which the verb writes.

use std::path::Path;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use glam::Vec3;
use octobayes::estimate::{Estimation, Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::posterior::{DataScale, Scale};
use octobayes::render::{RayAverage, Renderer};
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_depth::{DepthDeviation, LEVEL, Sweep, TrainingViews};
use octobayes_evaluation::metrics::{ErrorKind, PROBABILITIES, normal, sparsification};
use octobayes_evaluation::{Baseline, Evaluator, Measure, PixelKind, Reading, TrueView};
use octobayes_train::{SplatSettings, SplatTrainer, Training};
use serde::{Deserialize, Serialize};

use common::table::{Table, mean};

use crate::judge::{self, LEVELS};
use crate::scene::{Data, Scene};

/// One held-out view in so many counts.
pub const EVERY: usize = 2;
/// Pixels of each row of scenes by which factors and exponents are fitted.
const KEPT: usize = 4000;
/// Nominal probabilities of the table, the first of [`PROBABILITIES`].
const NOMINAL: usize = 4;
/// Names of the measures, in the order of [`Row::ause`].
const MEASURES: [&str; 4] = ["default", "field alone", "with images", "ensemble of five"];

/// How a scene is modelled.
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Kind {
    Volume,
    Splats,
}

/// Some views of a model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    /// Whether the model was trained on them.
    pub are_own: bool,
    /// Median error of depth, scene units.
    pub error: f64,
    /// AUSE by mean absolute and root mean square error, of [`MEASURES`].
    pub ause: [[f64; 2]; MEASURES.len()],
    /// Share of errors within nominal intervals, as if errors were normal: of the spread of the weights alone, and of
    /// both deviations.
    pub held: [[f64; NOMINAL]; 3],
    /// Error and terms of some pixels.
    pub kept: Vec<[f32; 5]>,
}

/// Trains a model of a scene, and judges its deviations.
pub fn measure(scene: &Scene, kind: Kind, seed: u64, others: u64) -> Result<Vec<Row>> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(folder.path())?;
    if kind == Kind::Splats {
        return of_splats(scene, &data, seed);
    }
    let model = scene.train(&data, seed)?;
    let members = (1..=others).map(|i| scene.train(&data, 1000 + 100 * seed + i)).collect::<Result<Vec<_>>>()?;
    let (fields, _) = judge::uncertainties(&data, &model.field, model.psnr, judge::rays().seed(seed))?;
    let settings = RaySettings::for_images();
    let renderer = (&model.field as &dyn Model).for_images(&settings, &Silent)?;
    let members = members.iter().map(|other| (&other.field as &dyn Model).for_images(&settings, &Silent));
    let members = members.collect::<Result<Vec<_>>>()?;
    judge_views(&data, &*renderer, &members.iter().map(|member| &**member).collect::<Vec<_>>(), &fields)
}

fn of_splats(scene: &Scene, data: &Data, seed: u64) -> Result<Vec<Row>> {
    let bounds = *data.domain.bounds().ok_or_else(|| Error::setting("domain", "a box", "all of space"))?;
    let settings = SplatSettings::default().most(SplatSettings::most_for(data.shots())).seed(seed);
    let mut trainer = SplatTrainer::new(settings, bounds, &[], data.shots())?;
    while trainer.steps() < scene.steps {
        trainer.step(trainer.steps() as f64 / scene.steps as f64);
    }
    let psnr = trainer.look(data.shots(), usize::MAX, None).map_or(f64::NAN, |quality| quality.psnr);
    let splats = trainer.splats()?;
    let of_data = DataScale::from_cameras(&data.cameras, DataScale::noise_of(psnr), &data.domain)?;
    let field = |level: &u8| -> Result<UncertaintyField> {
        let grid = judge::grid().level(*level).scale(Scale::Data(of_data));
        let run = Estimation::new(&splats, &data.cameras).domain(data.domain).rays(judge::rays().seed(seed));
        Ok(run.grid(grid).run()?.field)
    };
    let fields = LEVELS.iter().map(field).collect::<Result<Vec<_>>>()?;
    let settings = RaySettings::for_images().background(Vec3::ONE);
    let renderer = (&splats as &dyn Model).for_images(&settings, &Silent)?;
    judge_views(data, &*renderer, &[], &fields)
}

/// Judges held-out views, and those of the training, if their depth is known.
fn judge_views(
    data: &Data,
    renderer: &dyn Renderer,
    members: &[&dyn Renderer],
    fields: &[UncertaintyField],
) -> Result<Vec<Row>> {
    let offset = 0.5;
    let cameras: Vec<Camera> = data.strided_cameras(offset);
    let training = TrainingViews::render(renderer, &cameras, offset, &Silent)?;
    let photographs = data.photographs(offset);
    assert_eq!(LEVELS[0], LEVEL, "the field of the deviation");
    let baked = BakedField::unbaked(&fields[0]);
    let alone = DepthDeviation::new(&baked, None)?;
    let joined = DepthDeviation::new(&baked, Some(Sweep::new(&photographs, &training)))?;
    let reading =
        |name: &str, field: &UncertaintyField, averages| Reading { name: name.into(), field: field.clone(), averages };
    let readings =
        [reading("7", &fields[0], Vec::new()), reading("6", &fields[1], vec![RayAverage::USpreadPerRootRay])];
    let mut evaluator = Evaluator::new(renderer, &readings);
    if !members.is_empty() {
        evaluator.members = members.iter().copied().chain([renderer]).collect();
    }
    let measures = evaluator.measures();
    let index = |wanted: Measure| measures.iter().position(|measure| *measure == wanted);
    let default = index(Measure::Reading(1, RayAverage::USpreadPerRootRay)).expect("a reading with an average");
    let ensemble = index(Measure::Baseline(Baseline::EnsembleVariance));
    let jump = octobayes_evaluation::JUMP * DataScale::longest_edge(fields[0].lattice().domain());
    let held_out: Vec<TrueView> = data.held_out_with(offset, 1, jump)?.into_iter().step_by(EVERY).collect();
    let mut rows = Vec::new();
    for (are_own, truths) in [(false, held_out), (true, data.own_views(offset, jump)?)] {
        let (mut errors, mut found) = (Vec::new(), vec![Vec::new(); MEASURES.len() + 1]);
        let (mut terms, mut rounding) = (Vec::new(), 0.0);
        for truth in &truths {
            // One for all maps of a scene.
            rounding = truth.parts.rounding;
            let view = evaluator.evaluate(truth, 0, &Silent)?;
            let object = view.of_kind(PixelKind::Object);
            let by_field = alone.of_view(renderer, &truth.camera, offset, &view.rendered, &Silent)?;
            let of_images = joined.terms(renderer, &truth.camera, offset, &view.rendered, &Silent)?;
            let by_images = joined.of_terms(renderer, &of_images, &view.rendered);
            for (k, &i) in view.pixels.iter().enumerate() {
                if !object.is_none_or(|is| is[k]) || view.rendered.pixels[i].opacity <= 0.5 {
                    continue;
                }
                errors.push(view.absolute_error[k]);
                let value = |m: Option<usize>| m.map_or(f64::NAN, |m| view.measures[m][k]);
                let values = [view.measures[default][k], by_field[i], by_images[i], value(ensemble), view.spread[k]];
                found.iter_mut().zip(values).for_each(|(all, value)| all.push(value));
                let [s, u, b, e] = of_images[i];
                terms.push([view.absolute_error[k], s, u, b, e].map(|v| v as f32));
            }
        }
        if errors.is_empty() {
            continue;
        }
        let area = |values: &[f64], kind| sparsification(values, &errors, kind).map_or(f64::NAN, |found| found.area);
        let held = |sigma: &[f64]| {
            std::array::from_fn(|p| {
                let within = normal::deviations(PROBABILITIES[p]);
                let holds = |(e, s): &(&f64, &f64)| **e <= within * s.hypot(rounding);
                errors.iter().zip(sigma).filter(holds).count() as f64 / errors.len() as f64
            })
        };
        let mut sorted = errors.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        rows.push(Row {
            are_own,
            error: sorted[sorted.len() / 2],
            ause: std::array::from_fn(|m| [ErrorKind::Mae, ErrorKind::Rmse].map(|kind| area(&found[m], kind))),
            held: [MEASURES.len(), 1, 2].map(|m| held(&found[m])),
            kept: terms.iter().step_by(terms.len().div_ceil(KEPT)).copied().collect(),
        });
    }
    Ok(rows)
}

/// A line for each scene and kind of views, and their means.
pub fn table(names: &[String], rows: &[Vec<Row>]) -> String {
    written(names, rows, true)
}

/// The lines alone, of what has no common mean.
pub fn lines(names: &[String], rows: &[Vec<Row>]) -> String {
    written(names, rows, false)
}

fn written(names: &[String], rows: &[Vec<Row>], has_means: bool) -> String {
    let head = [
        "scene",
        "views",
        "median error",
        "AUSE of the default: MAE",
        "RMSE",
        "field alone: MAE",
        "RMSE",
        "with images: MAE",
        "RMSE",
        "ensemble of five: MAE",
        "RMSE",
        "s alone: 50, 68, 90, 95 % hold",
        "field alone",
        "with images",
    ]; // fmt: skip
    let mut table = Table::new(&head);
    let mut line = |name: &str, of: &[&Row]| {
        let average = |value: &dyn Fn(&Row) -> f64| mean(&of.iter().map(|row| value(row)).collect::<Vec<_>>());
        let views = if of[0].are_own { "training" } else { "held-out" };
        let mut cells = vec![name.to_owned(), views.into(), format!("{:.4}", average(&|row| row.error))];
        for m in 0..MEASURES.len() {
            let figure = |by: usize| average(&|row: &Row| row.ause[m][by]);
            cells.extend([0, 1].map(figure).map(|v| if v.is_nan() { "–".into() } else { format!("{v:.3}") }));
        }
        for d in 0..3 {
            let share = |p: usize| format!("{:.1}", 100.0 * average(&|row: &Row| row.held[d][p]));
            cells.push((0..NOMINAL).map(share).collect::<Vec<_>>().join(", "));
        }
        table.row(&cells);
    };
    for (name, rows) in names.iter().zip(rows) {
        rows.iter().for_each(|row| line(name, &[row]));
    }
    for are_own in [false, true] {
        let of: Vec<&Row> = rows.iter().flatten().filter(|row| row.are_own == are_own).collect();
        if has_means && of.len() > 1 {
            line("mean", &of);
        }
    }
    table.text().to_string()
}

/// The exponents and the factor that maximise the likelihood of held-out errors over scenes, which count alike, by
/// Student's t with five degrees of freedom: Fisher's scoring for log σ = Σ w x.
pub fn fit(rows: &[Vec<Row>]) -> String {
    const TERMS: usize = 5;
    let pixels: Vec<[f64; TERMS + 1]> = rows
        .iter()
        .flatten()
        .filter(|row| !row.are_own)
        .flat_map(|row| &row.kept)
        .map(|[error, s, u, b, e]| {
            let [s, u, b, e] = [s, u, b, e].map(|v| f64::from(*v).ln());
            [f64::from(*error), 1.0, s, u, b, e]
        })
        .collect();
    let mut w = [0.0, 0.34, 0.48, 0.18, -0.09];
    let mut information = Mat::<f64>::zeros(TERMS, TERMS);
    for pixel in &pixels {
        for i in 0..TERMS {
            for j in 0..TERMS {
                information[(i, j)] += pixel[1 + i] * pixel[1 + j];
            }
        }
    }
    let factors = information.llt(Side::Lower).expect("terms of many pixels are independent");
    for _ in 0..200 {
        let mut score = Mat::<f64>::zeros(TERMS, 1);
        for pixel in &pixels {
            let x = &pixel[1..];
            let z2 = (pixel[0] / x.iter().zip(w).map(|(x, w)| x * w).sum::<f64>().exp()).powi(2);
            // d/dlog σ of −3 log(1 + z²/3) − log σ.
            let slope = 2.0 * z2 / (1.0 + z2 / 3.0) - 1.0;
            (0..TERMS).for_each(|i| score[(i, 0)] += slope * x[i]);
        }
        // Fisher's information of log σ is 2 ν / (ν + 3) = 1.25 per pixel.
        let step = factors.solve(&score);
        (0..TERMS).for_each(|i| w[i] += step[(i, 0)] / 1.25);
    }
    let names = ["factor (Student's t)", "s", "U′", "b", "1 + e"];
    let mut table = Table::new(&names);
    let value = |i: usize| if i == 0 { format!("{:.2}", w[0].exp()) } else { format!("{:.2}", w[i]) };
    table.row(&(0..TERMS).map(value).collect::<Vec<_>>());
    table.text().to_string()
}
