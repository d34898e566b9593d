//! Question: what does each refinement criterion cost, and what error does it leave?
//!
//! Octrees of the same rays under every criterion against the dense grid of these rays: vertices, bytes, time, |Δ log10 U| over 500,000
//! random points of the box and up to as many on visible surfaces. Courtyard (level 7, 204,800 rays) and, with `OCTOBAYES_DATA`, the
//! Plenoptic PNG lego of type 1 (level 8, 409,600 rays). Prints the tables of `experiments/criteria.md`.

use std::path::PathBuf;
use std::time::Instant;

use octobayes::Result;
use octobayes::dataset::Views;
use octobayes::estimate::{Estimation, GridKind, GridSettings, Outcome, RaySettings};
use octobayes::field::{ClosedForm, Coordinates, RadianceField};
use octobayes::geometry::Camera;
use octobayes::open::open_in;
use octobayes::posterior::Criterion;
use octobayes::uncertainty::{Difference, compare};

const POINTS: usize = 500_000;

fn main() -> Result<()> {
    study("courtyard", &ClosedForm::courtyard(), &ClosedForm::half_circle(40, [400, 400]), 7, 204_800)?;
    if let Some(data) = std::env::var_os("OCTOBAYES_DATA").map(PathBuf::from) {
        let model = data.join("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng");
        let lego = open_in(&model.to_string_lossy(), Some(Coordinates::Blender))?;
        let file = data.join("nerf-mlp-pretrained/cameras/lego_train.json");
        let cameras = Views::read(&file, Some([400, 400]))?.cameras();
        study("lego, Plenoptic PNG type 1", &*lego, &cameras, 8, 409_600)?;
    }
    Ok(())
}

fn study(name: &str, field: &dyn RadianceField, cameras: &[Camera], level: u8, rays: u64) -> Result<()> {
    let rays = RaySettings::default().rays(rays);
    let settings = GridSettings::default().level(level).surface_points(POINTS);
    let Outcome { field: dense, .. } =
        Estimation::new(field, cameras).rays(rays).grid(settings.grid(GridKind::Dense)).run()?;
    let dense = dense.without_sums();
    println!("\n### {name}, level {level}, {} rays; dense: {} bytes\n", rays.rays, dense.query_memory());
    println!(
        "| refine | tolerance | min rays | vertices | bytes | dense : this | s | box: mean | max | surfaces: mean | 95 % | max |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let only = |criterion| vec![criterion];
    let cases = [
        (only(Criterion::Sensitivity), 0.0, 0.0),
        (only(Criterion::Sensitivity), 0.001, 0.0),
        (only(Criterion::Sensitivity), 0.01, 0.0),
        (only(Criterion::Sensitivity), 0.1, 0.0),
        (only(Criterion::Density), 0.01, 0.0),
        (vec![Criterion::Sensitivity, Criterion::Density], 0.01, 0.0),
        (only(Criterion::Uniform), 0.01, 0.0),
        (only(Criterion::RayCount), 0.01, 2.0),
        (only(Criterion::RayCount), 0.01, 4.0),
        (only(Criterion::RayCount), 0.01, 16.0),
    ];
    for (criteria, tolerance, min_rays) in cases {
        let grid = settings.criteria(criteria.into_iter().collect()).tolerance(tolerance).min_rays(min_rays);
        let start = Instant::now();
        let Outcome { field: octree, .. } = Estimation::new(field, cameras).rays(rays).grid(grid).run()?;
        let time = start.elapsed().as_secs_f64();
        let s = octree.summary();
        let compared = compare(&octree, &dense, POINTS, 1)?;
        let number = |d: &Option<Difference>, of: fn(&Difference) -> f64| {
            d.as_ref().map_or("–".into(), |d| format!("{:.4}", of(d)))
        };
        println!(
            "| {} | {tolerance} | {min_rays} | {} | {} | {:.1} | {time:.1} | {} | {} | {} | {} | {} |",
            grid.criteria,
            s.vertices,
            s.query_bytes,
            dense.query_memory() as f64 / s.query_bytes as f64,
            number(&compared.in_box, |d| d.mean),
            number(&compared.in_box, |d| d.max),
            number(&compared.on_surfaces, |d| d.mean),
            number(&compared.on_surfaces, |d| d.percentile_95),
            number(&compared.on_surfaces, |d| d.max),
        );
    }
    Ok(())
}
