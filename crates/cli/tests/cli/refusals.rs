//! The program refuses input that would give a wrong result without a sign: exit code 2, one line with the place, what
//! it expected and what it found, nothing on stdout, no file left or changed. Readers have tests of their own.

use octobayes::geometry::opencv;
use octobayes_data::write_transforms;

use crate::arrays::npy;
use crate::npz::NpzWriter;
use crate::program::{Desk, cameras};

const RUN: &str = "uncertainty scene:ball --cameras cameras.json --level 4 --rays 600 --occupancy 16";
const EVALUATE: &str = "evaluate scene:ball field.oct --cameras cameras.json --depth . --depth-encoding=0,1";
const CUBE: &str = "--box=-1,-1,-1,1,1,1";

/// Checks rows of arguments and the words that the message has.
fn all_refused(desk: &Desk, rows: &[(&str, &[&str])]) {
    rows.iter().for_each(|(args, words)| drop(desk.refused(args, words)));
}

/// A folder with fields of several runs, cameras and pictures.
fn with_fields() -> Desk {
    let desk = Desk::new(2, 16);
    desk.write("points.csv", "0,0,0\n");
    desk.good(&format!("{RUN} -o field.oct"));
    (0..2).for_each(|i| image::RgbaImage::new(16, 16).save(desk.join(format!("r_{i}.png"))).unwrap());
    desk
}

#[test]
fn files_of_fields_that_cannot_be_trusted() {
    let desk = with_fields();
    let bytes = desk.bytes("field.oct");
    let mut altered = bytes.clone();
    altered[bytes.len() - 9] ^= 1;
    desk.write("altered.oct", altered);
    desk.write("short.oct", &bytes[..bytes.len() - 1]);
    desk.write("newer.oct", [&bytes[..8], &99_u32.to_le_bytes(), &bytes[12..]].concat());
    desk.write("good.npz", "");
    desk.write("official.npy", npy(&[27], [-1.0_f32; 27]));
    desk.write("count.npy", npy(&[28], [1.0_f32; 28]));
    all_refused(
        &desk,
        &[
            ("query altered.oct points.csv -o x.csv", &["altered.oct: ", "checksum", "altered data"]),
            ("query short.oct points.csv -o x.csv", &["short.oct: length: expected ", ", found "]),
            ("info newer.oct", &["newer.oct: ", "version 1", "version 99"]),
            ("query good.npz points.csv -o x.csv", &["FIELD: expected ", "good.npz"]),
            ("render field.oct scene:ball --cameras cameras.json -o x.png", &["FIELD", "scene:ball"]),
            ("query field.oct points.csv -o x.csv --covariance block", &["--keep-sums", "block", "diagonal"]),
            ("export official.npy -o x.oct", &["--box", "official.npy"]),
            (&format!("export official.npy -o x.oct {CUBE}"), &["official.npy: ", "element 0", "found -1"]),
            (&format!("export count.npy -o x.oct {CUBE}"), &["count.npy: ", "found 28"]),
        ],
    );
}

#[test]
fn fields_that_do_not_belong_to_each_other_or_to_the_model() {
    let desk = with_fields();
    for (more, name) in [
        ("--error-bars 4", "bars"),
        ("--resolution 8 --seed 1", "resized"),
        ("--seed 1", "seed1"),
        ("--shard 0/2", "part0"),
        ("--shard 1/2", "part1"),
        ("--lambda 1e-3 --seed 2 --keep-sums", "prior"),
        ("--keep-sums", "sums"),
    ] {
        let run = if more.starts_with("--shard") { RUN.replace("600", "1200") } else { RUN.into() };
        desk.good(&format!("{run} {more} -o {name}.oct"));
    }
    let small = "--box=-0.5,-0.5,-0.5,0.5,0.5,0.5";
    desk.good(&format!("{RUN} {small} -o small.oct"));
    let mut npz = NpzWriter::create(&desk.join("tiny.npz"));
    npz.array("box", &[2, 3], [-0.1_f32, -0.1, -0.1, 0.1, 0.1, 0.1]);
    npz.array("density", &[2, 2, 2], [1.0_f32; 8]);
    npz.array("color", &[2, 2, 2, 3], [0.5_f32; 24]);
    npz.finish();
    let checksum: &[&str] = &["model of field.oct", "checksum", "scene:courtyard", "--force"];
    all_refused(
        &desk,
        &[
            ("merge sums.oct sums.oct -o x.oct", &["sums.oct and sums.oct", "rays in common"]),
            ("merge bars.oct bars.oct -o x.oct", &["bars.oct and bars.oct", "rays in common"]),
            ("merge field.oct resized.oct -o x.oct", &["model and cameras of resized.oct", "expected"]),
            ("merge sums.oct prior.oct -o x.oct", &["lambda of prior.oct", "expected"]),
            ("merge field.oct seed1.oct -o x.oct", &["--keep-sums", "field.oct"]),
            ("merge part0.oct part1.oct -o x.oct --error-bars", &["different seeds", "part0.oct and part1.oct"]),
            ("merge part0.oct none.oct -o x.oct", &["none.oct: cannot open"]),
            ("compare field.oct small.oct", &["same box", "0.5"]),
            ("render scene:courtyard field.oct --cameras cameras.json -o x.png", checksum),
            (&EVALUATE.replace("scene:ball", "scene:courtyard"), checksum),
            ("render tiny.npz field.oct --cameras cameras.json -o x.png", &["box of the field"]),
            (&format!("{EVALUATE} --ensemble scene:ball scene:city"), &["box of the member `scene:city`", "[1, 1, 1]"]),
        ],
    );
    // The cameras that the field was computed with are in no file beside these.
    std::fs::rename(desk.join("cameras.json"), desk.join("moved.json")).unwrap();
    write_transforms(&desk.join("half.json"), &cameras(1, [16; 2])).unwrap();
    let evaluate = EVALUATE.replace("cameras.json", "half.json");
    desk.refused(&format!("{evaluate} --training-depth ."), &["--training-depth", "training cameras"]);
}

#[test]
fn points_in_another_shape() {
    let desk = with_fields();
    desk.write("pairs.npy", npy(&[2, 2], [0.0_f32; 4]));
    desk.write("nan.npy", npy(&[1, 3], [0.0, f32::NAN, 0.0]));
    let fortran = String::from_utf8(npy(&[1, 3], [0_i32; 3])[10..].to_vec()).unwrap().replacen("False", "True", 1);
    let length = (fortran.len() - 12) as u16;
    desk.write("fortran.npy", [&b"\x93NUMPY\x01\x00"[..], &length.to_le_bytes(), fortran.as_bytes()].concat());
    desk.write("ragged.csv", "x,y,z\n1,2,3\n1,2,3,4\n");
    desk.write("four.csv", "7,0,0,0\n");
    all_refused(
        &desk,
        &[
            ("query field.oct pairs.npy -o x.csv", &["pairs.npy: ", "[any, 3]", "[2, 2]"]),
            ("query field.oct nan.npy -o x.csv", &["nan.npy: ", "row 0, column 1", "NaN"]),
            ("query field.oct fortran.npy -o x.csv", &["fortran.npy: ", "C order", "Fortran order"]),
            ("query field.oct ragged.csv -o x.csv", &["ragged.csv: row 3", "3 columns", "1,2,3,4"]),
            ("query field.oct four.csv -o x.csv", &["four.csv: row 1", "4 columns"]),
            ("query field.oct 0.75 -0.5 -0.35 -o x.csv", &["POINTS", "0.75"]),
        ],
    );
}

#[test]
fn models_with_impossible_values() {
    let desk = Desk::new(2, 16);
    let voxels = |name: &str, density: (&[u64], f32), color: f32, corners: [f64; 2]| {
        let mut npz = NpzWriter::create(&desk.join(name));
        npz.array("box", &[2, 3], corners.map(|v| [v; 3]).concat());
        npz.array("density", density.0, (0..density.0.iter().product::<u64>()).map(|_| density.1));
        npz.array("color", &[2, 2, 2, 3], [color; 24]);
        npz.finish();
    };
    let grid: &[u64] = &[2, 2, 2];
    voxels("good.npz", (grid, 1.0), 0.5, [-1.0, 1.0]);
    voxels("nan.npz", (grid, f32::NAN), 0.5, [-1.0, 1.0]);
    voxels("negative.npz", (grid, -1.0), 0.5, [-1.0, 1.0]);
    voxels("bright.npz", (grid, 1.0), 255.0, [-1.0, 1.0]);
    voxels("other.npz", (&[2, 2, 3], 1.0), 0.5, [-1.0, 1.0]);
    voxels("inside_out.npz", (grid, 1.0), 0.5, [1.0, -1.0]);
    // Where f32 numbers are a sixteenth apart.
    voxels("far.npz", (grid, 1.0), 0.5, [1e6 - 1.0, 1e6 + 1.0]);
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float trbf_center\nend_header\n";
    desk.write("moving.ply", header);
    let far = "uncertainty far.npz --cameras cameras.json --rays 600 -o x.oct --level";
    all_refused(
        &desk,
        &[
            ("info nan.npz", &["nan.npz: array `density`, element 0", "NaN"]),
            ("info negative.npz", &["negative.npz: array `density`, element 0", "found -1"]),
            ("info bright.npz", &["bright.npz: array `color`, element 0", "0 to 1", "255"]),
            ("info other.npz", &["other.npz: array `color`", "[2, 2, 3, 3]", "[2, 2, 2, 3]"]),
            ("info inside_out.npz", &["inside_out.npz: array `box`", "min < max", "-1.0"]),
            ("info moving.ply", &["moving.ply: header", "`trbf_center`"]),
            ("uncertainty good.npz -o x.oct", &["--cameras", "brings no cameras", "good.npz"]),
            (&format!("{far} 5"), &["finite-difference step", "nearer to the origin"]),
            (&format!("{far} 8 --gradient analytic"), &["finest level", "nearer to the origin"]),
        ],
    );
}

#[test]
fn cameras_of_something_else() {
    let desk = with_fields();
    let turned: Vec<_> = cameras(2, [16; 2]).into_iter().map(|(name, camera)| (name, opencv(&camera))).collect();
    write_transforms(&desk.join("opencv.json"), &turned).unwrap();
    let half = cameras(1, [16; 2])[0].1;
    let frame = |keys: &str| {
        let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]]";
        format!(r#"{{{keys}, "frames": [{{"file_path": "a", "transform_matrix": {pose}}}]}}"#)
    };
    desk.write("degrees.json", frame(r#""camera_angle_x": 40"#));
    desk.write("unused.json", frame(r#""fl_x": 20, "w": 16, "h": 16, "n_frames": 0"#));
    desk.write("unsized.json", frame(r#""fl_x": 20"#));
    desk.write("unscaled.json", desk.text("cameras.json").replacen('{', "{\"scale\": 0, ", 1));
    for (model, images) in [("0", 1), ("1", 2)] {
        std::fs::create_dir_all(desk.join(format!("project/sparse/{model}"))).unwrap();
        desk.write(&format!("project/sparse/{model}/cameras.txt"), "1 PINHOLE 16 16 20 20 8 8\n");
        let image = |i| format!("{i} 1 0 0 0 0 0 3 1 {i}.png\n\n");
        desk.write(&format!("project/sparse/{model}/images.txt"), (0..images).map(image).collect::<String>());
    }
    // A photograph that a telephone has stored lying, with the orientation in its EXIF.
    write_transforms(&desk.join("exif.json"), &[("exif.jpg".into(), half.resized([16, 24]))]).unwrap();
    image::RgbImage::new(24, 16).save(desk.join("exif.jpg")).unwrap();
    let mut picture = desk.bytes("exif.jpg");
    let exif = b"\xff\xe1\x00\x22Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
    picture.splice(2..2, *exif);
    desk.write("exif.jpg", picture);
    let run = |cameras: &str| RUN.replace("cameras.json", cameras) + " -o x.oct";
    all_refused(
        &desk,
        &[
            (&run("opencv.json"), &["cameras: expected ", "OpenCV's camera axes", "look away"]),
            (&format!("{RUN} --box=5,5,5,6,6,6 -o x.oct"), &["cameras: expected ", "domain"]),
            (&run("degrees.json"), &["degrees.json: frame 0", "radians", "40"]),
            (&run("unused.json"), &["unused.json: frames", "none of 1"]),
            (&run("unsized.json"), &["unsized.json: frame 0", "`w` and `h`", "a.png"]),
            (&run("project"), &["project: cameras", "sparse/0", "sparse/1", "2 images"]),
            (&run("."), &[".: cameras", "transforms.json"]),
            ("train unscaled.json -o x.safetensors --steps 1", &["unscaled.json: `scale`", "found 0"]),
            ("train exif.json -o x.safetensors --steps 1", &["exif.jpg: image", "16 x 24", "24 x 16", "EXIF"]),
            ("render scene:ball field.oct --cameras cameras.json --frame 99 -o x.png", &["frame 99", "from 0 to 1"]),
            (&format!("{EVALUATE} --depth-pattern {{}}.png"), &["depth maps", "0 pixels of 2 views"]),
            (&format!("{EVALUATE} --depth-pattern {{}}_no.png"), &["r_0_no.png: cannot open"]),
        ],
    );
}

#[test]
fn samples_that_no_rays_gave() {
    let desk = Desk::empty();
    let write = |name: &str, ray: [u64; 2], jacobian: f32, total: i64| {
        let mut npz = NpzWriter::create(&desk.join(name));
        npz.array("positions", &[2, 3], [0.1_f32; 6]);
        npz.array("jacobian", &[2, 3, 3], [jacobian; 18]);
        npz.array("ray", &[2], ray);
        npz.array("rays_total", &[], [total]);
        npz.finish();
    };
    write("good.npz", [0, 1], 1.0, 10);
    write("decreasing.npz", [5, 4], 1.0, 10);
    write("beyond.npz", [4, 50], 1.0, 10);
    write("nan.npz", [4, 5], f32::NAN, 10);
    write("none.npz", [0, 0], 1.0, 0);
    let mut flat = NpzWriter::create(&desk.join("flat.npz"));
    flat.array("positions", &[2, 3], [0.1_f32; 6]);
    flat.array("jacobian", &[2, 9], [1.0_f32; 18]);
    flat.finish();
    let run = |name: &str| format!("uncertainty {name}.npz {CUBE} -o x.oct");
    all_refused(
        &desk,
        &[
            (&run("decreasing"), &["decreasing.npz: array `ray`, element 1", "non-decreasing", "found 4"]),
            (&run("beyond"), &["beyond.npz: array `ray`, element 1", "10", "found 50"]),
            (&run("nan"), &["nan.npz: array `jacobian`, sample 0", "NaN"]),
            (&run("none"), &["none.npz: array `rays_total`", "above 0"]),
            (&run("flat"), &["flat.npz: array `jacobian`", "[2, 3, 3]", "[2, 9]"]),
            ("uncertainty good.npz --box=1,1,1,2,2,2 -o x.oct", &["good.npz: array `positions`", "0 of 2"]),
            (&format!("{} --rays 5", run("good")), &["--rays", "samples in good.npz"]),
        ],
    );
}

/// An option that changes nothing would pass for one that was obeyed.
#[test]
fn options_without_effect_or_without_what_they_need() {
    let desk = with_fields();
    desk.write("text.chk", "this is no checkpoint of a run, but more than twenty bytes");
    let render = "render scene:ball field.oct --cameras cameras.json";
    let depth = EVALUATE.split(" --depth ").next().unwrap();
    let splats = format!("{RUN} --for splats -o x.oct");
    all_refused(
        &desk,
        &[
            (&format!("export field.oct -o x.npz {CUBE}"), &["--box", "field.oct"]),
            ("export field.oct -o x.oct --rays 5M", &["--rays", "field.oct"]),
            ("export scene:ball field.oct -o x.npz", &["MODEL", "x.npz"]),
            ("export field.oct --pixels 400k -o x.npz", &["--pixels", "x.npz"]),
            ("export field.oct -o x.ply", &["MODEL", "surfaces"]),
            ("export scene:ball field.oct --mesh --cameras cameras.json -o x.ply", &["--cameras", "--mesh"]),
            ("export scene:ball field.oct --cameras cameras.json --ellipsoids -o x.ply", &["--keep-sums", "diagonal"]),
            (&format!("{render} --range=-3,6 -o x.exr"), &["--range", "x.exr"]),
            (&format!("{depth} --depth-pattern {{}}.exr"), &["--depth-pattern", "--depth"]),
            (&format!("{depth} --clean-up x.png --ray-average u-spread"), &["--ray-average", "--clean-up"]),
            (depth, &["--depth: expected ", "cameras.json"]),
            (&format!("{RUN} --grid dense --refine density -o x.oct"), &["--refine", "dense"]),
            (&format!("{} --pooling auto -o x.oct", RUN.replace("600", "all")), &["--pooling", "every pixel"]),
            (&format!("{RUN} --scale data -o x.oct"), &["--noise", "neither"]),
            (&format!("{RUN} --scale data --noise 0.7 -o x.oct"), &["--noise", "0.5"]),
            (&format!("{RUN} --noise 0.0316 -o x.oct"), &["--noise", "--scale data", "paper"]),
            (&splats, &["--for splats", "another model"]),
            (&format!("{RUN} --checkpoint text.chk --restart -o x.oct"), &["text.chk: start", "other bytes"]),
            (&format!("{RUN} -o x.npy"), &["x.npy: file name", "`.oct`"]),
        ],
    );
}
