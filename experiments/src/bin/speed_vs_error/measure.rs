//! Runs with their time and their error.

use octobayes::Result;
use octobayes::estimate::{GridKind, GridSettings, Outcome, RaySettings};
use octobayes::metrics::median;
use octobayes::rays::Pixels;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Difference, UncertaintyField, compare};
use serde::{Deserialize, Serialize};

use common::clock::Clock;
use common::scenes::Scene;
use common::table::{mean, spread};
use common::work::Work;

/// Every row is run with these; times are medians over them.
pub const SEEDS: [u64; 3] = [0, 1, 2];
/// Points of a comparison: of the box, and on visible surfaces.
pub const POINTS: usize = 200_000;

/// Grid of `level`.
pub fn grid(kind: GridKind, level: u8) -> GridSettings {
    // Without sums in the field, as `octobayes uncertainty` runs.
    GridSettings::default().grid(kind).level(level).keep_sums(false)
}

/// A finished run.
pub struct Run {
    pub field: UncertaintyField,
    /// Wall time of everything between the open model and the finished field.
    pub seconds: f64,
    pub samples: u64,
}

/// Runs once.
pub fn run(scene: &Scene, rays: &RaySettings, grid: &GridSettings) -> Result<Run> {
    let clock = Clock::start();
    let Outcome { field, progress, .. } = scene.estimation(*rays, *grid).run()?;
    let seconds = clock.elapsed().wall;
    Ok(Run { field: field.without_sums(), seconds, samples: progress.samples })
}

/// What an error is measured against: the dense grid of level 8 with so many random rays of another seed, exact
/// derivatives if the field has them, hardly a sample left out.
pub fn reference(work: &Work, scene: &Scene, rays: u64) -> Result<UncertaintyField> {
    let settings = scene.settings.rays(rays).gradient(GradientMethod::Auto).pixels(Pixels::Random);
    let settings = settings.seed(7_777).cutoff(1e-8);
    work.field(("reference", scene.name, rays), || {
        scene.with_surfaces(run(scene, &settings, &grid(GridKind::Dense, 8))?.field, settings, POINTS)
    })
}

/// What one run showed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    pub seconds: f64,
    pub samples: f64,
    pub bytes: f64,
    pub vertices: f64,
    /// |Δ log10 U| on visible surfaces and in the box: mean, 95 %, maximum; 0 without a reference.
    pub surfaces: [f64; 3],
    pub space: [f64; 3],
    /// AUSE (MAE) of the depth error, where the truth is known.
    pub ause: Option<f64>,
}

impl Row {
    pub fn new(run: &Run, reference: Option<&UncertaintyField>) -> Result<Self> {
        let compared = reference.map(|reference| compare(&run.field, reference, POINTS, 1)).transpose()?;
        let of = |d: Option<&Difference>| d.map_or([0.0; 3], |d| [d.mean, d.percentile_95, d.max]);
        let compared = compared.as_ref();
        Ok(Self {
            seconds: run.seconds,
            samples: run.samples as f64,
            bytes: run.field.query_memory() as f64,
            vertices: run.field.deviations().len() as f64,
            surfaces: of(compared.and_then(|c| c.on_surfaces.as_ref())),
            space: of(compared.and_then(|c| c.in_box.as_ref())),
            ause: None,
        })
    }
}

/// Values of some ways, one round of all ways behind the other: where the machine's speed drifts, it does so for all.
///
/// `of` gives the value of a way in a round, or none where a way has fewer rounds.
pub fn alternating<W, T>(ways: &[W], rounds: &[u64], of: impl Fn(&W, u64) -> Result<Option<T>>) -> Result<Vec<Vec<T>>> {
    let mut out: Vec<Vec<T>> = ways.iter().map(|_| Vec::new()).collect();
    for &round in rounds {
        for (way, values) in ways.iter().zip(&mut out) {
            values.extend(of(way, round)?);
        }
    }
    Ok(out)
}

/// Median, least and most of the ratios of two ways' times, round by round.
pub fn ratio(times: &[f64], first: &[f64]) -> String {
    let mut ratios: Vec<f64> = times.iter().zip(first).map(|(a, b)| a / b).collect();
    ratios.sort_by(f64::total_cmp);
    let middle = median(ratios.clone());
    format!("{middle:.2} ({:.2} to {:.2})", ratios[0], ratios[ratios.len() - 1])
}

/// The rows of all seeds.
pub struct Rows(pub Vec<Row>);

impl Rows {
    pub fn all(&self, value: impl Fn(&Row) -> f64) -> Vec<f64> {
        self.0.iter().map(value).collect()
    }

    pub fn mean(&self, value: impl Fn(&Row) -> f64) -> f64 {
        mean(&self.all(value))
    }

    /// Median of the times.
    pub fn seconds(&self) -> f64 {
        median(self.all(|row| row.seconds))
    }

    /// Mean, 95 % and maximum on surfaces, then in the box.
    pub fn errors(&self) -> Vec<String> {
        let cells = |value: fn(&Row) -> [f64; 3]| {
            [(0, 4), (1, 3), (2, 2)].map(|(k, digits)| spread(&self.all(|row| value(row)[k]), digits))
        };
        [cells(|row| row.surfaces), cells(|row| row.space)].concat()
    }
}
