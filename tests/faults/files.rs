//! No file is lost to another: what each verb does when an output is an input, another output, a link, or no
//! regular file. Every verb that writes is here.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::program::outcome;
use glam::Vec3;
use octobayes::dataset::write_transforms;
use octobayes::field::{ClosedForm, VoxelGrid};

const RUN: &str =
    "uncertainty model.npz --cameras cameras.json --level 4 --rays 600 --occupancy 16 --keep-sums --force";
const RENDER: &str = "render model.npz field.oct --cameras cameras.json";
const EVALUATE: &str = "evaluate model.npz field.oct --cameras cameras.json --depth . --depth-encoding 0,6 --views all";
const ACCUMULATE: &str = "uncertainty samples.npz --box=-1,-1,-1,1,1,1 --level 4";
const TRAIN: &str = "train cameras.json --steps 2 --log2-hashmap-size 8 --samples-per-step 1024";

/// A folder with every kind of input.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        let cameras = ClosedForm::half_circle(9, [16, 16]).into_iter().enumerate();
        let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
        write_transforms(&desk.path("cameras.json"), &named).unwrap();
        for i in 0..9 {
            let image = image::RgbaImage::from_pixel(16, 16, image::Rgba([90, 120, 150, 255]));
            image.save(desk.path(&format!("r_{i}.png"))).unwrap();
            let depth = image::GrayImage::from_fn(16, 16, |x, y| image::Luma([(60 + 7 * x + 3 * y) as u8]));
            depth.save(desk.path(&format!("r_{i}_depth_0001.png"))).unwrap();
        }
        VoxelGrid::bake(&ClosedForm::ball(), [9; 3], Vec3::Z).write(&desk.path("model.npz")).unwrap();
        std::fs::write(desk.path("points.csv"), "0,0,0\n").unwrap();
        std::fs::write(desk.path("mesh.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n").unwrap();
        desk.good(&format!("{RUN} -o field.oct --dump-samples samples.npz"));
        for shard in 0..2 {
            let run = RUN.replace("600", "1200");
            desk.good(&format!("{run} --shard {shard}/2 -o part{shard}.oct"));
        }
        desk.good("export field.oct -o unc.npy");
        for (from, to) in [("field.oct", "field.png"), ("cameras.json", "c.safetensors"), ("cameras.json", "c.state")] {
            std::fs::copy(desk.path(from), desk.path(to)).unwrap();
        }
        symlink("cameras.json", desk.path("soft")).unwrap();
        std::fs::hard_link(desk.path("cameras.json"), desk.path("hard")).unwrap();
        std::fs::create_dir(desk.path("sub")).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, args: &str) -> (Option<i32>, String) {
        let (code, _, said) = outcome(self.0.path(), args);
        (code, said)
    }

    fn good(&self, args: &str) {
        let (code, stderr) = self.run(args);
        assert_eq!(code, Some(0), "{args}: {stderr}");
    }

    /// Names and contents of everything in the folder; for links, where they lead.
    fn contents(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let content = |path: &Path| {
            let kind = path.symlink_metadata().unwrap().file_type();
            match (kind.is_symlink(), kind.is_file()) {
                (true, _) => std::fs::read_link(path).unwrap().into_os_string().into_encoded_bytes(),
                (_, true) => std::fs::read(path).unwrap(),
                _ => format!("{kind:?}").into_bytes(),
            }
        };
        let paths = std::fs::read_dir(self.0.path()).unwrap().map(|entry| entry.unwrap().path());
        paths.map(|path| (path.clone(), content(&path))).collect()
    }
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
        ("npy", "query field.oct points.csv -o".into()),
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
    let desk = Desk::new();
    let before = desk.contents();
    let own = [
        (format!("{RUN} -o model.npz"), ["--output", "MODEL"]),
        (format!("{RUN} -o ./sub/../model.npz"), ["--output", "MODEL"]),
        (format!("{RUN} -o cameras.json"), ["--output", "--cameras"]),
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
        ("export unc.npy --box=-1,-1,-1,1,1,1 -o unc.npy".into(), ["--output", "FIELD"]),
        ("render model.npz field.png --cameras cameras.json -o field.png".into(), ["--output", "FIELD"]),
        (format!("{RENDER} -o r_0.png"), ["--output", "an image of --cameras"]),
        (format!("{EVALUATE} --csv field.oct"), ["--csv", "FIELD"]),
        (format!("{EVALUATE} --csv cameras.json"), ["--csv", "--cameras"]),
        (format!("{EVALUATE} --plot model.npz"), ["--plot", "MODEL"]),
        (format!("{EVALUATE} --csv x --plot x"), ["--csv", "--plot"]),
        (format!("{EVALUATE} --calibrate field.oct"), ["--calibrate", "FIELD"]),
        (format!("{EVALUATE} --clean-up r_3.png"), ["--clean-up", "an image of --cameras"]),
        (format!("{EVALUATE} --clean-up r_3_depth_0001.png"), ["--clean-up", "--depth"]),
        (TRAIN.replace("cameras.json", "c.safetensors") + " -o c.safetensors", ["--output", "DATASET"]),
        (TRAIN.replace("cameras.json", "c.state") + " -o c.safetensors", ["the state of --output", "DATASET"]),
    ];
    for (args, named) in &own {
        let (code, stderr) = desk.run(args);
        let [output, other] = named;
        assert_eq!(code, Some(2), "{args}: {stderr}");
        // Notes on the cameras may come first.
        let errors: Vec<&str> = stderr.lines().filter(|line| !line.starts_with("note: ")).collect();
        let [error] = errors.as_slice() else { panic!("{args}: {stderr}") };
        assert!(
            error.contains(", the same file as ") && error.starts_with(&format!("error: {output}: ")),
            "{args}: {error}"
        );
        assert!(error.trim_end().ends_with(&format!(" of {other}")), "{args}: {stderr}");
        assert!(desk.contents() == before, "{args} touched a file");
    }
    // A folder for output must be new or empty: no input can be that folder or lie in it.
    for args in ["synth mesh.obj -o mesh.obj", "synth mesh.obj -o .", "demo --output mesh.obj"] {
        assert_eq!(desk.run(args).0, Some(2), "{args}");
        assert!(desk.contents() == before, "{args} touched a file");
    }
}

#[test]
fn what_is_no_file_is_not_replaced_by_one() {
    let desk = Desk::new();
    for ending in writers().iter().map(|(ending, _)| ending) {
        symlink("/dev/null", desk.path(&format!("device.{ending}"))).ok();
        std::fs::create_dir_all(desk.path(&format!("folder.{ending}"))).unwrap();
        let pipe = desk.path(&format!("pipe.{ending}"));
        if !pipe.exists() {
            assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        }
        assert!(pipe.metadata().unwrap().file_type().is_fifo());
    }
    let before = desk.contents();
    for (ending, command) in writers() {
        for (name, found) in [("device", "a device or a pipe"), ("pipe", "a device or a pipe"), ("folder", "a folder")]
        {
            let output = format!("{name}.{ending}");
            let (code, stderr) = desk.run(&format!("{command} {output}"));
            let expected = format!("error: {output}: output path: expected a file, found {found}\n");
            assert_eq!((code, stderr), (Some(2), expected), "{command} {output}");
            assert!(desk.contents() == before, "{command} {output} touched something");
        }
    }
    // Refused even where stdout is a file: the shell has it open, and would continue with the old one.
    let (code, stderr) = desk.run("merge part0.oct part1.oct -o /dev/stdout");
    assert!(code == Some(2) && stderr.contains("/dev/stdout: output path"), "{stderr}");
}

#[test]
fn links_are_followed_and_stay() {
    let desk = Desk::new();
    for (i, (ending, command)) in writers().into_iter().enumerate() {
        let [link, target] = [format!("link{i}.{ending}"), format!("sub/{i}.{ending}")];
        symlink(&target, desk.path(&link)).unwrap();
        desk.good(&format!("{command} {link}"));
        assert!(desk.path(&link).is_symlink() && desk.path(&target).is_file(), "{command} {link}");
        assert!(std::fs::metadata(desk.path(&target)).unwrap().len() > 0, "{command} {link}");
    }
    let cameras = std::fs::read(desk.path("cameras.json")).unwrap();
    desk.good(&format!("{RUN} -o hard"));
    assert_eq!(std::fs::read(desk.path("cameras.json")).unwrap(), cameras, "a hard link is a file of its own");
    symlink("sub/dataset", desk.path("dataset")).unwrap();
    desk.good("synth mesh.obj -o dataset --count 1 --test-count 1 --resolution 8");
    assert!(desk.path("dataset").is_symlink() && desk.path("sub/dataset/transforms_train.json").is_file());
    let left = std::fs::read_dir(desk.path("sub"))
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().ends_with(".part"));
    assert_eq!(left.count(), 0);
}

/// A run that takes days must not learn at its first checkpoint that it cannot save one.
#[test]
fn the_folder_of_a_checkpoint_is_looked_at_before_any_work() {
    let desk = Desk::new();
    let run = RUN.replace("600", "1000000000000");
    for more in ["", "--error-bars 2"] {
        // So many rays would take an age. If any work began, this test would not end.
        let (code, stderr) = desk.run(&format!("{run} -o x.oct --checkpoint no/folder/x.chk {more}"));
        assert!(code == Some(2) && stderr.starts_with("error: no/folder/x.chk"), "{stderr}");
        assert!(stderr.contains("cannot create a file in this folder"), "{stderr}");
    }
    // Side by side, both work.
    desk.good(&format!("{RUN} -o x.oct --checkpoint x.chk"));
    assert!(desk.path("x.oct").exists() && !desk.path("x.chk").exists());
    desk.good(&format!("{RUN} -o x.oct --checkpoint x --error-bars 2"));
    assert!(desk.path("x.oct").exists() && !desk.path("x.0").exists() && !desk.path("x.1").exists());
}

/// A folder of tiles is as many inputs. A field that joins them would make the folder one that nobody can read.
#[test]
fn tiles_of_a_folder_that_is_read_are_inputs_and_stay_among_themselves() {
    let desk = Desk::new();
    let run = RUN.replace(" --keep-sums", " --scale data --noise 0.1");
    for tile in 0..2 {
        desk.good(&format!("{run} --tile {tile}/2 -o tile{tile}.oct"));
    }
    // The folder need not exist.
    desk.good("merge tile0.oct tile1.oct -o new/tiles");
    desk.good("query new/tiles 0,0,0");
    symlink("new/tiles", desk.path("linked")).unwrap();
    let contents = || {
        let paths = std::fs::read_dir(desk.path("new/tiles")).unwrap().map(|entry| entry.unwrap().path());
        paths.map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect::<BTreeMap<_, _>>()
    };
    let before = contents();
    assert_eq!(before.len(), 2);
    let views = "--cameras cameras.json --depth . --depth-encoding 0,6 --views all";
    for (from, to) in [("new/tiles", "new/tiles"), ("linked", "new/tiles"), ("new/tiles", "linked")] {
        let evaluate = format!("evaluate model.npz {from} {views}");
        for (args, is_tile) in [
            (format!("{evaluate} --calibrate {to}/tile-000-of-002.oct"), true),
            (format!("{evaluate} --csv {to}/tile-000-of-002.oct"), true),
            (format!("{evaluate} --plot {to}/tile-001-of-002.oct"), true),
            (format!("{evaluate} --clean-up {to}/tile-001-of-002.oct"), true),
            (format!("export {from} -o {to}/tile-001-of-002.oct"), true),
            (format!("export {from} -o {to}/other.oct"), false),
            (format!("{evaluate} --calibrate {to}/other.oct"), false),
        ] {
            let (code, stderr) = desk.run(&args);
            assert_eq!(code, Some(2), "{args}: {stderr}");
            let expected = if is_tile { "the same file as" } else { "a file in another folder than the tiles" };
            assert!(stderr.contains(expected), "{args}: {stderr}");
            assert!(contents() == before, "{args} touched the tiles");
        }
    }
    // Files that are no fields may lie beside them.
    desk.good("query new/tiles 0,0,0 -o new/tiles/answers.csv");
    desk.good("query new/tiles 0,0,0 -o new/tiles/answers.csv");
    desk.good("export new/tiles -o new/whole.oct");
    let (code, stderr) = desk.run("merge field.oct part0.oct -o joined");
    assert!(code == Some(2) && stderr.contains("joined: file name: expected `.oct`"), "{stderr}");
    assert!(!desk.path("joined").exists());
}

/// The demo replaces results of an earlier one in its folder, and no files of others.
#[test]
fn the_demo_replaces_results_of_a_demo_only() {
    let desk = Desk::new();
    let demo = "demo --scene ball --level 4 --rays 1000 -o";
    std::fs::create_dir(desk.path("set")).unwrap();
    std::fs::copy(desk.path("cameras.json"), desk.path("set/transforms.json")).unwrap();
    let (code, stderr) = desk.run(&format!("{demo} set"));
    assert_eq!(code, Some(2), "{stderr}");
    assert!(
        stderr.contains("set/transforms.json: file in --output: expected nothing, or a folder of an earlier demo"),
        "{stderr}"
    );
    assert_eq!(std::fs::read_dir(desk.path("set")).unwrap().count(), 1);
    desk.good(&format!("{demo} new"));
    std::fs::write(desk.path("new/transforms.json"), "half").unwrap();
    desk.good(&format!("{demo} new"));
    assert!(std::fs::read_to_string(desk.path("new/transforms.json")).unwrap().contains("frames"));
}
