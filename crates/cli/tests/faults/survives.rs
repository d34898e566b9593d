//! Long runs survive: killed at random moments and resumed, or split into shards and merged.

#[cfg(unix)]
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

#[cfg(unix)]
use crate::interrupt::{send, stopped, wait_for};
use crate::program::Desk;
use octobayes::estimate::{Checkpoint, Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::ClosedForm;
use octobayes::uncertainty::compare;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

fn spawned(desk: &Desk, args: &str) -> Child {
    desk.command(args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

const RUN: &str = "uncertainty scene:courtyard --cameras cameras.json --level 6 --rays 20000 --occupancy 40";

/// A run by the library, which saves its state as often as it is asked to.
fn estimate(folder: &Path, grid: GridKind, every: Option<Duration>, output: &str) {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let rays = RaySettings::default().rays(20_000).occupancy(40);
    let run = Estimation::new(&scene, &cameras).rays(rays).grid(GridSettings::default().grid(grid).level(6));
    let checkpoint = every.map(|every| Checkpoint::new(folder.join("run.chk")).every(every));
    let run = checkpoint.iter().cloned().fold(run, Estimation::checkpoint);
    let field = run.run().unwrap().field;
    field.write(&folder.join(output)).unwrap();
    checkpoint.iter().for_each(|checkpoint| checkpoint.remove(None, &field).unwrap());
}

/// A run that ends removes its own state. What another run has saved under this name meanwhile is needed.
#[test]
fn the_state_of_another_run_stays() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, cameras) = (ClosedForm::ball(), ClosedForm::half_circle(2, [16, 16]));
    let checkpoint = Checkpoint::new(folder.path().join("run.chk")).every(Duration::ZERO);
    let run = |seed: u64| {
        let rays = RaySettings::default().rays(1200).occupancy(16).seed(seed);
        let run = Estimation::new(&scene, &cameras).rays(rays).grid(GridSettings::default().level(4));
        run.checkpoint(checkpoint.clone().restart(true)).run().unwrap().field
    };
    let [first, second] = [0, 1].map(run);
    checkpoint.remove(None, &first).unwrap();
    assert!(checkpoint.path().exists(), "the state of the second run");
    checkpoint.remove(None, &second).unwrap();
    assert!(!checkpoint.path().exists());
}

/// Where the process of [`worker`] works, and on which grid.
const WORKPLACE: [&str; 2] = ["OCTOBAYES_TEST_FOLDER", "OCTOBAYES_TEST_GRID"];

/// No test but a process of its own for [`kills_change_no_bit`], which kills it.
#[test]
#[ignore = "started by another test, which kills it"]
fn worker() {
    let [Ok(folder), Ok(grid)] = WORKPLACE.map(std::env::var) else { return };
    let grid = if grid == "dense" { GridKind::Dense } else { GridKind::Octree };
    estimate(Path::new(&folder), grid, Some(Duration::ZERO), "parts.oct");
}

#[test]
#[cfg(unix)]
fn a_kill_at_a_random_moment_changes_no_bit() {
    kills_change_no_bit(1);
}

#[test]
#[cfg(unix)]
#[ignore = "slow: many kills"]
fn many_kills_at_random_moments_change_no_bit() {
    kills_change_no_bit(20);
}

/// `kill -9` gives a process no chance to do anything. Whatever moment it hits, the run can be resumed and ends
/// with the same bytes.
#[cfg(unix)]
fn kills_change_no_bit(least: usize) {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (grid, name) in [(GridKind::Octree, "octree"), (GridKind::Dense, "dense")] {
        estimate(folder, grid, None, &format!("whole_{name}.oct"));
    }
    // Every state that is saved is another file under the same name.
    let state = || std::fs::metadata(folder.join("run.chk")).map(|state| state.ino()).ok();
    let is_part =
        |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().path().extension() == Some("part".as_ref());
    let is_saving = || std::fs::read_dir(folder).unwrap().any(is_part);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut kills, mut runs, mut resumed) = (0, 0, 0);
    while kills < least || runs < 2 {
        let grid = ["octree", "dense"][runs % 2];
        let _ = std::fs::remove_file(folder.join("parts.oct"));
        resumed += usize::from(folder.join("run.chk").exists());
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "survives::worker", "--include-ignored"])
            .envs([(WORKPLACE[0], folder.as_os_str()), (WORKPLACE[1], grid.as_ref())])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // Most attempts are killed, each after some progress, some of them while they save more.
        let (mut before, mut saved, mut status) = (state(), 0, None);
        let (goal, in_the_midst) = (rng.random_range(1..=2), rng.random::<bool>());
        while (saved < goal || in_the_midst && !is_saving()) && status.is_none() {
            let now = state();
            saved += u32::from(now != before);
            before = now;
            status = child.try_wait().unwrap();
            std::thread::yield_now();
        }
        if status.is_none() {
            child.kill().unwrap();
        }
        let output = child.wait_with_output().unwrap();
        if let Some(status) = status {
            assert!(status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let [whole, parts] =
                [format!("whole_{grid}.oct"), "parts.oct".into()].map(|f| std::fs::read(folder.join(f)).unwrap());
            assert!(whole == parts, "{grid}: the resumed field has other bytes");
            assert!(!folder.join("run.chk").exists(), "a finished run removes its checkpoint");
            runs += 1;
        } else {
            kills += 1;
            // A kill can hit after the field got its name and before the checkpoint is removed. Then the field is
            // whole.
            if let Ok(parts) = std::fs::read(folder.join("parts.oct")) {
                assert!(
                    parts == std::fs::read(folder.join(format!("whole_{grid}.oct"))).unwrap(),
                    "a field is whole or absent"
                );
            }
        }
    }
    assert!(2 * resumed >= least, "{resumed} of {kills} attempts found a checkpoint: none interrupts real progress");
}

/// Each group of a run with error bars has its own state, saved when the group is complete. Killed in any group, the
/// run ends with the same bytes.
#[test]
fn groups_of_rays_are_taken_up_where_they_stopped() {
    let desk = Desk::new(6, 64);
    desk.good(&format!("{RUN} --error-bars 4 -o whole.oct"));
    let args = format!("{RUN} --error-bars 4 -o parts.oct --checkpoint run.chk");
    let state = |g: usize| desk.join(format!("run.chk.{g}"));
    // Killed as soon as a group has a state, which is in the next one.
    for g in 0..3 {
        let mut child = spawned(&desk, &args);
        while !state(g).exists() {
            assert!(child.try_wait().unwrap().is_none(), "the run ended before group {g} did");
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
    }
    // A group's state is that of its own rays.
    desk.refused(&args.replace("--error-bars 4", "--error-bars 3"), &["run.chk.0: run, "]);
    let said = desk.said(&args);
    assert!(said.contains("run.chk holds 15000 of 20000 rays"), "{said}");
    assert!(desk.bytes("whole.oct") == desk.bytes("parts.oct"), "the resumed field has other bytes");
    assert!((0..4).all(|g| !state(g).exists()), "a finished run removes its checkpoints");
}

#[cfg(unix)]
fn assert_stopped(output: &Output) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(130) && stderr.contains("the same command goes on"), "{stderr}");
}

/// Ctrl-C, and SIGTERM, which batch systems send before they kill, some of them twice. After the first of eight groups
/// the run is in the midst of its rays.
#[test]
#[cfg(unix)]
fn a_run_that_is_told_to_end_saves_its_state_and_the_same_command_goes_on() {
    let desk = Desk::new(6, 64);
    let run = format!("{RUN} --error-bars 8");
    desk.good(&format!("{run} -o whole.oct"));
    let args = format!("{run} -o parts.oct --checkpoint run.chk");
    let mut child = spawned(&desk, &args);
    wait_for(&desk.join("run.chk.0"), &mut child);
    (0..2).for_each(|_| send("-TERM", &child));
    assert_stopped(&child.wait_with_output().unwrap());
    desk.good(&args);
    assert!(desk.bytes("parts.oct") == desk.bytes("whole.oct"), "the field has other bytes");
}

/// What a state is no use for: a dry run, a run with other settings, and one that starts over.
#[test]
#[cfg(unix)]
fn a_state_is_used_by_its_own_run_alone() {
    let desk = Desk::new(6, 64);
    let run = format!("{RUN} --error-bars 8");
    desk.good(&format!("{run} -o whole.oct"));
    let args = format!("{run} -o parts.oct --checkpoint run.chk");
    assert_stopped(&stopped(&desk.join("run.chk.0"), spawned(&desk, &args), "-INT"));
    // A dry run looks at no checkpoint; with other settings it is not continued.
    let state = desk.bytes("run.chk.0");
    desk.good(&format!("{args} --seed 5 --dry-run"));
    desk.refused(&format!("{args} --seed 5"), &["of another run"]);
    desk.refused(&format!("{args} --resolution 20"), &["run, cameras"]);
    assert!(desk.said(&args).contains("--restart discards them"));
    assert!(desk.bytes("parts.oct") == desk.bytes("whole.oct"), "the resumed field has other bytes");
    // A restart takes no notice of the state that is there, and removes it in the end.
    desk.write("run.chk.0", state);
    desk.good(&format!("{args} --seed 5 --restart"));
    assert!(!desk.join("run.chk.0").exists());
    desk.good(&format!("{run} --seed 5 -o whole.oct"));
    assert!(desk.bytes("parts.oct") == desk.bytes("whole.oct"), "the run that started over has other bytes");
}

#[test]
fn merged_shards_are_the_whole_octree() {
    shards_are_the_whole_run("octree", "0");
}

#[test]
fn merged_shards_are_the_whole_octree_within_its_tolerance() {
    shards_are_the_whole_run("octree", "0.01");
}

#[test]
fn merged_shards_are_the_whole_dense_grid() {
    shards_are_the_whole_run("dense", "0");
}

fn shards_are_the_whole_run(grid: &str, tolerance: &str) {
    let desk = Desk::new(6, 64);
    let settings = format!("{RUN} --keep-sums --grid {grid} --tolerance {tolerance}");
    desk.good(&format!("{settings} -o whole.oct"));
    (0..3).for_each(|i| drop(desk.good(&format!("{settings} --shard {i}/3 -o part{i}.oct"))));
    // In any order, to the last bit.
    desk.good("merge part0.oct part1.oct part2.oct -o a.oct");
    desk.good("merge part2.oct part0.oct part1.oct -o b.oct");
    assert!(desk.bytes("a.oct") == desk.bytes("b.oct"), "the order of the parts matters");
    // And step by step.
    let said = desk.said("merge part2.oct part0.oct -o two.oct");
    assert!(said.starts_with("warning: ") && said.contains("part 1 of 3"), "{said}");
    let (code, out, said) = desk.run("merge two.oct part1.oct -o merged.oct --json");
    assert!(code == Some(0) && said.is_empty(), "nothing is missing: {said}");
    let value: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(value["missing_shards"], serde_json::json!([]));
    let [whole, merged] = ["whole.oct", "merged.oct"].map(|name| desk.field(name));
    assert_eq!((whole.record().rays, whole.record().shard), (merged.record().rays, merged.record().shard));
    assert_eq!(whole.ray_sets(), merged.ray_sets());
    assert_eq!(whole.support(), merged.support());
    assert_eq!(whole.rays(), merged.rays());
    for (a, b) in whole.deviations().iter().zip(merged.deviations().iter()) {
        // At most 20,000 positive terms in another order: n ε relative. Deviations are stored as f32.
        assert!((a - b).abs() <= f64::from(f32::EPSILON) * a, "{a} and {b}");
    }
    let difference = compare(&whole, &merged, 50_000, 0).unwrap();
    assert!(difference.in_box.unwrap().max <= 1e-6 && difference.on_surfaces.unwrap().max <= 1e-6);
}

#[test]
fn shards_that_do_not_fit_together_are_refused() {
    let desk = Desk::new(6, 64);
    let settings = format!("{RUN} --keep-sums --grid dense --tolerance 0").replace("20000", "2000");
    (0..3).for_each(|i| drop(desk.good(&format!("{settings} --shard {i}/3 -o part{i}.oct"))));
    desk.good("merge part2.oct part0.oct -o two.oct");
    // Shard 1 of 3 and shard 1 of 2 of the same seed have batches in common.
    desk.good(&format!("{settings} --shard 1/2 -o half.oct"));
    for parts in ["part0.oct part0.oct", "two.oct part2.oct", "part1.oct half.oct"] {
        desk.refused(&format!("merge {parts} -o x.oct"), &["rays in common"]);
    }
    desk.good(&format!("{} --seed 8 -o ball.oct", settings.replace("courtyard", "ball")));
    desk.refused("merge part0.oct ball.oct -o x.oct", &["model and cameras of ball.oct"]);
    desk.good(&format!("{settings} --seed 9 --lambda 1e-3 -o other.oct"));
    desk.refused("merge part0.oct other.oct -o x.oct", &["lambda of other.oct"]);
}
