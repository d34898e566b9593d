//! Whether runs that end at a mean error know it: their estimate against the errors found with twenty times the rays.

use octobayes::estimate::RayError;
use octobayes::posterior::Pooling;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use crate::honesty::{FEWEST, Judged, LIMIT_SEED, MORE, SEEDS, ZOO_RAYS, grid, judged, limit, settings, zoo_scenes};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread, whole};
use common::work::Work;

/// Rays from which a vertex of a pooled field counts: of fewer, most errors are unknown.
const KNOWN_FROM: u32 = 4;

/// The mean error of one run.
#[derive(Serialize, Deserialize)]
struct Found {
    vertices: usize,
    truly: f64,
    estimated: f64,
}

impl Found {
    /// `None` if the run meets too many faults, or too few vertices moved.
    fn of(scene: &Scene, limit: &UncertaintyField, seed: u64) -> Result<Option<Self>> {
        // An error that no run reaches, so that all rays are drawn.
        let run = scene.estimation(settings(scene).seed(seed), grid(scene)).until_mean_error(1e-9).run();
        let outcome = match run {
            Err(Error::NonFinite { .. }) => return Ok(None),
            run => run?,
        };
        let least = if scene.grid.pooling.is_on() { KNOWN_FROM } else { 1 };
        let counts = |j: &Judged| j.has_moved && j.rays >= least;
        let errors: Vec<f64> =
            judged(&outcome.field, limit).iter().filter(|j| counts(j)).map(|j| j.error.abs()).collect();
        let Some(RayError::Halves(estimate)) = outcome.errors.rays else { return Ok(None) };
        let is_enough = errors.len() >= FEWEST;
        Ok(is_enough.then(|| Self { vertices: errors.len(), truly: mean(&errors), estimated: estimate.mean }))
    }
}

/// All scenes of the zoo that move enough vertices, one row each with and without pooling.
pub fn zoo(work: &Work) -> Result<(String, String)> {
    let mut table = Table::new(&["scene", "pooling", "vertices", "true mean", "estimated", "ratio"]);
    let mut said = String::new();
    for mut scene in zoo_scenes() {
        let name = scene.name;
        let limit = work.field(("limit", name, ZOO_RAYS), || limit(&scene))?;
        said = describe(&settings(&scene), &grid(&scene), &["rays", "level", "pooling", "tolerance"]);
        for pooling in [Pooling::Off, Pooling::Auto] {
            scene.grid = scene.grid.pooling(pooling);
            let of = |seed| work.row((name, ZOO_RAYS, pooling, seed), || Found::of(&scene, &limit, seed));
            let found = SEEDS.into_iter().map(of).collect::<Result<Vec<Option<Found>>>>()?;
            let found: Vec<Found> = found.into_iter().flatten().collect();
            let of = |value: fn(&Found) -> f64| found.iter().map(value).collect::<Vec<f64>>();
            if !found.is_empty() {
                table.row(&[
                    name.to_string(),
                    pooling.to_string(),
                    whole(mean(&of(|f| f.vertices as f64))),
                    format!("{:.3}", mean(&of(|f| f.truly))),
                    format!("{:.3}", mean(&of(|f| f.estimated))),
                    spread(&of(|f| f.estimated / f.truly), 2),
                ]);
            }
        }
    }
    let rays = whole(ZOO_RAYS as f64);
    let words = format!(
        "{rays} rays in two halves, every scene at its own level; a seed is left out if its rays meet too many faults. \
         Tolerance 0; with pooling 0.01, and vertices of at least {KNOWN_FROM} rays. The limit: {MORE} times the rays, \
         seed {LIMIT_SEED}. Vertices that moved by more than half a decade. {said} {}",
        seeds(&SEEDS)
    );
    Ok((words, table.text().into()))
}
