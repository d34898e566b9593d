//! Gaussian splats from file to file: `uncertainty`, `query`, `render`, `export`, and what they refuse.

use std::path::Path;

use glam::{DVec3, Quat, Vec3};
use octobayes::geometry::{Camera, opencv};
use octobayes::monitor::Silent;
use octobayes::render::Renderer;
use octobayes::uncertainty::compare;
use octobayes_data::{Views, write_transforms};
use octobayes_splats::{RenderMode, SplatRenderer, Splats};
use serde_json::Value;

use crate::program::Desk;

const RUN: &str = "uncertainty scene.ply --cameras transforms.json --background black --level 5 --rays 6000";

/// A ball of splats, each moved out by `away` of its number, all `scale` times as large and as far from 0.
fn scaled_ball(scale: f32, away: impl Fn(usize) -> f32) -> Splats {
    let count = 900;
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    let splats = Splats::new(
        (0..count).map(|i| scale * (0.7 + away(i)) * normal(i)).collect(),
        vec![Vec3::new(-3.0, -3.1, -4.6) + scale.ln(); count],
        (0..count).map(|i| Quat::from_rotation_arc(Vec3::Z, normal(i))).collect(),
        (0..count).map(|i| 1.0 + (i % 5) as f32).collect(),
        (0..12 * count).map(|k| ((k * 7) % 11) as f32 / 5.0 - 1.0).collect(),
        1,
        RenderMode::Classic,
    );
    splats.unwrap()
}

pub fn ball(away: impl Fn(usize) -> f32) -> Splats {
    scaled_ball(1.0, away)
}

/// Cameras at these angles around the vertical axis.
pub fn around(distance: f64, angles: impl Iterator<Item = f64>) -> Vec<(String, Camera)> {
    let camera = |(i, angle): (usize, f64)| {
        let eye = distance * DVec3::new(angle.cos(), angle.sin(), 0.23);
        (format!("r_{i:02}"), Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [48, 40]))
    };
    angles.enumerate().map(camera).collect()
}

/// A ball of splats and four cameras on one side of it, in a folder.
pub fn desk() -> Desk {
    let desk = Desk::empty();
    ball(|_| 0.0).write_ply(&desk.join("scene.ply"), &[], &[]).unwrap();
    write_transforms(&desk.join("transforms.json"), &around(2.2, (0..4).map(|i| 0.5 * f64::from(i)))).unwrap();
    desk
}

#[test]
fn a_run_its_queries_its_pictures_and_the_file_with_columns() {
    let desk = desk();
    let said = desk.said(&format!("{RUN} -o scene.oct"));
    assert!(said.contains("never seen by a training ray"), "{said}");
    let field = desk.field("scene.oct");
    // The box is what the cameras see, which the ball fills.
    let longest = field.lattice().domain().size().max_element();
    assert!((1.3..2.0).contains(&longest), "{longest}");

    desk.good("export scene.ply scene.oct --cameras transforms.json -o scene-u.ply");
    let found = Splats::read(&desk.join("scene-u.ply")).unwrap();
    let column = |name: &str| found.extra(name).unwrap_or_else(|| panic!("column {name}"));
    let names = ["uncertainty", "log10_uncertainty", "seen", "weight", "views", "front_share"];
    assert!(found.extra_names().ends_with(&names));
    let [u, log10, seen, weight, views, in_front] = names.map(column);
    // A closed ball: nothing floats.
    assert!(in_front.iter().all(|share| (0.0..0.9).contains(share)));
    for i in 0..found.len() {
        let expected = field.query(found.mean(i)).uncertainty;
        assert!((u[i] / expected - 1.0).abs() < 1e-6 && (log10[i] - expected.log10()).abs() < 1e-6);
    }
    // Towards the cameras splats were seen, away from them they were not.
    let towards = |i: &usize| found.mean(*i).dot(Vec3::new(0.7, 0.5, 0.2));
    let mean = |values: &[f64], keep: &dyn Fn(f32) -> bool| {
        let kept: Vec<f64> = (0..found.len()).filter(|i| keep(towards(i))).map(|i| values[i]).collect();
        kept.iter().sum::<f64>() / kept.len() as f64
    };
    let [front, back] = [mean(&weight, &|x| x > 0.4), mean(&weight, &|x| x < -0.4)];
    assert!(front > 20.0 * back, "{front} against {back}");
    assert!(mean(&views, &|x| x > 0.4) > 3.0 && mean(&views, &|x| x < -0.4) < 0.5);
    assert!(mean(&log10, &|x| x > 0.4) < mean(&log10, &|x| x < -0.4) - 0.5);

    // `query` answers as the file does, and by where rays passed.
    let points: String = found.means().iter().map(|x| format!("{},{},{}\n", x.x, x.y, x.z)).collect();
    desk.write("centres.csv", points);
    let answers = desk.good("query scene.oct centres.csv");
    for (i, row) in answers.lines().skip(1).enumerate() {
        let row: Vec<&str> = row.split(',').collect();
        assert_eq!((row[8] == "0", row[9] == "unseen"), (seen[i] == 0.0, seen[i] == 0.0), "{row:?}");
    }
    let unseen: Vec<f64> = seen.iter().map(|code| f64::from(*code == 0.0)).collect();
    assert!(mean(&unseen, &|x| x > 0.4) == 0.0 && mean(&unseen, &|x| x < -0.4) > 0.7);

    // The clean-up leaves out what is above its threshold and what was never seen; without cameras there are three
    // columns.
    desk.good("export scene.ply scene.oct --threshold 80% -o cleaned.ply");
    let cleaned = Splats::read(&desk.join("cleaned.ply")).unwrap();
    assert!(cleaned.len() < found.len() && cleaned.len() > found.len() / 10, "{}", cleaned.len());
    assert!(cleaned.extra_names().ends_with(&["uncertainty", "log10_uncertainty", "seen"]));
    let most = cleaned.extra("log10_uncertainty").unwrap().into_iter().fold(f64::MIN, f64::max);
    assert!((0..found.len()).filter(|&i| log10[i] <= most && seen[i] > 0.0).count() == cleaned.len());
    desk.good("render scene.ply scene.oct --cameras transforms.json --threshold 80% -o view.png");
}

#[test]
fn a_run_equals_the_sums_of_its_dumped_samples() {
    let desk = desk();
    let bounds = "--box=-0.8,-0.8,-0.8,0.8,0.8,0.8";
    desk.good(&format!("{RUN} {bounds} --dump-samples samples.npz -o run.oct"));
    desk.good(&format!("uncertainty samples.npz {bounds} --level 5 -o sums.oct"));
    let [run, sums] = ["run.oct", "sums.oct"].map(|name| desk.field(name));
    let compared = compare(&run, &sums, 5000, 1).unwrap();
    // Both may leave leaves coarser within the tolerance; the sums are the same.
    assert!(compared.in_box.clone().unwrap().max < 1e-5, "{compared:?}");
}

#[test]
fn the_mode_is_part_of_the_model() {
    let desk = desk();
    // Each is drawn as it was computed.
    for (field, mode) in [("mip", "--splat-mode mip"), ("classic", "")] {
        desk.good(&format!("{RUN} {mode} -o {field}.oct"));
        desk.good(&format!("render scene.ply {field}.oct --cameras transforms.json -o {field}.exr"));
    }
    let [mip, classic] = ["mip.oct", "classic.oct"].map(|name| desk.field(name).record().model_checksum);
    assert!(mip != classic && desk.bytes("mip.exr") != desk.bytes("classic.exr"));
    desk.refused("uncertainty scene:ball --splat-mode mip -o x.oct --dry-run", &["mode of splats", "scene:ball"]);
}

#[test]
fn what_splats_do_not_have_is_refused_by_name() {
    let desk = desk();
    for option in [
        "--gradient finite-difference",
        "--cutoff 1e-6",
        "--occupancy 64",
        "--audit",
        "--pooling auto",
        "--target-error 0.1",
        "--refine density",
    ] {
        desk.refused(&format!("{RUN} {option} -o x.oct"), &[option.split(' ').next().unwrap(), "splats"]);
    }
    // Splats have no other derivatives than those that `auto` asks for.
    desk.good(&format!("{RUN} --gradient auto -o auto.oct"));
    desk.good(&format!("{RUN} -o scene.oct"));
    assert!(desk.bytes("auto.oct") == desk.bytes("scene.oct"), "the same field");
    let cameras = "--cameras transforms.json";
    desk.refused(&format!("view scene.ply scene.oct {cameras} --cells 64 -o x.html"), &["--cells", "64"]);
    desk.refused("export scene.ply scene.oct --mesh -o x.ply", &["splats"]);
    desk.refused(&format!("export scene.ply scene.oct {cameras} --ellipsoids -o x.ply"), &["--ellipsoids"]);
    desk.refused(&format!("export scene.ply scene.oct {cameras} -o x.csv"), &["splats"]);
    // Cameras that look away: the likely causes of splats are named.
    let turn = |(name, camera): (String, Camera)| (name, opencv(&camera));
    let turned: Vec<_> = around(2.2, (0..4).map(|i| 0.5 * f64::from(i))).into_iter().map(turn).collect();
    write_transforms(&desk.join("turned.json"), &turned).unwrap();
    desk.refused(&format!("{} -o x.oct", RUN.replace("transforms", "turned")), &["OpenCV", "normalised", "glTF"]);
    // A field of other splats.
    let splats = Splats::read(&desk.join("scene.ply")).unwrap();
    let kept: Vec<bool> = (0..splats.len()).map(|i| i > 0).collect();
    splats.keep(&kept).unwrap().write_ply(&desk.join("other.ply"), &[], &[]).unwrap();
    desk.refused("export other.ply scene.oct -o x.ply", &["checksum", "--force"]);
}

#[test]
fn view_shows_splats_with_and_without_cameras() {
    let desk = desk();
    desk.good(&format!("{RUN} -o scene.oct"));
    let view = |options: &str| {
        desk.good(&format!("view scene.ply scene.oct {options} -o view.html"));
        desk.text("view.html")
    };
    let page = view("--cameras transforms.json");
    assert!(page.contains("splats-vertex") && !page.contains("id=\"march\""), "a page has one renderer");
    assert!(page.contains("r_03") && !view("").contains("r_03"));
}

/// What three other cameras see of another ball, whose splats lie elsewhere: `transforms_test.json`, images, and depth
/// maps of 16 bits, 1e-4 scene units each.
fn write_held_out(folder: &Path) {
    let truth = ball(|i| if i % 3 == 0 { 0.04 } else { -0.01 });
    let renderer = SplatRenderer::new(&truth, Vec3::ZERO);
    std::fs::create_dir(folder.join("depth")).unwrap();
    let name = |(name, camera): (String, Camera)| (name.replace('r', "t"), camera);
    let cameras: Vec<_> = around(2.2, (0..3).map(|i| 0.25 + 0.5 * f64::from(i))).into_iter().map(name).collect();
    for (name, camera) in &cameras {
        let view = renderer.image(camera, 0.5, &[], &Silent).unwrap();
        let pixel = |x: u32, y: u32| &view.pixels[(48 * y + x) as usize];
        let image = image::RgbaImage::from_fn(48, 40, |x, y| {
            let [r, g, b] = pixel(x, y).color.to_array().map(|v| (255.0 * v.min(1.0)).round() as u8);
            image::Rgba([r, g, b, if pixel(x, y).opacity > 0.9 { 255 } else { 0 }])
        });
        image.save(folder.join(format!("{name}.png"))).unwrap();
        let depth = |x, y| image::Luma([(1e4 * pixel(x, y).median_depth).round() as u16]);
        image::ImageBuffer::from_fn(48, 40, depth).save(folder.join(format!("depth/{name}.png"))).unwrap();
    }
    write_transforms(&folder.join("transforms_test.json"), &cameras).unwrap();
}

const JUDGE: &str = "--cameras transforms_test.json --depth depth --depth-pattern {}.png --depth-encoding 0,6.5535";

#[test]
fn splats_are_judged_like_volumes() {
    let desk = desk();
    write_held_out(&desk);
    desk.good(&format!("{RUN} --scale data --noise 0.03 --keep-sums --covariance block -o scene.oct"));
    let judge = format!("evaluate scene.ply scene.oct {JUDGE}");
    let files = "--plot plot.svg --csv curves.csv --clean-up sheet.png --calibrate calibrated.oct --probability 0.8";
    let report = desk.json(&format!("{judge} {files}"));
    let number = |value: &Value| value.as_f64().unwrap();
    // Everything that a volume is measured by.
    let rows = report["baselines"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["name"].as_str().unwrap()).collect();
    let baselines = [
        "ray-weight variance",
        "distance from the camera",
        "weights' spread / sqrt(rays)",
        "weights' spread / rays",
        "random",
    ];
    assert_eq!(names, baselines);
    let readings = report["readings"].as_array().unwrap();
    assert!(readings.iter().any(|row| row["name"] == "scene block, depth deviation"), "{readings:?}");
    assert!(rows.iter().chain(readings).all(|row| (0.0..1.0).contains(&number(&row["ause_pooled"]["mae"]))));
    // The splats lie 0.01 too far out, or 0.04 too far in.
    let error = number(&report["depth_error"]["median"]);
    assert!((0.003..0.04).contains(&error) && number(&report["psnr"]) > 15.0, "{error}, {}", report["psnr"]);
    assert!(["plot.svg", "curves.csv", "sheet.png"].iter().all(|name| desk.bytes(name).len() > 1000));
    let cleaned = report["clean_up"].as_array().unwrap();
    assert!(cleaned.len() == 11 && number(&cleaned[10]["coverage"]) >= number(&cleaned[1]["coverage"]), "{cleaned:?}");

    // A calibrated interval holds what it was counted on: 80 %, to within a pixel.
    let conformal = *desk.field("calibrated.oct").conformal().unwrap();
    assert!(conformal.factor > 0.0 && conformal.views == 3, "{conformal:?}");
    let again = desk.json(&format!("evaluate scene.ply calibrated.oct {JUDGE} --covariance block"));
    let inside = number(&again["conformal"][0]["share_inside"]);
    assert!((0.8..0.8 + 2.0 / conformal.pixels as f64).contains(&inside), "{inside}");
    // Every third pixel of the same images: neither larger splats nor other colours.
    let strided = desk.json(&format!("{judge} --stride 3"));
    let [all, some] = [&report, &strided].map(|report| number(&report["psnr"]));
    assert!((all - some).abs() < 1.0, "{all} and {some} dB");
    desk.good("render scene.ply calibrated.oct --cameras transforms_test.json --depth-error -o x.exr");

    // An ensemble of splats, and what is none.
    ball(|i| 0.002 * (i % 7) as f32).write_ply(&desk.join("other.ply"), &[], &[]).unwrap();
    let with = desk.good(&format!("{judge} --ensemble scene.ply other.ply"));
    assert!(with.contains("ensemble depth variance"), "{with}");
    desk.refused(&format!("{judge} --ensemble scene.ply scene:ball"), &["scene:ball", "splats"]);
    ball(|_| 3.0).write_ply(&desk.join("far.ply"), &[], &[]).unwrap();
    desk.refused(&format!("{judge} --ensemble scene.ply far.ply"), &["box of the member `far.ply`"]);

    // Without the training cameras: what needs them is left out, and named.
    std::fs::rename(desk.join("transforms.json"), desk.join("moved.json")).unwrap();
    let (code, out, said) = desk.run(&judge);
    assert!(code == Some(0) && said.contains("is left out"), "{said}");
    assert!(!out.contains("training views see a surface") && out.contains("ray-weight variance"), "{out}");
    desk.refused(&format!("{judge} --training-depth depth"), &["--training-depth", "training cameras"]);
}

/// Masks belong to the cameras by which a field knows what its splats were trained on.
#[test]
fn training_cameras_with_masks_are_recognised() {
    let desk = desk();
    write_held_out(&desk);
    let mask = image::GrayImage::from_fn(48, 40, |x, _| image::Luma([if x < 6 { 0 } else { 255 }]));
    mask.save(desk.join("mask.png")).unwrap();
    let mut file: Value = serde_json::from_str(&desk.text("transforms.json")).unwrap();
    desk.good(&format!("{RUN} -o plain.oct"));
    file["frames"][2]["mask_path"] = "mask.png".into();
    desk.write("transforms.json", file.to_string());
    desk.good(&format!("{RUN} -o scene.oct"));
    let knows =
        |field: &str| !desk.said(&format!("evaluate scene.ply {field}.oct {JUDGE}")).contains("confirm is left out");
    // The same cameras without the masks, too.
    assert!(knows("scene") && knows("plain"));
    // With another mask they are other cameras.
    file["frames"][1]["mask_path"] = "mask.png".into();
    desk.write("transforms.json", file.to_string());
    assert!(!knows("scene"));
}

#[test]
fn splats_that_cameras_do_not_see_are_warned_of() {
    let desk = desk();
    let said = |model: &str, cameras: &str| {
        desk.said(&format!("{} -o x.oct", RUN.replace("scene.ply", model).replace("transforms.json", cameras)))
    };
    let [too_near, outside] = ["scene units and not drawn", "of the opaque splats lie within"];
    assert!(!said("scene.ply", "transforms.json").contains(too_near));
    // A tenth of the distances: the nearer half of the ball is at 0.15 scene units.
    scaled_ball(0.1, |_| 0.0).write_ply(&desk.join("small.ply"), &[], &[]).unwrap();
    write_transforms(&desk.join("near.json"), &around(0.22, (0..4).map(|i| 0.5 * f64::from(i)))).unwrap();
    assert!(said("small.ply", "near.json").contains(too_near));
    // All around, and inside of the ball, where all cameras see a part of the other side.
    for (distance, step, is_warned) in [(2.2, 0.5, false), (0.55, 0.05, true)] {
        let cameras = around(distance, (0..12).map(|i| step * f64::from(i)));
        write_transforms(&desk.join("around.json"), &cameras).unwrap();
        assert_eq!(said("scene.ply", "around.json").contains(outside), is_warned, "{distance}");
    }
}

/// Saves what the cameras see of the ball in front of a grey of this shade.
fn photograph(folder: &Path, shade: f32) {
    let (ball, frames) = (ball(|_| 0.0), Views::read(&folder.join("transforms.json"), None).unwrap());
    let renderer = SplatRenderer::new(&ball, Vec3::splat(shade));
    for frame in frames.frames {
        let view = renderer.image(&frame.camera, 0.5, &[], &Silent).unwrap();
        let color = |x: u32, y: u32| view.pixels[(48 * y + x) as usize].color.to_array();
        let byte = |v: f64| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
        let image = image::RgbImage::from_fn(48, 40, |x, y| image::Rgb(color(x, y).map(byte)));
        image.save(folder.join(format!("{}.png", frame.name))).unwrap();
    }
}

#[test]
fn what_lay_behind_splats_is_stated_or_shown_by_images_or_assumed_with_a_note() {
    let desk = desk();
    let run = "uncertainty scene.ply --cameras transforms.json --views all --level 4 --rays 2000 -o x.oct --json";
    let found = |args: &str| {
        let (code, out, notes) = desk.run(&format!("{run} {args}"));
        assert_eq!(code, Some(0), "{notes}");
        let report: Value = serde_json::from_str(&out).unwrap();
        (desk.field("x.oct").record().background.unwrap(), notes, report["images"]["psnr"].as_f64())
    };
    let (background, notes, psnr) = found("");
    assert!(background == [1.0; 3] && notes.contains("white is assumed") && psnr.is_none(), "{notes}");
    for shade in [0.0, 1.0] {
        photograph(&desk, shade);
        let (background, notes, psnr) = found("");
        assert!(background == [shade; 3] && psnr > Some(30.0), "{psnr:?}: {notes}");
        assert!(notes.contains("lay behind the splats by the images"), "{notes}");
    }
    // Who states a background is believed, and so is the file of the original code; both together are warned of.
    let (background, notes, _) = found("--background 0.5,0.5,0.5 --force");
    assert!(background == [0.5; 3] && !notes.contains("lay behind"), "{notes}");
    photograph(&desk, 0.0);
    desk.write("cfg_args", "Namespace(sh_degree=3, white_background=False, eval=True)");
    let (background, notes, _) = found("");
    assert!(background == [0.0; 3] && notes.contains("cfg_args: black"), "{notes}");
    let (background, notes, _) = found("--background white --force");
    assert!(background == [1.0; 3] && notes.contains("warning: ") && notes.contains("cfg_args: black"), "{notes}");
    // Pictures of another scene: grey noise.
    for i in 0..4 {
        let noise = image::RgbImage::from_fn(48, 40, |x, y| image::Rgb([((x * 37 + y * 91 + i * 13) % 251) as u8; 3]));
        noise.save(desk.join(format!("r_{i:02}.png"))).unwrap();
    }
    let (_, notes, psnr) = found("--force");
    assert!(psnr < Some(20.0) && notes.contains("20 dB would be fair"), "{notes}");
}

/// The original code writes the size of its images and whether it held out frames.
#[test]
fn cfg_args_say_which_frames_were_trained_on_and_at_which_size() {
    let desk = desk();
    write_transforms(&desk.join("transforms.json"), &around(2.2, (0..12).map(|i| 0.5 * f64::from(i)))).unwrap();
    photograph(&desk, 0.0);
    let said = |settings: &str| {
        desk.write("cfg_args", format!("Namespace({settings}, white_background=False)"));
        desk.said(&format!("{RUN} -o x.oct"))
    };
    assert!(said("eval=True, resolution=-1").contains("is held out"));
    assert!(said("eval=False, resolution=1").contains("12 cameras of 12 frames"));
    assert!(said("resolution=2").contains("--resolution 24x20"));
}
