//! Question: how do vertices, bytes and time grow with the level, in a scene that no dense grid can hold at its finest?
//!
//! The closed-form city with the cameras of its drive, occupancy 512: levels 8 to 12 with as many vertices as it takes,
//! and levels 12 and 13 with four times the rays in at most 4 GiB. Every row is a process of its own, so that its peak
//! memory is its own; point queries are at a million random points of the surfaces that the rays saw. Writes the blocks
//! of `experiments/scaling.md` and its plot.

mod common;

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use glam::Vec3;
use octobayes::estimate::{GridSettings, Outcome, RaySettings};
use octobayes::picture::{Curve, write_plot};
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use common::memory::peak;
use common::program::{Needs, Program, folder};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, whole};
use common::work::Work;

const QUERIES: usize = 1_000_000;
/// Level, rays, budget in bytes.
type Case = (u8, u64, Option<u64>);
const UNLIMITED: [Case; 5] =
    [(8, 1_024_000, None), (9, 1_024_000, None), (10, 1_024_000, None), (11, 1_024_000, None), (12, 1_024_000, None)];
const LIMITED: [Case; 2] = [(12, 4_096_000, Some(4 << 30)), (13, 4_096_000, Some(4 << 30))];
/// The first argument of a process that measures one row.
const ROW: &str = "row";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|word| word == ROW) {
        let [level, rays, memory] = [1, 2, 3].map(|i| arguments[i].parse::<u64>().expect("a whole number"));
        let row = measure((level as u8, rays, Some(memory).filter(|&bytes| bytes > 0)))?;
        println!("{}", serde_json::to_string(&row).expect("numbers"));
        return Ok(());
    }
    let program = Program::start("scaling", &[("growth", Needs::Nothing), ("budget", Needs::Nothing)])?;
    program.part("growth", |work| {
        let rows = rows(work, &UNLIMITED)?;
        plot(&rows)?;
        Ok((words(1_024_000), table(&UNLIMITED, &rows)))
    })?;
    program.part("budget", |work| Ok((words(4_096_000), table(&LIMITED, &rows(work, &LIMITED)?))))
}

/// What a process measures.
#[derive(Serialize, Deserialize)]
struct Row {
    vertices: u64,
    query_bytes: usize,
    structure_bytes: usize,
    /// A dense grid of one f32 a vertex.
    dense_bytes: u64,
    /// Of the sums that the field keeps.
    kept_bytes: usize,
    /// Of the process.
    peak: u64,
    seconds: f64,
    /// Of one query.
    nanoseconds: f64,
}

fn settings(rays: u64) -> RaySettings {
    RaySettings::default().rays(rays).occupancy(512)
}

fn words(rays: u64) -> String {
    let described = describe(&settings(rays), &GridSettings::default(), &["level"]);
    format!("city, 800 cameras. {described} {} Times and peaks are of one process a row.", seeds(&[0]))
}

fn measure((level, rays, memory): Case) -> Result<Row> {
    let city = Scene::city()?;
    let grid = GridSettings::default().level(level).memory(memory);
    let start = Instant::now();
    let Outcome { field, .. } = city.estimation(settings(rays), grid).run()?;
    let seconds = start.elapsed().as_secs_f64();
    let peak = peak();
    let field = city.with_surfaces(field, settings(rays), QUERIES)?;
    let points: Vec<Vec3> = field.surface().iter().map(|&x| Vec3::from_array(x)).collect();
    // In an order that no cache likes.
    let n = points.len();
    let start = Instant::now();
    let sum: f64 = (0..n).map(|i| field.query(points[i * 7_368_787 % n]).uncertainty).sum();
    let nanoseconds = start.elapsed().as_secs_f64() * 1e9 / n as f64;
    assert!(sum.is_finite(), "queries have answers");
    let summary = field.summary();
    Ok(Row {
        vertices: summary.vertices,
        query_bytes: summary.query_bytes,
        structure_bytes: summary.structure_bytes,
        dense_bytes: 4 * field.lattice().dense_vertices(),
        kept_bytes: field.sums().map_or(0, size_of_val),
        peak,
        seconds,
        nanoseconds,
    })
}

/// One process a row.
fn rows(work: &Work, cases: &[Case]) -> Result<Vec<Row>> {
    let this = Path::new("this program");
    let row = |&(level, rays, memory): &Case| {
        work.row(("scaling", level, rays, memory), || {
            let program = std::env::current_exe().map_err(Error::io(this, "cannot find"))?;
            let numbers = [u64::from(level), rays, memory.unwrap_or(0)].map(|v| v.to_string());
            let output =
                Command::new(program).arg(ROW).args(numbers).output().map_err(Error::io(this, "cannot run"))?;
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            if !output.status.success() {
                return Err(Error::malformed(this, format!("level {level}"), "a row", said));
            }
            serde_json::from_slice(&output.stdout).map_err(|e| Error::malformed(this, "row", "JSON", e.to_string()))
        })
    };
    cases.iter().map(row).collect()
}

fn table(cases: &[Case], rows: &[Row]) -> String {
    let mut table = Table::new(&[
        "level",
        "cells per axis",
        "rays",
        "budget",
        "vertices",
        "field for queries, bytes",
        "structure, B / vertex",
        "dense f32 grid, bytes",
        "dense : field",
        "sums kept, bytes",
        "peak of the process, MB",
        "time, s",
        "query, ns",
    ]);
    for ((level, rays, memory), row) in cases.iter().zip(rows) {
        let dense = row.dense_bytes as f64;
        table.row(&[
            level.to_string(),
            (1_u64 << level).to_string(),
            whole(*rays as f64),
            memory.map_or("none".into(), |bytes| format!("{} GiB", bytes >> 30)),
            whole(row.vertices as f64),
            whole(row.query_bytes as f64),
            format!("{:.2}", row.structure_bytes as f64 / row.vertices as f64),
            whole(dense),
            whole(dense / row.query_bytes as f64),
            whole(row.kept_bytes as f64),
            whole(row.peak as f64 / 1e6),
            format!("{:.1}", row.seconds),
            whole(row.nanoseconds),
        ]);
    }
    table.text().into()
}

fn plot(rows: &[Row]) -> Result<()> {
    let curve = |name: &str, value: &dyn Fn(usize) -> f64| Curve {
        name: name.into(),
        points: (0..rows.len()).map(|i| (f64::from(UNLIMITED[i].0), value(i).log10())).collect(),
        reference: false,
    };
    let curves = [
        curve("vertices", &|i| rows[i].vertices as f64),
        curve("bytes for queries", &|i| rows[i].query_bytes as f64),
        curve("bytes of the dense f32 grid", &|i| rows[i].dense_bytes as f64),
        curve("seconds", &|i| rows[i].seconds),
    ];
    write_plot(&folder().join("scaling.svg"), "city: growth with the level", ["level", "log10"], &curves)
}
