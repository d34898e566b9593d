//! The images that lie beside the cameras are compared with the model before a run: cameras of another scene, another
//! background or other poses would give a field that looks as good as any.

use std::path::Path;

use crate::program::{Desk, cameras};
use glam::{DVec3, Vec3};
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::{Camera, inverted, opencv};
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Tracer, VolumeRenderer, render_view};
use octobayes_data::{Frame, MaskFile};
use octobayes_evaluation::{ImageCheck, check_images};

const RUN: &str = "uncertainty scene:courtyard --cameras cameras.json --level 4 --rays 1000 --occupancy 32 -o x.oct";
const SIDE: u32 = 40;

fn tracer(scene: &ClosedForm, background: Vec3) -> Tracer<'_> {
    let marcher = Marcher { step: 0.02, bounds: scene.bounds(), occupancy: None, cutoff: 0.0 };
    Tracer { field: scene, marcher, background }
}

/// Saves what `cameras` see of a scene: of each pixel what `color` makes of its colour without the background, and its
/// opacity.
fn photograph(
    folder: &Path,
    scene: &ClosedForm,
    cameras: &[Camera],
    color: impl Fn(DVec3, f64) -> [f64; 4],
) -> Vec<Frame> {
    let save = |(i, camera): (usize, &Camera)| {
        let view = render_view(&tracer(scene, Vec3::ZERO), camera, 0.5, &[], &Silent).unwrap();
        let [w, h] = camera.resolution;
        let image = image::RgbaImage::from_fn(w, h, |x, y| {
            let pixel = &view.pixels[(y * w + x) as usize];
            image::Rgba(color(pixel.color, pixel.opacity).map(|v| (255.0 * v).round() as u8))
        });
        let path = folder.join(format!("r_{i}.png"));
        image.save(&path).unwrap();
        Frame::new(*camera, i.to_string(), path)
    };
    cameras.iter().enumerate().map(save).collect()
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

/// Six cameras, and pictures of a scene beside them.
fn desk(scene: &ClosedForm, side: u32, color: impl Fn(DVec3, f64) -> [f64; 4]) -> Desk {
    let desk = Desk::new(6, SIDE);
    let cameras: Vec<Camera> = cameras(6, [SIDE; 2]).iter().map(|(_, camera)| camera.resized([side; 2])).collect();
    photograph(&desk, scene, &cameras, color);
    desk
}

/// What a run over the courtyard says of the images beside its cameras.
fn told(desk: &Desk, args: &str) -> String {
    let said = desk.said(&format!("{RUN} {args}"));
    said.lines().find(|line| line.contains("beside the cameras")).unwrap_or_default().to_owned()
}

#[test]
fn the_right_images_pass_without_a_word() {
    let courtyard = ClosedForm::courtyard();
    for (desk, args) in [
        (desk(&courtyard, SIDE, transparent), ""),
        (desk(&courtyard, SIDE, over(0.0)), "--background black"),
        // Images of another size, in the folder and by request.
        (desk(&courtyard, 2 * SIDE, over(1.0)), ""),
        (desk(&courtyard, SIDE, over(1.0)), "--resolution 30x20"),
    ] {
        assert_eq!(told(&desk, args), "", "{args}");
    }
}

#[test]
fn images_of_another_scene_are_refused_unless_forced() {
    // Black where the courtyard shows a white background, and something else where it shows matter.
    let desk = desk(&ClosedForm::ball(), SIDE, |_, opacity| [0.05 * opacity, 0.0, 0.0, 1.0]);
    desk.refused(RUN, &["images beside the cameras", "another scene", "384 pixels of 6 images", "--force"]);
    let said = told(&desk, "--force");
    assert!(said.starts_with("warning: ") && said.contains("another scene"), "{said}");
}

#[test]
fn images_in_another_order_are_warned_of_the_same_way_on_any_number_of_threads() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(1.0));
    let path = |i: usize| desk.join(format!("r_{i}.png"));
    std::fs::rename(path(0), path(9)).unwrap();
    (1..6).for_each(|i| std::fs::rename(path(i), path(i - 1)).unwrap());
    std::fs::rename(path(9), path(5)).unwrap();
    let said = told(&desk, "--threads 1");
    assert!(said.starts_with("warning: ") && said.contains("another scene"), "{said}");
    assert_eq!(told(&desk, "--threads 3"), said);
}

#[test]
fn the_images_background_is_named() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(0.0));
    let said = told(&desk, "--force");
    assert!(said.contains("another background") && said.contains("with black"), "{said}");
}

#[test]
fn what_cannot_be_read_is_told_and_stops_nothing() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(1.0));
    desk.write("r_0.png", "no picture");
    let said = told(&desk, "");
    assert!(said.contains("1 image") && said.contains("r_0.png"), "{said}");
}

/// Frames whose images are what the courtyard shows, over white.
fn frames(folder: &Path, count: u32) -> Vec<Frame> {
    photograph(folder, &ClosedForm::courtyard(), &ClosedForm::half_circle(count, [32; 2]), over(1.0))
}

fn renderer(scene: &ClosedForm) -> VolumeRenderer<'_> {
    VolumeRenderer { tracer: tracer(scene, Vec3::ONE), differentiation: None }
}

fn found(frames: &[Frame]) -> ImageCheck {
    check_images(&renderer(&ClosedForm::courtyard()), &[], frames, 0.5, None, &Silent).unwrap().unwrap()
}

#[test]
fn other_readings_of_poses_are_named_if_they_show_the_images() {
    let folder = tempfile::tempdir().unwrap();
    let right = frames(folder.path(), 4);
    let check = found(&right);
    // Rounding to 8 bits is off by 1 / (255 √12), 58.9 dB, where there is matter; white is exact.
    assert!((58.5..70.0).contains(&check.psnr) && check.pixels == 256 && check.warnings().is_empty(), "{check:?}");
    // Each reading undoes itself, but for axes that are turned in the world.
    for (reading, name) in [
        (&opencv as &dyn Fn(&Camera) -> Camera, "OpenCV axes"),
        (&|camera: &Camera| inverted(camera)[0], "world-to-camera matrices in place"),
        (&|camera: &Camera| inverted(&opencv(camera))[0], "world-to-camera matrices with OpenCV"),
    ] {
        let frame = |frame: &Frame| Frame { camera: reading(&frame.camera), ..frame.clone() };
        let check = found(&right.iter().map(frame).collect::<Vec<_>>());
        assert!(check.is_poor() && check.poses.is_some_and(|(told, _)| told.starts_with(name)), "{name}: {check:?}");
        assert!(check.warnings()[0].contains(name), "{check:?}");
    }
}

/// Cameras that look past the model show blank images exactly, which is no reason to read their poses so.
#[test]
fn poses_that_see_nothing_are_not_named() {
    let folder = tempfile::tempdir().unwrap();
    let right = frames(folder.path(), 2);
    for frame in &right {
        image::RgbImage::from_fn(32, 32, |x, _| image::Rgb([255 - (x % 2) as u8; 3])).save(&frame.image).unwrap();
    }
    let check = found(&right);
    assert!(check.is_poor() && check.poses.is_none() && check.causes().contains("another scene"), "{check:?}");
}

/// Placeholders of pictures, of one colour each, tell nothing of cameras.
#[test]
fn images_of_one_color_are_not_compared() {
    let folder = tempfile::tempdir().unwrap();
    let frames = frames(folder.path(), 3);
    image::RgbImage::from_pixel(32, 32, image::Rgb([0; 3])).save(&frames[1].image).unwrap();
    let check = found(&frames);
    assert!(check.images == 2 && check.blank == 1 && check.psnr > 50.0 && check.refuse().is_ok(), "{check:?}");
    assert!(matches!(&check.warnings()[..], [warning] if warning.contains("1 image of one colour")), "{check:?}");
    let check = found(&frames[1..2]);
    assert!(check.images == 0 && check.blank == 1 && check.refuse().is_ok(), "{check:?}");
}

#[test]
fn masked_pixels_and_other_shapes() {
    let folder = tempfile::tempdir().unwrap();
    let mut frames = frames(folder.path(), 2);
    // The left half of the images is black, and masks say so.
    for (i, frame) in frames.iter_mut().enumerate() {
        let mut image = image::open(&frame.image).unwrap().to_rgb8();
        image.enumerate_pixels_mut().filter(|(x, ..)| *x < 16).for_each(|(.., pixel)| *pixel = image::Rgb([0; 3]));
        image.save(&frame.image).unwrap();
        let mask = folder.path().join(format!("mask_{i}.png"));
        image::GrayImage::from_fn(32, 32, |x, _| image::Luma([if x < 16 { 0 } else { 255 }])).save(&mask).unwrap();
        frame.mask = Some(MaskFile::Kept(mask));
    }
    let check = found(&frames);
    assert!(check.psnr > 50.0 && (48..80).contains(&check.pixels), "{check:?}");
    frames.iter_mut().for_each(|frame| frame.mask = None);
    assert!(found(&frames).is_poor());
    // Cameras that cut off what their images show.
    frames.iter_mut().for_each(|frame| frame.camera.resolution = [32, 16]);
    let check = found(&frames);
    assert!(check.shapes == Some([[32, 16], [32, 32]]) && check.causes().contains("32 x 32 pixels"), "{check:?}");
    // Without images there is nothing to compare.
    frames.iter_mut().for_each(|frame| frame.image = "none.png".into());
    let scene = ClosedForm::courtyard();
    assert_eq!(check_images(&renderer(&scene), &[], &frames, 0.5, None, &Silent).unwrap(), None);
}

#[test]
fn images_that_a_budget_has_no_room_for_are_not_compared() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ClosedForm::courtyard());
    let frames = frames(folder.path(), 3);
    let check = |room| check_images(&renderer(&scene), &[], &frames, 0.5, Some(room), &Silent).unwrap().unwrap();
    assert_eq!(check(4 * 32 * 32).images, 3);
    let check = check(4 * 32 * 32 - 1);
    assert!(check.images == 0 && check.refuse().is_ok() && check.warnings()[0].contains("3 images"), "{check:?}");
}

#[test]
fn masks_beside_the_images_are_applied_with_a_note() {
    let desk = desk(&ClosedForm::courtyard(), SIDE, over(1.0));
    std::fs::create_dir(desk.join("masks")).unwrap();
    image::GrayImage::new(SIDE / 2, SIDE / 2).save(desk.join("masks/r_0.png.png")).unwrap();
    let notes = desk.said(&format!("{RUN} --views all"));
    assert!(notes.contains("masks of 1 of 6 frames leave out 16.7 % of the pixels"), "{notes}");
    std::fs::rename(desk.join("masks/r_0.png.png"), desk.join("masks/0.png")).unwrap();
    let notes = desk.said(&format!("{RUN} --views all"));
    assert!(notes.contains("masks looks like masks and is not used") && !notes.contains("leave out"), "{notes}");
}
