//! Damages valid files at random and reads them, on all cores: many more inputs than libFuzzer has time for, none
//! chosen by coverage.
//!
//! `cargo run --release --bin storm -- SECONDS [SEED] [KIND …]` in `fuzz/`; the seconds are those of one kind. An input
//! that makes a reader panic is kept in `artifacts/`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use octobayes_fuzz::Kind;
use octobayes_fuzz::untrusted::damage::{self, Damage};
use octobayes_fuzz::untrusted::{probe, samples};

/// What was read, and what came of it.
#[derive(Default)]
struct Count {
    inputs: u64,
    refused: u64,
    panics: u64,
    slowest: Duration,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let seconds = arguments.next().and_then(|text| text.parse().ok()).expect("seconds for each kind");
    let seed = arguments.next().map_or(0, |text| text.parse().expect("a seed, a whole number"));
    let wanted: Vec<String> = arguments.collect();
    let name = |kind: Kind| format!("{kind:?}").to_lowercase();
    let folder = tempfile::tempdir_in(if Path::new("/dev/shm").is_dir() { "/dev/shm" } else { "." }).expect("a folder");
    println!("| kind | inputs | refused | panics | slowest, ms |\n|---|---|---|---|---|");
    let mut all = 0;
    for (k, kind) in Kind::ALL.into_iter().enumerate() {
        if !wanted.is_empty() && !wanted.contains(&name(kind)) {
            continue;
        }
        let count = Mutex::new(Count::default());
        let until = Instant::now() + Duration::from_secs_f64(seconds);
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        std::thread::scope(|scope| {
            for thread in 0..threads {
                let (count, folder) = (&count, folder.path().join(thread.to_string()));
                let random = fastrand::Rng::with_seed(seed << 16 | (k as u64) << 8 | thread as u64);
                scope.spawn(move || storm(kind, until, random, &folder, count));
            }
        });
        let Count { inputs, refused, panics, slowest } = count.into_inner().expect("no thread panicked");
        all += inputs;
        println!("| `{}` | {inputs} | {refused} | {panics} | {} |", name(kind), slowest.as_millis());
    }
    println!("{all} inputs");
}

/// Damages and reads files of a kind in `folder` until it is time.
fn storm(kind: Kind, until: Instant, mut random: fastrand::Rng, folder: &Path, count: &Mutex<Count>) {
    std::fs::create_dir_all(folder).expect("a folder");
    let path = folder.join(kind.file_name());
    let files = samples::of(kind);
    let mut own = Count::default();
    while Instant::now() < until {
        let whole = &files[random.usize(..files.len())];
        let damages: Vec<(f64, Damage)> = (0..random.usize(1..5)).map(|_| (random.f64(), any(&mut random))).collect();
        let bytes = damage::file(kind, whole, random.bool(), &damages);
        std::fs::write(&path, &bytes).expect("the file to read");
        let start = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| probe::read(kind, &path))) {
            Ok(outcome) => own.refused += u64::from(outcome.is_err()),
            Err(_) => {
                own.panics += 1;
                keep(kind, &bytes);
            }
        }
        own.slowest = own.slowest.max(start.elapsed());
        own.inputs += 1;
    }
    let mut count = count.lock().expect("no thread panicked");
    count.inputs += own.inputs;
    count.refused += own.refused;
    count.panics += own.panics;
    count.slowest = count.slowest.max(own.slowest);
}

fn any(random: &mut fastrand::Rng) -> Damage {
    let at = random.f64();
    match random.u8(..7) {
        0 => Damage::Set(at, random.u8(..)),
        1 => Damage::Flip(at, random.u8(..8)),
        2 => Damage::Cut(at),
        3 => Damage::Grow(at, random.usize(1..9)),
        4 => Damage::Remove(at, random.usize(1..40)),
        5 => Damage::Copy(at, random.f64(), random.usize(1..200)),
        _ => Damage::Insert(at, (0..random.usize(1..9)).map(|_| random.u8(..)).collect()),
    }
}

fn keep(kind: Kind, bytes: &[u8]) {
    let folder = PathBuf::from("artifacts");
    std::fs::create_dir_all(&folder).expect("a folder for what makes readers panic");
    let mut hash = crc32fast::Hasher::new();
    hash.update(bytes);
    std::fs::write(folder.join(format!("storm-{kind:?}-{:08x}", hash.finalize())), bytes).expect("a file");
}
