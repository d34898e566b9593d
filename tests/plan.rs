//! `plan`: forecasts that hold, and a script that says what was asked for. Slurm itself is in tests/slurm; here its
//! commands are stand-ins, so that every machine with bash can run the script.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::Vec3;
use octobayes::dataset::write_transforms;
use octobayes::field::{ClosedForm, VoxelGrid};
use octobayes::uncertainty::{UncertaintyField, compare};
use serde_json::Value;

const RUN: [&str; 8] = ["model.npz", "--cameras", "cameras.json", "--level", "5", "--rays", "6000", "--occupancy=32"];

/// Records how it was called, one word a line, and answers as sbatch does.
const SBATCH: &str = r#"#!/bin/bash
printf '%s\n' "$@" --end-- >> "$TRACE"
echo 4711
"#;
/// Runs the step here, or ends as $SRUN_CODE says.
const SRUN: &str = r#"#!/bin/bash
if test -n "${SRUN_CODE-}"; then exit "$SRUN_CODE"; fi
while [[ $1 == --* ]]; do shift; done
exec "$@"
"#;
const SCONTROL: &str = r#"#!/bin/bash
printf '%s\n' "$@" >> "$TRACE"
"#;

/// A folder with a model, its cameras, and stand-ins for Slurm's commands.
struct Desk {
    _root: tempfile::TempDir,
    folder: PathBuf,
    bin: PathBuf,
}

impl Desk {
    fn new(name: &str) -> Self {
        let root = tempfile::tempdir().unwrap();
        let [folder, bin] = [name, "bin"].map(|name| root.path().join(name));
        for folder in [&folder, &bin] {
            std::fs::create_dir(folder).unwrap();
        }
        for (name, text) in [("sbatch", SBATCH), ("srun", SRUN), ("scontrol", SCONTROL)] {
            std::fs::write(bin.join(name), text).unwrap();
            std::fs::set_permissions(bin.join(name), std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        let cameras = ClosedForm::half_circle(4, [32, 32]).into_iter().enumerate();
        let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
        write_transforms(&folder.join("cameras.json"), &named).unwrap();
        VoxelGrid::bake(&ClosedForm::courtyard(), [33; 3], Vec3::Z).write(&folder.join("model.npz")).unwrap();
        Self { _root: root, folder, bin }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn octobayes(&self, words: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_octobayes")).args(words).current_dir(&self.folder).output().unwrap()
    }

    /// Runs the program and returns stdout. Panics on failure.
    fn good(&self, words: &[&str]) -> String {
        let output = self.octobayes(words);
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs the program, which must refuse, and returns what it says.
    fn refused(&self, words: &[&str]) -> String {
        let output = self.octobayes(words);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && output.stdout.is_empty(), "{words:?}: {stderr}");
        stderr.lines().find_map(|line| line.strip_prefix("error: ")).expect(&stderr).to_string()
    }

    fn plan(&self, more: &[&str]) -> Value {
        let words = [&["plan", "--json"], &RUN[..], more].concat();
        serde_json::from_str(&self.good(&words)).unwrap()
    }

    /// Runs the script with `words` behind it, from another folder than it was written in.
    fn bash(&self, script: &str, words: &[&str], variables: &[(&str, &str)]) -> Output {
        let path = format!("{}:{}", self.bin.display(), std::env::var("PATH").unwrap());
        let variables = variables.iter().copied();
        Command::new("bash")
            .arg(self.path(script))
            .args(words)
            .current_dir(&self.bin)
            .env("PATH", path)
            .env("TRACE", self.bin.join("trace"))
            .envs(variables)
            .output()
            .unwrap()
    }

    fn shard(&self, script: &str, index: u64) -> Output {
        self.bash(script, &["shard"], &[("SLURM_ARRAY_TASK_ID", &index.to_string()), ("SLURM_JOB_ID", "4712")])
    }

    fn trace(&self) -> String {
        std::fs::read_to_string(self.bin.join("trace")).unwrap_or_default()
    }

    fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.folder).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

fn succeeds(output: &Output) -> String {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    format!("{}{stderr}", String::from_utf8_lossy(&output.stdout))
}

/// Contents of a folder's files.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect()
}

#[test]
fn a_plan_tells_what_the_run_takes_and_writes_nothing() {
    let desk = Desk::new("plain");
    let before = desk.files();
    let run = RUN.map(|word| if word == "6000" { "60000" } else { word });
    let plan: Value = serde_json::from_str(&desk.good(&[&["plan", "--json"], &run[..]].concat())).unwrap();
    let text = desk.good(&[&["plan"], &run[..]].concat());
    assert!(text.starts_with("run     level 5, 60000 rays, about ") && text.contains("a file of"), "{text}");
    assert_eq!(desk.files(), before);
    assert!(plan["slurm"].is_null() && plan["rays"] == 60_000 && plan["level"] == 5, "{plan}");

    let run = [&["uncertainty", "--json", "-o", "field.oct"], &run[..]].concat();
    let done: Value = serde_json::from_str(&desk.good(&run)).unwrap();
    let size = std::fs::metadata(desk.path("field.oct")).unwrap().len() as f64;
    let number = |value: &Value| value.as_f64().unwrap();
    for (expected, found) in [
        (number(&plan["vertices"]), number(&done["summary"]["vertices"])),
        (number(&plan["file_bytes"]), size),
        (number(&plan["peak_bytes"]), number(&done["peak_bytes"])),
    ] {
        assert!((0.7..1.5).contains(&(expected / found)), "expected {expected}, found {found}");
    }
}

#[test]
fn requests_are_the_forecasts_with_their_margins() {
    let desk = Desk::new("requests");
    let plan = desk.plan(&["--jobs", "3", "--slurm", "-o", "run.sbatch", "--cpus", "4"]);
    let script = std::fs::read_to_string(desk.path("run.sbatch")).unwrap();
    for (job, variable) in [("shard", "shard_requests"), ("merge", "merge_requests")] {
        let job = &plan["slurm"][job];
        let [peak, seconds] = ["peak_bytes", "seconds"].map(|key| job[key].as_f64().unwrap());
        let [mb, minutes] = ["megabytes", "minutes"].map(|key| job["request"][key].as_u64().unwrap());
        assert_eq!(mb, ((1.5 * peak / 1_048_576.0).ceil() as u64).max(128), "{job}");
        assert_eq!(minutes, ((3.0 * seconds / 60.0).ceil() as u64).max(5), "{job}");
        let line = format!("\n{variable}=(--cpus-per-task=4 --mem={mb}M --time={minutes})\n");
        assert!(script.contains(&line), "{line} in {script}");
    }
    // Four batches of 512 rays, of which the run's last is short.
    assert_eq!(plan["slurm"]["shard"]["rays"], 1904, "{plan}");
    assert!(!script.contains("{{") && !script.contains("}}"), "{script}");
}

#[test]
fn the_script_runs_shards_and_merge_whatever_the_names() {
    let desk = Desk::new("it's a \"run\", $HOME %a ü");
    let mut run = RUN;
    std::fs::rename(desk.path("model.npz"), desk.path("the model's $(file).npz")).unwrap();
    std::fs::rename(desk.path("cameras.json"), desk.path("-\\cameras`1`.json")).unwrap();
    (run[0], run[2]) = ("the model's $(file).npz", "./-\\cameras`1`.json");
    let extent = ["--box", "-0.9,-0.9,-0.9,0.9,0.9,0.9"];
    desk.good(&[&["uncertainty", "-o", "single.oct"], &run[..], &extent].concat());

    let asked = ["--jobs", "3", "--slurm", "-o", "to do.sbatch", "--json"];
    let plan: Value = serde_json::from_str(&desk.good(&[&["plan"], &run[..], &extent, &asked].concat())).unwrap();
    let parts = desk.path(plan["slurm"]["parts"].as_str().unwrap());
    assert_eq!(plan["slurm"]["field"], "to do.oct");

    let said = succeeds(&desk.bash("to do.sbatch", &["--partition=some where"], &[]));
    assert!(said.contains("shards: job 4711"), "{said}");
    let trace = desk.trace();
    let calls: Vec<Vec<&str>> = trace.split("--end--\n").map(|call| call.lines().collect()).collect();
    for (call, own) in calls.iter().zip([["--array=0-2", "shard"], ["--dependency=afterany:4711", "merge"]]) {
        assert!(own.iter().all(|word| call.contains(word)), "{call:?}");
        for word in ["--parsable", "--requeue", "--open-mode=append", "--job-name=to do", "--partition=some where"] {
            assert!(call.contains(&word), "{word} in {call:?}");
        }
        // A % would stand for a number.
        let log = call.iter().find_map(|word| word.strip_prefix("--output=")).unwrap();
        assert!(log.ends_with(if own[1] == "shard" { "/%a.log" } else { "/merge.log" }), "{log}");
        assert!(Path::new(call[call.len() - 2]).is_absolute(), "the script's own path: {call:?}");
    }
    assert!(calls[0].contains(&"--signal=TERM@60") && calls.len() == 3 && calls[2].is_empty(), "{calls:?}");

    // A part is missing: the merge names it.
    for index in [0, 2] {
        succeeds(&desk.shard("to do.sbatch", index));
    }
    let output = desk.bash("to do.sbatch", &["merge"], &[]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains("/1.oct: cannot open"), "{stderr}");
    assert!(!desk.path("to do.oct").exists());
    succeeds(&desk.shard("to do.sbatch", 1));
    succeeds(&desk.bash("to do.sbatch", &["merge"], &[]));
    let [single, merged] = ["single.oct", "to do.oct"].map(|name| UncertaintyField::read(&desk.path(name)).unwrap());
    assert_eq!(single.protocol().rays, merged.protocol().rays);
    let difference = compare(&single, &merged, 20_000, 0).unwrap();
    assert!(difference.in_box.unwrap().max <= 1e-6 && difference.on_surfaces.unwrap().max <= 1e-6);

    // Again: nothing is computed. A part that was cut short is.
    let before = contents(&parts);
    assert_eq!(before.keys().filter(|path| path.extension().is_some_and(|e| e == "oct")).count(), 3);
    assert!(before.keys().all(|path| path.extension().is_none_or(|e| e != "chk")), "checkpoints are gone");
    for index in 0..3 {
        assert!(succeeds(&desk.shard("to do.sbatch", index)).contains("is complete: nothing to do"));
    }
    let part = parts.join("2.oct");
    std::fs::write(&part, &before[&part][..1000]).unwrap();
    assert!(!succeeds(&desk.shard("to do.sbatch", 2)).contains("nothing to do"));
    assert_eq!(contents(&parts), before);

    // The part of a run with other settings, in the place of one that belongs.
    let other = ["--lambda=1", "--shard=2/3", "-o", part.to_str().unwrap()];
    desk.good(&[&["uncertainty"], &run[..], &extent, &other].concat());
    succeeds(&desk.shard("to do.sbatch", 2));
    let output = desk.bash("to do.sbatch", &["merge"], &[]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2), "{stderr}");
    assert!(
        stderr.contains("lambda of ") && stderr.contains("/2.oct: expected ") && stderr.contains("/0.oct, found 1")
    );
}

#[test]
fn what_a_signal_ended_queues_again_and_failures_do_not() {
    let desk = Desk::new("signals");
    desk.plan(&["--jobs", "2", "--slurm", "-o", "run.sbatch"]);
    let ended = |code: &str, restarts: &str| {
        let variables = [
            ("SLURM_ARRAY_TASK_ID", "1"),
            ("SLURM_JOB_ID", "4712"),
            ("SLURM_RESTART_COUNT", restarts),
            ("SRUN_CODE", code),
        ];
        let output = desk.bash("run.sbatch", &["shard"], &variables);
        let trace = desk.trace();
        let _ = std::fs::remove_file(desk.bin.join("trace"));
        (output.status.code().unwrap().to_string(), trace)
    };
    // 130 after SIGTERM, 137 after kill -9.
    for (code, restarts) in [("130", "0"), ("137", "4"), ("143", "")] {
        assert_eq!(ended(code, restarts), (code.to_string(), "requeue\n4712\n".to_string()));
    }
    for (code, restarts) in [("2", "0"), ("1", "0"), ("137", "5")] {
        assert_eq!(ended(code, restarts), (code.to_string(), String::new()));
    }
}

#[test]
fn parts_of_different_runs_have_different_folders() {
    let desk = Desk::new("folders");
    let parts = |more: &[&str]| {
        let asked = ["--jobs", "2", "--slurm", "-o", "run.sbatch"];
        let plan = desk.plan(&[&asked, more].concat());
        plan["slurm"]["parts"].as_str().unwrap().to_string()
    };
    let first = parts(&[]);
    assert!(first.starts_with("run.parts-") && first == parts(&["--cpus", "3"]), "{first}");
    let mut others = vec![first, parts(&["--seed", "1"]), parts(&["--keep-sums"])];
    VoxelGrid::bake(&ClosedForm::ball(), [33; 3], Vec3::Z).write(&desk.path("model.npz")).unwrap();
    others.push(parts(&[]));
    others.sort();
    others.dedup();
    assert_eq!(others.len(), 4, "{others:?}");
    let field = parts(&["--field", "field.oct"]);
    assert!(field.starts_with("field.parts-"), "{field}");
}

#[test]
fn options_without_meaning_are_refused() {
    let desk = Desk::new("refusals");
    let before = desk.files();
    let slurm = ["--jobs", "2", "--slurm", "-o", "run.sbatch"];
    for (more, sentence) in [
        (vec!["--rays=auto"], "--rays: expected a number of rays to plan for, found auto"),
        (vec!["--error-bars"], "--error-bars: expected none beside --jobs: shards of one seed are not independent"),
        (vec!["--dump-samples", "s.npz"], "--dump-samples: expected none beside --jobs"),
        (vec!["--shard", "0/2"], "--shard: expected none beside --jobs: every job is a shard"),
        (
            vec!["--checkpoint", "c.chk"],
            "--checkpoint: expected none beside --jobs: every shard has a checkpoint of its",
        ),
        (vec!["--audit"], "--audit: expected none beside --jobs"),
        (vec!["--field", "field.npy"], "field.npy: file name: expected `.oct`"),
        (vec!["--field", "run.sbatch"], "run.sbatch: file name: expected `.oct`"),
        (vec!["--field", "no/field.oct"], "no/field.oct: cannot create a file in this folder"),
    ] {
        let run = RUN.iter().copied().filter(|word| more != ["--rays=auto"] || !["--rays", "6000"].contains(word));
        let words: Vec<&str> = ["plan"].into_iter().chain(run).chain(slurm).chain(more.iter().copied()).collect();
        let said = desk.refused(&words);
        assert!(said.starts_with(sentence), "{more:?}: {said}");
    }
    for (more, sentence) in [
        (vec!["--jobs", "2", "--slurm", "-o", "run.oct"], "run.oct: file name: expected a script's"),
        (vec!["--jobs", "2", "--slurm", "-o", "model.npz"], "--output: expected a file of its own"),
        (vec!["--jobs", "13", "--slurm", "-o", "x"], "--jobs: expected at most 12: 6000 rays are dealt out in batches"),
        (vec!["--jobs", "1", "--slurm", "-o", "x"], "invalid value '1' for '--jobs <N>'"),
        (vec!["--jobs", "2", "-o", "x"], "the following required arguments were not provided"),
        (vec!["--jobs", "2", "--slurm"], "the following required arguments were not provided"),
        (vec!["-o", "run.sbatch"], "run.sbatch: file name: expected `.oct`"),
    ] {
        let said = desk.refused(&[&["plan"], &RUN[..], &more].concat());
        assert!(said.starts_with(sentence), "{more:?}: {said}");
    }
    assert_eq!(desk.files(), before);
}
