//! Cameras belong to the model: `uncertainty` uses those that `train` trained on. One rule selects frames, and
//! files that do not belong together are refused.

use crate::program::{Desk, OCTAHEDRON};
use octobayes::field::TrainedField;
use octobayes::geometry::Domain;
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::Views;
use octobayes_models::HashGrid;

const SMALL: &str = "--samples-per-step 4096 --log2-hashmap-size 12";
const RUN: &str = "--level 4 --rays 1000 --gradient auto --occupancy 16 --keep-sums";
const DEPTH: &str = "--depth set/depth --depth-pattern {}.png --depth-encoding 0,6.5535";

/// Checksums of what a field was computed from.
fn checksums(field: &UncertaintyField) -> [Option<u32>; 2] {
    [field.record().model_checksum, field.record().cameras_checksum]
}

/// A folder with synthetic images of an octahedron: 20 for training and 2 held out.
fn desk() -> Desk {
    let desk = Desk::empty();
    desk.write("mesh.obj", OCTAHEDRON);
    desk.good("synth mesh.obj -o set --count 20 --test-count 2 --resolution 24 --samples-per-pixel 4");
    desk
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn uncertainty_uses_the_cameras_that_the_model_was_trained_on() {
    let desk = desk();
    desk.good(&format!("train set -o m.safetensors --views 4 --steps 40 {SMALL}"));
    let stderr = desk.said(&format!("uncertainty m.safetensors {RUN} -o own.oct"));
    assert!(stderr.contains("4 cameras (stored in the model)"), "{stderr}");

    // The same frames from the file give the same field, and nothing to warn of.
    let file = "--cameras set/transforms_train.json";
    let stderr = desk.said(&format!("uncertainty m.safetensors {file} --views 4 {RUN} -o same.oct"));
    assert!(stderr.contains("4 cameras of 20 frames") && !stderr.contains("not the cameras"), "{stderr}");
    let [own, same] = ["own.oct", "same.oct"].map(|name| desk.field(name));
    assert!(own.deviations() == same.deviations() && own.support() == same.support());
    assert_eq!(checksums(&own), checksums(&same));
    assert!(own.record().model_checksum.is_some() && own.record().cameras_checksum.is_some());

    // With all frames of the file, it says so and warns.
    let stderr = desk.said(&format!("uncertainty m.safetensors {file} --seed 1 {RUN} -o all.oct"));
    assert!(stderr.contains("16 of these 20 are others, 0 of its 4"), "{stderr}");
    desk.refused("merge own.oct all.oct -o x.oct", &["model and cameras of all.oct"]);
    desk.good(&format!("uncertainty m.safetensors {file} --views 4 --seed 1 {RUN} -o second.oct"));
    desk.good("merge own.oct second.oct -o merged.oct");

    desk.good("render m.safetensors own.oct --frame 3 -o view.png");
    desk.refused("render m.safetensors own.oct --frame 4 -o x.png", &["frame 4", "from 0 to 3"]);
    desk.refused(&format!("uncertainty m.safetensors --fov 60 {RUN} -o x.oct"), &["--fov", "lenses"]);
}

#[test]
fn models_without_cameras_are_read_and_damaged_cameras_refused() {
    let desk = desk();
    desk.good(&format!("train set -o m.safetensors --views 2 --steps 2 {SMALL}"));
    let field = HashGrid::read(&desk.join("m.safetensors")).unwrap();
    let frames = Views::read(&desk.join("set/transforms_train.json"), None).unwrap().frames;
    let named = field.training_cameras();
    assert_eq!(named.len(), 2);
    assert!(named.iter().all(|n| frames.iter().any(|f| f.name == n.name && f.camera == n.camera)));

    // No cameras, no section.
    field.with_training_cameras(Vec::new()).write(&desk.join("old.safetensors")).unwrap();
    let bytes = std::fs::read(desk.join("old.safetensors")).unwrap();
    assert!(!bytes.windows(8).any(|part| part == b"position"));
    desk.refused(&format!("uncertainty old.safetensors {RUN} -o x.oct"), &["--cameras", "brings no cameras"]);

    let bytes = std::fs::read(desk.join("m.safetensors")).unwrap();
    for (from, to, expected) in [
        ("[24,24]", "[0 ,24]", "0 x 24 pixels"),
        ("focal\\\":[", "vocal\\\":[", "missing field `focal`"),
        ("axes\\\":[[", "axes\\\":[9", "description of a hash grid"),
    ] {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|part| part == from.as_bytes()).expect(from);
        let damaged = [&bytes[..at], to.as_bytes(), &bytes[at + to.len()..]].concat();
        std::fs::write(desk.join("damaged.safetensors"), damaged).unwrap();
        desk.refused("info damaged.safetensors", &["damaged.safetensors: metadata", expected]);
    }
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn all_verbs_select_frames_by_one_rule() {
    let desk = desk();
    // The training frames alone, without the images of two.
    std::fs::copy(desk.join("set/transforms_train.json"), desk.join("set/transforms.json")).unwrap();
    let frames = Views::read(&desk.join("set/transforms.json"), None).unwrap().frames;
    [1, 5].iter().for_each(|i: &usize| std::fs::remove_file(&frames[*i].image).unwrap());
    // By name they have places 9 and 18 of 20.
    let held_out = format!("9 ({}), 18 ({})", frames[9].name, frames[18].name);
    let file = "--cameras set/transforms.json";
    for command in [
        format!("train set/transforms.json -o m.safetensors --steps 40 {SMALL}"),
        format!("uncertainty m.safetensors {file} {RUN} -o file.oct"),
        format!("uncertainty scene:ball {file} {RUN} -o file.oct"),
    ] {
        let stderr = desk.said(&command);
        assert!(stderr.contains("16 cameras of 20 frames") && stderr.contains(&held_out), "{command}: {stderr}");
        assert!(stderr.contains("2 have no image") && !stderr.contains("not the cameras"), "{command}: {stderr}");
    }
    let stderr = desk.said(&format!("uncertainty m.safetensors {file} --views all {RUN} -o x.oct"));
    assert!(stderr.contains("18 cameras of 20") && stderr.contains("2 of these 18 are others"), "{stderr}");

    desk.good(&format!("uncertainty m.safetensors {RUN} -o own.oct"));
    let stderr = desk.said(&format!("evaluate m.safetensors own.oct {file} {DEPTH}"));
    assert!(stderr.contains("2 cameras of 20 frames") && !stderr.contains("was trained on"), "{stderr}");
    let stderr = desk.said(&format!("evaluate m.safetensors own.oct {file} --views all {DEPTH}"));
    assert!(stderr.contains("trained on 16 of these 18 frames"), "{stderr}");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_field_of_another_model_is_refused_wherever_models_lie() {
    let desk = desk();
    desk.good(&format!("train set -o m.safetensors --views 4 --steps 40 --members 2 {SMALL}"));
    desk.good(&format!("uncertainty m-0.safetensors {RUN} -o field.oct"));
    let render = |model: &str| format!("render {model} field.oct -o view.png");
    let evaluate = |model: &str| format!("evaluate {model} field.oct --cameras set/transforms_test.json {DEPTH}");
    for verb in [render("m-1.safetensors"), evaluate("m-1.safetensors")] {
        desk.refused(&verb, &["model of field.oct", "m-0.safetensors", "`m-1.safetensors`", "--force"]);
        let stderr = desk.said(&format!("{verb} --force"));
        assert!(stderr.contains("warning: model of field.oct"), "{stderr}");
    }

    // The same model under another path is the same model.
    std::fs::create_dir(desk.join("moved")).unwrap();
    std::fs::copy(desk.join("m-0.safetensors"), desk.join("moved/n.safetensors")).unwrap();
    desk.good(&render("moved/n.safetensors"));
    desk.good(&evaluate("moved/n.safetensors"));
    desk.good(&format!("uncertainty moved/n.safetensors --seed 1 {RUN} -o second.oct"));
    desk.good("merge field.oct second.oct -o merged.oct");
    desk.good(&format!("uncertainty m-1.safetensors --seed 1 {RUN} -o other.oct"));
    desk.refused("merge field.oct other.oct -o x.oct", &["model and cameras of other.oct"]);
    // Rays that were already drawn are recognised under any path.
    desk.good(&format!("uncertainty moved/n.safetensors {RUN} -o again.oct"));
    desk.refused("merge field.oct again.oct -o x.oct", &["rays in common"]);
    desk.refused("merge merged.oct second.oct -o x.oct", &["rays in common"]);
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_contracted_model_gives_a_contracted_field() {
    let desk = desk();
    // Hardly a step of training leaves fog, whose rays are long.
    let run = RUN.replace("--rays 1000", "--rays 200");
    desk.good(&format!("train set -o m.safetensors --contract linf:0,0,0,1.5 --views 2 --steps 2 {SMALL}"));
    let model = HashGrid::read(&desk.join("m.safetensors")).unwrap();
    let stderr = desk.said(&format!("uncertainty m.safetensors {run} -o field.oct"));
    assert!(stderr.contains("domain: the model's own") && stderr.contains("contract"), "{stderr}");
    let domain = *desk.field("field.oct").lattice().domain();
    assert!(matches!(domain, Domain::Contracted { .. }) && domain == model.natural_domain(), "{domain}");
    let stderr = desk.said(&format!("uncertainty m.safetensors --box=-1,-1,-1,1,1,1 {run} -o box.oct"));
    assert!(!stderr.contains("what the model does"), "{stderr}");
    assert!(desk.field("box.oct").lattice().domain().bounds().is_some());
    desk.good("render m.safetensors field.oct -o view.png");
}

/// A field of samples from elsewhere does not say which model they are of.
#[test]
fn a_field_of_unknown_origin_passes() {
    let desk = desk();
    desk.good(&format!("train set -o m.safetensors --views 2 --steps 2 {SMALL}"));
    let jacobians = "--dump-samples samples.npz --box=-1,-1,-1,1,1,1";
    desk.good(&format!("uncertainty m.safetensors {jacobians} {RUN} -o own.oct"));
    desk.good("uncertainty samples.npz --box=-1,-1,-1,1,1,1 --level 4 -o unknown.oct");
    let model = |name: &str| desk.field(name).record().model_checksum;
    assert!(model("own.oct").is_some() && model("unknown.oct").is_none());
    desk.good("render m.safetensors unknown.oct -o view.png");
}
