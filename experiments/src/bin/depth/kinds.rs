//! How ranking and intervals do on each kind of pixel.

use std::path::Path;

use octobayes::estimate::RaySettings;
use octobayes::field::TrainedField;
use octobayes::posterior::Covariance;
use octobayes::render::RayAverage;
use octobayes::{Error, Result};
use octobayes_data::Views;
use octobayes_evaluation::metrics::Calibration;
use octobayes_evaluation::{Baseline, ByError, Evaluation, PixelKind, Reading};
use serde::{Deserialize, Serialize};

use common::table::{Table, mean};

use crate::judge::{self, LEVELS, STRIDE};
use crate::scene::Scene;

/// Nominal coverage of the table, and where it is in [`octobayes_evaluation::metrics::PROBABILITIES`].
const NOMINAL: usize = 4;

/// Some pixels of a model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    /// The kind, or all of them.
    pub kind: String,
    pub share: f64,
    /// Median error of depth, scene units.
    pub error: f64,
    /// AUSE by mean absolute and root mean square error: of the default, and of the spread of the weights over the root
    /// of the rays.
    pub ause: [[f64; 2]; 2],
    /// Share of errors within the intervals of nominal 50, 68, 90 and 95 %.
    pub held: [f64; NOMINAL],
}

/// The name of what is around and with the object together.
const ALL: &str = "all pixels";

/// Trains a scene's model, and judges it kind by kind.
pub fn measure(scene: &Scene, seed: u64) -> Result<Vec<Row>> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(folder.path())?;
    let model = scene.train(&data, seed)?;
    let (fields, _) = judge::uncertainties(&data, &model.field, model.psnr, judge::rays().seed(seed))?;
    let reading = |level: usize, averages: &[RayAverage]| {
        Reading::from_field(&format!("{}", LEVELS[level]), &fields[level], Some(&[Covariance::Block]), Some(averages))
    };
    // Ranking by the default; the deviation of depth is that of the finest level.
    let default = RayAverage::USpreadPerRootRay;
    let readings = [reading(1, &[default])?, reading(0, &[default])?].concat();
    let path = data.folder.join("transforms_test.json");
    let evaluation = Evaluation {
        model: &model.field,
        name: scene.name(),
        settings: RaySettings::for_images().pixel_offset(Some(model.field.pixel_offset())),
        readings: &readings,
        ensemble: Vec::new(),
        selection: octobayes_data::Selection::All,
        stride: STRIDE,
        depth: data.depth_files(),
        object_masks: None,
        training_depth: Some(data.folder.join("depth")),
        images: None,
        calibrate: None,
        clean_up: false,
        curves: false,
        cameras: path.clone(),
    };
    let prepared = evaluation.prepare(Views::read(&path, None)?)?;
    let report = prepared.judge(&octobayes::monitor::Silent, &mut |_| {})?.report;
    let two = |ause: Option<ByError>| ause.map_or([f64::NAN; 2], |ause| [ause.mae, ause.rmse]);
    let held = |calibration: Option<&Calibration>| {
        let found = calibration.map(|calibration| calibration.coverage.map(|[_, held]| held));
        found.unwrap_or([f64::NAN; NOMINAL])
    };
    let control = Baseline::WeightsSpreadPerRootRay.name();
    // The first deviation is that of level 6, the second that of level 7.
    let deviation = format!("{}, depth deviation", readings[1].name);
    let mut rows = Vec::new();
    for of in &report.kinds {
        let named = |name: &str| of.measures.iter().find(|measure| measure.name == name);
        rows.push(Row {
            kind: of.kind.to_string(),
            share: of.share,
            error: of.depth_error.median,
            ause: [two(of.measures[0].ause), two(named(control).and_then(|measure| measure.ause))],
            held: held(named(&deviation).and_then(|measure| measure.calibration.as_ref())),
        });
    }
    let named = |name: &str| report.scored().find(|scored| scored.name == name);
    rows.push(Row {
        kind: ALL.into(),
        share: 1.0,
        error: report.depth_error.map_or(f64::NAN, |error| error.median),
        ause: [
            two(report.scored().next().map(|s| s.score.ause_pooled)),
            two(named(control).map(|s| s.score.ause_pooled)),
        ],
        held: held(named(&deviation).and_then(|scored| scored.calibration.as_ref())),
    });
    // A kind with hardly a pixel has no ranking.
    rows.retain(|row| row.ause.iter().flatten().chain(&row.held).all(|value| value.is_finite()));
    Ok(rows)
}

/// Means over scenes and seeds, and the least and largest coverage of nominal 90 % of one scene.
pub fn table(rows: &[Vec<Row>]) -> String {
    let head = [
        "pixels",
        "share",
        "median error",
        "AUSE of the default: MAE",
        "RMSE",
        "of the control: MAE",
        "RMSE",
        "50 % holds",
        "68 %",
        "90 %",
        "95 %",
        "90 % on single scenes",
    ]; // fmt: skip
    let mut table = Table::new(&head);
    let kinds = PixelKind::ALL.map(|kind| kind.to_string()).into_iter().chain([ALL.to_string()]);
    for kind in kinds {
        let of: Vec<&Row> = rows.iter().flatten().filter(|row| row.kind == kind).collect();
        if of.is_empty() {
            continue;
        }
        let mean_of = |value: &dyn Fn(&Row) -> f64| mean(&of.iter().map(|row| value(row)).collect::<Vec<_>>());
        let mut cells =
            vec![kind, format!("{:.3}", mean_of(&|row| row.share)), format!("{:.4}", mean_of(&|row| row.error))];
        for which in 0..2 {
            cells.extend((0..2).map(|by| format!("{:.3}", mean_of(&|row| row.ause[which][by]))));
        }
        cells.extend((0..NOMINAL).map(|p| format!("{:.1}", 100.0 * mean_of(&|row| row.held[p]))));
        let ninety = of.iter().map(|row| 100.0 * row.held[2]);
        let [low, high] = [f64::min, f64::max].map(|f| ninety.clone().reduce(f).unwrap_or(f64::NAN));
        cells.push(format!("{low:.0} to {high:.0}"));
        table.row(&cells);
    }
    table.text().to_string()
}
