//! `uncertainty --dry-run`: forecasts that hold; and the scripts of `examples/slurm`. Slurm itself is in tests/slurm;
//! here its commands are stand-ins, so that every machine with bash can run the scripts.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::program::cameras;
use glam::Vec3;
use octobayes::field::{ClosedForm, VoxelGrid};
use octobayes::uncertainty::{UncertaintyField, compare};
use octobayes_data::write_transforms;
use octobayes_models::write_voxel_grid;
use serde_json::Value;

/// What follows `octobayes uncertainty`. A shell would change these names.
const RUN: [&str; 9] = [
    "the model's $(file).npz",
    "--cameras",
    "./-\\cameras`1`.json",
    "--level",
    "5",
    "--rays",
    "6000",
    "--occupancy=32",
    "--box=-0.9,-0.9,-0.9,0.9,0.9,0.9",
];
const SHARDS: &str = "3";
const PARTS: &str = "its parts";

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
struct Cluster {
    _root: tempfile::TempDir,
    folder: PathBuf,
    bin: PathBuf,
}

impl Cluster {
    fn new(name: &str) -> Self {
        let root = tempfile::tempdir().unwrap();
        let [folder, bin] = [name, "bin"].map(|name| root.path().join(name));
        for folder in [&folder, &bin] {
            std::fs::create_dir(folder).unwrap();
        }
        for (name, text) in [("srun", SRUN), ("scontrol", SCONTROL)] {
            std::fs::write(bin.join(name), text).unwrap();
            std::fs::set_permissions(bin.join(name), std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        write_transforms(&folder.join(RUN[2]), &cameras(4, [32; 2])).unwrap();
        write_voxel_grid(&VoxelGrid::bake(&ClosedForm::courtyard(), [33; 3], Vec3::Z), &folder.join(RUN[0])).unwrap();
        Self { _root: root, folder, bin }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Runs the program and returns stdout. Panics on failure.
    fn good(&self, words: &[&str]) -> String {
        let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
        let output = command.args(words).current_dir(&self.folder).output().unwrap();
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs a script of `examples/slurm` with `words` behind it, as a job.
    fn bash(&self, script: &str, words: &[&str], variables: &[(&str, &str)]) -> Output {
        let path = format!("{}:{}", self.bin.display(), std::env::var("PATH").unwrap());
        Command::new("bash")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/slurm").join(script))
            .args(words)
            .current_dir(&self.folder)
            .env("PATH", path)
            .env("TRACE", self.bin.join("trace"))
            .env("OCTOBAYES", env!("CARGO_BIN_EXE_octobayes"))
            .env("SLURM_CPUS_PER_TASK", "1")
            .envs(variables.iter().copied())
            .output()
            .unwrap()
    }

    fn shard(&self, index: u64) -> Output {
        let variables = [("SLURM_ARRAY_TASK_ID", &*index.to_string()), ("SLURM_JOB_ID", "4712")];
        self.bash("shard.sbatch", &[&[SHARDS, PARTS], &RUN[..]].concat(), &variables)
    }

    fn merge(&self) -> Output {
        self.bash("merge.sbatch", &[SHARDS, PARTS, "whole.oct", "--keep-sums"], &[])
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
fn a_dry_run_tells_what_the_run_takes_and_writes_nothing() {
    let desk = Cluster::new("plain");
    let before = desk.files();
    let run = RUN.map(|word| if word == "6000" { "60000" } else { word });
    let dry = |more: &[&str]| desk.good(&[&["uncertainty", "--dry-run"], &run[..], more].concat());
    let needs: Value = serde_json::from_str(&dry(&["--json", "-o", "field.oct"])).unwrap();
    let text = dry(&[]);
    assert!(text.starts_with("run     level 5, 60000 rays, at most ") && text.contains("a file of"), "{text}");
    assert_eq!(desk.files(), before);
    assert!(needs["rays"] == 60_000 && needs["level"] == 5, "{needs}");
    // Batches of 512 rays are dealt out.
    let shard: Value = serde_json::from_str(&dry(&["--json", "--shard", "0/4"])).unwrap();
    assert_eq!(shard["rays"], 14_848, "{shard}");

    let done: Value =
        serde_json::from_str(&desk.good(&[&["uncertainty", "--json", "-o", "field.oct"], &run[..]].concat())).unwrap();
    let size = std::fs::metadata(desk.path("field.oct")).unwrap().len() as f64;
    let number = |value: &Value| value.as_f64().unwrap();
    for (expected, found) in [
        (number(&needs["vertices"]), number(&done["summary"]["vertices"])),
        (number(&needs["file_bytes"]), size),
        (number(&needs["peak_bytes"]), number(&done["peak_bytes"])),
    ] {
        assert!((1.0..1.5).contains(&(expected / found)), "at most {expected}, found {found}");
    }
}

#[test]
fn the_scripts_run_shards_and_merge_whatever_the_names() {
    let desk = Cluster::new("it's a \"run\", $HOME %a ü");
    desk.good(&[&["uncertainty", "-o", "single.oct"], &RUN[..]].concat());
    let parts = desk.path(PARTS);

    // A part is missing: the merge names it.
    for index in [0, 2] {
        succeeds(&desk.shard(index));
    }
    let output = desk.merge();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains("/1.oct: cannot open"), "{stderr}");
    assert!(!desk.path("whole.oct").exists());
    succeeds(&desk.shard(1));
    succeeds(&desk.merge());
    let [single, merged] = ["single.oct", "whole.oct"].map(|name| UncertaintyField::read(&desk.path(name)).unwrap());
    assert_eq!(single.record().rays, merged.record().rays);
    assert!(merged.sums().is_some(), "what stands behind the field's name goes to `merge`");
    let difference = compare(&single, &merged, 20_000, 0).unwrap();
    assert!(difference.in_box.unwrap().max <= 1e-6 && difference.on_surfaces.unwrap().max <= 1e-6);

    // Again: nothing is computed. A part that was cut short is.
    let before = contents(&parts);
    assert_eq!(before.len(), 3, "checkpoints are gone");
    for index in 0..3 {
        assert!(succeeds(&desk.shard(index)).contains("is complete: nothing to do"));
    }
    let part = parts.join("2.oct");
    std::fs::write(&part, &before[&part][..1000]).unwrap();
    assert!(!succeeds(&desk.shard(2)).contains("nothing to do"));
    assert_eq!(contents(&parts), before);

    // The part of a run with other settings, in the place of one that belongs.
    let other = ["--lambda=1", "--shard=2/3", "-o", part.to_str().unwrap()];
    desk.good(&[&["uncertainty"], &RUN[..], &other].concat());
    succeeds(&desk.shard(2));
    let output = desk.merge();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains("lambda of ") && stderr.contains("/2.oct"), "{stderr}");
}

#[test]
fn what_a_signal_ended_queues_again_and_failures_do_not() {
    let desk = Cluster::new("signals");
    let ended = |code: &str, restarts: &str| {
        let variables = [
            ("SLURM_ARRAY_TASK_ID", "1"),
            ("SLURM_JOB_ID", "4712"),
            ("SLURM_RESTART_COUNT", restarts),
            ("SRUN_CODE", code),
        ];
        let output = desk.bash("shard.sbatch", &[&[SHARDS, PARTS], &RUN[..]].concat(), &variables);
        let trace = std::fs::read_to_string(desk.bin.join("trace")).unwrap_or_default();
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
