//! Question: does U rank errors of depth of Gaussian splats, and how wide are its intervals?
//!
//! Splats of lego, trained on 100 views, on 12 of one side and on 10, judged on 40 held-out views with true depth. All
//! readings and all measures without a Hessian are in the table. Writes the block of `experiments/splats.md`.

mod common;

use octobayes::dataset::{Selection, Views};
use octobayes::estimate::{Estimation, GridSettings, RaySettings, Subject};
use octobayes::evaluate::{Evaluation, Reading, Scored};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::splats::Splats;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use common::halved;
use common::program::{Needs, Program};
use common::settings::seeds;
use common::table::{Table, spread};
use common::work::Work;

const MODELS: [(&str, &str); 3] =
    [("lego_15k_sh3", "100 views"), ("lego_half12_6k_sh2", "12 views, one side"), ("lego_10views_5k_sh2", "10 views")];
const LEVELS: [u8; 2] = [5, 6];
const SEEDS: [u64; 2] = [0, 1];
const RAYS: u64 = 1_000_000;
/// Error of the models' colours that the scale of the data presumes.
const NOISE: f64 = 0.03;
/// Half the edge of the box, scene units.
const HALF: f64 = 1.4;

fn main() -> Result<()> {
    let program = Program::start("splats", &[("depth", Needs::Data)])?;
    program.part("depth", |work| {
        let words = format!(
            "200 × 200 pixels, all that show lego in 40 held-out views; 1,000,000 rays, box of edge {}, `--scale data \
             --noise {NOISE}`, covariance block. {}",
            2.0 * HALF,
            seeds(&SEEDS),
        );
        Ok((words, table(work)?))
    })
}

/// One measure of one model.
#[derive(Serialize, Deserialize)]
struct Row {
    name: String,
    /// Of the mean absolute error, pooled over views.
    ause: f64,
    rank_correlation: f64,
    /// Shares of the errors within the normal density's intervals of 68 and 95 %, if the measure is a deviation.
    held: Option<[f64; 2]>,
}

fn table(work: &Work) -> Result<String> {
    let head = ["trained on", "level", "measure", "AUSE", "ρ", "68 % holds", "95 % holds"];
    let mut table = Table::new(&head);
    for (model, trained) in MODELS {
        for level in LEVELS {
            let rows = SEEDS.map(|seed| work.row((model, level, seed, RAYS), || measure(model, level, seed)));
            let rows: Vec<Vec<Row>> = rows.into_iter().collect::<Result<_>>()?;
            for m in 0..rows[0].len() {
                let of = |value: &dyn Fn(&Row) -> Option<f64>| {
                    let values: Option<Vec<f64>> = rows.iter().map(|rows| value(&rows[m])).collect();
                    values.map_or(String::new(), |values| spread(&values, 3))
                };
                table.row(&[
                    trained.to_string(),
                    level.to_string(),
                    rows[0][m].name.clone(),
                    of(&|row| Some(row.ause)),
                    of(&|row| Some(row.rank_correlation)),
                    of(&|row| row.held.map(|held| held[0])),
                    of(&|row| row.held.map(|held| held[1])),
                ]);
            }
        }
    }
    Ok(table.text().into())
}

fn measure(model: &str, level: u8, seed: u64) -> Result<Vec<Row>> {
    let data = Program::data()?;
    let folder = tempfile::tempdir().map_err(Error::io(&data, "no temporary folder"))?;
    halved::write(&data.join("nerf-lego-400"), folder.path())?;
    let file = |end: &str| data.join(format!("splats-trained/{model}{end}"));
    let splats = Splats::read(&file(".ply"))?;
    let cameras = Views::read(&file("_transforms.json"), None)?.cameras();
    let domain = Domain::Box(Aabb::centered_cube(HALF));
    let pixels = cameras.iter().map(Camera::pixels).sum();
    let scale = Scale::Data(DataScale::new(pixels, NOISE, DataScale::default_prior_deviation(&domain))?);
    let grid = GridSettings::default().level(level).covariance(Covariance::Block).scale(scale).keep_sums(true);
    let run = Estimation::of_splats(&splats, &cameras).domain(domain).grid(grid);
    let field = run.rays(RaySettings::default().rays(RAYS).seed(seed)).run()?.field;
    let readings = Reading::from_field("U", &field, Some(&[Covariance::Block]), None)?;
    let truth = folder.path().join("transforms_test.json");
    let views = Views::read(&truth, None)?;
    let evaluation = Evaluation {
        model: Subject::Splats(&splats),
        name: model.into(),
        settings: RaySettings::for_images(),
        readings: &readings,
        ensemble: Vec::new(),
        cameras: truth,
        selection: Selection::All,
        stride: 1,
        depth: halved::depth(folder.path()),
        training_depth: None,
        calibrate: None,
        clean_up: false,
        curves: false,
    };
    let report = evaluation.prepare(views)?.judge(&Silent, &mut |_| ())?.report;
    let row = |scored: &Scored| Row {
        name: scored.name.clone(),
        ause: scored.score.ause_pooled.mae,
        rank_correlation: scored.score.rank_correlation,
        held: scored.calibration.as_ref().map(|found| [1, 3].map(|k| found.densities[0].coverage[k][1])),
    };
    Ok(report.scored().map(row).collect())
}
