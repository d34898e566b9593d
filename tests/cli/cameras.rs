//! Cameras belong to the model: `uncertainty` uses those that `train` trained on. One rule selects frames, and
//! files that do not belong together are refused.

use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

#[cfg(unix)]
use crate::interrupt::stopped;
use crate::program::command;
use octobayes::dataset::Views;
use octobayes::field::{HashGrid, RadianceField};
use octobayes::geometry::Domain;
use octobayes::uncertainty::UncertaintyField;

/// A folder with synthetic images of an octahedron: 20 for training and 2 held out.
struct Desk(tempfile::TempDir);

const SMALL: &str = "--samples-per-step 4096 --log2-hashmap-size 12";
const RUN: &str = "--level 4 --rays 1000 --gradient auto --occupancy 16 --keep-sums";

/// Checksums of what a field was computed from.
fn checksums(field: &UncertaintyField) -> [Option<u32>; 2] {
    [field.record().model_checksum, field.record().cameras_checksum]
}

impl Desk {
    fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        let mut mesh = String::new();
        for v in ["1 0 0", "-1 0 0", "0 1 0", "0 -1 0", "0 0 1", "0 0 -1"] {
            mesh += &format!("v {v}\n");
        }
        for [a, b, c] in [[1, 3, 5], [3, 2, 5], [2, 4, 5], [4, 1, 5], [3, 1, 6], [2, 3, 6], [4, 2, 6], [1, 4, 6]] {
            mesh += &format!("f {a} {b} {c}\n");
        }
        std::fs::write(desk.path("mesh.obj"), mesh).unwrap();
        desk.good("synth mesh.obj -o set --count 20 --test-count 2 --resolution 24 --samples-per-pixel 4");
        desk
    }

    /// Writes the training frames alone as `set/transforms.json`. Two of their images are gone; returns these.
    fn one_file(&self) -> [PathBuf; 2] {
        let path = self.path("set/transforms.json");
        std::fs::copy(self.path("set/transforms_train.json"), &path).unwrap();
        let frames = Views::read(&path, None).unwrap().frames;
        [1, 5].map(|i| {
            std::fs::remove_file(&frames[i].image).unwrap();
            frames[i].image.strip_prefix(self.0.path()).unwrap().to_path_buf()
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, args: &str) -> Command {
        let mut command = command(self.0.path(), args);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Runs the program and returns stderr. Panics on failure.
    fn good(&self, args: &str) -> String {
        let output = self.command(args).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{args}: {stderr}");
        stderr
    }

    /// Runs a command that must be refused with exit code 2 and one line. Returns that line.
    fn refused(&self, args: &str) -> String {
        let Output { status, stderr, .. } = self.command(args).output().unwrap();
        let stderr = String::from_utf8(stderr).unwrap();
        assert_eq!(status.code(), Some(2), "{args}: {stderr}");
        let errors: Vec<&str> = stderr.lines().filter_map(|line| line.strip_prefix("error: ")).collect();
        assert_eq!(errors.len(), 1, "{args}: {stderr}");
        errors[0].to_string()
    }

    fn field(&self, name: &str) -> UncertaintyField {
        UncertaintyField::read(&self.path(name)).unwrap()
    }
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn uncertainty_uses_the_cameras_that_the_model_was_trained_on() {
    let desk = Desk::new();
    let stderr = desk.good(&format!("train set -o m.safetensors --views 4 --steps 40 {SMALL}"));
    assert!(stderr.contains("note: 4 cameras of 20 frames of set/transforms_train.json: 16 not chosen"), "{stderr}");
    let stderr = desk.good(&format!("uncertainty m.safetensors {RUN} -o own.oct"));
    assert!(stderr.contains("4 cameras (stored in the model)"), "{stderr}");

    // The same frames from the file give the same field, and nothing to warn of.
    let file = "--cameras set/transforms_train.json";
    let stderr = desk.good(&format!("uncertainty m.safetensors {file} --views 4 {RUN} -o same.oct"));
    assert!(stderr.contains("4 cameras of 20 frames") && !stderr.contains("not the cameras"), "{stderr}");
    let [own, same] = ["own.oct", "same.oct"].map(|name| desk.field(name));
    assert!(own.deviations() == same.deviations() && own.support() == same.support());
    assert_eq!(checksums(&own), checksums(&same));
    assert!(own.record().model_checksum.is_some() && own.record().cameras_checksum.is_some());

    // With all frames of the file, it says so and warns.
    let stderr = desk.good(&format!("uncertainty m.safetensors {file} --seed 1 {RUN} -o all.oct"));
    assert!(stderr.contains("20 cameras of 20 frames of set/transforms_train.json\n"), "{stderr}");
    let warning = "16 of these 20 are others, 0 of its 4 are not among these";
    assert!(stderr.contains(warning), "{stderr}");
    let stderr = desk.good(&format!("uncertainty m.safetensors {file} --views 0,1,2 {RUN} -o x.oct"));
    assert!(stderr.contains("of these 3 are others"), "{stderr}");
    assert!(desk.refused("merge own.oct all.oct -o x.oct").contains("model and cameras of all.oct"));
    desk.good(&format!("uncertainty m.safetensors {file} --views 4 --seed 1 {RUN} -o second.oct"));
    desk.good("merge own.oct second.oct -o merged.oct");

    desk.good("render m.safetensors own.oct --frame 3 -o view.png");
    let error = desk.refused("render m.safetensors own.oct --frame 4 -o x.png");
    assert!(error.contains("frame 4: expected a frame from 0 to 3"), "{error}");
    let error = desk.refused(&format!("uncertainty m.safetensors --fov 60 {RUN} -o x.oct"));
    assert!(error.contains("--fov") && error.contains("knows the lenses"), "{error}");
    let info = desk.command("info m.safetensors").output().unwrap().stdout;
    assert!(String::from_utf8(info).unwrap().contains("4 that it was trained on"));
}

#[test]
fn models_without_cameras_are_read_and_damaged_cameras_refused() {
    let desk = Desk::new();
    desk.good(&format!("train set -o m.safetensors --views 2 --steps 2 {SMALL}"));
    let field = HashGrid::read(&desk.path("m.safetensors")).unwrap();
    let frames = Views::read(&desk.path("set/transforms_train.json"), None).unwrap().frames;
    let named = field.training_cameras();
    assert_eq!(named.len(), 2);
    assert!(named.iter().all(|n| frames.iter().any(|f| f.name == n.name && f.camera == n.camera)));

    // No cameras, no section.
    field.with_training_cameras(Vec::new()).write(&desk.path("old.safetensors")).unwrap();
    let bytes = std::fs::read(desk.path("old.safetensors")).unwrap();
    assert!(!bytes.windows(8).any(|part| part == b"position"));
    let error = desk.refused(&format!("uncertainty old.safetensors {RUN} -o x.oct"));
    assert!(error.contains("--cameras") && error.contains("brings no cameras"), "{error}");
    // After two steps it shows nothing of the images.
    desk.good(&format!("uncertainty old.safetensors --cameras set/transforms_train.json {RUN} --force -o x.oct"));

    let bytes = std::fs::read(desk.path("m.safetensors")).unwrap();
    for (from, to, expected) in [
        ("[24,24]", "[0 ,24]", "0 x 24 pixels"),
        ("focal\\\":[", "vocal\\\":[", "missing field `focal`"),
        ("axes\\\":[[", "axes\\\":[9", "description of a hash grid"),
    ] {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|part| part == from.as_bytes()).expect(from);
        let damaged = [&bytes[..at], to.as_bytes(), &bytes[at + to.len()..]].concat();
        std::fs::write(desk.path("damaged.safetensors"), damaged).unwrap();
        let error = desk.refused("info damaged.safetensors");
        assert!(error.starts_with("damaged.safetensors: metadata") && error.contains(expected), "{error}");
    }
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn all_verbs_select_frames_by_one_rule() {
    let desk = Desk::new();
    let [first, second] = desk.one_file();
    let missing = format!("{}, {}", first.display(), second.file_name().unwrap().display());
    let why = format!("of 20 frames of set/transforms.json: 2 have no image ({missing})");
    let frames = Views::read(&desk.path("set/transforms.json"), None).unwrap().frames;
    // By name they have places 9 and 18 of 20.
    let those = format!("9 ({}), 18 ({}) (views `all` takes both)", frames[9].name, frames[18].name);
    let held = format!("2 are held out, a tenth, as nerfstudio does: {those}");
    let stderr = desk.good(&format!("train set/transforms.json -o m.safetensors --steps 40 {SMALL}"));
    assert!(stderr.contains(&format!("16 cameras {why}, {held}")), "{stderr}");
    let file = "--cameras set/transforms.json";
    let by_model = format!("2 are held out, as the model was not trained on them: {those}");
    for (model, held) in [("m.safetensors", &by_model), ("scene:ball", &held)] {
        let stderr = desk.good(&format!("uncertainty {model} {file} {RUN} -o file.oct"));
        assert!(
            stderr.contains(&format!("16 cameras {why}, {held}")) && !stderr.contains("not the cameras"),
            "{stderr}"
        );
    }
    let stderr = desk.good(&format!("uncertainty m.safetensors {file} --views all {RUN} -o x.oct"));
    assert!(stderr.contains(&format!("18 cameras {why}\n")), "{stderr}");
    assert!(stderr.contains("2 of these 18 are others, 0 of its 16"), "{stderr}");

    desk.good(&format!("uncertainty m.safetensors {RUN} -o own.oct"));
    let depth = "--depth set/depth --depth-pattern {}.png --depth-encoding 0,6.5535";
    let stderr = desk.good(&format!("evaluate m.safetensors own.oct {file} {depth}"));
    assert!(stderr.contains(&format!("2 cameras {why}, 16 are for training")), "{stderr}");
    assert!(!stderr.contains("was trained on"), "{stderr}");
    let stderr = desk.good(&format!("evaluate m.safetensors own.oct {file} --views all {depth}"));
    assert!(stderr.contains("trained on 16 of these 18 frames"), "{stderr}");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_field_of_another_model_is_refused_wherever_models_lie() {
    let desk = Desk::new();
    desk.good(&format!("train set -o m.safetensors --views 4 --steps 40 --members 2 {SMALL}"));
    desk.good(&format!("uncertainty m-0.safetensors {RUN} -o field.oct"));
    let judged =
        "--cameras set/transforms_test.json --depth set/depth --depth-pattern {}.png --depth-encoding 0,6.5535";
    let render = |model: &str| format!("render {model} field.oct -o view.png");
    let evaluate = |model: &str| format!("evaluate {model} field.oct {judged}");
    for verb in [render("m-1.safetensors"), evaluate("m-1.safetensors")] {
        let error = desk.refused(&verb);
        assert!(error.starts_with("model of field.oct: expected checksum ") && error.contains("--force"), "{error}");
        assert!(error.contains("m-0.safetensors") && error.contains("`m-1.safetensors`"), "{error}");
        let stderr = desk.good(&format!("{verb} --force"));
        assert!(stderr.contains("warning: model of field.oct"), "{stderr}");
    }

    // The same model under another path is the same model.
    std::fs::create_dir(desk.path("moved")).unwrap();
    std::fs::copy(desk.path("m-0.safetensors"), desk.path("moved/n.safetensors")).unwrap();
    desk.good(&render("moved/n.safetensors"));
    desk.good(&evaluate("moved/n.safetensors"));
    desk.good(&format!("uncertainty moved/n.safetensors --seed 1 {RUN} -o second.oct"));
    desk.good("merge field.oct second.oct -o merged.oct");
    desk.good(&format!("uncertainty m-1.safetensors --seed 1 {RUN} -o other.oct"));
    assert!(desk.refused("merge field.oct other.oct -o x.oct").contains("model and cameras of other.oct"));
    // Rays that were already drawn are recognised under any path.
    desk.good(&format!("uncertainty moved/n.safetensors {RUN} -o again.oct"));
    assert!(desk.refused("merge field.oct again.oct -o x.oct").contains("rays in common"));
    assert!(desk.refused("merge merged.oct second.oct -o x.oct").contains("rays in common"));
}

#[test]
#[cfg(unix)]
#[ignore = "slow: whole runs as processes"]
fn a_run_goes_on_with_a_model_that_has_moved() {
    let desk = Desk::new();
    desk.good(&format!("train set -o m.safetensors --views 4 --steps 40 {SMALL}"));
    std::fs::create_dir(desk.path("moved")).unwrap();
    std::fs::copy(desk.path("m.safetensors"), desk.path("moved/n.safetensors")).unwrap();
    let run = |model: &str, out: &str| {
        format!("uncertainty {model} --level 4 --rays 8000 --error-bars 8 --gradient auto --occupancy 16 -o {out}")
    };
    desk.good(&run("m.safetensors", "whole.oct"));
    let begun = format!("{} --checkpoint run.chk", run("m.safetensors", "parts.oct"));
    let output = stopped(&desk.path("run.chk.0"), desk.command(&begun).spawn().unwrap(), "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    desk.good(&format!("{} --checkpoint run.chk", run("moved/n.safetensors", "parts.oct")));
    let [whole, parts] = ["whole.oct", "parts.oct"].map(|name| desk.field(name));
    assert!(whole.deviations() == parts.deviations() && whole.sums() == parts.sums());
    assert_eq!(checksums(&whole), checksums(&parts));
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_contracted_model_gives_a_contracted_field() {
    let desk = Desk::new();
    // Hardly a step of training leaves fog, whose rays are long.
    let run = RUN.replace("--rays 1000", "--rays 200");
    desk.good(&format!("train set -o m.safetensors --contract linf:0,0,0,1.5 --views 2 --steps 2 {SMALL}"));
    let model = HashGrid::read(&desk.path("m.safetensors")).unwrap();
    let stderr = desk.good(&format!("uncertainty m.safetensors {run} -o field.oct"));
    assert!(stderr.contains("the field covers what the model does") && stderr.contains("contract"), "{stderr}");
    let domain = *desk.field("field.oct").lattice().domain();
    assert!(matches!(domain, Domain::Contracted { .. }) && domain == model.natural_domain(), "{domain}");
    let stderr = desk.good(&format!("uncertainty m.safetensors --box=-1,-1,-1,1,1,1 {run} -o box.oct"));
    assert!(!stderr.contains("what the model does"), "{stderr}");
    assert!(desk.field("box.oct").lattice().domain().bounds().is_some());
    desk.good("render m.safetensors field.oct -o view.png");
}

/// A field of samples from elsewhere does not say which model they are of.
#[test]
fn a_field_of_unknown_origin_passes() {
    let desk = Desk::new();
    desk.good(&format!("train set -o m.safetensors --views 2 --steps 2 {SMALL}"));
    let jacobians = "--dump-samples samples.npz --box=-1,-1,-1,1,1,1";
    desk.good(&format!("uncertainty m.safetensors {jacobians} {RUN} -o own.oct"));
    desk.good("uncertainty samples.npz --box=-1,-1,-1,1,1,1 --level 4 -o unknown.oct");
    let model = |name: &str| desk.field(name).record().model_checksum;
    assert!(model("own.oct").is_some() && model("unknown.oct").is_none());
    desk.good("render m.safetensors unknown.oct -o view.png");
}
