//! The images that lie beside the cameras are compared with the model before a run: cameras of another scene, another
//! background or other poses would give a field that looks as good as any.

use std::path::Path;
use std::process::Command;

use glam::{DVec3, Vec3};
use octobayes::dataset::write_transforms;
use octobayes::estimate::RaySettings;
use octobayes::field::ClosedForm;
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::render_view;

const RUN: &str = "--level 4 --rays 1000 --occupancy 32 -o x.oct";
const SIDE: u32 = 40;

/// Exit code and stderr.
fn run(folder: &Path, args: &str) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    let output = command.args(args.split_whitespace()).current_dir(folder).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// What a run over the courtyard says of the images beside its cameras, and whether it succeeded.
fn told(folder: &Path, args: &str) -> (bool, String) {
    let (code, said) = run(folder, &format!("uncertainty scene:courtyard --cameras cameras.json {RUN} {args}"));
    let line = said.lines().find(|line| line.contains("beside the cameras")).unwrap_or_default();
    assert!(code == Some(0) || line.starts_with("error: images beside the cameras"), "{said}");
    (code == Some(0), line.to_owned())
}

fn cameras() -> Vec<Camera> {
    ClosedForm::half_circle(6, [SIDE; 2])
}

/// Writes cameras and, for each, what `color` says of a pixel: its colour without the background, and its opacity.
fn desk(scene: &ClosedForm, side: u32, color: impl Fn(DVec3, f64) -> [f64; 4]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let settings = RaySettings::default().occupancy(32).cutoff(1e-4).background(Vec3::ZERO);
    let tracer = settings.tracer(scene, 0.0, &Silent).unwrap();
    let mut named = Vec::new();
    for (i, camera) in cameras().into_iter().enumerate() {
        let view = render_view(&tracer, &camera.resized([side; 2]), 0.5, &[], &Silent).unwrap();
        let image = image::RgbaImage::from_fn(side, side, |x, y| {
            let pixel = &view.pixels[(y * side + x) as usize];
            image::Rgba(color(pixel.color, pixel.opacity).map(|v| (255.0 * v).round() as u8))
        });
        image.save(folder.path().join(format!("r_{i}.png"))).unwrap();
        named.push((format!("r_{i}"), camera));
    }
    write_transforms(&folder.path().join("cameras.json"), &named).unwrap();
    folder
}

fn transparent(color: DVec3, opacity: f64) -> [f64; 4] {
    let [r, g, b] = (color / opacity.max(1e-6)).to_array();
    [r, g, b, opacity]
}

fn over(background: f64) -> impl Fn(DVec3, f64) -> [f64; 4] {
    move |color, opacity| {
        let [r, g, b] = (color + (1.0 - opacity) * background).to_array();
        [r, g, b, 1.0]
    }
}

#[test]
fn the_right_images_pass_without_a_word() {
    let courtyard = ClosedForm::courtyard();
    for (desk, args) in [
        (desk(&courtyard, SIDE, transparent), ""),
        (desk(&courtyard, SIDE, transparent), "--background black"),
        (desk(&courtyard, SIDE, over(1.0)), ""),
        (desk(&courtyard, SIDE, over(0.0)), "--background black"),
        // Images of another size, in the folder and by request.
        (desk(&courtyard, 2 * SIDE, over(1.0)), ""),
        (desk(&courtyard, SIDE, over(1.0)), "--resolution 20"),
        (desk(&courtyard, SIDE, over(1.0)), "--resolution 30x20"),
    ] {
        assert_eq!(told(desk.path(), args), (true, String::new()), "{args}");
    }
}

#[test]
fn images_of_another_scene_are_refused_unless_forced() {
    // Black where the courtyard shows a white background, and something else where it shows matter.
    let desk = desk(&ClosedForm::ball(), SIDE, |_, _| [0.0, 0.0, 0.0, 1.0]);
    let (is_run, said) = told(desk.path(), "");
    assert!(!is_run && said.contains("another scene") && said.contains("dB over 320 pixels of 5 images"), "{said}");
    assert!(!desk.path().join("x.oct").exists());
    let (is_run, said) = told(desk.path(), "--force");
    assert!(is_run && said.starts_with("warning: ") && said.contains("another scene"), "{said}");
    let (code, said) = run(desk.path(), &format!("plan scene:courtyard --cameras cameras.json {RUN}"));
    assert!(code == Some(2) && said.contains("--force insists"), "{said}");
}

#[test]
fn images_in_another_order_are_warned_of_the_same_way_on_any_number_of_threads() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(1.0));
    let path = |i: usize| desk.path().join(format!("r_{i}.png"));
    std::fs::rename(path(0), path(9)).unwrap();
    (1..6).for_each(|i| std::fs::rename(path(i), path(i - 1)).unwrap());
    std::fs::rename(path(9), path(5)).unwrap();
    let (is_run, said) = told(desk.path(), "--threads 1");
    assert!(is_run && said.starts_with("warning: ") && said.contains("another scene"), "{said}");
    assert_eq!(told(desk.path(), "--threads 3"), (true, said));
}

#[test]
fn the_images_background_is_named() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(0.0));
    let (_, said) = told(desk.path(), "--force");
    assert!(said.contains("another background") && said.contains("with black"), "{said}");
    assert_eq!(told(desk.path(), "--background black"), (true, String::new()));
}

#[test]
fn what_cannot_be_read_is_told_and_stops_nothing() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(1.0));
    std::fs::write(desk.path().join("r_0.png"), b"no picture").unwrap();
    let (is_run, said) = told(desk.path(), "");
    assert!(is_run && said.contains("not compared with 1 image") && said.contains("r_0.png"), "{said}");
    // Without images there is nothing to compare.
    (0..6).for_each(|i| std::fs::remove_file(desk.path().join(format!("r_{i}.png"))).unwrap());
    assert_eq!(told(desk.path(), ""), (true, String::new()));
}
