//! Question: what do the two approximations of a ray's Jacobian cost: leaving samples out, and the finite-difference
//! step?
//!
//! Cutoff: fields with samples left out at several cutoffs against one with nothing left out (no occupancy grid, no
//! early end of rays, every sample differentiated), same rays. Step: fields at several steps against the best reference
//! there is: on the closed-form courtyard a step of 1/64 edge, where central differences have converged; on trained
//! models their own exact derivatives. Every number is |Δ log10 U| on visible surfaces. Writes the blocks of
//! `experiments/approximations.md`.

use octobayes::Result;
use octobayes::estimate::{Outcome, RaySettings};
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Difference, UncertaintyField, compare};
use serde::{Deserialize, Serialize};

use common::program::{Needs, Program};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, spread, spread_e, whole_spread};
use common::work::Work;

/// Points of a comparison: of the box, and at most on surfaces.
const POINTS: usize = 200_000;
const CUTOFFS: [f64; 6] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3];
/// log2 of the steps, lattice edges.
const STEPS: [i32; 10] = [-12, -11, -10, -9, -8, -6, -4, -2, 0, 1];
const SEEDS: [u64; 3] = [0, 1, 2];

fn main() -> Result<()> {
    let parts = [
        ("cutoff-courtyard", Needs::Nothing),
        ("step-courtyard", Needs::Nothing),
        ("cutoff-png", Needs::Data),
        ("step-png", Needs::Data),
        ("cutoff-mlp", Needs::Data),
        ("step-mlp", Needs::Data),
    ];
    let program = Program::start("approximations", &parts)?;
    let courtyard = || {
        let scene = Scene::courtyard();
        Ok(Scene { settings: scene.settings.rays(20_480), ..scene })
    };
    let png = || {
        let scene = Scene::lego(&Program::data()?)?;
        Ok(Scene { settings: scene.settings.rays(102_400), ..scene })
    };
    let mlp = || {
        let scene = Scene::lego_mlp(&Program::data()?)?;
        Ok(Scene { settings: scene.settings.rays(8_192), ..scene })
    };
    let scenes: [&dyn Fn() -> Result<Scene>; 3] = [&courtyard, &png, &mlp];
    for (parts, scene) in parts.chunks(2).zip(scenes) {
        program.part(parts[0].0, |work| cutoffs(work, &scene()?))?;
        program.part(parts[1].0, |work| steps(work, &scene()?))?;
    }
    Ok(())
}

/// A field against the reference.
#[derive(Serialize, Deserialize)]
struct Row {
    samples: f64,
    /// On surfaces: mean, 95 %, 99 %, maximum.
    surfaces: [f64; 4],
    /// In the box.
    space: [f64; 4],
}

impl Row {
    fn new(field: &UncertaintyField, samples: u64, reference: &UncertaintyField) -> Result<Self> {
        let compared = compare(field, reference, POINTS, 0)?;
        let of = |d: &Option<Difference>| {
            d.as_ref().map_or([f64::NAN; 4], |d| [d.mean, d.percentile_95, d.percentile_99, d.max])
        };
        Ok(Self { samples: samples as f64, surfaces: of(&compared.on_surfaces), space: of(&compared.in_box) })
    }
}

fn run(scene: &Scene, rays: RaySettings) -> Result<(UncertaintyField, u64)> {
    let grid = scene.grid.tolerance(0.0);
    let Outcome { field, progress, .. } = scene.estimation(rays, grid).run()?;
    Ok((field, progress.samples))
}

/// Rows by seed.
type Rows = Vec<Vec<Row>>;

fn rows(work: &Work, scene: &Scene, what: &str, of: impl Fn(u64) -> Result<Vec<Row>>) -> Result<Rows> {
    SEEDS.into_iter().map(|seed| work.row((what, scene.name, scene.settings.rays, seed), || of(seed))).collect()
}

/// A number of all seeds.
fn numbers(rows: &Rows, i: usize, value: impl Fn(&Row) -> f64) -> Vec<f64> {
    rows.iter().map(|rows| value(&rows[i])).collect()
}

/// Mean, 95 %, 99 % and maximum as cells.
fn cells(rows: &Rows, i: usize, values: fn(&Row) -> [f64; 4]) -> Vec<String> {
    let of = |k: usize| numbers(rows, i, |row| values(row)[k]);
    vec![spread_e(&of(0)), spread_e(&of(1)), spread_e(&of(2)), spread(&of(3), 3)]
}

fn words(scene: &Scene, rest: &str, varied: &[&str]) -> String {
    let grid = scene.grid.tolerance(0.0);
    format!("{}. {} {} {rest}", scene.name, describe(&scene.settings, &grid, varied), seeds(&SEEDS))
}

fn cutoffs(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let rows = rows(work, scene, "cutoffs", |seed| {
        let rays = scene.settings.seed(seed);
        let (all, samples) = run(scene, rays.cutoff(0.0))?;
        let all = scene.with_surfaces(all, rays, POINTS)?;
        let mut rows = vec![Row::new(&all, samples, &all)?];
        for cutoff in CUTOFFS {
            let (some, samples) = run(scene, rays.cutoff(cutoff))?;
            rows.push(Row::new(&some, samples, &all)?);
        }
        Ok(rows)
    })?;
    let mut table =
        Table::new(&["cutoff", "samples", "surfaces: mean", "95 %", "99 %", "max", "box: mean", "95 %", "99 %", "max"]);
    for (i, cutoff) in [0.0].into_iter().chain(CUTOFFS).enumerate() {
        let mut row = vec![format!("{cutoff:e}"), whole_spread(&numbers(&rows, i, |row| row.samples))];
        if i > 0 {
            row.extend(cells(&rows, i, |row| row.surfaces));
            row.extend(cells(&rows, i, |row| row.space));
        } else {
            row.extend(vec![String::new(); 8]);
        }
        table.row(&row);
    }
    Ok((words(scene, "Errors are against cutoff 0.", &["cutoff"]), table.text().into()))
}

fn steps(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let is_exact = scene.field.differentiable().is_some();
    let rows = rows(work, scene, "steps", |seed| {
        let rays = scene.settings.seed(seed).gradient(GradientMethod::FiniteDifference);
        let best = if is_exact { rays.gradient(GradientMethod::Analytic) } else { rays.step(1.0 / 64.0) };
        let reference = scene.with_surfaces(run(scene, best)?.0, best, POINTS)?;
        let row = |k: i32| {
            let (field, samples) = run(scene, rays.step(2_f64.powi(k)))?;
            Row::new(&field, samples, &reference)
        };
        STEPS.into_iter().map(row).collect()
    })?;
    let mut table = Table::new(&["step, lattice edges", "surfaces: mean", "95 %", "99 %", "max"]);
    for (i, k) in STEPS.into_iter().enumerate() {
        let step = if k < 0 { format!("1/{}", 1 << -k) } else { format!("{}", 1 << k) };
        table.row(&[vec![step], cells(&rows, i, |row| row.surfaces)].concat());
    }
    let reference = if is_exact { "the field's own derivatives" } else { "differences over 1/64" };
    let rest = format!("Errors are against {reference}.");
    Ok((words(scene, &rest, &["step", "gradient"]), table.text().into()))
}
