//! `train` as scripts see it: a data set in, a model out that the other verbs read. Interrupted runs can be
//! resumed.

#[cfg(unix)]
use std::io::{BufRead, BufReader};
#[cfg(unix)]
use std::process::Stdio;

#[cfg(unix)]
use crate::interrupt::send;
use crate::program::{Desk, cameras};
use glam::{DVec3, Vec3};
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, RadianceField, TrainedField};
use octobayes::monitor::Silent;
use octobayes::render::render_view;
use octobayes_data::{Frame, Views, write_transforms};
use octobayes_models::HashGrid;
use octobayes_splats::Splats;
use serde_json::Value;

const SMALL: &str = "--background black --box=-1,-1,-1,1,1,1 --log2-hashmap-size 12 --samples-per-step 4096";
const SPLATS: &str = "--splats --background black --box=-1,-1,-1,1,1,1";

/// A folder with images of the courtyard, on a black background: 12 for training and 3 held out.
fn desk() -> Desk {
    let desk = Desk::empty();
    let scene = ClosedForm::courtyard();
    let settings = RaySettings::default().occupancy(32).cutoff(1e-4).background(Vec3::ZERO);
    let tracer = settings.tracer(&scene, 0.0, &Silent).unwrap();
    for (name, camera) in cameras(15, [40; 2]) {
        let view = render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap();
        let byte = |v: f64| (255.0 * v).round() as u8;
        let pixel = |x: u32, y: u32| -> DVec3 { view.pixels[(y * 40 + x) as usize].color };
        let image = image::RgbImage::from_fn(40, 40, |x, y| image::Rgb(pixel(x, y).to_array().map(byte)));
        image.save(desk.join(format!("{name}.png"))).unwrap();
    }
    write_cameras(&desk, 40);
    desk
}

/// Writes the two files of cameras. One frame's image is missing, as in instant-ngp's fox.
fn write_cameras(desk: &Desk, side: u32) {
    let (test, mut train): (Vec<_>, Vec<_>) =
        cameras(15, [side; 2]).into_iter().partition(|(name, _)| ["r_2", "r_7", "r_12"].contains(&&**name));
    train.push(("gone".into(), train[0].1));
    write_transforms(&desk.join("transforms_train.json"), &train).unwrap();
    write_transforms(&desk.join("transforms_test.json"), &test).unwrap();
}

fn frames(desk: &Desk, name: &str) -> Vec<Frame> {
    Views::read(&desk.join(name), None).unwrap().frames
}

/// New folders to write splats to.
fn folders(desk: &Desk, names: &[&str]) {
    names.iter().for_each(|name| std::fs::create_dir(desk.join(name)).unwrap());
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_model_is_trained_and_the_other_verbs_read_it() {
    let desk = desk();
    let (code, out, said) = desk.run(&format!("train . -o a.safetensors --steps 150 {SMALL} --json"));
    assert!(code == Some(0) && said.contains("12 cameras of 13 frames") && said.contains("./gone.png"), "{said}");
    let model = &serde_json::from_str::<Value>(&out).unwrap()["models"][0];
    assert_eq!((&model["images"], &model["steps"], &model["seed"]), (&12.into(), &150.into(), &0.into()));
    assert_eq!((&model["held_out"]["views"], &model["held_out"]["pixels"]), (&3.into(), &4800.into()));
    // Black images have about 11 dB here; 19.1 was measured.
    let psnr = model["held_out"]["psnr"].as_f64().unwrap();
    assert!(psnr > 17.0, "{psnr}");

    let field = HashGrid::read(&desk.join("a.safetensors")).unwrap();
    assert!(field.training()["images"] == 12 && field.bounds().size() == DVec3::splat(2.0));
    // A model that has learnt nothing is a poor one; its cameras are right, and need no --force.
    desk.good(&format!("train . -o poor.safetensors --steps 1 {SMALL}"));
    let run = "--cameras transforms_train.json --rays 600 --level 5 --occupancy 32";
    let said = desk.said(&format!("uncertainty poor.safetensors {run} --background white -o poor.oct"));
    assert!(said.contains("hardly trained"), "{said}");
    // The model knows the noise that training left: somewhat below that of held-out images.
    desk.good(&format!("uncertainty a.safetensors {run} --background black --scale data -o a.oct"));
    let noise = field.training_noise().unwrap();
    assert!(noise < 10_f64.powf(-psnr / 20.0) && noise > 0.3 * 10_f64.powf(-psnr / 20.0), "{noise}");
    desk.good("render a.safetensors a.oct --cameras transforms_test.json -o a.png");
}

/// A model that has hardly begun to learn is fog, and comparing it with images takes long.
#[test]
fn a_run_limited_by_time_keeps_to_it_until_its_end() {
    let desk = Desk::empty();
    for i in 0..15 {
        image::RgbImage::from_pixel(400, 400, image::Rgb([90; 3])).save(desk.join(format!("r_{i}.png"))).unwrap();
    }
    write_cameras(&desk, 400);
    let start = std::time::Instant::now();
    let fog = "--contract linf:0,0,0,0.2 --log2-hashmap-size 12 --samples-per-step 1024";
    let report = desk.json(&format!("train . -o x.safetensors --time 1 {fog}"));
    let elapsed = start.elapsed().as_secs_f64();
    let pixels = report["models"][0]["held_out"]["pixels"].as_u64().unwrap();
    // 200,000 pixels of fog take minutes. A second of training, two for each comparison, and the rest is the machine's.
    assert!(elapsed < 25.0 && (200..200_000).contains(&pixels), "{elapsed:.1} s, {pixels} pixels");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn views_members_and_what_is_wrong_with_them() {
    let desk = desk();
    let two = format!("train transforms_train.json -o m.safetensors --steps 5 --views 3 --members 2 --seed 7 {SMALL}");
    let models = desk.json(&two)["models"].clone();
    assert!(models[0]["images"] == 3 && models[1]["seed"] == 8, "{models}");
    let members = || ["m-0.safetensors", "m-1.safetensors"].map(|name| desk.bytes(name));
    let [first, second] = members();
    assert!(first != second && !desk.join("m.safetensors").exists());
    // Finished members of the same command are kept, others are not.
    std::fs::remove_file(desk.join("m-1.safetensors")).unwrap();
    let finished = "m-0.safetensors is finished";
    let said = desk.said(&two);
    assert!(said.contains(finished) && !said.contains("m-1") && members() == [first.clone(), second.clone()], "{said}");
    let said = desk.said(&format!("{two} --restart"));
    assert!(!said.contains(finished) && members()[0] == first, "{said}");
    let said = desk.said(&two.replace("--seed 7", "--seed 8"));
    assert!(!said.contains(finished) && members()[0] == second, "{said}");
    // Members that were trained on other pictures are trained again.
    let with_first = two.replace("--views 3", "--views 0,1,3");
    desk.good(&with_first);
    assert!(desk.said(&with_first).contains(finished));
    image::RgbImage::from_pixel(40, 40, image::Rgb([90; 3])).save(desk.join("r_0.png")).unwrap();
    assert!(!desk.said(&with_first).contains(finished));
    // No argument names the members: a file that `train` did not write stays. Only the state of a run may be replaced.
    desk.write("m-1.safetensors", "precious");
    desk.write("y.state", "no state");
    for restart in ["", "--restart"] {
        desk.refused(&format!("{two} {restart}"), &["another file at m-1.safetensors"]);
        desk.refused(&format!("train . -o y.safetensors --steps 1 {SMALL} {restart}"), &["y.state: start"]);
    }

    let train = "train . -o x.safetensors --steps 1";
    desk.write("no_images.json", desk.text("transforms_test.json").replace("r_", "q_"));
    desk.write("r_1.png", "no picture");
    for (args, expected) in [
        ("train . -o m.npz --steps 1", "--output"),
        (&format!("{train} --views 13"), "at most 12"),
        (&format!("{train} --views 0,12"), "frame 12 (no "),
        (&format!("{train} --views 0,13"), "from 0 to 12"),
        (&train.replace(". ", "no_images.json "), "images that exist"),
        (&train.replace(". ", "nowhere "), "nowhere"),
        (train, "r_1.png"),
    ] {
        desk.refused(args, &[expected]);
    }
}

/// Stops a run after some steps, and goes on.
#[cfg(unix)]
fn stop_and_resume(desk: &Desk, args: &str) {
    let mut child = desk.command(args).stderr(Stdio::piped()).spawn().unwrap();
    // On its way it says how good the model is.
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.starts_with("step ")), "it ended before it was told to");
    send("-INT", &child);
    let said = lines.collect::<Vec<_>>().join("\n");
    assert!(child.wait().unwrap().code() == Some(130) && said.contains("the same command goes on"), "{said}");
    desk.refused(&format!("{args}1"), &["which a restart discards"]);
}

#[test]
#[cfg(unix)]
#[ignore = "slow: whole runs as processes"]
fn ctrl_c_saves_a_usable_model_and_resume_ends_with_the_same_bytes() {
    let desk = desk();
    let args = |out: &str| format!("train . -o {out}.safetensors {SMALL} --steps 120");
    desk.good(&args("whole"));
    stop_and_resume(&desk, &args("parts"));
    let so_far = HashGrid::read(&desk.join("parts.safetensors")).unwrap().training()["steps"].as_u64().unwrap();
    assert!((1..120).contains(&so_far), "{so_far}");
    assert!(desk.said(&args("parts")).contains(&format!("going on after {so_far} steps")));
    assert!(desk.bytes("whole.safetensors") == desk.bytes("parts.safetensors"));
    assert!(!desk.join("parts.state").exists());
}

#[test]
#[cfg(unix)]
fn ctrl_c_saves_usable_splats_and_resume_ends_with_the_same_bytes() {
    let desk = desk();
    let args = |out: &str| format!("train . -o {out}/s.ply {SPLATS} --steps 1200");
    folders(&desk, &["whole", "parts"]);
    stop_and_resume(&desk, &args("parts"));
    desk.good("info parts/s.ply");
    assert!(["s.state", "cameras.json", "transforms.json"].iter().all(|name| desk.join("parts").join(name).exists()));
    assert!(desk.said(&args("parts")).contains("going on after "));
    desk.good(&args("whole"));
    assert!(desk.bytes("whole/s.ply") == desk.bytes("parts/s.ply") && !desk.join("parts/s.state").exists());
}

#[test]
fn splats_are_trained_and_the_other_verbs_read_them() {
    let desk = desk();
    folders(&desk, &["a", "b"]);
    let train = |out: &str, more: &str| {
        desk.json(&format!("train . -o {out}/s.ply {SPLATS} --steps 300 {more}"))["models"][0].clone()
    };
    let model = train("a", "--threads 1");
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
    for name in ["a/cameras.json", "a/transforms.json"] {
        let (found, given) = (frames(&desk, name), frames(&desk, "transforms_train.json"));
        assert_eq!(found.len(), 12, "{name}");
        for (found, given) in found.iter().zip(&given) {
            assert!(found.name == given.name && found.camera.is_like(&given.camera, 1.0), "{name}: {}", found.name);
        }
    }
    desk.good("uncertainty a/s.ply --cameras a/cameras.json --rays 600 --level 5 --background black -o a/s.oct");
}

/// Tanks and Temples and Deep Blending are published so.
/// [`desk`], with pictures of half the size that its cameras state.
fn smaller_pictures() -> Desk {
    let desk = desk();
    for i in 0..15 {
        let path = desk.join(format!("r_{i}.png"));
        let picture = image::open(&path).unwrap().into_rgb8();
        image::imageops::resize(&picture, 20, 20, image::imageops::FilterType::Triangle).save(&path).unwrap();
    }
    desk
}

#[test]
fn cameras_follow_pictures_that_are_smaller_than_they_state() {
    let desk = smaller_pictures();
    let note = "cameras are resized to their pictures (12 of 12)";
    let said = desk.said(&format!("train . -o m.safetensors {SMALL} --steps 20"));
    assert!(said.contains(note), "{said}");
    let run = "uncertainty m.safetensors --level 4 --rays 2000 --occupancy 16 --background black --force";
    let said = desk.said(&format!("{run} --cameras . -o known.oct"));
    assert!(said.contains(note) && !said.contains("not the cameras that the model was trained on"), "{said}");
    desk.good(&format!("{run} -o own.oct"));
    // The same cameras, so the same rays.
    let [known, own] = ["known.oct", "own.oct"].map(|name| desk.field(name));
    for x in [Vec3::ZERO, Vec3::new(0.3, -0.2, 0.5), Vec3::new(-0.4, 0.1, -0.3)] {
        assert!((known.log10(x) - own.log10(x)).abs() < 1e-3, "{x}: {} {}", known.log10(x), own.log10(x));
    }
}

#[test]
fn cameras_of_splats_follow_pictures_that_are_smaller_than_they_state() {
    let desk = smaller_pictures();
    // 17 does not divide 20.
    folders(&desk, &["out", "odd"]);
    for (out, more, size) in [("out", "", 20), ("odd", "--resolution 17", 17)] {
        desk.good(&format!("train . -o {out}/s.ply {SPLATS} --steps 3 {more}"));
        assert_eq!(frames(&desk, &format!("{out}/cameras.json"))[0].camera.resolution, [size; 2]);
    }
}

#[test]
fn wide_pictures_become_as_wide_as_in_the_original_code() {
    let desk = Desk::empty();
    let cameras = cameras(2, [1700, 10]);
    for (name, _) in &cameras {
        image::RgbImage::from_pixel(1700, 10, image::Rgb([90; 3])).save(desk.join(format!("{name}.png"))).unwrap();
    }
    write_transforms(&desk.join("wide.json"), &cameras).unwrap();
    folders(&desk, &["out"]);
    desk.good(&format!("train wide.json -o out/s.ply {SPLATS} --steps 1"));
    assert_eq!(frames(&desk, "out/cameras.json")[0].camera.resolution, [1600, 9]);
}

#[test]
fn splats_at_another_size_and_what_is_wrong_with_them() {
    let desk = desk();
    folders(&desk, &["out", "new", "got", "gotten"]);
    // The same command replaces what it wrote; where another program's model lies, its cameras stay.
    for _ in 0..2 {
        desk.good(&format!("train . -o out/s.ply {SPLATS} --steps 3 --resolution 20"));
    }
    assert_eq!(frames(&desk, "out/cameras.json")[0].camera.resolution, [20, 20]);
    let cameras = desk.bytes("out/cameras.json");
    // Without the comment of the one that was trained here.
    Splats::read(&desk.join("out/s.ply")).unwrap().write_ply(&desk.join("out/other.ply"), &[], &[]).unwrap();
    desk.refused("train . --splats -o out/other.ply --steps 1", &["out/cameras.json"]);
    assert!(desk.bytes("out/cameras.json") == cameras);
    // A model that was trained here does not make other cameras its own, wherever it lies.
    for other in ["got/cameras.json", "gotten/transforms.json"] {
        let model = desk.join(other).with_file_name("got.ply");
        std::fs::copy(desk.join("out/s.ply"), &model).unwrap();
        desk.write(other, "precious");
        let folder = other.split('/').next().unwrap();
        desk.refused(&format!("train . -o {folder}/got.ply {SPLATS} --steps 3"), &[other]);
        assert_eq!(desk.bytes(other), b"precious");
    }
    // A folder with a model of COLMAP: a transforms.json there would be read in its place.
    std::fs::create_dir_all(desk.join("col/sparse/0")).unwrap();
    ["cameras", "images"].iter().for_each(|name| desk.write(&format!("col/sparse/0/{name}.bin"), ""));
    for out in ["col", "col/sparse", "col/sparse/0"] {
        desk.refused(&format!("train . -o {out}/m.ply {SPLATS} --steps 3"), &["beside col/sparse/0/images.bin"]);
        assert!(!desk.join(out).join("transforms.json").exists() && !desk.join(out).join("m.ply").exists());
    }
    for (args, expected) in [
        ("--splats -o out/x.safetensors", "--output"),
        // The cameras would be split again where their images are.
        ("--splats -o x.ply", "a folder without a data set"),
        ("--splats -o new/x.ply --resolution 50", "40 x 40"),
        ("--splats -o new/x.ply --resolution 20x30", "20 x 30"),
        ("--splats -o x.ply --contract l2", "--contract"),
        ("--splats -o x.ply --members 2", "--members"),
        ("--splats -o x.ply --log2-hashmap-size 12", "--log2-hashmap-size"),
        ("--splats -o x.ply --samples-per-step 4096", "--samples-per-step"),
        ("-o x.safetensors --resolution 20", "--splats"),
    ] {
        let (code, _, said) = desk.run(&format!("train . --steps 1 {args}"));
        assert!(code == Some(2) && said.contains(expected), "{args}: {said}");
        assert!(!desk.join("x.ply").exists() && !desk.join("new/x.ply").exists(), "{args}");
    }
    // A data set's own camera file is not replaced; nor are others written where the images are.
    std::fs::rename(desk.join("transforms_train.json"), desk.join("transforms.json")).unwrap();
    desk.refused("train . --splats -o x.ply --steps 1", &["--output"]);
    std::fs::rename(desk.join("transforms.json"), desk.join("named.json")).unwrap();
    std::fs::remove_file(desk.join("transforms_test.json")).unwrap();
    desk.refused("train named.json --splats -o x.ply --steps 1", &["--output", "training images"]);
}
