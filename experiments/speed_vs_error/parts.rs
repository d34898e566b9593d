//! The tables of time against error.

use std::path::Path;

use octobayes::Result;
use octobayes::estimate::{GridKind, GridSettings, RaySettings};
use octobayes::internal::{Curve, write_plot};
use octobayes::posterior::Criterion;
use octobayes::rays::Pixels;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::UncertaintyField;

use super::ause::Truth;
use super::measure::{cells, error, grid, median, run};
use super::scenes::Scene;

/// The paper's workload, five times each.
pub fn targets(lego: &Scene) -> Result<()> {
    println!(
        "\n## The paper's workload: lego, level 8, 4,096,000 rays\n\n| derivatives | s, median of 5 | rays / s |\n|---|---|---|"
    );
    for gradient in [GradientMethod::FiniteDifference, GradientMethod::Analytic] {
        let rays = lego.settings.gradient(gradient);
        let run = median(lego, &rays, &grid(GridKind::Octree, 8), 5)?;
        println!("| {gradient:?} | {:.2} | {:.0} |", run.seconds, rays.rays as f64 / run.seconds);
    }
    Ok(())
}

/// Each feature switched on behind the others.
pub fn ablation(lego: &Scene, reference: &UncertaintyField) -> Result<()> {
    let paper = lego.settings.rays(409_600).pixels(Pixels::Random).cutoff(1e-8);
    let (dense, octree) = (grid(GridKind::Dense, 8), grid(GridKind::Octree, 8));
    let culled = paper.cutoff(RaySettings::default().cutoff);
    let coarse = paper.cutoff(1e-4);
    let sobol = culled.pixels(Pixels::Sobol);
    let analytic = sobol.gradient(GradientMethod::Analytic);
    let rows: [(&str, RaySettings, GridSettings); 8] = [
        ("dense grid, random rays, differences, cutoff 1e-8", paper, dense),
        ("octree instead", paper, octree),
        ("+ cutoff 1e-6 (default)", culled, octree),
        ("  or cutoff 1e-4", coarse, octree),
        ("+ low-discrepancy rays (default)", sobol, octree),
        ("+ the field's own derivatives (`--gradient auto`)", analytic, octree),
        ("+ `--min-rays 4`", analytic, octree.min_rays(4.0)),
        ("dense grid with all of the rays' features", analytic, dense),
    ];
    println!("\n## Feature by feature: lego, level 8, 409,600 rays\n");
    println!(
        "| | s, median of 3 | samples / ray | bytes for queries | surfaces: mean | 95 % | max | box: mean | 95 % | max |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    for (name, rays, grid) in rows {
        let run = median(lego, &rays, &grid, 3)?;
        let bytes = run.field.query_memory();
        let [surface, space] = error(&run.field, reference)?;
        println!(
            "| {name} | {:.2} | {:.1} | {bytes} | {} | {} |",
            run.seconds,
            run.samples as f64 / rays.rays as f64,
            cells(&surface),
            cells(&space)
        );
    }
    Ok(())
}

/// Error over rays, time and memory, with a plot; AUSE where the truth is known.
pub fn rays(scene: &Scene, reference: &UncertaintyField, truth: Option<&Truth>) -> Result<()> {
    let methods = [
        ("dense, random", GridKind::Dense, Pixels::Random, GradientMethod::FiniteDifference),
        ("octree, differences", GridKind::Octree, Pixels::Sobol, GradientMethod::FiniteDifference),
        ("octree, own derivatives", GridKind::Octree, Pixels::Sobol, GradientMethod::Auto),
    ];
    println!("\n## Rays: {}, level 8\n", scene.name);
    println!(
        "| rays | method | s | bytes for queries | surfaces: mean | 95 % | max | box: mean | 95 % | max | AUSE (MAE) |\n|---|---|---|---|---|---|---|---|---|---|---|"
    );
    let mut curves: Vec<Curve> =
        methods.iter().map(|m| Curve { name: m.0.into(), points: Vec::new(), reference: false }).collect();
    let counts = [20_480, 102_400, 204_800, 409_600, 1_024_000, 4_096_000];
    for rays in counts.into_iter().filter(|&rays| rays <= scene.rays) {
        for ((name, kind, pixels, gradient), curve) in methods.into_iter().zip(&mut curves) {
            let settings = scene.settings.rays(rays).pixels(pixels).gradient(gradient);
            let run = run(scene, &settings, &grid(kind, 8))?;
            let bytes = run.field.query_memory();
            let [surface, space] = error(&run.field, reference)?;
            curve.points.push((run.seconds.log10(), surface.mean.log10()));
            let ause = truth.map(|truth| truth.ause(scene, &run.field)).transpose()?;
            let ause = ause.map_or("-".into(), |ause| format!("{ause:.4}"));
            println!(
                "| {rays} | {name} | {:.2} | {bytes} | {} | {} | {ause} |",
                run.seconds,
                cells(&surface),
                cells(&space)
            );
        }
    }
    let file = format!("experiments/speed_vs_error_{}.svg", scene.name.split(' ').next().unwrap_or(scene.name));
    let title = format!("{}: error on surfaces against time", scene.name);
    write_plot(Path::new(&file), &title, ["log10 seconds", "log10 mean |Δ log10 U|"], &curves)
}

/// Time per ray over levels, on leaves as fine as the lattice, and no finer than four rays a vertex support.
pub fn levels(lego: &Scene) -> Result<()> {
    println!(
        "\n## Levels: lego, 409,600 rays, own derivatives\n\n| level | leaves | s, median of 3 | µs / ray | vertices | bytes for queries | dense f32 grid |\n|---|---|---|---|---|---|---|"
    );
    for level in 7..=11 {
        of_level(lego, &grid(GridKind::Octree, level), "as fine as the level")?;
    }
    for level in 8..=12 {
        let criteria = [Criterion::Sensitivity, Criterion::RayCount].into_iter().collect();
        let limited = grid(GridKind::Octree, level).criteria(criteria);
        of_level(lego, &limited, "`--refine sensitivity,ray-count`")?;
    }
    Ok(())
}

fn of_level(lego: &Scene, grid: &GridSettings, leaves: &str) -> Result<()> {
    let rays = lego.settings.rays(409_600).gradient(GradientMethod::Analytic);
    let run = median(lego, &rays, grid, 3)?;
    let dense = 4 * run.field.lattice().dense_vertices();
    println!(
        "| {} | {leaves} | {:.2} | {:.1} | {} | {} | {dense} |",
        grid.level,
        run.seconds,
        run.seconds * 1e6 / rays.rays as f64,
        run.field.summary().vertices,
        run.field.query_memory()
    );
    Ok(())
}
