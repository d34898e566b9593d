//! What it costs to leave correlations between vertices out: the full posterior beside its blocks, from the same rays.

use std::path::Path;

use glam::DVec3;
use octobayes::estimate::{Estimation, RaySettings};
use octobayes::field::TrainedField;
use octobayes::metrics::quantile;
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{DepthProbe, DepthVariance, Probe, RayAverage, render_view_with_depth};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_evaluation::metrics::{Calibration, ErrorKind, PROBABILITIES, sparsification};
use serde::{Deserialize, Serialize};

use crate::full::{DrawnPosterior, Draws, ExactPosterior, FullPosterior};
use crate::judge::{grid, rays};
use crate::scene::{Data, Scene};
use common::clock::Clock;
use common::settings::describe;
use common::table::{Table, mean, whole};

pub const LEVELS: [u8; 3] = [4, 5, 6];
/// Every row of J is kept.
const RAYS: u64 = 120_000;
/// Every so many pixels of a held-out view are compared, along x and y.
const STRIDE: u32 = 4;
const DRAWS: Draws = Draws { number: 32, seed: 0, residual: 1e-2, iterations: 400 };
const NAMES: [&str; 3] = ["diagonal", "block", "full"];

/// One posterior on one scene and level.
#[derive(Clone, Serialize, Deserialize)]
struct Judged {
    /// AUSE of √Var by MAE and RMSE, and of √(Var + s²).
    alone: [f64; 2],
    whole: [f64; 2],
    /// AUSE of the geometric mean of √Var and the blocks' U s.
    mixed: [f64; 2],
    /// Shares of errors within the intervals of √(Var + s²).
    held: [f64; PROBABILITIES.len()],
    nll: f64,
    /// log10 of the full σ over this one, over the touched vertices: median, 10th and 90th of a hundred.
    lost: [f64; 3],
    /// Median √Var of the pixels, scene units.
    deviation: f64,
}

/// One scene at one level.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    scene: String,
    level: u8,
    vertices: usize,
    /// Iterations of conjugate gradients; none if the inverse was exact.
    iterations: Option<usize>,
    judged: Vec<Judged>,
    /// AUSE of the blocks' U s by MAE and RMSE.
    spread: [f64; 2],
    /// Processor seconds of the rays, and of the full posterior.
    seconds: [f64; 2],
}

/// The exact inverse if it fits, else draws.
enum Full {
    Exact(ExactPosterior),
    Drawn(DrawnPosterior),
}

impl Full {
    fn deviation(&self, point: [u32; 3]) -> f64 {
        match self {
            Self::Exact(full) => full.deviation(point),
            Self::Drawn(full) => full.deviation(point),
        }
    }

    fn variance(&self) -> &dyn DepthVariance {
        match self {
            Self::Exact(full) => full,
            Self::Drawn(full) => full,
        }
    }
}

pub fn measure(scene: &Scene, level: u8) -> Result<Row> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(folder.path())?;
    let model = scene.train(&data, 0)?;
    let scale = DataScale::from_cameras(&data.cameras, DataScale::noise_of(model.psnr), &data.domain)?;
    let grid = grid().level(level).scale(Scale::Data(scale));
    let lattice = grid.lattice(data.domain)?;
    let mut full = FullPosterior::new(lattice);
    let clock = Clock::start();
    let estimation =
        Estimation::new(&model.field, &data.cameras).rays(rays().rays(RAYS)).grid(grid).domain(data.domain);
    let outcome = estimation
        .tap(|batches| {
            full.add(batches);
            Ok(())
        })
        .run()?;
    let summed = clock.elapsed().cpu;
    let (field, drawn) = (outcome.field, outcome.progress.rays);
    let clock = Clock::start();
    let (whole, iterations) = if full.vertices() <= FullPosterior::MOST_VERTICES {
        (Full::Exact(full.exact(drawn, scale)?), None)
    } else {
        let found = full.draw(drawn, scale, DRAWS)?;
        let iterations = found.iterations;
        (Full::Drawn(found), Some(iterations))
    };
    let seconds = [summed, clock.elapsed().cpu];
    let diagonal = field.clone().with_covariance(Covariance::Diagonal)?;
    let posteriors = [diagonal.depth_posterior()?, field.depth_posterior()?];
    let variances: [&dyn DepthVariance; 3] = [&posteriors[0], &posteriors[1], whole.variance()];
    let depths = Depths::of(&data, &model.field, &field, &variances)?;
    let points = full.points();
    let of_full: Vec<f64> = points.iter().map(|&point| whole.deviation(point).log10()).collect();
    let lost = |own: &dyn Fn(usize) -> f64| {
        let mut lost: Vec<f64> = of_full.iter().enumerate().map(|(i, full)| full - own(i)).collect();
        lost.sort_unstable_by(f64::total_cmp);
        [0.5, 0.1, 0.9].map(|share| quantile(&lost, share))
    };
    let at = |i: usize| lattice.position(DVec3::from(points[i].map(f64::from))).as_vec3();
    let lost = [lost(&|i| diagonal.log10(at(i))), lost(&|i| field.log10(at(i))), [0.0; 3]];
    let judged: Option<Vec<_>> = (0..NAMES.len()).map(|p| depths.judge(p, lost[p])).collect();
    let (spread, vertices) = (depths.areas(&depths.spread), full.vertices());
    let (Some(judged), Some(spread)) = (judged, spread) else {
        return Err(Error::malformed(&data.folder, "views", "errors of depth", "none"));
    };
    Ok(Row { scene: scene.name(), level, vertices, iterations, judged, spread, seconds })
}

/// Of the pixels that show matter: errors of depth, and by each posterior Var and √(Var + s²).
#[derive(Default)]
struct Depths {
    errors: Vec<f64>,
    variances: [Vec<f64>; NAMES.len()],
    deviations: [Vec<f64>; NAMES.len()],
    /// log10 of the blocks' U s.
    spread: Vec<f64>,
}

impl Depths {
    fn of(
        data: &Data,
        model: &dyn TrainedField,
        field: &UncertaintyField,
        posteriors: &[&dyn DepthVariance; NAMES.len()],
    ) -> Result<Self> {
        let settings = RaySettings::for_images();
        let tracer = settings.tracer(model, 0.0, &Silent)?;
        let spread = [Probe { field, averages: &[RayAverage::USpread] }];
        let probe =
            DepthProbe { differentiation: settings.differentiation(model, field.lattice())?, variances: posteriors };
        let mut found = Self::default();
        let offset = model.pixel_offset();
        for truth in data.held_out(offset, STRIDE)? {
            let view = render_view_with_depth(&tracer, &truth.camera, offset, &spread, &probe, &Silent)?;
            for (i, pixel) in view.pixels.iter().enumerate().filter(|(_, pixel)| pixel.opacity > 0.0) {
                let Some(distance) = truth.distance[i] else { continue };
                if view.posterior_variance.iter().any(|variance| variance[i].is_nan()) {
                    continue;
                }
                found.errors.push((pixel.median_depth - distance).abs());
                found.spread.push(view.log10_uncertainty[0][i]);
                for p in 0..NAMES.len() {
                    found.variances[p].push(view.posterior_variance[p][i]);
                    found.deviations[p].push(view.depth_deviation[p][i]);
                }
            }
        }
        Ok(found)
    }

    /// AUSE of a measure by MAE and RMSE.
    fn areas(&self, values: &[f64]) -> Option<[f64; 2]> {
        let area = |kind| sparsification(values, &self.errors, kind).map(|found| found.area);
        Some([area(ErrorKind::Mae)?, area(ErrorKind::Rmse)?])
    }

    fn judge(&self, p: usize, lost: [f64; 3]) -> Option<Judged> {
        let variances = &self.variances[p];
        let calibration = Calibration::new(&self.errors, &self.deviations[p])?;
        let predictive = calibration.predictive();
        let mixed = variances.iter().zip(&self.spread).map(|(variance, spread)| 0.5 * variance.log10() + spread);
        let mut sorted = variances.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        Some(Judged {
            alone: self.areas(variances)?,
            whole: self.areas(&self.deviations[p])?,
            mixed: self.areas(&mixed.collect::<Vec<_>>())?,
            held: predictive.coverage.map(|[_, share]| share),
            nll: predictive.nll,
            lost,
            deviation: quantile(&sorted, 0.5).sqrt(),
        })
    }
}

pub fn settings() -> String {
    let described = describe(&rays().rays(RAYS), &grid(), &["level"]);
    format!(
        "Every {STRIDE}th pixel of the held-out views; {} draws where the inverse does not fit. {described} Seed 0.",
        DRAWS.number
    )
}

pub fn table(rows: &[Row]) -> String {
    let area = |area: &f64| format!("{area:.3}");
    let mut table = Table::new(&[
        "scene",
        "level",
        "vertices",
        "posterior",
        "log10 σ too small by: median (10 % to 90 %)",
        "median √Var",
        "AUSE of √Var: MAE",
        "RMSE",
        "of √(Var + s²): MAE",
        "RMSE",
        "of its geometric mean with U s: MAE",
        "RMSE",
        "of U s: MAE",
        "RMSE",
        "68 %",
        "90 %",
        "95 %",
        "NLL",
        "rays, processor s",
        "full, processor s",
    ]);
    for row in rows {
        for (p, (judged, name)) in row.judged.iter().zip(NAMES).enumerate() {
            let first = |text: String| if p == 0 { text } else { String::new() };
            let how = match row.iterations {
                Some(iterations) if p == 2 => format!("{name}, {iterations} iterations"),
                None if p == 2 => format!("{name}, exact"),
                _ => name.into(),
            };
            let [median, low, high] = judged.lost;
            let lost = if p == 2 { String::new() } else { format!("{median:.2} ({low:.2} to {high:.2})") };
            let mut cells =
                vec![first(row.scene.clone()), first(row.level.to_string()), first(whole(row.vertices as f64))];
            cells.extend([how, lost, format!("{:.4}", judged.deviation)]);
            cells.extend([judged.alone, judged.whole, judged.mixed].as_flattened().iter().map(area));
            cells.extend(row.spread.iter().map(|spread| first(area(spread))));
            cells.extend(judged.held[1..].iter().map(|held| format!("{:.1}", 100.0 * held)));
            cells.push(format!("{:.2}", judged.nll));
            cells.extend(row.seconds.map(|seconds| first(format!("{seconds:.0}"))));
            table.row(&cells);
        }
    }
    for level in LEVELS {
        for (p, name) in NAMES.iter().enumerate() {
            let of = |value: &dyn Fn(&Judged) -> f64| {
                mean(&rows.iter().filter(|row| row.level == level).map(|row| value(&row.judged[p])).collect::<Vec<_>>())
            };
            let first = |text: String| if p == 0 { text } else { String::new() };
            let mut cells = vec![first("mean".into()), first(level.to_string()), String::new(), (*name).to_owned()];
            cells.extend([
                if p == 2 { String::new() } else { format!("{:.2}", of(&|j| j.lost[0])) },
                format!("{:.4}", of(&|j| j.deviation)),
            ]);
            for of_kind in [|j: &Judged| j.alone, |j: &Judged| j.whole, |j: &Judged| j.mixed] {
                cells.extend((0..2).map(|k| area(&of(&|j| of_kind(j)[k]))));
            }
            let here = || rows.iter().filter(|row| row.level == level);
            cells.extend((0..2).map(|k| first(area(&mean(&here().map(|row| row.spread[k]).collect::<Vec<_>>())))));
            cells.extend((1..PROBABILITIES.len()).map(|k| format!("{:.1}", 100.0 * of(&|j| j.held[k]))));
            cells.extend([format!("{:.2}", of(&|j| j.nll)), String::new(), String::new()]);
            table.row(&cells);
        }
    }
    table.text().to_owned()
}
