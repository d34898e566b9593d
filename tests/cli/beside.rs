//! The images that lie beside the cameras are compared with the model before a run: cameras of another scene, another
//! background or other poses would give a field that looks as good as any.

use std::path::Path;

use crate::program::outcome;
use glam::{DVec3, Vec3};
use octobayes::dataset::{Frame, MaskFile, write_transforms};
use octobayes::estimate::RaySettings;
use octobayes::evaluate::{ImageCheck, check_images};
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::{Camera, inverted, opencv};
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Tracer, VolumeRenderer, render_view};

const RUN: &str = "--level 4 --rays 1000 --occupancy 32 -o x.oct";
const SIDE: u32 = 40;

/// What a run over the courtyard says of the images beside its cameras, and whether it succeeded.
fn told(folder: &Path, args: &str) -> (bool, String) {
    let (code, _, said) = outcome(folder, &format!("uncertainty scene:courtyard --cameras cameras.json {RUN} {args}"));
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
    let desk = desk(&ClosedForm::ball(), SIDE, |_, opacity| [0.05 * opacity, 0.0, 0.0, 1.0]);
    let (is_run, said) = told(desk.path(), "");
    assert!(!is_run && said.contains("another scene") && said.contains("dB over 384 pixels of 6 images"), "{said}");
    assert!(!desk.path().join("x.oct").exists());
    let (is_run, said) = told(desk.path(), "--force");
    assert!(is_run && said.starts_with("warning: ") && said.contains("another scene"), "{said}");
    let (code, _, said) =
        outcome(desk.path(), &format!("uncertainty scene:courtyard --cameras cameras.json {RUN} --dry-run"));
    assert!(code == Some(2) && said.contains("override with --force"), "{said}");
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

/// Frames whose images are what `scene` shows from `cameras`, over white.
fn frames(folder: &Path, scene: &ClosedForm, cameras: &[Camera]) -> Vec<Frame> {
    let tracer = tracer(scene);
    let write = |(i, camera): (usize, &Camera)| {
        let view = render_view(&tracer, camera, 0.5, &[], &Silent).unwrap();
        let [w, h] = camera.resolution;
        let pixel = |x: u32, y: u32| view.pixels[(y * w + x) as usize].color;
        let image = image::RgbImage::from_fn(w, h, |x, y| {
            image::Rgb(pixel(x, y).to_array().map(|v| (255.0 * v).round() as u8))
        });
        let path = folder.join(format!("{i}.png"));
        image.save(&path).unwrap();
        Frame::new(*camera, i.to_string(), path)
    };
    cameras.iter().enumerate().map(write).collect()
}

fn renderer(scene: &ClosedForm) -> VolumeRenderer<'_> {
    VolumeRenderer { tracer: tracer(scene), differentiation: None }
}

fn tracer(scene: &ClosedForm) -> Tracer<'_> {
    let marcher = Marcher { step: 0.02, bounds: scene.bounds(), occupancy: None, cutoff: 0.0 };
    Tracer { field: scene, marcher, background: Vec3::ONE }
}

fn found(scene: &ClosedForm, frames: &[Frame]) -> ImageCheck {
    check_images(&renderer(scene), &[], frames, 0.5, None, &Silent).unwrap().unwrap()
}

#[test]
fn other_readings_of_poses_are_named_if_they_show_the_images() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ClosedForm::courtyard());
    let right = frames(folder.path(), &scene, &ClosedForm::half_circle(4, [32; 2]));
    let check = found(&scene, &right);
    // Rounding to 8 bits is off by 1 / (255 √12), 58.9 dB, where there is matter; white is exact.
    assert!((58.5..70.0).contains(&check.psnr) && check.pixels == 256 && check.warnings().is_empty(), "{check:?}");
    let read_as = |reading: &dyn Fn(&Camera) -> Camera| -> ImageCheck {
        let frame = |frame: &Frame| Frame { camera: reading(&frame.camera), ..frame.clone() };
        found(&scene, &right.iter().map(frame).collect::<Vec<_>>())
    };
    // Each reading undoes itself, but for axes that are turned in the world.
    for (reading, name) in [
        (&opencv as &dyn Fn(&Camera) -> Camera, "OpenCV axes"),
        (&|camera: &Camera| inverted(camera)[0], "world-to-camera matrices in place"),
        (&|camera: &Camera| inverted(&opencv(camera))[0], "world-to-camera matrices with OpenCV"),
    ] {
        let check = read_as(reading);
        assert!(check.is_poor() && check.poses.is_some_and(|(told, _)| told.starts_with(name)), "{name}: {check:?}");
        assert!(check.warnings()[0].contains(name), "{check:?}");
    }
}

/// Cameras that look past the model show blank images exactly, which is no reason to read their poses so.
#[test]
fn poses_that_see_nothing_are_not_named() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ClosedForm::courtyard());
    let right = frames(folder.path(), &scene, &ClosedForm::half_circle(2, [32; 2]));
    for frame in &right {
        image::RgbImage::from_fn(32, 32, |x, _| image::Rgb([255 - (x % 2) as u8; 3])).save(&frame.image).unwrap();
    }
    let check = found(&scene, &right);
    assert!(check.is_poor() && check.poses.is_none() && check.causes().contains("another scene"), "{check:?}");
}

/// Placeholders of pictures, of one colour each, tell nothing of cameras.
#[test]
fn images_of_one_color_are_not_compared() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ClosedForm::courtyard());
    let mut frames = frames(folder.path(), &scene, &ClosedForm::half_circle(3, [32; 2]));
    image::RgbImage::from_pixel(32, 32, image::Rgb([0; 3])).save(&frames[1].image).unwrap();
    let check = found(&scene, &frames);
    assert!(check.images == 2 && check.blank == 1 && check.psnr > 50.0 && check.refuse().is_ok(), "{check:?}");
    assert_eq!(check.warnings(), ["the model is not compared with 1 image of one colour beside the cameras"]);
    frames.drain(2..);
    frames.swap_remove(0);
    let check = found(&scene, &frames);
    assert!(
        check.images == 0 && check.blank == 1 && check.refuse().is_ok() && check.warnings().len() == 1,
        "{check:?}"
    );
}

#[test]
fn masked_pixels_and_other_shapes() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ClosedForm::courtyard());
    let cameras = ClosedForm::half_circle(2, [32; 2]);
    let mut frames = frames(folder.path(), &scene, &cameras);
    // The left half of the images is black, and masks say so.
    for (i, frame) in frames.iter_mut().enumerate() {
        let mut image = image::open(&frame.image).unwrap().to_rgb8();
        image.enumerate_pixels_mut().filter(|(x, ..)| *x < 16).for_each(|(.., pixel)| *pixel = image::Rgb([0; 3]));
        image.save(&frame.image).unwrap();
        let mask = folder.path().join(format!("mask_{i}.png"));
        image::GrayImage::from_fn(32, 32, |x, _| image::Luma([if x < 16 { 0 } else { 255 }])).save(&mask).unwrap();
        frame.mask = Some(MaskFile::Kept(mask));
    }
    let check = found(&scene, &frames);
    assert!(check.psnr > 50.0 && (48..80).contains(&check.pixels), "{check:?}");
    frames.iter_mut().for_each(|frame| frame.mask = None);
    assert!(found(&scene, &frames).is_poor());
    // Cameras that cut off what their images show.
    for frame in &mut frames {
        frame.camera.resolution = [32, 16];
    }
    let check = found(&scene, &frames);
    assert!(check.shapes == Some([[32, 16], [32, 32]]) && check.causes().contains("32 x 32 pixels"), "{check:?}");
    // Without images there is nothing to say.
    frames.iter_mut().for_each(|frame| frame.image = "none.png".into());
    assert_eq!(check_images(&renderer(&scene), &[], &frames, 0.5, None, &Silent).unwrap(), None);
}

#[test]
fn images_that_a_budget_has_no_room_for_are_not_compared() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ClosedForm::courtyard());
    let frames = frames(folder.path(), &scene, &ClosedForm::half_circle(3, [32; 2]));
    let check = |room| check_images(&renderer(&scene), &[], &frames, 0.5, Some(room), &Silent).unwrap().unwrap();
    assert_eq!(check(3 * 32 * 32).images, 3);
    let check = check(3 * 32 * 32 - 1);
    assert!(check.images == 0 && check.refuse().is_ok(), "{check:?}");
    let warning = &check.warnings()[0];
    assert!(warning.starts_with("the model is not compared with 3 images beside the cameras: "), "{warning}");
    assert!(warning.ends_with("what the memory budget leaves, found 1 MB"), "{warning}");
}

#[test]
fn masks_beside_the_images_are_applied_with_a_note() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(1.0));
    std::fs::create_dir(desk.path().join("masks")).unwrap();
    image::GrayImage::new(SIDE / 2, SIDE / 2).save(desk.path().join("masks/r_0.png.png")).unwrap();
    let said =
        || outcome(desk.path(), &format!("uncertainty scene:courtyard --cameras cameras.json {RUN} --views all")).2;
    let notes = said();
    assert!(notes.contains("masks of 1 of 6 frames lie beside the pictures"), "{notes}");
    assert!(notes.contains("masks of 1 of 6 frames leave out 16.7 % of the pixels"), "{notes}");
    std::fs::rename(desk.path().join("masks/r_0.png.png"), desk.path().join("masks/0.png")).unwrap();
    let notes = said();
    assert!(notes.contains("masks looks like masks and is not used") && !notes.contains("leave out"), "{notes}");
}
