//! Question: what does a leaf that is kept coarse say of a surface?
//!
//! Leaves one to four levels coarser everywhere, against the finest lattice with the same rays, many a vertex. A leaf k
//! levels coarser has its information divided by 8^k, its volume. Equivalently, its U is 8^(k/2) times that of a field
//! of its level with the prior precision 8^k λ. Writes the blocks of `experiments/coarse_leaves.md`.

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::GridSettings;
use octobayes::posterior::Covariance;
use octobayes::uncertainty::UncertaintyField;
use serde::{Deserialize, Serialize};

use common::program::{Needs, Program};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread, whole};
use common::work::Work;

const SEEDS: [u64; 3] = [0, 1, 2];
const COVARIANCES: [Covariance; 2] = [Covariance::Diagonal, Covariance::Block];
/// Most levels given up.
const COARSEST: u8 = 4;
/// Points on surfaces.
const POINTS: usize = 100_000;
/// Fewest rays at a point on the finest lattice. With fewer, its U is not converged.
const LEAST_RAYS: f64 = 64.0;

fn main() -> Result<()> {
    let parts = [("built-in", Needs::Nothing), ("city", Needs::Nothing), ("lego", Needs::Data)];
    let program = Program::start("coarse_leaves", &parts)?;
    program.part("built-in", |work| {
        let level_6 = |name| -> Result<Scene> {
            let scene = Scene::built_in(name)?;
            Ok(Scene { settings: scene.settings.rays(204_800), ..scene })
        };
        let courtyard = Scene::courtyard();
        let courtyard = Scene { settings: courtyard.settings.rays(1_024_000), ..courtyard };
        study(work, &[courtyard, level_6("wall")?, level_6("ball")?])
    })?;
    program.part("city", |work| {
        let city = Scene::city()?;
        study(work, &[Scene { settings: city.settings.rays(1_024_000), ..city }])
    })?;
    program.part("lego", |work| {
        let lego = Scene::lego(&Program::data()?)?;
        study(work, &[Scene { settings: lego.settings.rays(4_096_000), ..lego }])
    })
}

/// How log10 U of leaves one level coarser, two, … differs from that of the finest.
#[derive(Serialize, Deserialize)]
struct Row {
    points: f64,
    /// By levels given up: mean, standard deviation, 5th and 95th percentile.
    shifts: Vec<[f64; 4]>,
}

/// The rows of all [`COVARIANCES`], from the same rays.
fn measure(scene: &Scene, seed: u64) -> Result<Vec<Row>> {
    let finest = scene.grid;
    let rays = scene.settings.seed(seed);
    let run = scene.estimation(rays, finest).prepare()?;
    let lambda = finest.prior_precision(run.lattice());
    let coarser = |k: u8| finest.level(finest.level - k).lambda(lambda * 8_f64.powi(k.into()));
    let grids: Vec<GridSettings> = [finest].into_iter().chain((1..=COARSEST).map(coarser)).collect();
    let mut fields = run.finish_on(&grids)?.into_iter().map(|outcome| outcome.field);
    let truth = fields.next().expect("the finest is the first");
    let truth = scene.with_surfaces(truth, rays, POINTS)?;
    let fields: Vec<UncertaintyField> = [truth].into_iter().chain(fields).collect();
    let rows = COVARIANCES.into_iter().map(|covariance| {
        let fields = fields.iter().map(|field| field.clone().with_covariance(covariance));
        Ok(shifts(&fields.collect::<Result<Vec<UncertaintyField>>>()?))
    });
    rows.collect()
}

/// How the coarser of `fields` differ from the first.
fn shifts(fields: &[UncertaintyField]) -> Row {
    let truth = &fields[0];
    assert!(!truth.surface().is_empty(), "a scene with surfaces");
    let moved = truth.prior() * 10_f64.powf(-octobayes::uncertainty::MOVED);
    let points: Vec<Vec3> = truth.surface().iter().copied().map(Vec3::from_array).collect();
    let points: Vec<(Vec3, f64)> = points
        .iter()
        .zip(truth.query_all(&points))
        .filter(|(_, found)| found.rays.is_some_and(|rays| rays >= LEAST_RAYS) && found.uncertainty < moved)
        .map(|(x, found)| (*x, found.uncertainty.log10()))
        .collect();
    let positions: Vec<Vec3> = points.iter().map(|point| point.0).collect();
    let shifts = (1..=COARSEST).map(|k| {
        let found = fields[usize::from(k)].query_all(&positions);
        let up = 0.5 * f64::from(k) * 8_f64.log10();
        let mut off: Vec<f64> =
            found.iter().zip(&points).map(|(found, (_, finest))| found.uncertainty.log10() + up - finest).collect();
        off.sort_by(f64::total_cmp);
        let average = mean(&off);
        let deviation = common::table::deviation(&off);
        let at = |share: f64| off[((off.len() - 1) as f64 * share) as usize];
        [average, deviation, at(0.05), at(0.95)]
    });
    Row { points: points.len() as f64, shifts: shifts.collect() }
}

fn study(work: &Work, scenes: &[Scene]) -> Result<(String, String)> {
    let mut table = Table::new(&[
        "scene",
        "level",
        "covariance",
        "points",
        "levels given up",
        "shift: mean",
        "deviation",
        "5 %",
        "95 %",
        "mean, per level",
        "divided by 4^k",
        "not divided",
    ]);
    for scene in scenes {
        let of = |seed| work.row((scene.name, seed), || measure(scene, seed));
        let rows = SEEDS.into_iter().map(of).collect::<Result<Vec<Vec<Row>>>>()?;
        for (c, covariance) in COVARIANCES.into_iter().enumerate() {
            for k in 1..=usize::from(COARSEST) {
                let of = |value: &dyn Fn(&[f64; 4]) -> f64| -> Vec<f64> {
                    rows.iter().map(|rows| value(&rows[c].shifts[k - 1])).collect()
                };
                let levels = k as f64;
                table.row(&[
                    scene.name.to_string(),
                    scene.grid.level.to_string(),
                    covariance.name().to_string(),
                    whole(mean(&rows.iter().map(|rows| rows[c].points).collect::<Vec<f64>>())),
                    k.to_string(),
                    spread(&of(&|s| s[0]), 3),
                    spread(&of(&|s| s[1]), 2),
                    spread(&of(&|s| s[2]), 2),
                    spread(&of(&|s| s[3]), 2),
                    spread(&of(&|s| s[0] / levels), 3),
                    // Far from the prior U goes with the root of the information.
                    spread(&of(&|s| s[0] / levels - 0.5 * 2_f64.log10()), 3),
                    spread(&of(&|s| s[0] / levels - 0.5 * 8_f64.log10()), 3),
                ]);
            }
        }
    }
    let described: Vec<String> = scenes
        .iter()
        .map(|scene| {
            let varied = ["grid", "pooling", "covariance"];
            format!(
                "{}, {} cameras. {}",
                scene.name,
                scene.cameras.len(),
                describe(&scene.settings, &scene.grid, &varied)
            )
        })
        .collect();
    Ok((format!("{} {}", described.join(" "), seeds(&SEEDS)), table.text().into()))
}
