//! One run with its time and its error.

use std::time::Instant;

use octobayes::Result;
use octobayes::estimate::{Estimation, GridKind, GridSettings, Outcome, RaySettings};
use octobayes::rays::Pixels;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Difference, UncertaintyField, compare};

use super::scenes::Scene;

/// Points of a comparison: of the box, and on visible surfaces.
const POINTS: usize = 200_000;

/// Grid of `level` with surface points to compare at.
pub fn grid(kind: GridKind, level: u8) -> GridSettings {
    GridSettings::default().grid(kind).level(level).surface_points(POINTS)
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
    let start = Instant::now();
    let Outcome { field, progress, .. } =
        Estimation::new(&*scene.field, &scene.cameras).rays(*rays).grid(*grid).run()?;
    let seconds = start.elapsed().as_secs_f64();
    Ok(Run { field: field.without_sums(), seconds, samples: progress.samples })
}

/// Runs `times` times; the last one with the median of the times.
pub fn median(scene: &Scene, rays: &RaySettings, grid: &GridSettings, times: usize) -> Result<Run> {
    let mut runs = (0..times).map(|_| run(scene, rays, grid)).collect::<Result<Vec<_>>>()?;
    let mut seconds: Vec<f64> = runs.iter().map(|r| r.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let last = runs.pop().expect("at least one run");
    Ok(Run { seconds: seconds[times / 2], ..last })
}

/// What an error is measured against: the dense grid, `rays` random rays of another seed, exact derivatives if the field has them, hardly
/// a sample left out.
pub fn reference(scene: &Scene, level: u8, rays: u64) -> Result<UncertaintyField> {
    let gradient = GradientMethod::Auto;
    let settings = scene.settings.rays(rays).gradient(gradient).pixels(Pixels::Random).seed(7_777).cutoff(1e-8);
    let run = run(scene, &settings, &grid(GridKind::Dense, level))?;
    eprintln!("reference of {}: {rays} rays, {:.0} s", scene.name, run.seconds);
    Ok(run.field)
}

/// |Δ log10 U| on visible surfaces and in the box.
pub fn error(field: &UncertaintyField, reference: &UncertaintyField) -> Result<[Difference; 2]> {
    let compared = compare(field, reference, POINTS, 1)?;
    Ok([compared.on_surfaces, compared.in_box].map(|d| d.expect("both fields have points to compare at")))
}

/// Mean, 95 % and maximum for a table.
pub fn cells(d: &Difference) -> String {
    format!("{:.4} | {:.4} | {:.3}", d.mean, d.percentile_95, d.max)
}
