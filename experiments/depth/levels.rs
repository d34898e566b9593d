//! Several levels from the same rays: what they cost beside one level, and how their mean ranks.

use std::path::Path;

use octobayes::estimate::{Estimation, Outcome, RaySettings};
use octobayes::evaluate::{Evaluator, Reading, Score};
use octobayes::field::RadianceField;
use octobayes::geometry::Domain;
use octobayes::metrics::ErrorKind;
use octobayes::monitor::Silent;
use octobayes::posterior::{DataScale, Scale};
use octobayes::render::RayAverage;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use crate::common::clock::Clock;
use crate::common::settings::describe;
use crate::common::table::{Table, mean};
use crate::judge::{STRIDE, grid, rays};
use crate::scene::{SIDE, Scene, TEST_VIEWS};
use crate::{STEPS, compared};

/// Levels of the runs, and how many coarser ones they have.
const RUNS: [(u8, u8); 8] = [(8, 0), (7, 0), (6, 0), (5, 0), (4, 0), (8, 2), (7, 2), (6, 2)];

/// One run on one scene.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    scene: String,
    /// AUSE of `u-spread-per-root-ray` by MAE and RMSE.
    ranking: [f64; 2],
    /// Processor seconds of the run.
    seconds: f64,
    /// Bytes of the sums, and of the file without them.
    sums: f64,
    file: f64,
}

/// All runs on one scene.
pub fn measure(scene: &Scene) -> Result<Vec<Row>> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(folder.path())?;
    let model = scene.train(&data, 0)?;
    let (field, domain) = (&model.field, Domain::Box(model.field.bounds()));
    let scale = Scale::Data(DataScale::from_cameras(&data.cameras, DataScale::noise_of(model.psnr), &domain)?);
    let (mut readings, mut rows) = (Vec::new(), Vec::new());
    for (level, coarser) in RUNS {
        let clock = Clock::start();
        let grid = grid().level(level).scale(scale).keep_sums(false);
        let run = Estimation::new(field, &data.cameras).rays(rays()).grid(grid).domain(domain).coarser_levels(coarser);
        let Outcome { field, sums_bytes, .. } = run.run()?;
        let seconds = clock.elapsed().cpu;
        let path = folder.path().join("field.oct");
        field.write(&path)?;
        let file = path.metadata().map_err(Error::io(&path, "cannot read"))?.len() as f64;
        rows.push(Row { scene: scene.name(), ranking: [0.0; 2], seconds, sums: sums_bytes as f64, file });
        readings.push(Reading { name: String::new(), field, averages: vec![RayAverage::USpreadPerRootRay] });
    }
    let tracer = RaySettings::for_images().tracer(field, 0.0, &Silent)?;
    let evaluator = Evaluator::new(tracer, &readings);
    let truths = data.held_out(field.pixel_offset(), STRIDE)?;
    let views = truths.iter().map(|truth| evaluator.evaluate(truth, 0, &Silent)).collect::<Result<Vec<_>>>()?;
    for (m, row) in rows.iter_mut().enumerate() {
        let score = Score::new(&views, m);
        let score = score.ok_or_else(|| Error::malformed(&data.folder, "views", "errors of depth", "none"))?;
        row.ranking = [ErrorKind::Mae, ErrorKind::Rmse].map(|kind| score.area(kind));
    }
    Ok(rows)
}

pub fn settings() -> String {
    let (pixels, described) = (compared(STRIDE), describe(&rays(), &grid(), &["level"]));
    format!(
        "{SIDE} × {SIDE} pixels, {STEPS} steps; {pixels} of {TEST_VIEWS} held-out views. {described} Scale of the \
         data. Seed 0."
    )
}

/// `scenes`: the rows of each.
pub fn table(scenes: &[Vec<Row>]) -> String {
    let mut table =
        Table::new(&["scene", "levels", "AUSE: MAE", "RMSE", "processor s", "sums, MB", "field without sums, MB"]);
    let mut add = |name: &str, r: usize, rows: &[&Row]| {
        let of = |value: &dyn Fn(&Row) -> f64| mean(&rows.iter().map(|row| value(row)).collect::<Vec<_>>());
        let (level, coarser) = RUNS[r];
        let levels: Vec<String> = (0..=coarser).map(|below| (level - below).to_string()).collect();
        table.row(&[
            if r == 0 { name.to_owned() } else { String::new() },
            levels.join(", "),
            format!("{:.3}", of(&|row| row.ranking[0])),
            format!("{:.3}", of(&|row| row.ranking[1])),
            format!("{:.1}", of(&|row| row.seconds)),
            format!("{:.1}", of(&|row| row.sums) / 1e6),
            format!("{:.2}", of(&|row| row.file) / 1e6),
        ]);
    };
    for rows in scenes {
        rows.iter().enumerate().for_each(|(r, row)| add(&row.scene, r, &[row]));
    }
    (0..RUNS.len()).for_each(|r| add("mean", r, &scenes.iter().map(|rows| &rows[r]).collect::<Vec<_>>()));
    table.text().to_owned()
}
