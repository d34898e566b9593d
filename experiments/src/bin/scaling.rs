//! Question: how do vertices, bytes and time grow with the level, in a scene that no dense grid can hold at its finest?
//!
//! The closed-form city with the cameras of its drive, occupancy 512: levels 8 to 12 with as much memory as it takes,
//! and levels 12 and 13 with four times the rays, without a budget and in 1 and 4 GiB, whose fields are compared. Every
//! row is a process of its own, so that its peak memory is its own; point queries are at a million random points of the
//! surfaces that the rays saw. An unbounded scene of the data at levels that a dense grid can hold shows what a run
//! takes beside its sums. Writes the blocks of `experiments/scaling.md` and its plot.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use glam::{DVec3, Vec3};
use octobayes::estimate::{GridKind, GridSettings, Outcome, RaySettings};
use octobayes::geometry::{Aabb, Domain, Lattice, Norm};
use octobayes::posterior::{DensePosterior, VertexSums};
use octobayes::uncertainty::{Support, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_show::picture::{Curve, write_plot};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use common::memory::peak;
use common::program::{Needs, Program, folder};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, whole};
use common::work::Work;

const QUERIES: usize = 1_000_000;
/// Level, rays, budget in bytes, whether the field keeps its sums.
type Case = (u8, u64, Option<u64>, bool);
const UNLIMITED: [Case; 5] = [
    (8, 1_024_000, None, false),
    (9, 1_024_000, None, false),
    (10, 1_024_000, None, false),
    (11, 1_024_000, None, false),
    (12, 1_024_000, None, false),
];
/// The same runs without a budget and with one.
const LIMITED: [Case; 4] = [
    (12, 4_096_000, None, false),
    (12, 4_096_000, Some(1 << 30), false),
    (13, 4_096_000, None, false),
    (13, 4_096_000, Some(4 << 30), false),
];
/// Level, rays and budget in bytes of the unbounded scene, on both grids where a dense one can be held.
const UNBOUNDED: [(u8, u64, Option<u64>); 3] =
    [(7, 102_400, None), (8, 102_400, None), (9, 1_024_000, Some(320_000_000))];
/// The highest of these levels that is measured on a dense grid, too.
const MOST_DENSE: u8 = 8;
/// The first argument of a process that measures one row of the city, and of the unbounded scene.
const ROW: &str = "row";
const UNBOUNDED_ROW: &str = "unbounded-row";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|word| word == ROW) {
        let [level, rays, memory, keeps] = [1, 2, 3, 4].map(|i| arguments[i].parse::<u64>().expect("a whole number"));
        let row = measure((level as u8, rays, Some(memory).filter(|&bytes| bytes > 0), keeps > 0))?;
        println!("{}", serde_json::to_string(&row).expect("numbers"));
        return Ok(());
    }
    if let [UNBOUNDED_ROW, grid, numbers @ ..] = &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        let [level, rays, memory] = [0, 1, 2].map(|i| numbers[i].parse::<u64>().expect("a whole number"));
        let grid = if *grid == "dense" { GridKind::Dense } else { GridKind::Octree };
        let case = (level as u8, rays, Some(memory).filter(|&bytes| bytes > 0));
        println!("{}", serde_json::to_string(&measure_unbounded(case, grid)?).expect("numbers"));
        return Ok(());
    }
    let parts = [("growth", Needs::Nothing), ("budget", Needs::Nothing), ("unbounded", Needs::Data)];
    let program = Program::start("scaling", &parts)?;
    program.part("growth", |work| {
        let rows = rows(work, &UNLIMITED)?;
        plot(&rows)?;
        Ok((words(1_024_000), table(&UNLIMITED, &rows)))
    })?;
    program.part("budget", |work| Ok((words(4_096_000), table(&LIMITED, &rows(work, &LIMITED)?))))?;
    program.part("unbounded", |work| unbounded(work, &Scene::bicycle(&Program::data()?)?.settings))
}

/// What a process measures.
#[derive(Serialize, Deserialize)]
struct Row {
    vertices: u64,
    query_bytes: usize,
    structure_bytes: usize,
    /// A dense grid of one f32 a vertex.
    dense_bytes: u64,
    /// Of the sums in memory, when they were largest.
    sums_bytes: usize,
    /// Of those that left memory.
    disk_bytes: u64,
    /// Checksums of all vertices, and of their deviations.
    checksums: [u32; 2],
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

fn measure((level, rays, memory, keeps_sums): Case) -> Result<Row> {
    let city = Scene::city()?;
    let grid = GridSettings::default().level(level).memory(memory).keep_sums(keeps_sums);
    let start = Instant::now();
    let Outcome { field, sums_bytes, disk_bytes, .. } = city.estimation(settings(rays), grid).run()?;
    let seconds = start.elapsed().as_secs_f64();
    let peak = peak();
    let checksums = checksums(&field);
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
        sums_bytes,
        disk_bytes,
        checksums,
        peak,
        seconds,
        nanoseconds,
    })
}

/// Of all vertices, and of their deviations.
fn checksums(field: &UncertaintyField) -> [u32; 2] {
    let Support::Octree(octree) = field.support() else { unreachable!("every row is an octree") };
    let (mut vertices, mut deviations) = (crc32fast::Hasher::new(), crc32fast::Hasher::new());
    octree.vertex_positions().for_each(|point| point.iter().for_each(|i| vertices.update(&i.to_le_bytes())));
    field.deviations().iter().for_each(|sigma| deviations.update(&sigma.to_le_bytes()));
    [vertices.finalize(), deviations.finalize()]
}

/// What a process with these arguments measures.
fn measured<T: DeserializeOwned>(arguments: &[String]) -> Result<T> {
    let this = Path::new("this program");
    let program = std::env::current_exe().map_err(Error::io(this, "cannot find"))?;
    let output = Command::new(program).args(arguments).output().map_err(Error::io(this, "cannot run"))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(Error::malformed(this, arguments.join(" "), "a row", said));
    }
    serde_json::from_slice(&output.stdout).map_err(|e| Error::malformed(this, "row", "JSON", e.to_string()))
}

/// One process a row.
fn rows(work: &Work, cases: &[Case]) -> Result<Vec<Row>> {
    let row = |&(level, rays, memory, keeps_sums): &Case| {
        let numbers = [u64::from(level), rays, memory.unwrap_or(0), u64::from(keeps_sums)].map(|v| v.to_string());
        let arguments = [&[ROW.to_owned()][..], &numbers].concat();
        work.row(("scaling", level, rays, memory, keeps_sums), || measured(&arguments))
    };
    cases.iter().map(row).collect()
}

/// What a run of the unbounded scene takes.
#[derive(Serialize, Deserialize)]
struct Taken {
    /// Before the run: program and model.
    before: u64,
    /// Of the process.
    peak: u64,
    /// Of all sums in memory, when they were largest.
    sums: usize,
    /// Of those that left memory.
    disk: u64,
    seconds: f64,
    vertices: u64,
}

fn measure_unbounded((level, rays, memory): (u8, u64, Option<u64>), grid: GridKind) -> Result<Taken> {
    let bicycle = Scene::bicycle(&Program::data()?)?;
    let domain = Domain::contracted(DVec3::splat(0.5), 0.5, Norm::L2)?;
    let before = peak();
    let grid = GridSettings::default().level(level).grid(grid).keep_sums(false).memory(memory);
    let start = Instant::now();
    let outcome = bicycle.estimation(bicycle.settings.rays(rays), grid).domain(domain).run()?;
    let (sums, vertices) = (outcome.sums_bytes, outcome.field.summary().vertices);
    let (disk, seconds) = (outcome.disk_bytes, start.elapsed().as_secs_f64());
    Ok(Taken { before, peak: peak(), sums, disk, seconds, vertices })
}

/// Peaks of dense grid and octree.
fn unbounded(work: &Work, settings: &RaySettings) -> Result<(String, String)> {
    let mut table = Table::new(&[
        "level",
        "rays",
        "grid",
        "budget, MB",
        "vertices",
        "program and model, MB",
        "sums, MB",
        "on disk, MB",
        "peak of the process, MB",
        "to dense",
        "time, s",
    ]);
    let megabytes = |bytes: f64| whole(bytes / 1e6);
    for (level, rays, memory) in UNBOUNDED {
        let mut dense = f64::NAN;
        for grid in ["dense", "octree"] {
            if grid == "dense" && level > MOST_DENSE {
                // Its sums alone, which are all in memory.
                dense = DensePosterior::required_memory(&Lattice::new(Aabb::centered_cube(1.0), level)?) as f64;
                let mut cells = vec![String::new(); 11];
                (cells[0], cells[1], cells[2]) = (level.to_string(), whole(rays as f64), "dense, computed".into());
                (cells[4], cells[6]) = (whole(dense / size_of::<VertexSums>() as f64), megabytes(dense));
                table.row(&cells);
                continue;
            }
            let numbers = [u64::from(level), rays, memory.unwrap_or(0)].map(|v| v.to_string());
            let arguments = [&[UNBOUNDED_ROW.to_owned(), grid.to_owned()][..], &numbers].concat();
            let row: Taken = work.row((UNBOUNDED_ROW, level, grid, rays, memory), || measured(&arguments))?;
            if grid == "dense" {
                dense = row.peak as f64;
            }
            table.row(&[
                level.to_string(),
                whole(rays as f64),
                grid.into(),
                memory.map_or("none".into(), |bytes| megabytes(bytes as f64)),
                whole(row.vertices as f64),
                megabytes(row.before as f64),
                megabytes(row.sums as f64),
                megabytes(row.disk as f64),
                megabytes(row.peak as f64),
                format!("{:.3}", row.peak as f64 / dense),
                whole(row.seconds),
            ]);
        }
    }
    let described = describe(settings, &GridSettings::default(), &["level", "grid", "rays"]);
    let words = format!(
        "bicycle (mip-NeRF 360), contracted around its object region, in its own poses at 400 × 300. {described} {} \
         Peaks are of one process a row, which keeps no sums in its field.",
        seeds(&[0])
    );
    Ok((words, table.text().into()))
}

fn table(cases: &[Case], rows: &[Row]) -> String {
    // Without a budget nothing leaves memory, and there is no other field to compare with.
    let has_budget = cases.iter().any(|(_, _, memory, _)| memory.is_some());
    let of_budget = |cells: Vec<String>| if has_budget { cells } else { Vec::new() };
    let heads = [
        "level",
        "cells per axis",
        "rays",
        "field keeps sums",
        "budget",
        "vertices",
        "field for queries, bytes",
        "structure, B / vertex",
        "dense f32 grid, bytes",
        "dense : field",
        "sums, bytes",
    ]
    .map(String::from);
    let more = of_budget(vec!["on disk, bytes".into(), "vertices, deviations (CRC-32)".into()]);
    let last = ["peak of the process, MB", "time, s", "query, ns"].map(String::from);
    let heads = [heads.to_vec(), more, last.to_vec()].concat();
    let mut table = Table::new(&heads.iter().map(String::as_str).collect::<Vec<_>>());
    for ((level, rays, memory, keeps_sums), row) in cases.iter().zip(rows) {
        let dense = row.dense_bytes as f64;
        let cells = vec![
            level.to_string(),
            (1_u64 << level).to_string(),
            whole(*rays as f64),
            if *keeps_sums { "yes" } else { "no" }.into(),
            memory.map_or("none".into(), |bytes| format!("{} GiB", bytes >> 30)),
            whole(row.vertices as f64),
            whole(row.query_bytes as f64),
            format!("{:.2}", row.structure_bytes as f64 / row.vertices as f64),
            whole(dense),
            whole(dense / row.query_bytes as f64),
            whole(row.sums_bytes as f64),
        ];
        let sums = row.checksums.map(|sum| format!("{sum:08x}")).join(", ");
        let more = of_budget(vec![whole(row.disk_bytes as f64), sums]);
        let last = vec![whole(row.peak as f64 / 1e6), format!("{:.1}", row.seconds), whole(row.nanoseconds)];
        table.row(&[cells, more, last].concat());
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
