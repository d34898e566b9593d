//! Queries of octree and dense grid, and files.

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use octobayes::estimate::GridKind;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};

use super::measure::{grid, run};
use crate::common::clock::median;
use crate::common::scenes::Scene;
use crate::common::settings::{describe, seeds};
use crate::common::table::{Table, whole};
use crate::common::work::Work;

const POINTS: usize = 4_000_000;

/// Nanoseconds per point, median of five.
fn time(field: &UncertaintyField, points: &[Vec3]) -> f64 {
    let times = (0..5)
        .map(|_| {
            let start = Instant::now();
            std::hint::black_box(field.query_all(points));
            start.elapsed().as_secs_f64() * 1e9 / points.len() as f64
        })
        .collect();
    median(times)
}

/// The same for single queries on one core.
fn latency(field: &UncertaintyField, points: &[Vec3]) -> f64 {
    let some = &points[..200_000];
    let times = (0..5)
        .map(|_| {
            let start = Instant::now();
            some.iter().for_each(|&x| {
                std::hint::black_box(field.query(x));
            });
            start.elapsed().as_secs_f64() * 1e9 / some.len() as f64
        })
        .collect();
    median(times)
}

/// Level of the field that is written and read.
const FILE_LEVEL: u8 = 10;

/// Octree and dense grid with the same values, in the same run.
pub fn queries(work: &Work, lego: &Scene) -> Result<(String, String)> {
    let rays = lego.settings.rays(1_024_000).gradient(GradientMethod::Analytic);
    let mut table = Table::new(&[
        "level",
        "points",
        "octree, ns",
        "dense, ns",
        "dense : octree",
        "single: octree, ns",
        "dense, ns",
    ]);
    let mut file = None;
    for level in [8, 9, FILE_LEVEL] {
        let row: LevelRow = work.row(("queries", level), || {
            let octree = run(lego, &rays, &grid(GridKind::Octree, level))?.field;
            let file = (level == FILE_LEVEL).then(|| files(&octree)).transpose()?;
            Ok((of_level(lego, &octree), file))
        })?;
        let (times, this) = row;
        file = file.or(this);
        for (name, [a, b, single, alone]) in ["anywhere in the box", "on surfaces"].iter().zip(times) {
            table.row(&[
                level.to_string(),
                (*name).into(),
                format!("{a:.1}"),
                format!("{b:.1}"),
                format!("{:.2}", b / a),
                whole(single),
                whole(alone),
            ]);
        }
    }
    let [vertices, written, read] = file.unwrap_or_default();
    let words = format!(
        "{}. {} {} {} points in no order, all threads (single queries: one, 200,000 points), medians of 5; the dense \
         grid has the octree's values.",
        lego.name,
        describe(&rays, &grid(GridKind::Octree, 8), &["level"]),
        seeds(&[0]),
        whole(POINTS as f64),
    );
    let body = format!(
        "{}\nA field of level {FILE_LEVEL} with {} vertices, without sums: written in {written:.2} s, read in \
         {read:.2} s.",
        table.text(),
        whole(vertices)
    );
    Ok((words, body))
}

/// Of points anywhere and on surfaces: nanoseconds of octree and dense grid, then of single queries; vertices and
/// seconds of the file.
type LevelRow = ([[f64; 4]; 2], Option<[f64; 3]>);

fn of_level(lego: &Scene, octree: &UncertaintyField) -> [[f64; 4]; 2] {
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
    let dense = octree.on_dense_grid();
    [&anywhere, &surfaces]
        .map(|points| [time(octree, points), time(&dense, points), latency(octree, points), latency(&dense, points)])
}

/// Writes and reads a field: its vertices, and seconds.
fn files(field: &UncertaintyField) -> Result<[f64; 3]> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let path = folder.path().join("field.oct");
    let start = Instant::now();
    field.write(&path)?;
    let written = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let read = UncertaintyField::read(&path)?;
    Ok([read.summary().vertices as f64, written, start.elapsed().as_secs_f64()])
}
