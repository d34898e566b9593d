//! Where the intervals of depth fail, and which of them training views confirm.

use std::path::Path;

use glam::DVec3;
use octobayes::estimate::{Estimation, RaySettings};
use octobayes::field::TrainedField;
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes::posterior::{DataScale, Scale};
use octobayes::render::VolumeRenderer;
use octobayes::{Error, Result};
use octobayes_depth::{CONFIRMING_VIEWS, TrainingImage, TrainingViews, compare_images};
use octobayes_evaluation::metrics::{Calibration, PROBABILITIES};
use octobayes_evaluation::{EvaluatedView, Evaluator, Measure, Reading, TrueView};
use serde::{Deserialize, Serialize};

use crate::judge::{STRIDE, grid};
use crate::scene::{Data, LEGO_STEP};
use common::table::{Table, mean, spread};

/// Pixels whose true depth differs by more than this share of it within two pixels are at an edge.
const EDGE: f64 = 0.02;
/// Standard deviation of the training images' colours of a point above which its look depends on the direction, or no
/// surface is there.
const GLOSS: f64 = 0.1;
/// Root mean square error of a pixel's colour above which the model is wrong there.
const WRONG: f64 = 0.1;
/// Cells along an axis of the box, by which misses are gathered.
const CELLS: f64 = 16.0;
/// Share of the pixels that are called the worst part.
const WORST: f64 = 0.05;
/// Index of the probability by which a pixel is a miss: 90 %.
const MISS: usize = 2;

/// What a pixel may be, beside its interval.
const CAUSES: [&str; 7] = [
    "within two pixels of a depth edge",
    "training images differ by more than 0.1 there",
    "expected depth outside the median's interval of 68 %",
    "opacity below 0.95",
    "held-out colour wrong by more than 0.1",
    "the model's surface is before the true one",
    "the worst 5 % of the pixels, by place",
];

/// Coverage of the intervals.
pub type Held = [f64; PROBABILITIES.len()];

/// One model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    psnr: f64,
    /// Shares of the pixels that training views confirm, and of those whose colour images agree on, too.
    shares: [f64; 2],
    /// Plain and with residuals, over all pixels and these parts.
    held: [[Held; 2]; 3],
    /// Plain, of expected depth instead of the median.
    expected: Held,
    /// Plain, if the truth had lego's steps.
    stepped: Held,
    /// Of each of [`CAUSES`]: share of pixels, and of misses.
    causes: Vec<[f64; 2]>,
}

/// What is known of all judged pixels.
#[derive(Default)]
struct Pixels {
    /// Median depth less the truth, expected depth less the truth, and the truth.
    error: Vec<f64>,
    expected: Vec<f64>,
    truth: Vec<f64>,
    /// Plain, and with residuals; without the steps of the truth.
    variance: [Vec<f64>; 2],
    confirmed: Vec<bool>,
    photo_consistent: Vec<bool>,
    causes: [Vec<bool>; CAUSES.len()],
    /// Cell of the true point.
    cell: Vec<[i32; 3]>,
}

/// Judges a model of that PSNR on its training images.
pub fn judge(data: &Data, field: &dyn TrainedField, psnr: f64, rays: RaySettings) -> Result<Row> {
    let domain = Domain::Box(field.bounds());
    let of_data = DataScale::from_cameras(&data.cameras, DataScale::noise_of(psnr), &domain)?;
    let run = Estimation::new(&field, &data.cameras).rays(rays).grid(grid().scale(Scale::Data(of_data))).run()?;
    let offset = field.pixel_offset();
    let settings = RaySettings::for_images();
    let differentiation = settings.differentiation(field, run.field.lattice())?;
    let tracer = settings.tracer(field, 0.0, &Silent)?;
    let plain = VolumeRenderer { tracer: tracer.clone(), differentiation: None };
    let model = VolumeRenderer { differentiation: Some(differentiation), ..plain.clone() };
    let training = TrainingViews::render(&plain, &data.strided_cameras(offset), offset, &Silent)?;
    let images = data.for_residuals(offset);
    let compared = compare_images(&plain, images.iter().cloned().map(Ok), run.field.lattice(), &Silent)?;
    let look = |image: TrainingImage| {
        let seen = TrainingViews::render(&plain, &[image.camera], offset, &Silent)?;
        Ok(Look { image, seen })
    };
    let looks = images.into_iter().map(look).collect::<Result<Vec<_>>>()?;
    let with_images = compared.join(run.field.clone())?;
    let reading = |name: &str, field| Reading { name: name.into(), field, averages: Vec::new() };
    let readings = [reading("plain", run.field), reading("with images", with_images)];
    let evaluator = Evaluator { training: Some(&training), ..Evaluator::new(&model, &readings) };
    let measures = evaluator.measures();
    let [of_plain, of_residuals] = [0, 1].map(|r| measures.iter().position(|m| *m == Measure::DepthDeviation(r)));
    let deviations =
        of_plain.zip(of_residuals).ok_or_else(|| Error::setting("field", "deviations of depth", "none"))?;
    let bounds = field.bounds();
    let (mut pixels, mut psnr) = (Pixels::default(), Vec::new());
    for (seed, truth) in (0..).zip(data.held_out(offset, STRIDE)?) {
        let view = evaluator.evaluate(&truth, seed, &Silent)?;
        psnr.push(view.psnr);
        let in_box =
            |x: DVec3| ((x - bounds.min()) / (bounds.max() - bounds.min()) * CELLS).floor().as_ivec3().to_array();
        pixels.add(&truth, &view, [deviations.0, deviations.1], &looks, in_box);
    }
    pixels
        .row(mean(&psnr), data.depth_step.powi(2) / 12.0)
        .ok_or_else(|| Error::malformed(Path::new("held-out views"), "depth", "errors, and finite deviations", "none"))
}

impl Pixels {
    fn add(
        &mut self,
        truth: &TrueView,
        view: &EvaluatedView,
        deviations: [usize; 2],
        looks: &[Look],
        cell: impl Fn(DVec3) -> [i32; 3],
    ) {
        let [width, height] = truth.camera.resolution.map(|n| n as usize);
        self.confirmed.extend(&view.confirmed);
        self.photo_consistent.extend(&view.photo_consistent);
        for (k, &i) in view.pixels.iter().enumerate() {
            let (Some(distance), pixel) = (truth.distance[i], &view.rendered.pixels[i]) else { continue };
            let [x, y] = [i % width, i / width];
            let ray = truth.camera.ray(x as f64 + truth.pixel_offset, y as f64 + truth.pixel_offset);
            let neighbours = (y.saturating_sub(1)..=(y + 1).min(height - 1))
                .flat_map(|y| (x.saturating_sub(1)..=(x + 1).min(width - 1)).map(move |x| y * width + x));
            // Pixels of the truth are two of the image apart.
            let mut depths = neighbours.map(|i| truth.distance[i]);
            let at_edge = depths.any(|d| d.is_none_or(|d| (d - distance).abs() > EDGE * distance));
            let [plain, of_residuals] = deviations.map(|m| view.measures[m][k].powi(2));
            self.error.push(pixel.median_depth - distance);
            self.expected.push(pixel.expected_depth - distance);
            self.truth.push(distance);
            self.variance[0].push(plain);
            self.variance[1].push(of_residuals);
            self.cell.push(cell(ray.at(distance)));
            let wrong = (pixel.color - truth.colors[i]).length() / 3.0_f64.sqrt();
            let causes = [
                at_edge,
                gloss(ray.at(distance), looks) > GLOSS,
                (pixel.expected_depth - pixel.median_depth).abs() > 0.8 * plain.sqrt(),
                pixel.opacity < 0.95,
                wrong > WRONG,
                pixel.median_depth < distance,
                false,
            ];
            self.causes.iter_mut().zip(causes).for_each(|(all, is)| all.push(is));
        }
    }

    fn row(mut self, psnr: f64, of_truth: f64) -> Option<Row> {
        let every = vec![true; self.error.len()];
        let held = |errors: &[f64], variance: &[f64], of_truth: f64, which: &[bool]| {
            let pairs = errors.iter().zip(variance).zip(which).filter(|(_, is)| **is);
            let (e, s): (Vec<f64>, Vec<f64>) = pairs.map(|((e, v), _)| (e.abs(), (v + of_truth).sqrt())).unzip();
            Calibration::new(&e, &s).map(|found| found.predictive().coverage.map(|[_, share]| share))
        };
        let all = |which: &[bool]| -> Option<[Held; 2]> {
            let [plain, of_residuals] = &self.variance;
            Some([held(&self.error, plain, of_truth, which)?, held(&self.error, of_residuals, of_truth, which)?])
        };
        // Like lego's maps: rounded to steps, which the deviation counts.
        let stepped = |(error, truth): (&f64, &f64)| error + truth - (truth / LEGO_STEP).round() * LEGO_STEP;
        let stepped: Vec<f64> = self.error.iter().zip(&self.truth).map(stepped).collect();
        let misses = self.misses(of_truth)?;
        self.causes[CAUSES.len() - 1] = self.worst(&misses);
        let share = |is: &dyn Fn(usize) -> bool, of: &[bool]| {
            let counted = (0..of.len()).filter(|&i| of[i]);
            counted.clone().filter(|&i| is(i)).count() as f64 / counted.count().max(1) as f64
        };
        let cause = |cause: &Vec<bool>| [share(&|i| cause[i], &every), share(&|i| cause[i], &misses)];
        Some(Row {
            psnr,
            shares: [&self.confirmed, &self.photo_consistent].map(|part| share(&|i| part[i], &every)),
            held: [all(&every)?, all(&self.confirmed)?, all(&self.photo_consistent)?],
            expected: held(&self.expected, &self.variance[0], of_truth, &every)?,
            stepped: held(&stepped, &self.variance[0], LEGO_STEP.powi(2) / 12.0, &every)?,
            causes: self.causes.iter().map(cause).collect(),
        })
    }

    /// The pixels outside their plain interval of [`MISS`].
    fn misses(&self, of_truth: f64) -> Option<Vec<bool>> {
        let is_miss = |(error, variance): (&f64, &f64)| {
            let found = Calibration::new(&[error.abs()], &[(variance + of_truth).sqrt()])?;
            Some(found.predictive().coverage[MISS][1] < 0.5)
        };
        self.error.iter().zip(&self.variance[0]).map(is_miss).collect()
    }

    /// The cells with the largest shares of misses, until they have [`WORST`] of the pixels.
    fn worst(&self, misses: &[bool]) -> Vec<bool> {
        let mut cells = std::collections::BTreeMap::<[i32; 3], [usize; 2]>::new();
        for (cell, miss) in self.cell.iter().zip(misses) {
            let counts = cells.entry(*cell).or_default();
            *counts = [counts[0] + 1, counts[1] + usize::from(*miss)];
        }
        let mut cells: Vec<([i32; 3], [usize; 2])> = cells.into_iter().collect();
        cells.sort_by(|(_, [n, a]), (_, [m, b])| (b * n).cmp(&(a * m)).then(m.cmp(n)));
        let most = (WORST * misses.len() as f64) as usize;
        let mut taken = std::collections::BTreeSet::new();
        let mut count = 0;
        for (cell, [n, _]) in cells {
            if count + n <= most {
                count += n;
                taken.insert(cell);
            }
        }
        self.cell.iter().map(|cell| taken.contains(cell)).collect()
    }
}

/// A training image, and what its camera sees of the model.
struct Look {
    image: TrainingImage,
    seen: TrainingViews,
}

impl Look {
    /// The image's colour at a point where its camera sees the model's surface.
    fn color(&self, x: DVec3) -> Option<DVec3> {
        let camera = &self.image.camera;
        let ([column, row], _) = camera.project(x)?;
        let is_seen = self.seen.sighting(x).agreeing > 0;
        is_seen.then(|| self.image.colors[row as usize * camera.resolution[0] as usize + column as usize])
    }
}

/// Standard deviation of the colours that training images have of a point; 0 if none has it.
fn gloss(x: DVec3, looks: &[Look]) -> f64 {
    let colors: Vec<DVec3> = looks.iter().filter_map(|look| look.color(x)).collect();
    let mean = colors.iter().copied().sum::<DVec3>() / colors.len().max(1) as f64;
    let squares: f64 = colors.iter().map(|c| (*c - mean).length_squared() / 3.0).sum();
    (squares / colors.len().max(1) as f64).sqrt()
}

/// Coverage of all pixels, of the confirmed ones, and of those on whose colour images agree, too.
pub fn coverage(names: &[String], rows: &[Vec<Row>]) -> String {
    let head = ["model", "PSNR, dB", "pixels", "share", "50, 68, 90, 95 %", "with `--images`"];
    let mut table = Table::new(&head);
    let percent = |values: &[f64], digits| spread(&values.iter().map(|v| 100.0 * v).collect::<Vec<_>>(), digits);
    for (name, rows) in names.iter().zip(rows) {
        let of = |value: &dyn Fn(&Row) -> f64| rows.iter().map(value).collect::<Vec<f64>>();
        let held = |which: usize, kind: usize| {
            let of = |p: usize| percent(&of(&|row| row.held[which][kind][p]), 1);
            (0..PROBABILITIES.len()).map(of).collect::<Vec<_>>().join(", ")
        };
        table.row(&[name.clone(), spread(&of(&|row| row.psnr), 2), "all".into(), "100".into(), held(0, 0), held(0, 1)]);
        for (k, part) in ["confirmed", "and of one colour"].into_iter().enumerate() {
            let share = percent(&of(&|row| row.shares[k]), 1);
            table.row(&[String::new(), String::new(), part.into(), share, held(k + 1, 0), held(k + 1, 1)]);
        }
    }
    format!(
        "### Coverage where {CONFIRMING_VIEWS} training views see a surface at that depth, and images agree on its \
         colour\n\n{}",
        table.text()
    )
}

/// What misses have in common.
pub fn causes(names: &[String], rows: &[Vec<Row>]) -> String {
    let mut table = Table::new(
        &[&["of pixels / of misses, %"], names.iter().map(String::as_str).collect::<Vec<_>>().as_slice()].concat(),
    );
    let mean_of = |rows: &[Row], value: &dyn Fn(&Row) -> f64| mean(&rows.iter().map(value).collect::<Vec<_>>());
    for (i, cause) in CAUSES.iter().enumerate() {
        let cell = |rows: &Vec<Row>| {
            let [pixels, misses] = [0, 1].map(|k| 100.0 * mean_of(rows, &|row| row.causes[i][k]));
            format!("{pixels:.0} / {misses:.0}")
        };
        table.row(&[vec![(*cause).to_owned()], rows.iter().map(cell).collect()].concat());
    }
    let held = |row: &Row| [row.held[0][0], row.expected, row.stepped];
    let of = ["plain", "of expected depth instead of the median", "against a truth in lego's steps"];
    for (k, of) in of.into_iter().enumerate() {
        let cell = |rows: &Vec<Row>| {
            let of = |p: usize| format!("{:.0}", 100.0 * mean_of(rows, &|row| held(row)[k][p]));
            [1, 2, 3].map(of).join(", ")
        };
        table.row(&[vec![format!("coverage of 68, 90, 95 %: {of}")], rows.iter().map(cell).collect()].concat());
    }
    format!("### What the misses have in common\n\n{}", table.text())
}
