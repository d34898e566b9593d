//! The bytes that a field reports are those that the allocator gave, and those that a run plans are those that the
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

/// A run of the program as a process of its own.
struct Measured {
    /// The kernel's count at the process's end, bytes.
    peak: f64,
    /// Of the file that it wrote, bytes.
    file: f64,
    /// The last plan that it announced.
    plan: Option<Announced>,
}

/// What a plan says, bytes.
#[derive(Debug)]
struct Announced {
    peak: f64,
    file: f64,
}

fn run(folder: &Path, args: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace()).current_dir(folder).output().unwrap()
}

fn measure(args: &str) -> Measured {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), &format!("uncertainty {args} --json -o field.oct"));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{args}: {stderr}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let file = folder.path().join("field.oct").metadata().unwrap().len() as f64;
    let plan = stderr.lines().rfind(|line| line.starts_with("plan:")).map(announced);
    Measured { peak: report["peak_bytes"].as_f64().unwrap(), file, plan }
}

/// Reads "plan: …, 1.01 GB the peak of the process, a file of 56.27 MB, …".
fn announced(line: &str) -> Announced {
    let bytes = |part: &str| {
        let words: Vec<&str> = part.split_whitespace().collect();
        let unit = words.iter().position(|word| ["B", "kB", "MB", "GB", "TB"].contains(word)).expect("a unit");
        let scale = match words[unit] {
            "B" => 1.0,
            "kB" => 1e3,
            "MB" => 1e6,
            _ => 1e9,
        };
        scale * words[unit - 1].parse::<f64>().unwrap()
    };
    let part = |words: &str| line.split(',').find(|part| part.contains(words)).map(bytes).unwrap();
    Announced { peak: part("the peak of the process"), file: part("a file of") }
}

/// Runs under a budget that they would exceed: the kernel's peak is at most a twentieth above it and at least half of
/// it.
fn keeps_and_uses(scene: &str, cases: &[(u8, f64)]) {
    for (level, budget) in cases {
        let run = measure(&format!("{scene} --level {level} --memory {budget}"));
        let share = run.peak / budget;
        println!(
            "| {scene} | {level} | {:.0} | {:.0} | {share:.2} | {:.1} |",
            budget / 1e6,
            run.peak / 1e6,
            run.file / 1e6
        );
        assert!((0.5..=1.05).contains(&share), "{scene}, level {level}: {} of {budget} bytes", run.peak);
    }
}

#[test]
#[cfg(target_os = "linux")]
#[ignore = "slow: whole runs as processes"]
fn a_budget_bounds_the_peak_of_the_process_and_is_used() {
    let _alone = ALONE.lock();
    keeps_and_uses("scene:courtyard --rays 100k", &[(9, 150e6), (10, 200e6), (13, 400e6)]);
    keeps_and_uses("scene:city --rays 200k", &[(12, 200e6)]);
}

/// Models of other kinds, of which some need much memory beside the sums.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "needs OCTOBAYES_DATA and minutes"]
fn a_budget_bounds_the_peak_with_models_of_the_data() {
    let _alone = ALONE.lock();
    let data = std::env::var("OCTOBAYES_DATA").unwrap();
    let ppng = |name: &str, more: &str| format!("{data}/ppng-pretrained/{name}.ppng {more} --gradient auto");
    keeps_and_uses(&ppng("NeRFSynthetic/ppng_1/lego", "--rays 400k --fov 39.6"), &[(8, 100e6), (10, 200e6)]);
    keeps_and_uses(&ppng("NeRFSynthetic/ppng_1/lego", "--rays 200k --fov 39.6"), &[(12, 500e6)]);
    keeps_and_uses(&ppng("TanksAndTemple/ppng_1/Ignatius", "--rays 400k --fov 50"), &[(10, 500e6)]);
    keeps_and_uses(&ppng("Synthetic_NSVF/ppng_1/Robot", "--rays 200k --fov 39.6"), &[(9, 150e6)]);
    let around = "--rays 30k --fov 60 --contract l2:0.5,0.5,0.5,0.5 --background black";
    keeps_and_uses(&ppng("360_v2/ppng_1/garden", around), &[(10, 400e6)]);
}

/// What a plan announces is right within a factor of two, from sparse rays on the finest lattices to dense ones.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "slow: whole runs as processes"]
fn a_plan_foresees_peak_and_file_within_a_factor_of_two() {
    let _alone = ALONE.lock();
    for args in [
        "scene:courtyard --level 16 --rays 1000",
        "scene:courtyard --level 12 --rays 10000",
        "scene:courtyard --level 8 --rays 100000",
        "scene:courtyard --level 8 --rays 20000 --keep-sums",
        "scene:courtyard --level 7 --rays 20000 --grid dense",
        "scene:city --level 10 --rays 100000",
    ] {
        let run = measure(&format!("{args} --memory 100GB"));
        let plan = run.plan.expect("a run with a budget is planned");
        println!("{args}: {plan:?}, {} and {} found", run.peak, run.file);
        for (expected, found) in [(plan.peak, run.peak), (plan.file, run.file)] {
            assert!((0.5..=2.0).contains(&(expected / found)), "{args}: {expected} expected, {found} found");
        }
    }
    // Without a budget too, a large file is announced: here four times what counts as large, by a pilot of 125 rays.
    assert!(measure("scene:courtyard --level 16 --rays 4000").plan.is_some());
}

/// What a larger budget foresees is never coarser, and within the budget. Every budget is a process of its own: what a
/// process holds beside the sums counts, and here other tests leave much behind.
#[test]
fn a_larger_budget_gives_up_no_more() {
    let _alone = ALONE.lock();
    let folder = tempfile::tempdir().unwrap();
    // What the process holds beside the sums is measured, and rounded up to 16 MB: budgets are farther apart.
    let budgets = [100, 150, 200, 300, 500, 1000, 10_000];
    let plans = budgets.map(|megabytes| {
        let args = format!("scene:courtyard --level 9 --rays 100k --memory {megabytes}MB --dry-run --json");
        let output = run(folder.path(), &format!("uncertainty {args}"));
        assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
        let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        ["peak_bytes", "vertices", "rays_per_vertex"].map(|key| plan[key].as_f64().unwrap())
    });
    for ([peak, ..], megabytes) in plans.iter().zip(budgets) {
        assert!(*peak <= 1e6 * f64::from(megabytes), "{megabytes} MB: {plans:?}");
    }
    for pair in plans.windows(2) {
        let [[_, tight, tight_rays], [_, free, free_rays]] = pair else { unreachable!("windows of two") };
        assert!(free >= tight && free_rays <= tight_rays, "{plans:?}");
    }
    let [[_, tightest, _], .., [_, freest, freest_rays]] = plans;
    assert!(2.0 * tightest < freest && freest_rays == 0.0, "{plans:?}");
}

/// A budget that is too small is refused, and the one that the refusal names is enough.
#[test]
#[cfg(target_os = "linux")]
#[ignore = "slow: whole runs as processes"]
fn a_refused_budget_is_told_the_smallest_one() {
    let _alone = ALONE.lock();
    let folder = tempfile::tempdir().unwrap();
    let args = "scene:courtyard --rays 50k";
    let output = run(folder.path(), &format!("uncertainty {args} --level 10 --memory 20MB -o x.oct"));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    let (_, least) = stderr.split_once("--memory: expected at least ").expect("the smallest budget");
    let least: f64 = least.split_whitespace().next().unwrap().parse().unwrap();
    assert!(least > 20.0, "{stderr}");
    keeps_and_uses(args, &[(10, 1e6 * least)]);
    // A part of a run uses less of its budget, and names what is enough for that.
    let part = |memory: f64| {
        let part = format!("uncertainty {args} --level 10 --shard 0/2 --memory {memory}MB -o x.oct --dry-run");
        let output = run(folder.path(), &part);
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (_, stderr) = part(20.0);
    let (_, least) = stderr.split_once("--memory: expected at least ").expect("the smallest budget of a part");
    let (code, stderr) = part(least.split_whitespace().next().unwrap().parse().unwrap());
    assert_eq!(code, Some(0), "{stderr}");
}
