//! Several levels from the same rays: what they cost beside one level, and how their mean ranks.

use std::path::Path;

use octobayes::estimate::{Estimation, Outcome, RaySettings};
use octobayes::evaluate::{Evaluator, Reading, Score};
use octobayes::field::RadianceField;
use octobayes::geometry::Domain;
use octobayes::metrics::ErrorKind;
use octobayes::monitor::Silent;
use octobayes::render::RayAverage;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use crate::common::clock::Clock;
use crate::common::settings::describe;
use crate::common::table::{Table, mean};
use crate::judge::{STRIDE, grid, rays};
use crate::scene::{SIDE, Scene, TEST_VIEWS};
use crate::{STEPS, compared};

/// Finest levels whose run also has two coarser ones.
const FINEST: [u8; 3] = [8, 7, 6];
const COARSER: u8 = 2;

/// One finest level on one scene: alone, and with coarser levels.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    scene: String,
    level: u8,
    /// AUSE of `spread-per-ray` by MAE and RMSE.
    ranking: [[f64; 2]; 2],
    /// Processor seconds of the run.
    seconds: [f64; 2],
    /// Bytes of the sums, and of the file without them.
    sums: [f64; 2],
    file: [f64; 2],
}

/// All finest levels on one scene.
pub fn measure(scene: &Scene) -> Result<Vec<Row>> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(folder.path())?;
    let field = scene.train(&data, 0)?.field;
    let mut readings = Vec::new();
    let mut rows = Vec::new();
    for level in FINEST {
        let mut row = Row {
            scene: scene.name(),
            level,
            ranking: [[0.0; 2]; 2],
            seconds: [0.0; 2],
            sums: [0.0; 2],
            file: [0.0; 2],
        };
        for (k, coarser) in [0, COARSER].into_iter().enumerate() {
            let clock = Clock::start();
            let grid = grid().level(level).keep_sums(false);
            let run =
                Estimation::new(&field, &data.cameras).rays(rays()).grid(grid).domain(Domain::Box(field.bounds()));
            let Outcome { field, sums_bytes, .. } = run.coarser_levels(coarser).run()?;
            row.seconds[k] = clock.elapsed().cpu;
            row.sums[k] = sums_bytes as f64;
            let path = folder.path().join("field.oct");
            field.write(&path)?;
            row.file[k] = path.metadata().map_err(Error::io(&path, "cannot read"))?.len() as f64;
            readings.push(Reading { name: String::new(), field, averages: vec![RayAverage::SpreadPerRay] });
        }
        rows.push(row);
    }
    let tracer = RaySettings::for_images().tracer(&field, 0.0, &Silent)?;
    let evaluator = Evaluator::new(tracer, &readings);
    let truths = data.held_out(field.pixel_offset(), STRIDE)?;
    let views = truths.iter().map(|truth| evaluator.evaluate(truth, 0, &Silent)).collect::<Result<Vec<_>>>()?;
    for (i, row) in rows.iter_mut().enumerate() {
        for (k, ranking) in row.ranking.iter_mut().enumerate() {
            let score = Score::new(&views, 2 * i + k);
            let score = score.ok_or_else(|| Error::malformed(&data.folder, "views", "errors of depth", "none"))?;
            *ranking = [ErrorKind::Mae, ErrorKind::Rmse].map(|kind| score.area(kind));
        }
    }
    Ok(rows)
}

pub fn settings() -> String {
    let (pixels, described) = (compared(STRIDE), describe(&rays(), &grid(), &["level"]));
    format!("{SIDE} × {SIDE} pixels, {STEPS} steps; {pixels} of {TEST_VIEWS} held-out views. {described} Seed 0.")
}

pub fn table(rows: &[Row]) -> String {
    let mut table = Table::new(&[
        "scene",
        "levels",
        "AUSE: MAE",
        "RMSE",
        "processor seconds",
        "sums, MB",
        "field without sums, MB",
    ]);
    let mut add = |name: &str, level: u8, k: usize, rows: &[&Row]| {
        let of = |value: &dyn Fn(&Row) -> f64| mean(&rows.iter().map(|row| value(row)).collect::<Vec<_>>());
        let levels: Vec<String> = (0..=[0, COARSER][k]).map(|below| (level - below).to_string()).collect();
        table.row(&[
            name.to_owned(),
            levels.join(", "),
            format!("{:.3}", of(&|row| row.ranking[k][0])),
            format!("{:.3}", of(&|row| row.ranking[k][1])),
            format!("{:.1}", of(&|row| row.seconds[k])),
            format!("{:.1}", of(&|row| row.sums[k]) / 1e6),
            format!("{:.2}", of(&|row| row.file[k]) / 1e6),
        ]);
    };
    for row in rows {
        (0..2).for_each(|k| add(&row.scene, row.level, k, &[row]));
    }
    for level in FINEST {
        let here: Vec<&Row> = rows.iter().filter(|row| row.level == level).collect();
        (0..2).for_each(|k| add("mean", level, k, &here));
    }
    table.text().to_owned()
}
