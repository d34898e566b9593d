//! Queries of octree and dense grid, and files.

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use octobayes::estimate::GridKind;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};

use super::measure::{grid, run};
use super::scenes::Scene;

const POINTS: usize = 4_000_000;

/// Nanoseconds per point, median of five.
fn time(field: &UncertaintyField, points: &[Vec3]) -> f64 {
    let mut times: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            std::hint::black_box(field.query_all(points));
            start.elapsed().as_secs_f64() * 1e9 / points.len() as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[2]
}

/// The same for single queries on one core.
fn latency(field: &UncertaintyField, points: &[Vec3]) -> f64 {
    let some = &points[..200_000];
    let mut times: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            some.iter().for_each(|&x| {
                std::hint::black_box(field.query(x));
            });
            start.elapsed().as_secs_f64() * 1e9 / some.len() as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[2]
}

/// Octree and dense grid with the same values, in the same run.
pub fn queries(lego: &Scene) -> Result<()> {
    println!(
        "\n## Queries: lego, {POINTS} points in no order, two threads (single queries: one), ns per point, medians of 5\n"
    );
    println!(
        "| level | points | octree | dense | dense : octree | single: octree | dense |\n|---|---|---|---|---|---|---|"
    );
    for level in [8, 9, 10] {
        let rays = lego.settings.rays(1_024_000).gradient(GradientMethod::Analytic);
        let octree = run(lego, &rays, &grid(GridKind::Octree, level))?.field;
        let bounds = lego.field.bounds();
        let golden = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];
        let at = |i: usize| glam::DVec3::from(golden.map(|g| (i as f64 * g).fract()));
        let anywhere: Vec<Vec3> = (0..POINTS).map(|i| (bounds.min() + at(i) * bounds.size()).as_vec3()).collect();
        let half = (0.5 * octree.lattice().edge()).as_vec3();
        let seen = octree.surface();
        // Around points that the rays saw, up to half a cell off, in no order.
        let surfaces: Vec<Vec3> = (0..POINTS)
            .map(|i| Vec3::from_array(seen[i * 7_919 % seen.len()]) + half * (2.0 * at(i).as_vec3() - 1.0))
            .collect();
        if level == 10 {
            files(&octree)?;
        }
        let dense = octree.on_dense_grid();
        for (name, points) in [("anywhere in the box", &anywhere), ("on surfaces", &surfaces)] {
            let (a, b) = (time(&octree, points), time(&dense, points));
            let (single, alone) = (latency(&octree, points), latency(&dense, points));
            println!("| {level} | {name} | {a:.1} | {b:.1} | {:.2} | {single:.0} | {alone:.0} |", b / a);
        }
    }
    Ok(())
}

/// Writes and reads a field of level 10.
fn files(field: &UncertaintyField) -> Result<()> {
    let path = Path::new("target/experiments/level10.oct");
    let folder = path.parent().expect("the path has a folder");
    std::fs::create_dir_all(folder).map_err(Error::io(folder, "cannot create the folder"))?;
    let start = Instant::now();
    field.write(path)?;
    let written = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let read = UncertaintyField::read(path)?;
    eprintln!(
        "a field of level 10 with {} vertices: written in {written:.3} s, read in {:.3} s",
        read.summary().vertices,
        start.elapsed().as_secs_f64()
    );
    Ok(())
}
