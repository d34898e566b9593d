//! Limits in the user's own terms, as the binary takes them: cell size, memory, refinement criteria, bytes per
//! value.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use octobayes::posterior::Criteria;
use octobayes::uncertainty::{Store, Support, UncertaintyField, compare};

const RUN: &str = "uncertainty scene:courtyard --resolution 64 --rays 40000 --occupancy 40";

fn command(folder: &Path, args: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace()).current_dir(folder);
    command
}

fn run(folder: &Path, args: &str) -> Output {
    command(folder, args).output().unwrap()
}

fn good(folder: &Path, args: &str) -> String {
    let output = run(folder, args);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{args}: {stderr}");
    stderr
}

fn refused(folder: &Path, args: &str) -> String {
    let output = run(folder, args);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{args}: {stderr}");
    stderr
}

fn read(folder: &Path, name: &str) -> UncertaintyField {
    UncertaintyField::read(&folder.join(name)).unwrap()
}

#[test]
fn a_cell_size_chooses_the_level_that_is_as_fine() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The courtyard's box has edge 2. A size of 0.03 asks for 67 cells, so 128; 2/64 is met exactly.
    for (size, level) in [("0.03", 7), ("0.03125", 6), ("5", 1)] {
        good(folder, &format!("{RUN} --cell-size {size} -o field.oct"));
        assert_eq!(read(folder, "field.oct").lattice().level(), level, "{size}");
    }
    let stderr = refused(folder, &format!("{RUN} --cell-size 1e-9 -o field.oct"));
    assert!(stderr.contains("--cell-size") && stderr.contains("level 16"), "{stderr}");
}

#[test]
fn a_budget_is_planned_kept_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let stderr = good(folder, &format!("{RUN} --level 9 --memory 60MB -o limited.oct"));
    assert!(stderr.contains("plan: level 9") && stderr.contains("given up"), "{stderr}");
    let limited = read(folder, "limited.oct");
    let bytes: usize = limited.memory().iter().map(|part| part.1).sum();
    assert!(bytes <= 60_000_000 && !limited.limits().is_unlimited() && limited.validate().is_ok());
    // A plan that cannot fit says what would.
    let stderr = refused(folder, &format!("{RUN} --level 9 --memory 5kB -o x.oct"));
    assert!(stderr.contains("--memory") && stderr.contains("at least"), "{stderr}");
    let stderr = refused(folder, &format!("{RUN} --level 8 --grid dense --memory 100MB -o x.oct"));
    assert!(stderr.contains("at least") && stderr.contains("lower level"), "{stderr}");
    assert!(!folder.join("x.oct").exists());
}

#[test]
fn a_limited_run_survives_and_merges() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let limited = format!("{RUN} --level 8 --refine ray-count --tolerance 0");
    good(folder, &format!("{limited} -o whole.oct"));
    // Killed as soon as it has saved something, a run resumes with its own limits.
    let resumable = format!("{limited} -o again.oct --checkpoint run.chk --checkpoint-every 0 --resume");
    let mut child = command(folder, &resumable).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    while !folder.join("run.chk").exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(folder.join("run.chk").exists() && !folder.join("again.oct").exists(), "it was killed under way");
    // Only a run with the same limits may continue it.
    let other = resumable.replace("--refine ray-count", "--refine sensitivity");
    assert!(refused(folder, &other).contains("run, limits"));
    good(folder, &resumable);
    assert_eq!(std::fs::read(folder.join("whole.oct")).unwrap(), std::fs::read(folder.join("again.oct")).unwrap());
    for shard in 0..2 {
        good(folder, &format!("{limited} --shard {shard}/2 -o part{shard}.oct"));
    }
    good(folder, "merge part0.oct part1.oct -o merged.oct");
    let [whole, merged] = ["whole.oct", "merged.oct"].map(|name| read(folder, name));
    assert_eq!((whole.support(), whole.limits()), (merged.support(), merged.limits()));
    assert!(!whole.limits().is_unlimited());
    // Sums in another order, rounded to f32.
    assert!(compare(&whole, &merged, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
    good(folder, &format!("{RUN} --level 8 --tolerance 0 --seed 1 -o other.oct"));
    assert!(refused(folder, "convert whole.oct x.npy").contains("coarser leaves"));
    let stderr = refused(folder, "merge whole.oct other.oct -o x.oct");
    assert!(stderr.contains("criteria") || stderr.contains("limits"), "{stderr}");
}

#[test]
fn criteria_refine_where_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let vertices = |refine: &str| {
        good(folder, &format!("{RUN} --level 6 --refine {refine} -o field.oct"));
        let field = read(folder, "field.oct");
        let Support::Octree(octree) = field.support() else { panic!("an octree was asked for") };
        (octree.vertex_count(), field)
    };
    let (sensitive, field) = vertices("sensitivity");
    assert_eq!(field.protocol().criteria, Criteria::default());
    let (dense, _) = vertices("density");
    let (both, _) = vertices("sensitivity,density");
    let (all, uniform) = vertices("uniform");
    assert_eq!(all, 65 * 65 * 65);
    assert!(sensitive < both && dense < both && both < all, "{sensitive} {dense} {both} {all}");
    // Uniform refinement is the dense grid, bit for bit, if it leaves no negligible samples out either.
    good(folder, &format!("{RUN} --level 6 --grid dense -o dense.oct"));
    good(folder, &format!("{RUN} --level 6 --refine uniform --tolerance 0 -o exact.oct"));
    let [exact, dense] = ["exact.oct", "dense.oct"].map(|file| read(folder, file));
    assert_eq!(compare(&exact, &dense, 20_000, 1).unwrap().in_box.unwrap().max, 0.0);
    // A tenth of the default tolerance is for negligible samples; both fields are stored as f32.
    assert!(compare(&uniform, &dense, 20_000, 1).unwrap().in_box.unwrap().max <= 0.001 + 1e-6);
    assert!(refused(folder, &format!("{RUN} --level 10 --refine uniform -o x.oct")).contains("level up to 9"));
    // Shards of such a run merge into one field.
    for shard in 0..2 {
        good(folder, &format!("{RUN} --level 6 --refine uniform --shard {shard}/2 -o part{shard}.oct"));
    }
    good(folder, "merge part0.oct part1.oct -o merged.oct");
    assert_eq!(read(folder, "merged.oct").support(), uniform.support());
}

#[test]
fn two_bytes_a_value_stay_within_the_stated_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder, &format!("{RUN} --level 6 -o full.oct"));
    good(folder, &format!("{RUN} --level 6 --store f16 -o half.oct"));
    good(folder, "convert full.oct converted.oct --store f16");
    good(folder, "convert full.oct coarse.oct --store f16 --coarsen 0.1");
    let [full, half, converted, coarse] =
        ["full", "half", "converted", "coarse"].map(|n| read(folder, &format!("{n}.oct")));
    assert_eq!(half.deviations(), converted.deviations());
    assert_eq!((half.deviations().store(), coarse.deviations().store()), (Store::F16, Store::F16));
    assert_eq!(2 * half.deviations().memory(), full.deviations().memory());
    let stated = half.protocol().tolerance - full.protocol().tolerance;
    let found = compare(&full, &half, 50_000, 1).unwrap().on_surfaces.unwrap().max;
    assert!(found <= stated && found > 0.2 * stated, "{found} of {stated}");
    assert!(compare(&full, &coarse, 50_000, 1).unwrap().in_box.unwrap().max <= 0.1);
    assert!(refused(folder, "convert full.oct x.oct --store f16 --coarsen 0.0001").contains("rounding"));
}

#[test]
fn contracted_fields_are_made_stored_and_asked_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder, &format!("{RUN} --level 6 --contract l2 --inner 0,0,-0.3,0.5 -o all.oct"));
    let field = read(folder, "all.oct");
    assert!(field.lattice().domain().bounds().is_none());
    let far = field.query(glam::Vec3::new(1e20, 0.0, 0.0));
    assert!(far.inside && (far.uncertainty / field.prior() - 1.0).abs() < 1e-6);
    let info = String::from_utf8(run(folder, "info all.oct").stdout).unwrap();
    assert!(info.contains("L2 contraction outside 0.5"), "{info}");
    let stderr = refused(folder, &format!("{RUN} --contract l2 -o x.oct"));
    assert!(stderr.contains("--inner"), "{stderr}");
    assert!(refused(folder, "convert all.oct x.npy").contains("contracted"));
}
