//! Question: what does it cost to share the rays of a run among processes?
//!
//! The closed-form city at levels 8, 10 and 12: the same rays in one process of two threads, in two processes of one
//! thread, and in eight shards of which two run at a time, as a scheduler with two processors would have it. Writes the
//! block of `experiments/distributed.md`.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::time::Instant;

use octobayes::estimate::{GridSettings, RaySettings};
use octobayes::uncertainty::Merging;
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use common::clock::{Clock, Time};
use common::memory::peak;
use common::program::{Needs, Program};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, whole};
use common::work::Work;

/// Rays and levels: the default run, and finer ones.
const SHARED: (u64, [u8; 3]) = (4_096_000, [8, 10, 12]);
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
    let program = Program::start("distributed", &[("rays", Needs::Nothing)])?;
    program.part("rays", |work| Ok((words_of(), by_rays(work)?)))
}

/// What a process measures.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Row {
    time: Time,
    /// Of the process, bytes.
    peak: u64,
    /// Of the file that it wrote.
    bytes: u64,
}

fn settings() -> RaySettings {
    RaySettings::default().rays(SHARED.0).occupancy(512)
}

fn grid(level: u8) -> GridSettings {
    GridSettings::default().level(level).keep_sums(false)
}

fn words_of() -> String {
    let described = describe(&settings(), &grid(8), &["level"]);
    format!("city, 800 cameras. {described} {} Times and peaks are of one process a row.", seeds(&[0]))
}

/// Does one step of the work in this process.
fn step(what: &str, to: &Path, words: &[String]) -> Result<Row> {
    let clock = Clock::start();
    let number = |i: usize| words[i].parse::<u64>().expect("a whole number");
    let field = match what {
        "shard" => {
            let (level, index, of) = (number(0) as u8, number(1), number(2));
            Scene::city()?.estimation(settings(), grid(level)).shard(index, of).run()?.field
        }
        "merge" => {
            let folder = to.parent().unwrap_or(Path::new("."));
            let merging = Merging::default().keep_sums(false).scratch(folder);
            merging.join(&words.iter().map(PathBuf::from).collect::<Vec<_>>())?
        }
        _ => unreachable!("the steps of this program"),
    };
    field.write(to)?;
    let bytes = to.metadata().map_err(Error::io(to, "cannot read"))?.len();
    Ok(Row { time: clock.elapsed(), peak: peak(), bytes })
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
            let words = [u64::from(level), index, of].map(|v| v.to_string());
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
