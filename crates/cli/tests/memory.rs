//! The bytes that a field reports are those that the allocator gave, and those that a run foresees are those that the
//! kernel counts. Runs in a process of its own, because it counts all allocations.

use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Intrinsics, TrainedField};
use octobayes::uncertainty::{Support, UncertaintyField};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Mutex;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// What `make` returns, and the bytes allocated by it that are still held at its end.
fn held<T>(make: impl FnOnce() -> T) -> (usize, T) {
    let region = Region::new(ALLOCATOR);
    let made = make();
    let change = region.change();
    (change.bytes_allocated - change.bytes_deallocated, made)
}

fn city(level: u8, rays: u64) -> UncertaintyField {
    let city = ClosedForm::named("city").unwrap();
    let cameras = city.cameras(&Intrinsics::default()).unwrap().unwrap();
    let grid = GridSettings::default().level(level);
    Estimation::new(&city, &cameras).rays(RaySettings::default().rays(rays)).grid(grid).run().unwrap().field
}

/// The allocator counts for the whole process, so tests run one after another.
static ALONE: Mutex<()> = Mutex::new(());

#[test]
fn parts_add_up_to_what_was_allocated_and_structure_is_small() {
    let _alone = ALONE.lock();
    let courtyard = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(8, [64, 64]);
    let rays = RaySettings::default().rays(10_000);
    let of = |grid, level| {
        let settings = GridSettings::default().grid(grid).level(level);
        Estimation::new(&courtyard, &cameras).rays(rays).grid(settings).run().unwrap().field
    };
    let fields = [of(GridKind::Octree, 7), of(GridKind::Dense, 5), city(10, 10_000), city(12, 10_000)];
    for field in fields {
        let file = tempfile::NamedTempFile::new().unwrap();
        field.write(file.path()).unwrap();
        let makes: [fn(&UncertaintyField) -> UncertaintyField; 2] = [Clone::clone, |f| f.clone().without_sums()];
        for make in makes {
            let (bytes, copy) = held(|| make(&field));
            check(bytes, &copy);
        }
        // A field read from a file holds no more than it needs, either.
        let (bytes, read) = held(|| UncertaintyField::read(file.path()).unwrap());
        check(bytes, &read);
        if let Support::Octree(octree) = field.support() {
            let structure: usize = octree.memory().iter().map(|part| part.1).sum();
            let per_vertex = structure as f64 / octree.vertex_count() as f64;
            assert!((0.1..=1.5).contains(&per_vertex), "{per_vertex} bytes of structure per vertex");
            let dense = 4.0 * field.lattice().dense_vertices() as f64;
            let least = match field.lattice().level() {
                10 => 40.0,
                12 => 150.0,
                _ => 2.0,
            };
            let ratio = dense / field.query_memory() as f64;
            assert!(ratio >= least, "1/{ratio} of the dense grid at level {}", field.lattice().level());
        }
    }
}

/// Strings of the record, and headers of vectors inside vectors, come on top of what `memory` lists.
fn check(allocated: usize, field: &UncertaintyField) {
    let listed: usize = field.memory().iter().map(|part| part.1).sum();
    assert!(listed <= allocated && allocated <= listed + 4096, "{listed} bytes listed, {allocated} allocated");
}

/// What a process took, or foresees, bytes.
struct Taken {
    /// The kernel's count at the process's end.
    peak: f64,
    /// Of the file that it wrote.
    file: f64,
    /// Of the sums that left memory.
    disk: f64,
    /// Number of the field's vertices.
    vertices: f64,
}

fn run(folder: &Path, args: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace()).current_dir(folder).output().unwrap()
}

/// What a run of the program printed, as a process of its own.
fn reported(folder: &Path, args: &str) -> serde_json::Value {
    let output = run(folder, &format!("uncertainty {args} --json"));
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn measure(args: &str) -> Taken {
    let folder = tempfile::tempdir().unwrap();
    let report = reported(folder.path(), &format!("{args} -o field.oct"));
    let file = folder.path().join("field.oct").metadata().unwrap().len() as f64;
    let [peak, disk] = ["peak_bytes", "disk_bytes"].map(|key| report[key].as_f64().unwrap());
    Taken { peak, file, disk, vertices: report["summary"]["vertices"].as_f64().unwrap() }
}

fn foreseen(args: &str) -> Taken {
    let needs = reported(&std::env::temp_dir(), &format!("{args} --dry-run"));
    let keys = ["peak_bytes", "file_bytes", "disk_bytes", "vertices"];
    let [peak, file, disk, vertices] = keys.map(|key| needs[key].as_f64().unwrap());
    Taken { peak, file, disk, vertices }
}

/// Runs under a budget: the kernel's peak is at most a twentieth above it, or above what the finished field takes while
/// it is made, if that is more: 8 bytes for every vertex beside the program. Where sums left memory, at least half of
/// the budget was used. Returns the bytes of sums on disk.
fn keeps(scene: &str, cases: &[(u8, f64)]) -> f64 {
    let mut disk = 0.0;
    for (level, budget) in cases {
        let run = measure(&format!("{scene} --level {level} --memory {budget}"));
        let most = budget.max(48e6 + 8.0 * run.vertices);
        println!(
            "| {scene} | {level} | {:.0} | {:.0} | {:.2} | {:.1} | {:.1} |",
            budget / 1e6,
            run.peak / 1e6,
            run.peak / most,
            run.disk / 1e6,
            run.file / 1e6
        );
        assert!(run.peak <= 1.05 * most, "{scene}, level {level}: {} of {most} bytes", run.peak);
        let is_used = run.disk == 0.0 || run.peak >= 0.5 * budget;
        assert!(is_used, "{scene}, level {level}: sums left memory at {} of {budget} bytes", run.peak);
        disk += run.disk;
    }
    disk
}

#[test]
#[cfg(target_os = "linux")]
#[ignore = "slow: whole runs as processes"]
fn a_budget_bounds_the_peak_of_the_process() {
    let _alone = ALONE.lock();
    let disk = keeps("scene:courtyard --rays 100k", &[(8, 100e6), (9, 150e6), (10, 500e6)]);
    let more = keeps("scene:city --rays 200k", &[(10, 100e6), (12, 200e6)]);
    assert!(disk > 3e8 && more > 3e8, "what the test is for: {disk} and {more} bytes on disk");
    // Several sets of sums.
    let groups = keeps("scene:courtyard --rays 100k --error-bars 4", &[(9, 150e6)]);
    let halves = keeps("scene:city --rays 400k --target-error 0.01", &[(10, 150e6)]);
    assert!(groups > 1e8 && halves > 1e8, "what the test is for: {groups} and {halves} bytes on disk");
}

/// Models of other kinds, of which some need much memory beside the sums.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "needs OCTOBAYES_DATA and minutes"]
fn a_budget_bounds_the_peak_with_models_of_the_data() {
    let _alone = ALONE.lock();
    let data = std::env::var("OCTOBAYES_DATA").unwrap();
    let ppng = |name: &str, more: &str| format!("{data}/ppng-pretrained/{name}.ppng {more} --gradient auto");
    let lego = keeps(&ppng("NeRFSynthetic/ppng_1/lego", "--rays 400k --fov 39.6"), &[(9, 100e6), (10, 200e6)]);
    let ignatius = keeps(&ppng("TanksAndTemple/ppng_1/Ignatius", "--rays 400k --fov 50"), &[(10, 500e6)]);
    let robot = keeps(&ppng("Synthetic_NSVF/ppng_1/Robot", "--rays 200k --fov 39.6"), &[(9, 150e6)]);
    let around = "--rays 30k --fov 60 --contract l2:0.5,0.5,0.5,0.5 --background black";
    let garden = keeps(&ppng("360_v2/ppng_1/garden", around), &[(10, 400e6)]);
    let splats =
        format!("{data}/splats-trained/lego_15k_sh3.ply --cameras {data}/splats-trained/lego_15k_sh3_cameras.json");
    let splats = keeps(&format!("{splats} --rays 1M --force"), &[(8, 100e6)]);
    println!("bytes on disk: {:?}", [lego, ignatius, robot, garden, splats]);
    assert!(lego > 0.0 && garden > 0.0, "what the test is for");
}

/// What is foreseen of a run is never below what it takes, and at most twice as much: from sparse rays on the finest
/// lattices to dense ones. Time is not tested, because other work on the machine takes it, too.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "slow: whole runs as processes"]
fn peak_file_and_disk_are_bounded_by_what_is_foreseen_within_a_factor_of_two() {
    let _alone = ALONE.lock();
    for args in [
        "scene:courtyard --level 16 --rays 1000",
        "scene:courtyard --level 12 --rays 10000",
        "scene:courtyard --level 8 --rays 100000",
        "scene:courtyard --level 8 --rays 20000 --keep-sums",
        "scene:courtyard --level 7 --rays 20000 --grid dense",
        "scene:city --level 10 --rays 100000",
        "scene:courtyard --level 11 --rays 50000 --memory 200MB",
        "scene:city --level 12 --rays 100000 --memory 200MB",
        "scene:courtyard --level 9 --rays 50000 --error-bars 4",
        "scene:courtyard --level 10 --rays 50000 --error-bars 4 --memory 150MB",
    ] {
        let (expected, found) = (foreseen(args), measure(args));
        for (what, expected, found) in [
            ("peak", expected.peak, found.peak),
            ("file", expected.file, found.file),
            ("disk", expected.disk, found.disk),
        ] {
            println!("{args}: {what} {expected} expected, {found} found, {:.2}", expected / found);
            let is_right = expected == found || (1.0..=2.0).contains(&(expected / found));
            assert!(is_right, "{args}: {what} {expected} expected, {found} found");
        }
    }
}

/// A budget that is too small is refused, and the one that the refusal names is enough.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "slow: whole runs as processes"]
fn a_refused_budget_is_told_the_smallest_one() {
    let _alone = ALONE.lock();
    let folder = tempfile::tempdir().unwrap();
    let args = "scene:courtyard --rays 50k";
    let output = run(folder.path(), &format!("uncertainty {args} --level 8 --memory 20MB -o x.oct"));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    let (_, least) = stderr.split_once("--memory: expected at least ").expect("the smallest budget");
    let least: f64 = least.split_whitespace().next().unwrap().parse().unwrap();
    assert!(least > 20.0, "{stderr}");
    keeps(args, &[(8, 1e6 * least)]);
}
