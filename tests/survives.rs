//! Long runs survive: killed at random moments and resumed, or split into shards and merged.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use octobayes::field::ClosedForm;
use octobayes::uncertainty::{UncertaintyField, compare};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn command(folder: &Path, args: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace()).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn run(folder: &Path, args: &str) -> Output {
    command(folder, args).output().unwrap()
}

fn good(folder: &Path, args: &str) {
    let output = run(folder, args);
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
}

fn folder_with_cameras() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let cameras = ClosedForm::half_circle(6, [64, 64]);
    let named: Vec<_> = cameras.into_iter().enumerate().map(|(i, camera)| (format!("r_{i}"), camera)).collect();
    octobayes::dataset::write_transforms(&folder.path().join("transforms.json"), &named).unwrap();
    folder
}

const RUN: &str = "uncertainty scene:courtyard --cameras transforms.json --level 6 --rays 40000 --occupancy 40";

/// `kill -9` gives a process no chance to do anything. Whatever moment it hits, the run can be resumed and ends
/// with the same bytes.
#[test]
fn twenty_kills_at_random_moments_change_no_bit() {
    let folder = folder_with_cameras();
    let folder = folder.path();
    // Kills come within the time that a run takes here and now.
    let times = ["octree", "dense"].map(|grid| {
        let start = Instant::now();
        good(folder, &format!("{RUN} --grid {grid} -o whole_{grid}.oct"));
        start.elapsed()
    });
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut kills, mut runs, mut resumed) = (0, 0, 0);
    while kills < 20 || runs < 2 {
        let grid = ["octree", "dense"][runs % 2];
        let args = format!("{RUN} --grid {grid} -o parts.oct --checkpoint run.chk --checkpoint-every 0.1 --resume");
        let _ = std::fs::remove_file(folder.join("parts.oct"));
        resumed += usize::from(folder.join("run.chk").exists());
        let mut child = command(folder, &args).spawn().unwrap();
        // Most attempts are killed, and most of those after some progress.
        std::thread::sleep(times[runs % 2].mul_f64(rng.random_range(0.1..0.95)));
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{}", String::from_utf8_lossy(&child.wait_with_output().unwrap().stderr));
            let [whole, parts] =
                [format!("whole_{grid}.oct"), "parts.oct".into()].map(|f| std::fs::read(folder.join(f)).unwrap());
            assert!(whole == parts, "{grid}: the resumed field has other bytes");
            assert!(!folder.join("run.chk").exists(), "a finished run removes its checkpoint");
            runs += 1;
        } else {
            child.kill().unwrap();
            child.wait().unwrap();
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
    assert!(resumed >= 10, "{resumed} of {kills} attempts found a checkpoint: the test must interrupt real progress");
}

/// Each group of a run with error bars has its own state. Stopped in any group, the run ends with the same bytes.
#[test]
fn groups_of_rays_are_taken_up_where_they_stopped() {
    let folder = folder_with_cameras();
    let folder = folder.path();
    good(folder, &format!("{RUN} --error-bars 3 -o whole.oct"));
    let args = format!("{RUN} --error-bars 3 -o parts.oct --checkpoint run.chk --checkpoint-every 0 --resume");
    let state = |g: usize| folder.join(format!("run.chk.{g}"));
    // Killed as soon as the current group has a state: in the first, the second and the third.
    for g in 0..3 {
        let mut child = command(folder, &args).spawn().unwrap();
        while !state(g).exists() {
            assert!(child.try_wait().unwrap().is_none(), "the run ended before group {g} began");
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let refused = run(folder, &args.replace("--resume", ""));
        assert!(
            String::from_utf8_lossy(&refused.stderr).contains("run.chk.0, the state of an unfinished run"),
            "not overwritten by accident"
        );
    }
    // A group's state is that of its own rays.
    let other = run(folder, &args.replace("--error-bars 3", "--error-bars 4"));
    assert!(other.status.code() == Some(2) && String::from_utf8_lossy(&other.stderr).contains("run.chk.0: run, "));
    good(folder, &args);
    let [whole, parts] = ["whole.oct", "parts.oct"].map(|f| std::fs::read(folder.join(f)).unwrap());
    assert!(whole == parts, "the resumed field has other bytes");
    assert!((0..3).all(|g| !state(g).exists()), "a finished run removes its checkpoints");
}

/// Waits until the first group of rays is done, when the first checkpoint appears.
#[cfg(unix)]
fn wait_for_checkpoint(folder: &Path, child: &mut Child) {
    while !folder.join("run.chk").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended before it could be interrupted");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[cfg(unix)]
fn send(signal: &str, child: &Child) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

#[cfg(unix)]
fn assert_stopped(child: Child) {
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(stderr.contains("--resume goes on"), "{stderr}");
}

/// SIGTERM is what batch systems send before they kill, SIGHUP what a terminal sends that is closed.
#[test]
#[cfg(target_os = "linux")]
fn a_run_that_is_told_to_end_saves_its_state() {
    let folder = folder_with_cameras();
    let folder = folder.path();
    good(folder, &format!("{RUN} -o whole.oct"));
    let whole = std::fs::read(folder.join("whole.oct")).unwrap();
    let args = format!("{RUN} -o parts.oct --checkpoint run.chk --checkpoint-every");
    let spawn = |before: &str, args: &str| {
        // Whoever runs the tests may ignore hangups.
        let shell = format!("{before} exec env --default-signal=HUP {} {args}", env!("CARGO_BIN_EXE_octobayes"));
        let shell = if before.is_empty() { shell } else { shell.replace("env --default-signal=HUP ", "") };
        let mut command = Command::new("sh");
        command.args(["-c", &shell]).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::piped());
        command.spawn().unwrap()
    };
    for signal in ["-TERM", "-HUP"] {
        let mut child = spawn("", &format!("{args} 0"));
        wait_for_checkpoint(folder, &mut child);
        // A shell that ends and its terminal may both send one.
        send(signal, &child);
        send(signal, &child);
        assert_stopped(child);
        good(folder, &format!("{args} 1h --resume"));
        assert!(std::fs::read(folder.join("parts.oct")).unwrap() == whole, "{signal}: the field has other bytes");
    }
    // `nohup` starts programs with hangups ignored, and they stay so.
    let mut child = spawn("trap '' HUP;", &format!("{args} 0").replace("--rays 40000", "--rays 100M"));
    wait_for_checkpoint(folder, &mut child);
    send("-HUP", &child);
    std::thread::sleep(Duration::from_secs(1));
    assert!(child.try_wait().unwrap().is_none(), "a hangup ended a run that ignores hangups");
    send("-TERM", &child);
    assert_stopped(child);
}

#[test]
#[cfg(unix)]
fn ctrl_c_saves_the_state_and_resume_goes_on() {
    let folder = folder_with_cameras();
    let folder = folder.path();
    good(folder, &format!("{RUN} -o whole.oct"));
    let args = format!("{RUN} -o parts.oct --checkpoint run.chk --checkpoint-every 0");
    let mut child = command(folder, &args).spawn().unwrap();
    wait_for_checkpoint(folder, &mut child);
    send("-INT", &child);
    assert_stopped(child);
    // Without --resume the unfinished run is not overwritten; with other settings it is not continued.
    let again = run(folder, &format!("{RUN} -o parts.oct --checkpoint run.chk"));
    assert_eq!(again.status.code(), Some(2));
    let other = run(folder, &format!("{RUN} --seed 5 -o parts.oct --checkpoint run.chk --resume"));
    let stderr = String::from_utf8(other.stderr).unwrap();
    assert!(other.status.code() == Some(2) && stderr.contains("seed: expected 5, found 0"), "{stderr}");
    let other = run(folder, &format!("{RUN} --resolution 20 -o parts.oct --checkpoint run.chk --resume"));
    let stderr = String::from_utf8(other.stderr).unwrap();
    assert!(other.status.code() == Some(2) && stderr.contains("run, cameras"), "{stderr}");

    good(folder, &format!("{RUN} -o parts.oct --checkpoint run.chk --resume"));
    let [whole, parts] = ["whole.oct", "parts.oct"].map(|f| std::fs::read(folder.join(f)).unwrap());
    assert!(whole == parts, "the resumed field has other bytes");
}

#[test]
fn merged_shards_are_the_whole_run() {
    let folder = folder_with_cameras();
    let folder = folder.path();
    for (grid, tolerance) in [("octree", "0"), ("octree", "0.01"), ("dense", "0")] {
        let settings = format!("{RUN} --keep-sums --grid {grid} --tolerance {tolerance}");
        good(folder, &format!("{settings} -o whole.oct"));
        for shard in 0..3 {
            good(folder, &format!("{settings} --shard {shard}/3 -o part{shard}.oct"));
        }
        // In any order, to the last bit.
        good(folder, "merge part0.oct part1.oct part2.oct -o a.oct");
        good(folder, "merge part2.oct part0.oct part1.oct -o b.oct");
        let [a, b] = ["a.oct", "b.oct"].map(|f| std::fs::read(folder.join(f)).unwrap());
        assert!(a == b, "the order of the parts matters");
        // And step by step.
        let output = run(folder, "merge part2.oct part0.oct -o two.oct");
        let stderr = String::from_utf8(output.stderr).unwrap();
        let warning = "warning: the run over 40000 rays is not complete: part 1 of 3 (seed 0) missing\n";
        assert!(output.status.success() && stderr == warning, "{stderr}");
        let output = Command::new(env!("CARGO_BIN_EXE_octobayes"))
            .args(["merge", "two.oct", "part1.oct", "-o", "merged.oct", "--json"])
            .current_dir(folder)
            .output()
            .unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "nothing is missing");
        let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(value["missing_shards"], serde_json::json!([]));
        let [whole, merged] = ["whole.oct", "merged.oct"].map(|f| UncertaintyField::read(&folder.join(f)).unwrap());
        assert_eq!((whole.protocol().rays, whole.protocol().shard), (merged.protocol().rays, merged.protocol().shard));
        assert_eq!(whole.draws(), merged.draws());
        assert_eq!(whole.support(), merged.support());
        assert_eq!(whole.rays(), merged.rays());
        for (a, b) in whole.deviations().iter().zip(merged.deviations().iter()) {
            // At most 40,000 positive terms in another order: n ε relative. Deviations are stored as f32.
            assert!((a - b).abs() <= f64::from(f32::EPSILON) * a, "{a} and {b}");
        }
        let difference = compare(&whole, &merged, 50_000, 0).unwrap();
        assert!(difference.in_box.unwrap().max <= 1e-6 && difference.on_surfaces.unwrap().max <= 1e-6);
    }
    let twice = run(folder, "merge part0.oct part0.oct -o x.oct");
    let stderr = String::from_utf8(twice.stderr).unwrap();
    assert!(twice.status.code() == Some(2) && stderr.contains("rays in common"), "{stderr}");
    let inside = run(folder, "merge two.oct part2.oct -o x.oct");
    let stderr = String::from_utf8(inside.stderr).unwrap();
    assert!(inside.status.code() == Some(2) && stderr.contains("rays in common"), "{stderr}");
    // Shard 1 of 3 and shard 1 of 2 of the same seed have batches in common.
    good(folder, &format!("{RUN} --keep-sums --grid dense --tolerance 0 --shard 1/2 -o half.oct"));
    let overlapping = run(folder, "merge part1.oct half.oct -o x.oct");
    let stderr = String::from_utf8(overlapping.stderr).unwrap();
    assert!(overlapping.status.code() == Some(2) && stderr.contains("rays in common"), "{stderr}");
    let ball = RUN.replace("courtyard", "ball");
    good(folder, &format!("{ball} --keep-sums --grid dense --tolerance 0 --seed 8 -o ball.oct"));
    let stderr = String::from_utf8(run(folder, "merge part0.oct ball.oct -o x.oct").stderr).unwrap();
    assert!(stderr.contains("model and cameras of ball.oct: expected "), "{stderr}");
    good(folder, &format!("{RUN} --keep-sums --grid dense --tolerance 0 --seed 9 --lambda 1e-3 -o other.oct"));
    let unlike = run(folder, "merge part0.oct other.oct -o x.oct");
    let stderr = String::from_utf8(unlike.stderr).unwrap();
    assert!(unlike.status.code() == Some(2) && stderr.contains("lambda of other.oct: expected "), "{stderr}");
}
