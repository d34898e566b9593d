//! Question: what does it cost to share a run among processes, by rays or by space?
//!
//! The closed-form city. By rays: levels 8 and 10, the same rays in one process of two threads, in two processes of one
//! thread, and in eight shards of which two run at a time, as a scheduler with two processors would have it. By space:
//! level 13, where one process needs more than twice the memory of any tile; the tiles joined are compared with that
//! one process, bit for bit, and queried in their folder. Writes the blocks of `experiments/distributed.md`.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::time::Instant;

use glam::Vec3;
use octobayes::estimate::{GridSettings, RaySettings};
use octobayes::octree::Tile;
use octobayes::uncertainty::{Answers, TiledField, UncertaintyField, finish_tiles, merge};
use octobayes::{Error, Result};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};

use common::clock::{Clock, Time};
use common::memory::peak;
use common::program::{Needs, Program};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, whole};
use common::work::Work;

/// Rays, and levels, of what is shared by rays: the default run, and a finer one.
const SHARED: (u64, [u8; 2]) = (4_096_000, [8, 10]);
/// Rays, and level, of what is shared by space.
const DEEP: (u64, u8) = (1_024_000, 13);
const TILES: u32 = 64;
const QUERIES: usize = 1 << 18;
/// Number of shards, how many run at a time, and threads of each.
const SPLITS: [(u64, usize, usize); 3] = [(1, 1, 2), (2, 2, 1), (8, 2, 1)];
/// The first argument of a process that does one step.
const STEP: &str = "step";

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if words.first().is_some_and(|word| word == STEP) {
        let row = step(&words[1], Path::new(&words[2]), &words[3..])?;
        println!("{}", serde_json::to_string(&row).expect("numbers"));
        return Ok(());
    }
    let program = Program::start("distributed", &[("rays", Needs::Nothing), ("space", Needs::Nothing)])?;
    program.part("rays", |work| Ok((words_of(SHARED.0, None), by_rays(work)?)))?;
    program.part("space", |work| Ok((words_of(DEEP.0, Some(DEEP.1)), by_space(work)?)))
}

/// What a process measures.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Row {
    time: Time,
    /// Of the process, bytes.
    peak: u64,
    /// Of the file that it wrote, or of all files.
    bytes: u64,
    vertices: u64,
    /// Nanoseconds of a query: the first batch, then the same batch again.
    queries: [f64; 2],
    /// Seconds until the field could be asked.
    opening: f64,
}

fn settings(rays: u64) -> RaySettings {
    RaySettings::default().rays(rays).occupancy(512)
}

fn grid(level: u8) -> GridSettings {
    GridSettings::default().level(level).keep_sums(false)
}

fn words_of(rays: u64, level: Option<u8>) -> String {
    let described = match level {
        Some(level) => describe(&settings(rays), &grid(level), &[]),
        None => describe(&settings(rays), &grid(8), &["level"]),
    };
    format!("city, 800 cameras. {described} {} Times and peaks are of one process a row.", seeds(&[0]))
}

/// Does one step of the work in this process.
fn step(what: &str, to: &Path, words: &[String]) -> Result<Row> {
    let clock = Clock::start();
    let number = |i: usize| words[i].parse::<u64>().expect("a whole number");
    let files = || words.iter().map(PathBuf::from).collect::<Vec<_>>();
    let mut row = Row::default();
    match what {
        "shard" | "tile" => {
            let (rays, level, index, of) = (number(0), number(1) as u8, number(2), number(3));
            let city = Scene::city()?;
            let tile = if what == "tile" { Tile::new(index as u32, of as u32) } else { None };
            let estimation = city.estimation(settings(rays), grid(level).tile(tile));
            let estimation = if what == "shard" { estimation.shard(index, of) } else { estimation };
            let field = estimation.run()?.field;
            field.write(to)?;
            row.vertices = field.summary().vertices;
        }
        "merge" => {
            let field = merge(&files())?;
            field.write(to)?;
            row.vertices = field.summary().vertices;
        }
        "finish" => finish_tiles(&files(), to)?,
        "ask" => {
            let room = number(0) as usize;
            let start = Instant::now();
            let tiled = TiledField::open(to, room)?;
            row.opening = start.elapsed().as_secs_f64();
            let points = points(&tiled);
            row.queries = ask(&tiled, &points)?;
        }
        "ask-whole" => {
            let start = Instant::now();
            let field = UncertaintyField::read(to)?;
            row.opening = start.elapsed().as_secs_f64();
            let points = points(&TiledField::open(Path::new(&words[0]), 0)?);
            row.queries = ask(&field, &points)?;
            row.vertices = field.summary().vertices;
        }
        _ => unreachable!("the steps of this program"),
    }
    row.bytes = size(to);
    row.time = clock.elapsed();
    row.peak = peak();
    Ok(row)
}

/// Bytes of a file, or of the files in a folder.
fn size(path: &Path) -> u64 {
    let of = |path: &Path| path.metadata().map_or(0, |metadata| metadata.len());
    match std::fs::read_dir(path) {
        Ok(entries) => entries.filter_map(|entry| Some(of(&entry.ok()?.path()))).sum(),
        Err(_) => of(path),
    }
}

/// Points everywhere near the ground of the city, in no order.
fn points(field: &TiledField) -> Vec<Vec3> {
    let bounds = field.facts().lattice().domain().bounds().expect("the city is in a box");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut chance = || rng.random::<f64>();
    let size = bounds.size();
    let mut point = || bounds.min() + size * glam::DVec3::new(chance(), chance(), 0.03 + 0.03 * chance());
    (0..QUERIES).map(|_| point().as_vec3()).collect()
}

/// Nanoseconds per query of a batch, and of the same batch again.
fn ask(field: &dyn Answers, points: &[Vec3]) -> Result<[f64; 2]> {
    let mut nanoseconds = [0.0; 2];
    for time in &mut nanoseconds {
        let start = Instant::now();
        let answers = field.answers(points)?;
        *time = start.elapsed().as_secs_f64() * 1e9 / points.len() as f64;
        assert!(answers.iter().all(|answer| answer.estimate.inside), "all points are in the city");
    }
    Ok(nanoseconds)
}

/// Lets a process of `threads` threads do a step.
fn process(threads: usize, what: &str, to: &Path, words: &[String]) -> Result<Row> {
    let this = Path::new("this program");
    let program = std::env::current_exe().map_err(Error::io(this, "cannot find"))?;
    let mut command = Command::new(program);
    command.arg(STEP).arg(what).arg(to).args(words).env("RAYON_NUM_THREADS", threads.to_string());
    let output = command.output().map_err(Error::io(this, "cannot run"))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(Error::malformed(this, what, "a step done", said));
    }
    serde_json::from_slice(&output.stdout).map_err(|e| Error::malformed(this, "row", "JSON", e.to_string()))
}

/// Runs the shards, `at_once` at a time. Returns their rows, and the seconds that all of them took.
fn shards(folder: &Path, level: u8, (of, at_once, threads): (u64, usize, usize)) -> Result<(Vec<(PathBuf, Row)>, f64)> {
    let start = Instant::now();
    let (next, done) = (Mutex::new(0..of), Mutex::new(Vec::new()));
    let work = || -> Result<()> {
        loop {
            let Some(index) = next.lock().expect("no worker panics").next() else { return Ok(()) };
            let path = folder.join(format!("part-{index}-of-{of}.oct"));
            let words = [SHARED.0, u64::from(level), index, of].map(|v| v.to_string());
            let row = process(threads, "shard", &path, &words)?;
            done.lock().expect("no worker panics").push((path, row));
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..at_once).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().expect("no worker panics"))
    })?;
    Ok((done.into_inner().expect("no worker panics"), start.elapsed().as_secs_f64()))
}

/// What a way of sharing costs.
#[derive(Serialize, Deserialize)]
struct Shared {
    seconds: f64,
    processor: f64,
    peak: u64,
    part_bytes: u64,
    merge: Row,
}

fn by_rays(work: &Work) -> Result<String> {
    let mut table = Table::new(&[
        "level",
        "processes",
        "at a time",
        "threads of each",
        "time, s",
        "processor µs per ray",
        "to the first",
        "largest peak, MB",
        "a part's file, MB",
        "merge, s per part",
        "merge, peak MB",
    ]);
    let mut first = 0.0;
    for (level, split) in SHARED.1.into_iter().flat_map(|level| SPLITS.map(|split| (level, split))) {
        let row = work.row(("by rays", SHARED.0, level, split), || {
            let folder = tempfile::tempdir().map_err(Error::io(Path::new("temporary folder"), "cannot make"))?;
            let (parts, seconds) = shards(folder.path(), level, split)?;
            let words: Vec<String> = parts.iter().map(|(path, _)| path.display().to_string()).collect();
            let merge = match parts.len() {
                1 => Row::default(),
                _ => process(2, "merge", &folder.path().join("merged.oct"), &words)?,
            };
            let rows = || parts.iter().map(|(_, row)| row);
            let processor = rows().map(|row| row.time.cpu).sum();
            let (peak, part_bytes) = (rows().map(|row| row.peak).max(), rows().map(|row| row.bytes).max());
            let (peak, part_bytes) = (peak.unwrap_or(0), part_bytes.unwrap_or(0));
            Ok(Shared { seconds, processor, peak, part_bytes, merge })
        })?;
        let (of, at_once, threads) = split;
        let all = row.processor + row.merge.time.cpu;
        first = if of == 1 { all } else { first };
        table.row(&[
            level.to_string(),
            of.to_string(),
            at_once.to_string(),
            threads.to_string(),
            format!("{:.1}", row.seconds + row.merge.time.wall),
            format!("{:.2}", 1e6 * all / SHARED.0 as f64),
            format!("{:.3}", all / first),
            whole(row.peak as f64 / 1e6),
            whole(row.part_bytes as f64 / 1e6),
            if of == 1 { "none".into() } else { format!("{:.2}", row.merge.time.wall / of as f64) },
            if of == 1 { "none".into() } else { whole(row.merge.peak as f64 / 1e6) },
        ]);
    }
    Ok(table.text().into())
}

fn by_space(work: &Work) -> Result<String> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("temporary folder"), "cannot make"))?;
    let at = |name: &str| folder.path().join(name);
    let numbers = |index: u32, of: u32| [DEEP.0.to_string(), DEEP.1.to_string(), index.to_string(), of.to_string()];
    let (rows, joined, finished, whole_run, asked, asked_whole) = work.row(("by space", DEEP, TILES), || {
        let mut rows = Vec::new();
        let mut files = Vec::new();
        for index in 0..TILES {
            let path = at(&format!("tile-{index}.oct"));
            rows.push(process(2, "tile", &path, &numbers(index, TILES))?);
            files.push(path.display().to_string());
        }
        let tiles = at("tiles");
        std::fs::create_dir(&tiles).map_err(Error::io(&tiles, "cannot make"))?;
        let finished = process(2, "finish", &tiles, &files)?;
        let joined = process(2, "merge", &at("joined.oct"), &files)?;
        let whole_run = process(2, "shard", &at("whole.oct"), &numbers(0, 1))?;
        let [whole, joined_field] = ["whole.oct", "joined.oct"].map(|name| UncertaintyField::read(&at(name)));
        let (whole, joined_field) = (whole?, joined_field?);
        assert!(whole.support() == joined_field.support(), "the octrees are one");
        assert!(whole.deviations() == joined_field.deviations() && whole.rays() == joined_field.rays(), "bit for bit");
        drop((whole, joined_field));
        let room = (finished.bytes / 4).to_string();
        let asked = process(2, "ask", &tiles, &[room])?;
        let asked_whole = process(2, "ask-whole", &at("whole.oct"), &[tiles.display().to_string()])?;
        Ok((rows, joined, finished, whole_run, asked, asked_whole))
    })?;
    let mut table = Table::new(&["process", "vertices", "file, MB", "time, s", "processor s", "peak, MB"]);
    let mut add = |name: String, row: &Row| {
        let vertices = if row.vertices > 0 { whole(row.vertices as f64) } else { "–".into() };
        table.row(&[
            name,
            vertices,
            whole(row.bytes as f64 / 1e6),
            format!("{:.1}", row.time.wall),
            format!("{:.1}", row.time.cpu),
            whole(row.peak as f64 / 1e6),
        ]);
    };
    add("whole, in one process".into(), &whole_run);
    let largest = rows.iter().max_by_key(|row| row.peak).cloned().unwrap_or_default();
    let sum = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>();
    let all = Row {
        time: Time { cpu: sum(|row| row.time.cpu), wall: sum(|row| row.time.wall) },
        peak: largest.peak,
        bytes: rows.iter().map(|row| row.bytes).sum(),
        ..Row::default()
    };
    add(format!("largest of {TILES} tiles"), &largest);
    add(format!("all {TILES} tiles, one after the other"), &all);
    add("`merge` into one file".into(), &joined);
    add("`merge` into a folder of tiles".into(), &finished);
    let mut queries = Table::new(&["field", "opening, ms", "first batch, ns a point", "again, ns a point", "peak, MB"]);
    for (name, row) in [("the file, read whole", &asked_whole), ("the folder, room for a quarter of it", &asked)] {
        let [first, again] = row.queries.map(whole);
        queries.row(&[name.into(), format!("{:.1}", 1e3 * row.opening), first, again, whole(row.peak as f64 / 1e6)]);
    }
    Ok(format!(
        "{}\nQueries of {} points near the ground, in no order:\n\n{}",
        table.text(),
        whole(QUERIES as f64),
        queries.text()
    ))
}
