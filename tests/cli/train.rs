//! `train` as scripts see it: a data set in, a model out that the other verbs read. Interrupted runs can be
//! resumed.

#[cfg(unix)]
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

#[cfg(unix)]
use crate::interrupt::send;
use crate::program::command;
use glam::{DVec3, Vec3};
use octobayes::dataset::write_transforms;
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, HashGrid, RadianceField};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::render_view;
use octobayes::splats::Splats;
use serde_json::Value;

/// A folder with images of the courtyard, on a black background: 12 for training and 3 held out.
struct Desk {
    folder: tempfile::TempDir,
}

const SMALL: &str = "--background black --box=-1,-1,-1,1,1,1 --log2-hashmap-size 12 --samples-per-step 4096";

impl Desk {
    fn new() -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap() };
        let scene = ClosedForm::courtyard();
        let settings = RaySettings::default().occupancy(32).cutoff(1e-4).background(Vec3::ZERO);
        let tracer = settings.tracer(&scene, 0.0, &Silent).unwrap();
        let (mut train, mut test) = (Vec::new(), Vec::new());
        for (i, camera) in ClosedForm::half_circle(15, [40; 2]).into_iter().enumerate() {
            let view = render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap();
            let byte = |v: f64| (255.0 * v).round() as u8;
            let pixel = |x: u32, y: u32| -> DVec3 { view.pixels[(y * 40 + x) as usize].color };
            let image = image::RgbImage::from_fn(40, 40, |x, y| image::Rgb(pixel(x, y).to_array().map(byte)));
            let name = format!("r_{i}");
            image.save(desk.path(&format!("{name}.png"))).unwrap();
            if i % 5 == 2 { test.push((name, camera)) } else { train.push((name, camera)) }
        }
        // A frame whose image is missing, as in instant-ngp's fox.
        let missing: (String, Camera) = ("gone".into(), train[0].1);
        train.push(missing);
        write_transforms(&desk.path("transforms_train.json"), &train).unwrap();
        write_transforms(&desk.path("transforms_test.json"), &test).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, args: &str) -> Command {
        let mut command = command(self.folder.path(), args);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn run(&self, args: &str) -> Output {
        self.command(args).output().unwrap()
    }

    /// Runs the program and returns stdout and stderr. Panics on failure.
    fn good(&self, args: &str) -> [String; 2] {
        let output = self.run(args);
        let [stdout, stderr] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert!(output.status.success(), "{args}: {stderr}");
        [stdout, stderr]
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap()
    }
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_model_is_trained_and_the_other_verbs_read_it() {
    let desk = Desk::new();
    let [stdout, stderr] = desk.good(&format!("train . -o a.safetensors --steps 150 {SMALL} --json"));
    let left_out = "12 cameras of 13 frames of ./transforms_train.json: 1 has no image (./gone.png)";
    assert!(stderr.contains(left_out), "{stderr}");
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let model = &report["models"][0];
    assert_eq!((&model["images"], &model["steps"], &model["seed"]), (&12.into(), &150.into(), &0.into()));
    assert_eq!((&model["held_out"]["views"], &model["held_out"]["pixels"]), (&3.into(), &4800.into()));
    // Black images have about 11 dB here; 19.1 was measured.
    let psnr = model["held_out"]["psnr"].as_f64().unwrap();
    assert!(psnr > 17.0, "{psnr}");

    let field = HashGrid::read(&desk.path("a.safetensors")).unwrap();
    assert_eq!(field.training()["images"], 12);
    assert_eq!(field.bounds().size(), DVec3::splat(2.0));

    let [info, _] = desk.good("info a.safetensors");
    assert!(info.contains("hash grid"), "{info}");
    // A model that has learnt nothing is a poor one; its cameras are right, and need no --force.
    desk.good(&format!("train . -o poor.safetensors --steps 1 {SMALL}"));
    let [_, stderr] = desk.good(
        "uncertainty poor.safetensors --cameras transforms_train.json --rays 600 --level 5 --background white \
         --occupancy 32 -o poor.oct",
    );
    assert!(stderr.contains("hardly shows the images") && stderr.contains("hardly trained"), "{stderr}");
    desk.good(
        "uncertainty a.safetensors --cameras transforms_train.json --rays 600 --level 5 --background black \
         --occupancy 32 -o a.oct",
    );
    // The model knows the noise that training left: somewhat below that of held-out images.
    desk.good(
        "uncertainty a.safetensors --rays 600 --level 5 --background black --occupancy 32 --scale data -o scaled.oct",
    );
    let noise = field.training_noise().unwrap();
    assert!(noise < 10_f64.powf(-psnr / 20.0) && noise > 0.3 * 10_f64.powf(-psnr / 20.0), "{noise}");
    desk.good("render a.safetensors a.oct --cameras transforms_test.json -o a.png");
}

/// A model that has hardly begun to learn is fog, and comparing it with images takes long.
#[test]
fn a_run_limited_by_time_keeps_to_it_until_its_end() {
    let desk = Desk::new();
    for i in 0..15 {
        image::RgbImage::from_pixel(400, 400, image::Rgb([90; 3])).save(desk.path(&format!("r_{i}.png"))).unwrap();
    }
    for part in ["train", "test"] {
        let path = desk.path(&format!("transforms_{part}.json"));
        let frames = octobayes::dataset::Views::read(&path, None).unwrap().frames;
        let resized = frames.into_iter().map(|frame| (frame.name, frame.camera.resized([400; 2]))).collect::<Vec<_>>();
        write_transforms(&path, &resized).unwrap();
    }
    let start = std::time::Instant::now();
    let fog = "--contract linf:0,0,0,0.2 --log2-hashmap-size 12 --samples-per-step 1024";
    let [stdout, stderr] = desk.good(&format!("train . -o x.safetensors --time 1 {fog} --json"));
    let elapsed = start.elapsed().as_secs_f64();
    let pixels = serde_json::from_str::<Value>(&stdout).unwrap()["models"][0]["held_out"]["pixels"].as_u64().unwrap();
    // 200,000 pixels of fog take minutes. A second of training, two for each comparison, and the rest is the machine's.
    assert!(elapsed < 25.0 && (200..200_000).contains(&pixels), "{elapsed:.1} s, {pixels} pixels");
    assert!(stderr.contains("now the model is compared with its images, for at most about 4 s"), "{stderr}");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn views_members_and_what_is_wrong_with_them() {
    let desk = Desk::new();
    let two = format!("train transforms_train.json -o m.safetensors --steps 5 --views 3 --members 2 --seed 7 {SMALL}");
    let [stdout, _] = desk.good(&two);
    assert!(stdout.contains("m-0.safetensors") && stdout.contains("3 images") && stdout.contains("seed 8"), "{stdout}");
    let [first, second] = ["m-0.safetensors", "m-1.safetensors"].map(|name| desk.bytes(name));
    assert!(first != second && !desk.path("m.safetensors").exists());
    // Finished members of the same command are kept, others are not.
    std::fs::remove_file(desk.path("m-1.safetensors")).unwrap();
    let [_, stderr] = desk.good(&two);
    assert!(stderr.contains("m-0.safetensors is finished") && !stderr.contains("m-1"), "{stderr}");
    assert!(desk.bytes("m-0.safetensors") == first && desk.bytes("m-1.safetensors") == second);
    let [_, stderr] = desk.good(&format!("{two} --restart"));
    assert!(!stderr.contains("is finished") && desk.bytes("m-0.safetensors") == first, "{stderr}");
    let [_, stderr] = desk.good(&two.replace("--seed 7", "--seed 8"));
    assert!(!stderr.contains("is finished") && desk.bytes("m-0.safetensors") == second, "{stderr}");
    // Members that were trained on other pictures are trained again.
    let with_first = two.replace("--views 3", "--views 0,1,3");
    desk.good(&with_first);
    let [_, stderr] = desk.good(&with_first);
    assert!(stderr.contains("m-0.safetensors is finished"), "{stderr}");
    image::RgbImage::from_pixel(40, 40, image::Rgb([90; 3])).save(desk.path("r_0.png")).unwrap();
    let [_, stderr] = desk.good(&with_first);
    assert!(!stderr.contains("is finished"), "{stderr}");
    // No argument names the members: a file that `train` did not write stays.
    std::fs::write(desk.path("m-1.safetensors"), b"precious").unwrap();
    for restart in ["", "--restart"] {
        let output = desk.run(&format!("{two} {restart}"));
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains("another file at m-1.safetensors"), "{stderr}");
        assert_eq!(desk.bytes("m-1.safetensors"), b"precious");
    }
    // Only the state of a run may be replaced.
    std::fs::write(desk.path("y.state"), b"no state").unwrap();
    for restart in ["", "--restart"] {
        let output = desk.run(&format!("train . -o y.safetensors --steps 1 {SMALL} {restart}"));
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains("y.state: start: expected a file of"), "{stderr}");
    }

    let [stdout, _] = desk.good(&format!("train . -o list.safetensors --steps 2 --views 0,2,11 {SMALL}"));
    assert!(stdout.contains("3 images"), "{stdout}");

    std::fs::write(
        desk.path("no_images.json"),
        std::fs::read_to_string(desk.path("transforms_test.json")).unwrap().replace("r_", "q_"),
    )
    .unwrap();
    std::fs::write(desk.path("r_1.png"), b"no picture").unwrap();
    for (args, expected) in [
        ("train . -o m.npz --steps 1", "--output"),
        ("train . -o x.safetensors --steps 1 --views 13", "at most 12"),
        ("train . -o x.safetensors --steps 1 --views 0,12", "frame 12 (no "),
        ("train . -o x.safetensors --steps 1 --views 0,13", "from 0 to 12"),
        ("train . -o x.safetensors --steps 1 --contract l3", "--contract"),
        ("train . -o x.safetensors --steps 1 --time 1s", "--time"),
        ("train no_images.json -o x.safetensors --steps 1", "images that exist"),
        ("train nowhere -o x.safetensors --steps 1", "nowhere"),
        ("train . -o missing/x.safetensors --steps 1", "missing/x.safetensors"),
        ("train . -o x.safetensors --steps 1", "r_1.png"),
    ] {
        let output = desk.run(args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains(expected), "{args}: {stderr}");
        assert!(!desk.path("x.safetensors").exists(), "{args}");
    }
}

#[test]
#[cfg(unix)]
#[ignore = "slow: whole runs as processes"]
fn ctrl_c_saves_a_usable_model_and_resume_ends_with_the_same_bytes() {
    let desk = Desk::new();
    let args = |out: &str| format!("train . -o {out} --steps 120 {SMALL}");
    desk.good(&args("whole.safetensors"));
    let mut child = desk.command(&args("parts.safetensors")).spawn().unwrap();
    // On its way it says how good the model is.
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.starts_with("step ")), "it ended before it was told to");
    send("-INT", &child);
    let said = lines.collect::<Vec<_>>().join("\n");
    assert!(child.wait().unwrap().code() == Some(130) && said.contains("the same command goes on"), "{said}");
    let steps = |path: &Path| HashGrid::read(path).unwrap().training()["steps"].as_u64().unwrap();
    let so_far = steps(&desk.path("parts.safetensors"));
    assert!((1..120).contains(&so_far), "{so_far}");

    let other = desk.run(&args("parts.safetensors").replace("120", "121"));
    let stderr = String::from_utf8(other.stderr).unwrap();
    assert!(other.status.code() == Some(2) && stderr.contains("which a restart discards"), "{stderr}");
    let [_, stderr] = desk.good(&args("parts.safetensors"));
    assert!(stderr.contains(&format!("going on after {so_far} steps")), "{stderr}");
    assert!(desk.bytes("whole.safetensors") == desk.bytes("parts.safetensors"));
    assert!(!desk.path("parts.state").exists());
}

const SPLATS: &str = "--splats --background black --box=-1,-1,-1,1,1,1";

#[test]
fn splats_are_trained_and_the_other_verbs_read_them() {
    let desk = Desk::new();
    let train = |out: &str, more: &str| {
        std::fs::create_dir(desk.path(out)).unwrap();
        desk.good(&format!("train . -o {out}/s.ply {SPLATS} --steps 300 --json {more}"))
    };
    let [stdout, stderr] = train("a", "--threads 1");
    assert!(stderr.contains("splats begin anywhere in the box (--box)"), "{stderr}");
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let model = &report["models"][0];
    assert_eq!((&model["images"], &model["steps"], &model["seed"]), (&12.into(), &300.into(), &0.into()));
    assert_eq!((&model["held_out"]["views"], &model["held_out"]["pixels"]), (&3.into(), &4800.into()));
    // Black images have about 11 dB here.
    let psnr = model["held_out"]["psnr"].as_f64().unwrap();
    assert!(psnr > 17.0, "{psnr}");
    // A quarter of the most, 1000, at first; it changed once before six tenths of the run.
    let count = model["splats"].as_u64().unwrap();
    assert!((251..=300).contains(&count), "{count}");

    // Again with another number of threads: the same bytes.
    train("b", "--threads 3");
    for name in ["s.ply", "cameras.json", "transforms.json"] {
        assert!(desk.bytes(&format!("a/{name}")) == desk.bytes(&format!("b/{name}")), "{name}");
    }
    let views = |path: &str| octobayes::dataset::Views::read(&desk.path(path), None).unwrap().frames;
    for name in ["a/cameras.json", "a/transforms.json"] {
        let (found, given) = (views(name), views("transforms_train.json"));
        assert_eq!(found.len(), 12, "{name}");
        for (found, given) in found.iter().zip(&given) {
            assert!(found.name == given.name && found.camera.is_like(&given.camera, 1.0), "{name}: {}", found.name);
        }
    }
    let [info, _] = desk.good("info a/s.ply");
    assert!(info.contains("splats") && info.contains("degree 3"), "{info}");
    desk.good("uncertainty a/s.ply --cameras a/cameras.json --rays 600 --level 5 --background black -o a/s.oct");
}

/// Tanks and Temples and Deep Blending are published so.
#[test]
fn cameras_follow_pictures_that_are_smaller_than_they_state() {
    let desk = Desk::new();
    for i in 0..15 {
        let path = desk.path(&format!("r_{i}.png"));
        let picture = image::open(&path).unwrap().into_rgb8();
        image::imageops::resize(&picture, 20, 20, image::imageops::FilterType::Triangle).save(&path).unwrap();
    }
    let note = "cameras are resized to their pictures (12 of 12): `r_0` has 20 x 20 pixels, its camera 40 x 40";
    let [_, said] = desk.good(&format!("train . -o m.safetensors {SMALL} --steps 20"));
    assert!(said.contains(note), "{said}");
    let run = "uncertainty m.safetensors --level 4 --rays 2000 --occupancy 16 --background black --force";
    let [_, said] = desk.good(&format!("{run} --cameras . -o known.oct"));
    assert!(said.contains(note) && !said.contains("not the cameras that the model was trained on"), "{said}");
    desk.good(&format!("{run} -o own.oct"));
    // The same cameras, so the same rays.
    let sigma = |name: &str| octobayes::uncertainty::UncertaintyField::read(&desk.path(name)).unwrap();
    let [known, own] = ["known.oct", "own.oct"].map(sigma);
    for x in [Vec3::ZERO, Vec3::new(0.3, -0.2, 0.5), Vec3::new(-0.4, 0.1, -0.3)] {
        assert!((known.log10(x) - own.log10(x)).abs() < 1e-3, "{x}: {} {}", known.log10(x), own.log10(x));
    }
    std::fs::create_dir(desk.path("out")).unwrap();
    let [_, said] = desk.good(&format!("train . -o out/s.ply {SPLATS} --steps 3"));
    assert!(said.contains(note), "{said}");
    let size =
        |path: &str| octobayes::dataset::Views::read(&desk.path(path), None).unwrap().frames[0].camera.resolution;
    assert_eq!(size("out/cameras.json"), [20, 20]);
    // 17 does not divide 20.
    std::fs::create_dir(desk.path("odd")).unwrap();
    desk.good(&format!("train . -o odd/s.ply {SPLATS} --steps 3 --resolution 17"));
    assert_eq!(size("odd/cameras.json"), [17, 17]);
}

#[test]
fn wide_pictures_become_as_wide_as_in_the_original_code() {
    let desk = Desk::new();
    let cameras: Vec<(String, Camera)> = ClosedForm::half_circle(2, [1700, 10])
        .into_iter()
        .enumerate()
        .map(|(i, camera)| (format!("wide_{i}"), camera))
        .collect();
    for (name, _) in &cameras {
        let stripes = image::RgbImage::from_fn(1700, 10, |x, _| image::Rgb([(x % 256) as u8; 3]));
        stripes.save(desk.path(&format!("{name}.png"))).unwrap();
    }
    write_transforms(&desk.path("wide.json"), &cameras).unwrap();
    std::fs::create_dir(desk.path("out")).unwrap();
    let [_, said] = desk.good(&format!("train wide.json -o out/s.ply {SPLATS} --steps 1"));
    assert!(said.contains("images of 1700 x 10 are trained on at 1600 x 9"), "{said}");
    let views = octobayes::dataset::Views::read(&desk.path("out/cameras.json"), None).unwrap();
    assert_eq!(views.frames[0].camera.resolution, [1600, 9]);
}

#[test]
fn splats_at_another_size_and_what_is_wrong_with_them() {
    let desk = Desk::new();
    ["out", "new"].iter().for_each(|name| std::fs::create_dir(desk.path(name)).unwrap());
    desk.good(&format!("train . -o out/s.ply {SPLATS} --steps 3 --resolution 20"));
    let views = octobayes::dataset::Views::read(&desk.path("out/cameras.json"), None).unwrap();
    assert_eq!(views.frames[0].camera.resolution, [20, 20]);
    // The same command replaces what it wrote; where another program's model lies, its cameras stay.
    desk.good(&format!("train . -o out/s.ply {SPLATS} --steps 3 --resolution 20"));
    let cameras = desk.bytes("out/cameras.json");
    // Without the comment of the one that was trained here.
    Splats::read(&desk.path("out/s.ply")).unwrap().write_ply(&desk.path("out/other.ply"), &[], &[]).unwrap();
    let output = desk.run("train . --splats -o out/other.ply --steps 1");
    assert!(output.status.code() == Some(2) && desk.bytes("out/cameras.json") == cameras);
    // A model that was trained here does not make other cameras its own, wherever it lies.
    for (folder, name) in [("got", "cameras.json"), ("gotten", "transforms.json")] {
        std::fs::create_dir(desk.path(folder)).unwrap();
        std::fs::copy(desk.path("out/s.ply"), desk.path(&format!("{folder}/got.ply"))).unwrap();
        std::fs::write(desk.path(&format!("{folder}/{name}")), "precious").unwrap();
        let output = desk.run(&format!("train . -o {folder}/got.ply {SPLATS} --steps 3"));
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains(&format!("found {folder}/{name}")), "{stderr}");
        assert_eq!(desk.bytes(&format!("{folder}/{name}")), b"precious");
    }
    // A folder with a model of COLMAP: a transforms.json there would be read in its place.
    std::fs::create_dir_all(desk.path("col/sparse/0")).unwrap();
    ["cameras", "images"]
        .iter()
        .for_each(|name| std::fs::write(desk.path(&format!("col/sparse/0/{name}.bin")), "").unwrap());
    for out in ["col", "col/sparse", "col/sparse/0"] {
        let output = desk.run(&format!("train . -o {out}/m.ply {SPLATS} --steps 3"));
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains("beside col/sparse/0/images.bin"), "{stderr}");
        assert!(!desk.path(&format!("{out}/transforms.json")).exists() && !desk.path(&format!("{out}/m.ply")).exists());
    }
    for (args, expected) in [
        ("train . --splats -o out/x.safetensors --steps 1", "--output: expected a name that ends in .ply"),
        ("train . --splats -o out/x.ply --steps 1", "found out/cameras.json"),
        // The cameras would be split again where their images are.
        ("train . --splats -o x.ply --steps 1", "a folder without a data set"),
        (
            "train . --splats -o new/x.ply --steps 1 --resolution 50",
            "--resolution: expected at most the 40 x 40 pixels of",
        ),
        ("train . --splats -o new/x.ply --steps 1 --resolution 20x30", "a width alone has it, found 20 x 30"),
        ("train . --splats -o x.ply --steps 1 --contract l2", "--contract: expected a hash grid"),
        ("train . --splats -o x.ply --steps 1 --members 2", "--members: expected a hash grid"),
        ("train . --splats -o x.ply --steps 1 --log2-hashmap-size 12", "--log2-hashmap-size: expected a hash grid"),
        ("train . --splats -o x.ply --steps 1 --samples-per-step 4096", "--samples-per-step: expected a hash grid"),
        ("train . -o x.safetensors --steps 1 --resolution 20", "--splats"),
    ] {
        let output = desk.run(args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && stderr.contains(expected), "{args}: {stderr}");
        assert!(!desk.path("x.ply").exists() && !desk.path("cameras.json").exists(), "{args}");
    }
    // A data set's own camera file is not replaced.
    std::fs::rename(desk.path("transforms_train.json"), desk.path("transforms.json")).unwrap();
    let before = desk.bytes("transforms.json");
    let output = desk.run("train . --splats -o x.ply --steps 1");
    assert!(output.status.code() == Some(2) && desk.bytes("transforms.json") == before);
    // Where the images are, the cameras would be split again.
    std::fs::rename(desk.path("transforms.json"), desk.path("named.json")).unwrap();
    std::fs::remove_file(desk.path("transforms_test.json")).unwrap();
    let output = desk.run("train named.json --splats -o x.ply --steps 1");
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.contains("--output: expected a folder without the training images"), "{stderr}");
}

#[test]
#[cfg(unix)]
fn ctrl_c_saves_usable_splats_and_resume_ends_with_the_same_bytes() {
    let desk = Desk::new();
    let args = |out: &str| format!("train . -o {out}/s.ply {SPLATS} --steps 2000");
    for name in ["whole", "parts"] {
        std::fs::create_dir(desk.path(name)).unwrap();
    }
    let mut child = desk.command(&args("parts")).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.starts_with("step ")), "it ended before it was told to");
    send("-INT", &child);
    let said = lines.collect::<Vec<_>>().join("\n");
    assert!(child.wait().unwrap().code() == Some(130) && said.contains("the same command goes on"), "{said}");
    let [info, _] = desk.good("info parts/s.ply");
    assert!(info.contains("splats") && desk.path("parts/s.state").exists(), "{info}");
    assert!(desk.path("parts/cameras.json").exists() && desk.path("parts/transforms.json").exists());

    let other = desk.run(&args("parts").replace("2000", "2001"));
    let stderr = String::from_utf8(other.stderr).unwrap();
    assert!(other.status.code() == Some(2) && stderr.contains("which a restart discards"), "{stderr}");
    let [_, stderr] = desk.good(&args("parts"));
    assert!(stderr.contains("going on after "), "{stderr}");
    desk.good(&args("whole"));
    assert!(desk.bytes("whole/s.ply") == desk.bytes("parts/s.ply"));
    assert!(!desk.path("parts/s.state").exists());
}
