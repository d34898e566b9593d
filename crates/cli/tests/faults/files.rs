//! No file is lost to another: what each verb does when an output is an input, another output, a link, or no
//! regular file. Every verb that writes is here.
#![cfg(unix)]

use std::os::unix::fs::symlink;
use std::process::Command;

use crate::program::{Desk, TETRAHEDRON};
use glam::Vec3;
use octobayes::field::{ClosedForm, VoxelGrid};
use octobayes_models::write_voxel_grid;

const RUN: &str =
    "uncertainty model.npz --cameras cameras.json --level 4 --rays 600 --occupancy 16 --keep-sums --force";
const RENDER: &str = "render model.npz field.oct --cameras cameras.json";
const EVALUATE: &str = "evaluate model.npz field.oct --cameras cameras.json --depth . --depth-encoding 0,6 --views all";
const ACCUMULATE: &str = "uncertainty samples.npz --box=-1,-1,-1,1,1,1 --level 4";
const TRAIN: &str = "train cameras.json --steps 2 --log2-hashmap-size 8 --samples-per-step 1024";

/// A folder with every kind of input.
fn desk() -> Desk {
    let desk = Desk::new(9, 16);
    for i in 0..9 {
        let image = image::RgbaImage::from_pixel(16, 16, image::Rgba([90, 120, 150, 255]));
        image.save(desk.join(format!("r_{i}.png"))).unwrap();
        let depth = image::GrayImage::from_fn(16, 16, |x, y| image::Luma([(60 + 7 * x + 3 * y) as u8]));
        depth.save(desk.join(format!("r_{i}_depth_0001.png"))).unwrap();
    }
    write_voxel_grid(&VoxelGrid::bake(&ClosedForm::ball(), [9; 3], Vec3::Z), &desk.join("model.npz")).unwrap();
    desk.write("points.csv", "0,0,0\n");
    desk.write("mesh.obj", TETRAHEDRON);
    desk.good(&format!("{RUN} -o field.oct --dump-samples samples.npz"));
    (0..2).for_each(|i| drop(desk.good(&format!("{} --shard {i}/2 -o part{i}.oct", RUN.replace("600", "1200")))));
    std::fs::copy(desk.join("cameras.json"), desk.join("c.state")).unwrap();
    symlink("cameras.json", desk.join("soft")).unwrap();
    std::fs::hard_link(desk.join("cameras.json"), desk.join("hard.oct")).unwrap();
    std::fs::create_dir(desk.join("sub")).unwrap();
    desk
}

/// For every verb that writes a file: an ending that its output may have, and all arguments but the output's name.
fn writers() -> Vec<(&'static str, String)> {
    vec![
        ("oct", format!("{RUN} -o")),
        ("npz", format!("{RUN} -o y.oct --dump-samples")),
        ("oct", format!("{ACCUMULATE} -o")),
        ("oct", "export field.oct -o".into()),
        ("npy", "export field.oct -o".into()),
        ("oct", "merge part0.oct part1.oct -o".into()),
        ("csv", "query field.oct points.csv -o".into()),
        ("png", format!("{RENDER} -o")),
        ("exr", format!("{RENDER} -o")),
        ("svg", format!("{EVALUATE} --plot")),
        ("csv", format!("{EVALUATE} --csv")),
        ("png", format!("{EVALUATE} --clean-up")),
        ("safetensors", format!("{TRAIN} -o")),
    ]
}

/// Early versions overwrote whatever had the output's name. With a checkpoint of that name they even removed the
/// result at the end, as the checkpoint of a finished run, with exit code 0.
#[test]
fn two_files_of_a_command_are_never_the_same() {
    let desk = desk();
    for (args, named) in [
        (format!("{RUN} -o ./sub/../model.npz"), ["--output", "MODEL"]),
        (format!("{RUN} -o soft"), ["--output", "--cameras"]),
        (format!("{RUN} -o r_1.png"), ["--output", "an image of --cameras"]),
        (format!("{RUN} -o x.oct --checkpoint x.oct"), ["--checkpoint", "--output"]),
        (format!("{RUN} -o x.oct --checkpoint cameras.json"), ["--checkpoint", "--cameras"]),
        (format!("{RUN} -o x.1 --checkpoint x --error-bars 2"), ["--checkpoint, group 1", "--output"]),
        (format!("{RUN} -o x.oct --dump-samples x.oct"), ["--dump-samples", "--output"]),
        (format!("{RUN} -o x.oct --dump-samples model.npz"), ["--dump-samples", "MODEL"]),
        (format!("{ACCUMULATE} -o samples.npz"), ["--output", "MODEL"]),
        ("export field.oct -o field.oct".into(), ["--output", "FIELD"]),
        ("merge part0.oct part1.oct -o part1.oct".into(), ["--output", "FIELD"]),
        ("query field.oct points.csv -o points.csv".into(), ["--output", "POINTS"]),
        (format!("{RENDER} -o r_0.png"), ["--output", "an image of --cameras"]),
        (format!("{EVALUATE} --csv field.oct"), ["--csv", "FIELD"]),
        (format!("{EVALUATE} --plot cameras.json"), ["--plot", "--cameras"]),
        (format!("{EVALUATE} --csv x --plot x"), ["--csv", "--plot"]),
        (format!("{EVALUATE} --calibrate field.oct"), ["--calibrate", "FIELD"]),
        (format!("{EVALUATE} --clean-up r_3_depth_0001.png"), ["--clean-up", "--depth"]),
        (TRAIN.replace("cameras.json", "c.state") + " -o c.safetensors", ["the state of --output", "DATASET"]),
    ] {
        let error = desk.refused(&args, &["the same file as"]);
        let [output, other] = named;
        assert!(error.starts_with(&format!("{output}: ")) && error.ends_with(&format!(" of {other}")), "{error}");
    }
    // A folder for output must be new or empty: no input can be that folder or lie in it.
    for args in ["synth mesh.obj -o mesh.obj", "synth mesh.obj -o .", "demo --output mesh.obj"] {
        desk.refused(args, &[]);
    }
}

#[test]
fn what_is_no_file_is_not_replaced_by_one() {
    let desk = desk();
    for (i, (ending, command)) in writers().into_iter().enumerate() {
        let output = format!("output{i}.{ending}");
        let path = desk.join(&output);
        match i % 3 {
            0 => symlink("/dev/null", path).unwrap(),
            1 => std::fs::create_dir(path).unwrap(),
            _ => assert!(Command::new("mkfifo").arg(path).status().unwrap().success()),
        }
        desk.refused(&format!("{command} {output}"), &[&output, "output path", "a file"]);
    }
    // Refused even where stdout is a file: the shell has it open, and would continue with the old one.
    desk.refused("merge part0.oct part1.oct -o /dev/stdout", &["/dev/stdout: output path"]);
}

#[test]
fn links_are_followed_and_stay() {
    let desk = desk();
    let links = writers().into_iter().enumerate().map(|(i, (ending, command))| (format!("{i}.{ending}"), command));
    for (name, command) in links {
        let [link, target] = [format!("link{name}"), format!("sub/{name}")];
        symlink(&target, desk.join(&link)).unwrap();
        desk.good(&format!("{command} {link}"));
        assert!(desk.join(&link).is_symlink() && !desk.bytes(&target).is_empty(), "{command} {link}");
    }
    let cameras = desk.bytes("cameras.json");
    desk.good(&format!("{RUN} -o hard.oct"));
    assert_eq!(desk.bytes("cameras.json"), cameras, "a hard link is a file of its own");
    symlink("sub/dataset", desk.join("dataset")).unwrap();
    desk.good("synth mesh.obj -o dataset --count 1 --test-count 1 --resolution 8");
    assert!(desk.join("dataset").is_symlink() && desk.join("sub/dataset/transforms_train.json").is_file());
    let mut left = std::fs::read_dir(desk.join("sub")).unwrap().map(|entry| entry.unwrap().path());
    assert!(left.all(|path| path.extension().is_none_or(|extension| extension != "part")));
}

/// A run that takes days must not learn at its first checkpoint that it cannot save one.
#[test]
fn the_folder_of_a_checkpoint_is_looked_at_before_any_work() {
    let desk = desk();
    for more in ["", "--error-bars 2"] {
        // So many rays would take an age. If any work began, this test would not end.
        let run = RUN.replace("600", "1000000000000");
        let words = ["no/folder/x.chk", "cannot create a file in this folder"];
        desk.refused(&format!("{run} -o x.oct --checkpoint no/folder/x.chk {more}"), &words);
    }
}

/// The demo replaces results of an earlier one in its folder, and no files of others.
#[test]
#[ignore = "slow: whole runs as processes"]
fn the_demo_replaces_results_of_a_demo_only() {
    let desk = Desk::empty();
    let demo = "demo --scene ball --level 4 --rays 1000 -o";
    std::fs::create_dir(desk.join("set")).unwrap();
    desk.write("set/transforms.json", "precious");
    desk.refused(&format!("{demo} set"), &["set/transforms.json"]);
    assert!(desk.bytes("set/transforms.json") == b"precious" && !desk.join("set/field.oct").exists());
    desk.good(&format!("{demo} new"));
    desk.write("new/transforms.json", "half");
    desk.good(&format!("{demo} new"));
    assert!(desk.text("new/transforms.json").contains("frames"));
}
