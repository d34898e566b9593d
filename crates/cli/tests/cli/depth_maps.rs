//! Depth maps, from the command line: values that are no measurements, and which map belongs to which frame.

use std::path::Path;

use crate::program::Desk;
use exr::image::IntoSample;
use exr::prelude::{Image, SpecificChannels, Vec2, WritableImage, f16};
use glam::{DVec3, Vec3};
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Tracer, render_view};
use octobayes_data::write_transforms;
use serde_json::Value;

const SIDE: u32 = 32;
/// Depth of white in PNG.
const WHITE: f64 = 6.0;
const UNCERTAINTY: &str = "uncertainty scene:ball --cameras cameras.json --views all --level 4 --rays 4000 \
    --occupancy 32 --scale data --noise 0.0316 --keep-sums";

/// How a folder of depth maps is stored, and the value where there is no measurement.
#[derive(Debug, Clone, Copy)]
enum Store {
    F32(f32),
    F16(f16),
    Png(u16),
}

fn write_exr<T: IntoSample>(path: &Path, depth: &[Option<f64>], stored: impl Fn(Option<f64>) -> T + Sync) {
    let side = SIDE as usize;
    let value = |at: Vec2<usize>| (stored(depth[at.1 * side + at.0]),);
    let channels = SpecificChannels::build().with_channel("Z").with_pixel_fn(value);
    Image::from_channels((side, side), channels).write().to_file(path).unwrap();
}

impl Store {
    /// Writes the map of a picture of this name; `depth` has `None` where there is no measurement.
    fn write(self, folder: &Path, name: &str, depth: &[Option<f64>]) {
        std::fs::create_dir_all(folder).unwrap();
        let exr = folder.join(Path::new(name).file_name().unwrap()).with_extension("exr");
        match self {
            Self::F32(nothing) => write_exr(&exr, depth, |d| d.map_or(nothing, |d| d as f32)),
            Self::F16(nothing) => write_exr(&exr, depth, |d| d.map_or(nothing, f16::from_f64)),
            Self::Png(nothing) => {
                let at = |x: u32, y: u32| depth[(y * SIDE + x) as usize];
                let value = |x, y| image::Luma([at(x, y).map_or(nothing, |d| (d / WHITE * 65535.0).round() as u16)]);
                image::ImageBuffer::from_fn(SIDE, SIDE, value).save(exr.with_extension("png")).unwrap();
            }
        }
    }
}

/// A view of the ball: its picture, and what a depth sensor measures, which is off and has gaps.
struct Shot {
    name: String,
    depth: Vec<Option<f64>>,
}

/// Cameras on a half circle around a ball with opaque pictures of these names; depth of the ball, from which a sensor
/// is off by up to 0.3. It measures nothing where there is no surface, nor in a stripe of the surface.
fn shots(folder: &Path, names: &[&str]) -> Vec<Shot> {
    let ball = ClosedForm::ball();
    let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
    let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
    let cameras = ClosedForm::half_circle(names.len() as u32, [SIDE; 2]);
    let named: Vec<(String, Camera)> = names.iter().map(|name| (*name).to_string()).zip(cameras).collect();
    write_transforms(&folder.join("cameras.json"), &named).unwrap();
    let shot = |(name, camera): &(String, Camera)| {
        let view = render_view(&tracer, camera, 0.5, &[], &Silent).unwrap();
        let color = |x, y| {
            let color: DVec3 = 255.0 * view.pixels[(y * SIDE + x) as usize].color;
            image::Rgb(color.to_array().map(|value| value.round() as u8))
        };
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::RgbImage::from_fn(SIDE, SIDE, color).save(path).unwrap();
        let depth = |i: usize| {
            let (pixel, x) = (&view.pixels[i], i % SIDE as usize);
            let is_measured = pixel.opacity > 0.5 && !(14..17).contains(&x);
            is_measured.then_some(pixel.median_depth + 0.01 * (x as f64 - 2.0))
        };
        Shot { name: name.clone(), depth: (0..view.pixels.len()).map(depth).collect() }
    };
    named.iter().map(shot).collect()
}

/// Four views, and a field.
fn desk() -> (Desk, Vec<Shot>) {
    let desk = Desk::empty();
    let shots = shots(&desk, &["a.png", "b.png", "c.png", "d.png"]);
    desk.good(&format!("{UNCERTAINTY} -o f.oct"));
    (desk, shots)
}

const EXR: &str = "--depth-pattern {}.exr";

fn evaluate(maps: &str, options: &str) -> String {
    format!("evaluate scene:ball f.oct --cameras cameras.json --views all --depth {maps} {options}")
}

fn calibrate(maps: &str, options: &str) -> String {
    format!("{} --calibrate cal.oct", evaluate(maps, options))
}

fn depth_error(desk: &Desk, maps: &str, options: &str) -> Value {
    desk.json(&evaluate(maps, options))["depth_error"].clone()
}

#[test]
fn values_that_are_no_measurements_change_no_figure() {
    let (desk, shots) = desk();
    let families = [
        (Store::F32(0.0), [f32::MAX, f32::NAN, -1.0].map(Store::F32).to_vec()),
        (Store::F16(f16::ZERO), vec![Store::F16(f16::from_f32(1e10))]),
        (Store::Png(0), vec![Store::Png(u16::MAX)]),
    ];
    let measured = shots.iter().flat_map(|shot| &shot.depth).flatten().count();
    let share = 100.0 - 100.0 * measured as f64 / f64::from(4 * SIDE * SIDE);
    let note = format!("note: {share:.1} % of depth readings are not measurements (");
    let judge = |store: Store| {
        shots.iter().for_each(|shot| store.write(&desk.join("maps"), &shot.name, &shot.depth));
        let options = match store {
            Store::Png(_) => format!("--depth-pattern {{}}.png --depth-encoding 0,{WHITE}"),
            _ => EXR.into(),
        };
        let [judged, calibrated] = [evaluate("maps", &options), calibrate("maps", &options)].map(|args| {
            let (code, out, said) = desk.run(&format!("{args} --json"));
            assert!(code == Some(0) && said.matches(&note).count() == 1, "{store:?}: {said}, not {note}");
            let found: Value = serde_json::from_str(&out).unwrap();
            assert_eq!(found["depth_readings"]["measured"], measured, "{store:?}");
            found
        });
        let figures = ["pixels", "depth_error", "readings", "baselines", "psnr"].map(|key| judged[key].clone());
        (figures, ["conformal", "views_left_out"].map(|key| calibrated["calibrated"][key].clone()))
    };
    for (zero, others) in families {
        let expected = judge(zero);
        assert!(expected.0[1]["median"].as_f64().unwrap() > 0.05, "{expected:?}");
        others.into_iter().for_each(|store| assert_eq!(judge(store), expected, "{store:?}"));
    }
}

#[test]
fn depths_of_which_nearly_none_can_be_right_are_refused() {
    let (desk, shots) = desk();
    // Millimetres; and as far behind the ball as the box is wide and more, where cameras may still see.
    for (maps, change, reason) in [
        ("millimetres", &(|depth| 1000.0 * depth) as &dyn Fn(f64) -> f64, "100.0 %"),
        ("behind", &|depth| depth + 2.5, "half of the depths"),
    ] {
        for shot in &shots {
            let depth: Vec<Option<f64>> = shot.depth.iter().map(|depth| depth.map(change)).collect();
            Store::F32(0.0).write(&desk.join(maps), &shot.name, &depth);
        }
        for command in [evaluate(maps, EXR), calibrate(maps, EXR)] {
            desk.refused(&command, &[&format!("{maps}: depth maps"), reason, "--depth-encoding"]);
        }
    }
}

/// Frames of one base name in two folders have two depth maps.
#[test]
fn maps_belong_to_frames_by_their_folders() {
    let desk = Desk::empty();
    let names = ["images/front/0.png", "images/front/1.PNG", "images/back/0.png", "images/back/1.PNG"];
    let shots = shots(&desk, &names);
    desk.good(&format!("{UNCERTAINTY} -o f.oct"));
    for (shot, alone) in shots.iter().zip(["0.png", "1.png", "2.png", "3.png"]) {
        let store = Store::F32(0.0);
        let below = Path::new(&shot.name).parent().unwrap();
        store.write(&desk.join("whole").join(below), &shot.name, &shot.depth);
        store.write(&desk.join("depth").join(below.file_name().unwrap()), &shot.name, &shot.depth);
        store.write(&desk.join("alone"), alone, &shot.depth);
    }
    let expected = depth_error(&desk, "depth", EXR);
    assert_eq!(depth_error(&desk, "whole", EXR), expected);
    // The same cameras, each with a name of its own.
    let file = desk.text("cameras.json");
    let mut alone = file.clone();
    for (name, number) in names.iter().zip(0..) {
        std::fs::copy(desk.join(name), desk.join(format!("{number}.png"))).unwrap();
        alone = alone.replace(name, &format!("{number}.png"));
    }
    desk.write("cameras.json", alone);
    assert_eq!(depth_error(&desk, "alone", EXR), expected);
    desk.write("cameras.json", &file);

    let front = evaluate("depth/front", EXR);
    // Whether the other frame is judged, too, or not.
    for command in [&front, &front.replace("--views all", "--views 3"), &calibrate("depth/front", EXR)] {
        desk.refused(command, &["depth/front: depth maps", "`images/front/0.png` and `images/back/0.png`"]);
    }
    // A map that is nowhere.
    std::fs::remove_file(desk.join("depth/back/0.exr")).unwrap();
    desk.refused(&evaluate("depth", EXR), &["images/back/0.png", "back/0.exr"]);
}

/// The extension of a map may be written in capitals, in the pattern and on the disk.
#[test]
fn extensions_are_matched_in_any_case() {
    let (desk, shots) = desk();
    std::fs::create_dir(desk.join("capitals")).unwrap();
    for shot in &shots {
        Store::F32(0.0).write(&desk.join("maps"), &shot.name, &shot.depth);
        let name = shot.name.replace(".png", ".exr");
        std::fs::copy(desk.join("maps").join(&name), desk.join("capitals").join(name.replace("exr", "EXR"))).unwrap();
    }
    let expected = depth_error(&desk, "maps", EXR);
    for (maps, pattern) in [("maps", "{}.EXR"), ("capitals", "{}.EXR"), ("capitals", "{}.exr")] {
        assert_eq!(depth_error(&desk, maps, &format!("--depth-pattern {pattern}")), expected, "{maps}/{pattern}");
    }
}

/// Names from a camera file may hold anything. None of it reaches the terminal as a command, nor a spreadsheet.
#[test]
#[cfg(unix)]
fn names_of_frames_are_text_on_terminals_and_in_spreadsheets() {
    let desk = Desk::empty();
    let names = ["=a\u{1b}[2J\u{1b}]0;x\u{7}\n.png", "+b\r.png", "-c\u{9b}1m.png", "@d.png"];
    let shots = shots(&desk, &names);
    desk.good(&format!("{UNCERTAINTY} -o =f.oct"));
    let is_plain = |text: &str| !text.chars().any(|c| c.is_control() && c != '\n');
    let shown = |args: &str| {
        let (code, out, err) = desk.run(&args.replace(" f.oct", " =f.oct"));
        assert!(is_plain(&out) && is_plain(&err), "{args}: {out:?} and {err:?}");
        (code, out, err)
    };
    std::fs::create_dir(desk.join("empty")).unwrap();
    let (code, _, err) = shown(&evaluate("empty", EXR));
    assert!(code == Some(2) && err.contains("=a\\u{1b}[2J"), "{err}");
    for shot in &shots {
        Store::F32(0.0).write(&desk.join("maps"), &shot.name, &shot.depth);
    }
    let (code, json, _) = shown(&evaluate("maps", &format!("{EXR} --csv curves.csv --json")));
    // JSON has the names as they are.
    let json: Value = serde_json::from_str(&json).unwrap();
    assert!(code == Some(0) && json["views"][0]["name"] == names[0], "{}", json["views"]);

    let cells = |file: &str| -> Vec<Vec<String>> {
        let records = csv::ReaderBuilder::new().has_headers(false).from_path(desk.join(file)).unwrap().into_records();
        records.map(|record| record.unwrap().iter().map(String::from).collect()).collect()
    };
    let is_formula =
        |cell: &&String| cell.starts_with(['=', '+', '-', '@', '\t', '\r']) && cell.parse::<f64>().is_err();
    let curves = cells("curves.csv");
    assert_eq!(curves[0].iter().find(is_formula), None);
    assert!(curves[0].iter().any(|name| name.starts_with("'=f ")), "{:?}", curves[0]);
    desk.good("export scene:ball =f.oct --cameras cameras.json -o report.csv");
    let report = cells("report.csv");
    assert_eq!(report.iter().flatten().find(is_formula), None);
    let cameras: Vec<&str> = report.iter().filter(|row| row[0] == "camera").map(|row| &*row[1]).collect();
    assert_eq!(cameras, names.map(|name| format!("'{name}")));
}

/// A covariance that is asked for is the one that is calibrated and kept.
#[test]
fn calibration_reads_the_covariance_that_it_is_told() {
    let (desk, shots) = desk();
    for shot in &shots {
        Store::F32(0.0).write(&desk.join("maps"), &shot.name, &shot.depth);
    }
    let calibrated = |field: &str, more: &str| {
        let args = calibrate("maps", EXR).replace("f.oct", field);
        desk.json(&format!("{args}{more}"))["calibrated"]["conformal"].clone()
    };
    let own = calibrated("f.oct", "");
    let expected = desk.field("cal.oct").record().covariance;
    desk.good(&format!("{UNCERTAINTY} --covariance block -o block.oct"));
    let block = calibrated("block.oct", "");
    assert!(own != block && desk.field("cal.oct").record().covariance != expected, "{own} and {block}");
    // U that is read off kept sums is not rounded to f32, as that of a file is.
    let again = calibrated("f.oct", " --covariance block");
    let factor = |of: &Value| of["factor"].as_f64().unwrap();
    assert!((factor(&again) / factor(&block) - 1.0).abs() < 1e-6, "{again} and {block}");
    assert_ne!(desk.field("cal.oct").record().covariance, expected);
    // Without its sums a field has one covariance.
    desk.good("export f.oct -o bare.oct");
    let args = calibrate("maps", EXR).replace("f.oct", "bare.oct");
    desk.refused(&format!("{args} --covariance block"), &["--keep-sums", "block"]);
}
