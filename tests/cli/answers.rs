//! Answers of the program in all stated formats, and how it tells of long work. What it says of faulty input is tested
//! row by row of docs/errors.md.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use crate::arrays::npy;
use crate::npz::NpzWriter;
use crate::program::{command, good};
use glam::Vec3;
use octobayes::field::{ClosedForm, VoxelGrid};
use octobayes::geometry::Camera;
use octobayes::uncertainty::UncertaintyField;

/// Shape of a `.npy` file, and its elements as 64-bit floats; by no code of the program.
pub fn read_npy(path: &Path) -> (Vec<u64>, Vec<f64>) {
    let bytes = std::fs::read(path).unwrap();
    let (head, data) = bytes.split_at(10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]])));
    let head = String::from_utf8_lossy(head);
    let shape = head.split_once("'shape': (").unwrap().1.split_once(')').unwrap().0;
    let extents = shape.split(',').filter_map(|extent| extent.trim().parse().ok()).collect();
    (extents, data.chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())).collect())
}

/// A folder with cameras, a small field and its samples.
struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    fn new() -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap() };
        let named: Vec<(String, Camera)> =
            ClosedForm::half_circle(4, [32, 32]).into_iter().enumerate().map(|(i, c)| (format!("r_{i}"), c)).collect();
        octobayes::dataset::write_transforms(&desk.path("transforms.json"), &named).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, content: &[u8]) {
        std::fs::write(self.path(name), content).unwrap();
    }

    fn command(&self, args: &str) -> Command {
        command(self.folder.path(), args)
    }

    fn run(&self, args: &str) -> Output {
        self.command(args).output().unwrap()
    }

    /// Runs the program and returns stdout. Panics on failure.
    fn good(&self, args: &str) -> String {
        good(self.folder.path(), args)
    }

    fn files(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn with_field() -> Self {
        let desk = Self::new();
        desk.good(FIELD);
        desk
    }
}

const FIELD: &str =
    "uncertainty scene:courtyard --cameras transforms.json --level 5 --rays 3000 --occupancy 32 -o field.oct";

#[test]
fn a_field_of_another_box_is_refused() {
    let desk = Desk::with_field();
    desk.good(
        "uncertainty scene:courtyard --cameras transforms.json --level 4 --rays 2000 --occupancy 32 \
         --box=-0.5,-0.5,-0.5,0.5,0.5,0.5 -o small.oct",
    );
    let output = desk.run("compare field.oct small.oct");
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains("same box") && stderr.contains("0.5"), "{stderr}");
    // A model smaller than the field's box.
    let mut npz = NpzWriter::create(&desk.path("tiny.npz"));
    npz.array("box", &[2, 3], [-0.1_f32, -0.1, -0.1, 0.1, 0.1, 0.1]);
    npz.array("density", &[2, 2, 2], [1.0_f32; 8]);
    npz.array("color", &[2, 2, 2, 3], [0.5_f32; 24]);
    npz.finish();
    let output = desk.run("render tiny.npz field.oct --cameras transforms.json -o x.png");
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && stderr.contains("box of the field"), "{stderr}");
}

#[test]
#[cfg(unix)]
fn ctrl_c_leaves_no_file_and_exits_with_130() {
    let desk = Desk::new();
    let before = desk.files();
    let args = "uncertainty scene:courtyard --cameras transforms.json --level 8 --rays 100000000 -o long.oct \
                --dump-samples long.npz";
    let mut child = desk.command(args).stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    // Samples of the first rays are in a file.
    let written = || {
        let new = desk.files().into_iter().filter(|file| !before.contains(file));
        new.filter_map(|file| desk.path(&file).metadata().ok()).any(|file| file.len() > 100_000)
    };
    while !written() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(desk.files(), before);
}

#[test]
fn queries_answer_in_all_formats() {
    let desk = Desk::with_field();
    let field = UncertaintyField::read(&desk.path("field.oct")).unwrap();
    let points = [[0.5_f32, 0.5, -0.1], [0.0, 0.0, 0.9], [3.0, 0.0, 0.0]];
    std::fs::write(desk.path("points.npy"), npy(&[3, 3], points.into_iter().flatten())).unwrap();
    let csv: String = points.iter().map(|p| format!("{},{},{}\n", p[0], p[1], p[2])).collect();
    desk.write("points.csv", format!("x,y,z\n{csv}").as_bytes());

    desk.good("query field.oct points.npy -o out.npy");
    let (shape, answers) = read_npy(&desk.path("out.npy"));
    assert_eq!(shape, [3, 2]);
    for (row, point) in answers.chunks_exact(2).zip(points) {
        let expected = field.query(point.into()).uncertainty;
        assert_eq!((row[0], row[1]), (expected, expected.log10()));
    }
    desk.good("query field.oct points.csv -o out.csv");
    let text = std::fs::read_to_string(desk.path("out.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "x,y,z,uncertainty,log10_uncertainty,level,inside,rays,ray_coverage,seen");
    assert_eq!(lines.len(), 4);
    // Level, whether the point is inside, how many rays support the number, and what was seen. Outside, none can be.
    assert!(lines[1].contains(",5,1,") && !lines[1].ends_with(',') && lines[3].ends_with(",0,0,,0,unseen"), "{text}");
    assert!(lines[1].ends_with(",constrained") && lines[2].ends_with(",free"), "{text}");
    assert!(lines[3].contains(&field.prior().to_string()));

    let mut child =
        desk.command("query field.oct - -o -").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(csv.as_bytes()).unwrap();
    assert_eq!(String::from_utf8(child.wait_with_output().unwrap().stdout).unwrap(), text);
}

/// Whoever has a table with other columns must not get answers for those.
#[test]
fn columns_of_points_are_found_by_name_and_others_are_named() {
    let desk = Desk::with_field();
    desk.write("plain.csv", b"0.5,0.5,-0.1\n0,0,0.9\n");
    desk.write("named.csv", b"\xef\xbb\xbfid,Z,name,Y,X\n1,-0.1,a,0.5,0.5\n2,0.9,b,0,0\n");
    let expected = desk.good("query field.oct plain.csv -o -");
    let output = desk.run("query field.oct named.csv -o -");
    assert_eq!(String::from_utf8(output.stdout).unwrap(), expected);
    let notes = String::from_utf8(output.stderr).unwrap();
    assert!(notes.ends_with("note: columns x, y and z of named.csv are read, others are not: id, name\n"), "{notes}");
    // A field in the paper's scale has no lengths, and one line says so.
    let notes = String::from_utf8(desk.run("query field.oct plain.csv -o -").stderr).unwrap();
    assert!(notes.starts_with("note: U of this field ranks places and is no length") && notes.lines().count() == 1);
}

#[test]
fn arrays_of_any_type_of_numbers_and_files_with_a_byte_order_mark_are_read() {
    let desk = Desk::with_field();
    // All exact in every type.
    let points = [0_i8, 0, 1, 0, 1, 0, 3, 0, 0];
    let halves = points.map(|v| half::f16::from_f32(v.into()));
    std::fs::write(desk.path("f16.npy"), npy(&[3, 3], halves)).unwrap();
    std::fs::write(desk.path("f32.npy"), npy(&[3, 3], points.map(f32::from))).unwrap();
    std::fs::write(desk.path("f64.npy"), npy(&[3, 3], points.map(f64::from))).unwrap();
    std::fs::write(desk.path("i32.npy"), npy(&[3, 3], points.map(i32::from))).unwrap();
    std::fs::write(desk.path("i64.npy"), npy(&[3, 3], points.map(i64::from))).unwrap();
    let answers = |name: &str| desk.good(&format!("query field.oct {name}.npy -o -"));
    for name in ["f16", "f64", "i32", "i64"] {
        assert_eq!(answers(name), answers("f32"), "{name}");
    }

    // Samples and voxels as NumPy makes them if nobody says f32.
    let write = |name: &str, is_wide: bool| {
        let mut npz = NpzWriter::create(&desk.path(name));
        let mut array = |name: &str, shape: &[u64], values: &[f32]| match is_wide {
            true => npz.array(name, shape, values.iter().map(|&v| f64::from(v))),
            false => npz.array(name, shape, values.iter().copied()),
        };
        array("positions", &[2, 3], &[0.25, 0.5, 0.125, -0.25, 0.0, 0.5]);
        array("jacobian", &[2, 3, 3], &[1.5; 18]);
        array("weight", &[2], &[0.5; 2]);
        match is_wide {
            true => npz.array("ray", &[2], [0_i64, 1]),
            false => npz.array("ray", &[2], [0_u32, 1]),
        }
        npz.array("rays_total", &[], [2_i16]);
        npz.finish();
        desk.good(&format!("uncertainty {name} --box=-1,-1,-1,1,1,1 --level 4 -o {name}.oct"));
        UncertaintyField::read(&desk.path(&format!("{name}.oct"))).unwrap()
    };
    let [narrow, wide] = [write("narrow.npz", false), write("wide.npz", true)];
    assert_eq!((narrow.deviations(), narrow.sums()), (wide.deviations(), wide.sums()));
    let mut npz = NpzWriter::create(&desk.path("voxels.npz"));
    npz.array("box", &[2, 3], [-1_i64, -1, -1, 1, 1, 1]);
    npz.array("density", &[2, 2, 2], [1.0_f64; 8]);
    npz.array("color", &[2, 2, 2, 3], [half::f16::from_f32(0.5); 24]);
    npz.finish();
    desk.good("info voxels.npz");

    let cameras = std::fs::read(desk.path("transforms.json")).unwrap();
    desk.write("marked.json", &[b"\xef\xbb\xbf", &cameras[..]].concat());
    desk.good("render scene:courtyard field.oct --cameras marked.json -o x.png");
}

#[test]
fn numbers_and_times_are_taken_as_people_write_them() {
    let desk = Desk::with_field();
    let plain = std::fs::read(desk.path("field.oct")).unwrap();
    let run = |args: &str| FIELD.replace("--rays 3000", args);
    for args in ["--rays 3k", "--rays 3e3", "--rays 3_000"] {
        desk.good(&run(args));
        assert_eq!(std::fs::read(desk.path("field.oct")).unwrap(), plain, "{args}");
    }
    assert!(desk.good("compare field.oct field.oct --points 2k").contains("2000"), "points");
    for args in ["--rays 1.5", "--rays 3k5", "--rays 1m2", "--rays 0", "--rays=-1"] {
        let message = String::from_utf8(desk.run(&run(args)).stderr).unwrap();
        assert!(message.contains("whole number") && message.contains("20k"), "{args}: {message}");
    }
    let message = desk.run("train . -o x.safetensors --time often").stderr;
    assert!(String::from_utf8(message).unwrap().contains("1h30m"));
}

/// Queries of a list longer than memory. The peak is that of the child process.
#[test]
#[cfg(target_os = "linux")]
fn queries_of_long_lists_take_no_more_memory() {
    use std::io::{BufRead, BufReader};
    let desk = Desk::with_field();
    // Whole batches of the program, so that all are answered before the input ends.
    let peak = |points: usize| -> u64 {
        let mut child =
            desk.command("query field.oct - -o -").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut input = child.stdin.take().unwrap();
        let writer = std::thread::spawn(move || {
            let rows: String = (0..1 << 12).map(|i| format!("{},0.5,-0.1\n", f64::from(i) / 4096.0)).collect();
            (0..points >> 12).for_each(|_| input.write_all(rows.as_bytes()).unwrap());
            input
        });
        let mut answers = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        for _ in 0..=points {
            line.clear();
            answers.read_line(&mut line).unwrap();
        }
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap();
        drop(writer.join().unwrap());
        assert!(child.wait().unwrap().success() && line.split(',').count() == 10, "{line}");
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        peak.trim().strip_suffix(" kB").unwrap().parse::<u64>().unwrap() * 1024
    };
    let [short, long] = [1 << 18, 1 << 21].map(peak);
    // Answers in memory would be 88 bytes a point, 160 MB more; the allocator's own slack is a small part of one batch.
    assert!(long < short + (16 << 20), "{long} bytes for 2M points, {short} for 262k");
}

#[test]
fn error_bars_are_told_wherever_a_field_is() {
    let desk = Desk::new();
    let run = "uncertainty scene:courtyard --cameras transforms.json --level 5 --occupancy 32 --keep-sums";
    let out = desk.good(&format!("{run} --rays 6000 --error-bars -o bars.oct"));
    assert!(out.contains("median: 8 groups, known at "), "{out}");
    assert!(desk.good("info bars.oct").contains("median: 8 groups, known at "));
    let value: serde_json::Value = serde_json::from_str(&desk.good("info bars.oct --json")).unwrap();
    let bars = &value["errors"]["rays"];
    assert_eq!((&bars["from"], &value["errors"]["coarse_leaves"]), (&"groups".into(), &0.01.into()));
    assert!(
        bars["groups"] == 8 && bars["known"].as_u64() > Some(1000) && bars["moved"].as_u64() >= bars["known"].as_u64()
    );
    assert!(
        bars["root_mean_square"].as_f64() > bars["median"].as_f64() && value["memory"]["error bars"].as_u64() > Some(0)
    );

    // Points where rays are plenty, where no ray came, and outside.
    let points = [[0.5_f32, 0.5, -0.1], [0.0, 0.0, 0.9], [3.0, 0.0, 0.0]];
    std::fs::write(desk.path("points.npy"), npy(&[3, 3], points.into_iter().flatten())).unwrap();
    desk.good("query bars.oct points.npy -o out.npy");
    let (shape, answers) = read_npy(&desk.path("out.npy"));
    assert_eq!(shape, [3, 3]);
    assert!(answers[2] > 0.0 && answers[2] < 1.0 && answers[5].is_nan() && answers[8].is_nan());
    desk.good("query bars.oct points.npy -o out.csv");
    let text = std::fs::read_to_string(desk.path("out.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "x,y,z,uncertainty,log10_uncertainty,level,inside,rays,ray_coverage,seen,log10_error");
    assert!(lines[1].ends_with(&format!(",{}", answers[2])) && lines[2].ends_with(','), "{text}");
    // Leaving the sums out leaves the errors alone. Another scalar has none.
    desk.good("export bars.oct -o bare.oct");
    desk.good("query bare.oct points.npy -o bare.npy");
    assert_eq!(std::fs::read(desk.path("bare.npy")).unwrap(), std::fs::read(desk.path("out.npy")).unwrap());
    let output = desk.run("query bars.oct points.npy -o block.npy --covariance block");
    assert!(String::from_utf8(output.stderr).unwrap().contains("error bars are not those of `block`"));
    assert_eq!(read_npy(&desk.path("block.npy")).0, [3, 2]);

    // Fields of several seeds are groups, too.
    for seed in 1..=4 {
        desk.good(&format!("{run} --rays 1500 --seed {seed} --error-bars 2 -o part{seed}.oct"));
    }
    let parts = "part1.oct part2.oct part3.oct part4.oct";
    let output = desk.run(&format!("merge {parts} -o plain.oct"));
    assert!(output.status.success() && String::from_utf8(output.stderr).unwrap().contains("--error-bars compares"));
    assert_eq!(UncertaintyField::read(&desk.path("plain.oct")).unwrap().error_bars(), None);
    desk.good(&format!("merge {parts} -o merged.oct --error-bars"));
    let [one, merged] =
        ["bars.oct", "merged.oct"].map(|f| UncertaintyField::read(&desk.path(f)).unwrap().error_summary().unwrap());
    // With as many rays the errors are the same, but for chance and the smaller number of groups.
    let ratio = merged.root_mean_square / one.root_mean_square;
    assert!(merged.groups == 4 && (0.75..1.33).contains(&ratio), "{merged:?} {one:?}");

    for (args, named) in [
        ("--target-error 0.1 --error-bars", "cannot be used with"),
        ("--error-bars --shard 0/2", "cannot be used with"),
        ("--error-bars --memory 1GiB", "cannot be used with"),
        ("--error-bars --dump-samples x.npz", "cannot be used with"),
        ("--error-bars 1", "from 2 to 64"),
    ] {
        let output = desk.run(&format!("{run} -o x.oct {args}"));
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && message.contains(named), "{args}: {message}");
    }
}

/// An early version gave seeds 0 to 7 the same eight groups. Two such runs merged into twice the rays without a
/// word.
#[test]
fn error_bars_of_different_seeds_are_of_different_rays() {
    let desk = Desk::new();
    let run = "uncertainty scene:courtyard --cameras transforms.json --level 4 --occupancy 32 --rays 3000 --keep-sums";
    let read = |name: &str| UncertaintyField::read(&desk.path(name)).unwrap();
    for seed in [0, 3] {
        desk.good(&format!("{run} --error-bars --seed {seed} -o bars{seed}.oct"));
        desk.good(&format!("{run} --seed {seed} -o plain{seed}.oct"));
    }
    let [zero, three] = ["bars0.oct", "bars3.oct"].map(read);
    assert_eq!((zero.ray_sets().len(), three.ray_sets().len()), (8, 8));
    assert!(zero.deviations() != three.deviations(), "the same rays");

    desk.good("merge bars0.oct bars3.oct -o both.oct --error-bars --keep-sums");
    let both = read("both.oct");
    assert_eq!((both.record().rays, both.ray_sets().len()), (6000, 16));
    // Twice the rays give 1/√2 of the error, within a factor of 3 because two groups are few. The same rays would
    // give 0.
    let [one, two] = [&zero, &both].map(|field| field.error_summary().unwrap().root_mean_square);
    assert!((0.3 / 2_f64.sqrt()..3.0 / 2_f64.sqrt()).contains(&(two / one)), "{one} of one, {two} of both");

    // Fields that share rays are distinguished from fields that do not, whatever the base seeds are.
    let refused = |parts: &str| {
        let output = desk.run(&format!("merge {parts} -o x.oct"));
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && message.contains("rays in common"), "{parts}: {message}");
        assert!(!desk.path("x.oct").exists());
    };
    refused("both.oct bars3.oct");
    refused("bars0.oct plain3.oct both.oct");
    let group = zero.ray_sets()[5].seed;
    desk.good(&format!("{run} --seed {group} -o group.oct"));
    refused("bars0.oct group.oct");
    desk.good("merge bars3.oct group.oct -o x.oct");
    desk.good("merge bars0.oct plain0.oct plain3.oct -o x.oct");
    assert_eq!(read("x.oct").ray_sets().len(), 10);
}

#[test]
fn json_is_one_object_and_states_the_protocol() {
    let desk = Desk::new();
    let out = desk.good(&format!("{FIELD} --json --seed 3"));
    let value: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((value["record"]["rays"].as_u64(), value["record"]["seed"].as_u64()), (Some(3000), Some(3)));
    for key in ["lambda", "covariance", "tolerance", "march_step", "difference_step", "cutoff", "background"] {
        assert!(!value["record"][key].is_null(), "{key}: {out}");
    }
    assert!(value["threads"].as_u64() > Some(0) && value["level"] == 5);
    for args in ["info field.oct --json", "compare field.oct field.oct --points 1000 --json", "info scene:ball --json"]
    {
        serde_json::from_str::<serde_json::Value>(&desk.good(args)).unwrap();
    }
    let value: serde_json::Value =
        serde_json::from_str(&desk.good("compare field.oct field.oct --points 1000 --json")).unwrap();
    assert_eq!(value["in_box"]["max"], 0.0);
    assert!(value["on_surfaces"]["points"].as_u64() > Some(100));
}

#[test]
fn pictures_and_official_grids_are_written() {
    let desk = Desk::with_field();
    desk.good("render scene:courtyard field.oct --cameras transforms.json --frame 1 -o view.png --threshold 3.5");
    desk.good("render scene:courtyard field.oct --cameras transforms.json --frame 1 -o view.exr");
    let image = image::open(desk.path("view.png")).unwrap();
    assert!(image.width() > 3 * 32 && image.height() > 2 * 32);
    let exr = exr::prelude::read_first_flat_layer_from_file(desk.path("view.exr")).unwrap();
    let names: Vec<String> = exr.layer_data.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["A", "B", "G", "R", "depth.Z", "log10_uncertainty.U", "uncertainty.U"]);

    // The ball stays away from the box's faces, where the official index order makes vertices share entries.
    desk.good(
        "uncertainty scene:ball --cameras transforms.json --level 5 --rays 3000 --occupancy 32 --keep-sums -o ball.oct",
    );
    desk.good("export ball.oct -o unc.npy");
    assert_eq!(read_npy(&desk.path("unc.npy")).0, [33 * 33 * 33]);
    desk.good("export unc.npy -o unc.oct --box=-1,-1,-1,1,1,1 --rays 3000");
    let out = desk.good("compare ball.oct unc.oct --covariance trace --points 20000 --json");
    let value: serde_json::Value = serde_json::from_str(&out).unwrap();
    for place in ["in_box", "on_surfaces"] {
        let max = value[place]["max"].as_f64().unwrap();
        // Sums pass through f32. Hanging corners of coarse leaves stay within the tolerance.
        assert!(max <= 0.01, "{place}: {out}");
    }
}

/// The preview is as wide as the picture would be, in 800 pixels; and nothing is squashed.
#[test]
fn pictures_are_previews_with_the_cameras_aspect_ratio_unless_told_otherwise() {
    let desk = Desk::with_field();
    let camera = ClosedForm::half_circle(1, [10, 1600])[0];
    octobayes::dataset::write_transforms(&desk.path("portrait.json"), &[("a".into(), camera)]).unwrap();
    let size = |args: &str| {
        let run = "render scene:courtyard field.oct --cameras portrait.json -o x.exr";
        let output = desk.run(&format!("{run} {args}"));
        assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
        let exr = exr::prelude::read_first_flat_layer_from_file(desk.path("x.exr")).unwrap();
        ([exr.layer_data.size.0, exr.layer_data.size.1], String::from_utf8(output.stderr).unwrap())
    };
    let (preview, note) = size("");
    assert_eq!(preview, [5, 800]);
    assert_eq!(note, "note: a preview of 5 x 800 pixels; --resize 1 renders all 10 x 1600\n");
    for (args, expected) in [
        ("--resize 1", [10, 1600]),
        ("--resize 0.1", [1, 160]),
        ("--scale 0.1", [1, 160]),
        ("--resolution 2", [2, 320]),
        ("--resolution 3x4", [3, 4]),
    ] {
        assert_eq!(size(args), (expected, String::new()), "{args}");
    }
    // Small pictures are left as they are.
    desk.good("render scene:courtyard field.oct --cameras transforms.json -o y.exr");
    let exr = exr::prelude::read_first_flat_layer_from_file(desk.path("y.exr")).unwrap();
    assert_eq!((exr.layer_data.size.0, exr.layer_data.size.1), (32, 32));
    let refused =
        desk.run("render scene:courtyard field.oct --cameras portrait.json --resize 1 --resolution 9 -o x.exr");
    assert_eq!(refused.status.code(), Some(2));
}

/// A log file of a long run says how far it is; one of a short run holds nothing.
#[test]
#[cfg(unix)]
#[ignore = "slow: whole runs as processes"]
fn long_work_tells_off_a_terminal_how_far_it_is() {
    use std::io::{BufRead, BufReader};
    let desk = Desk::with_field();
    let is_progress =
        |line: &str| line.starts_with("rays: ") && line.contains(" %), about ") && line.contains(" s left");
    let short = desk.run(FIELD);
    assert!(!String::from_utf8(short.stderr).unwrap().lines().any(is_progress));
    let started = std::time::Instant::now();
    let mut child =
        desk.command(&format!("{} --threads 1", FIELD.replace("3000", "1G"))).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let line = lines.by_ref().map(Result::unwrap).find(|line| is_progress(line));
    assert!(line.is_some() && started.elapsed().as_secs() >= 10, "{line:?} after {:?}", started.elapsed());
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(lines.last().unwrap().unwrap().starts_with("error: interrupted"));
}

#[test]
fn shells_and_man_know_every_verb() {
    let desk = Desk::new();
    let help = desk.good("--help");
    let verbs: Vec<&str> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty())
        // Lines of longer descriptions are further indented.
        .filter_map(|line| line.strip_prefix("  ")?.split_once(' ').map(|(verb, _)| verb))
        .filter(|verb| !verb.is_empty())
        .filter(|verb| *verb != "help")
        .collect();
    assert!(verbs.len() == 13 && !verbs.contains(&"completions"), "{verbs:?}");
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = desk.good(&format!("completions {shell}"));
        for verb in &verbs {
            assert!(script.contains(verb), "{shell}: {verb}");
        }
        assert!(script.contains("--dump-samples") || script.contains("dump-samples"), "{shell}");
    }
    desk.good("completions man -o share/man1");
    for verb in &verbs {
        let page = std::fs::read_to_string(desk.path(&format!("share/man1/octobayes-{verb}.1"))).unwrap();
        assert!(page.contains(&format!(".TH octobayes-{verb} 1")) && page.contains(".SH SYNOPSIS"), "{page}");
    }
    assert!(std::fs::read_to_string(desk.path("share/man1/octobayes.1")).unwrap().contains("octobayes\\-query(1)"));
    for args in ["completions", "completions csh", "completions man", "completions bash -o x"] {
        assert_eq!(desk.run(args).status.code(), Some(2), "{args}");
    }
}

#[test]
fn derivatives_and_the_number_of_rays_can_be_chosen() {
    let desk = Desk::new();
    VoxelGrid::bake(&ClosedForm::ball(), [25; 3], Vec3::Z).write(&desk.path("ball.npz")).unwrap();
    let base = "uncertainty ball.npz --cameras transforms.json --level 4 --cutoff 1e-6 -o a.oct";
    // Differences over a step that is small beside a voxel are the slope itself. Both fields agree, and say how
    // they were made.
    let exact = desk.good(&format!("{base} --rays 4000 --gradient auto"));
    assert!(exact.contains("the field's own derivatives"), "{exact}");
    std::fs::rename(desk.path("a.oct"), desk.path("exact.oct")).unwrap();
    let differences = desk.good(&format!("{base} --rays 4000"));
    assert!(differences.contains("difference   central"), "{differences}");
    let [a, b] = ["a.oct", "exact.oct"].map(|name| UncertaintyField::read(&desk.path(name)).unwrap());
    let found = octobayes::uncertainty::compare(&a, &b, 20_000, 0).unwrap().in_box.unwrap();
    // The bits differ, but kinks of the voxels rarely lie between the two sides of a difference.
    assert!(found.max > 0.0 && found.mean < 0.01, "{found:?}");

    let output = desk.run("uncertainty scene:ball --gradient analytic --rays 10 -o x.oct");
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && message.contains("differentiates itself"), "{message}");

    let output = desk.run(&format!("{base} --rays 200000 --target-error 0.3 --audit"));
    let [said, message] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(output.status.success() && !message.contains("--rays"), "{message}");
    for row in ["at most 1.0e-2, certain", "two halves, ", "samples left out", "finite differences", "difference step"]
    {
        assert!(said.contains(row), "{row}: {said}");
    }
    let rays = UncertaintyField::read(&desk.path("a.oct")).unwrap().record().rays;
    assert!(rays < 200_000 && rays.is_power_of_two(), "{rays}");
    let output = desk.run(&format!("{base} --rays 2000 --target-error 1e-9"));
    assert!(String::from_utf8(output.stderr).unwrap().contains("do not bring the mean error within 1e-9 decades"));
    for args in
        ["--rays 0", "--rays some", "--rays auto", "--target-error 1 --shard 0/2", "--target-error 1 --memory 1GiB"]
    {
        assert_eq!(desk.run(&format!("{base} {args}")).status.code(), Some(2), "{args}");
    }
}
