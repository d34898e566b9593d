//! `depth` and `measure`: maps, points and lengths of a ball whose surface is known.

use std::collections::BTreeMap;

use glam::DVec3;
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Tracer, render_view};
use octobayes_data::write_transforms;
use serde_json::Value;

use crate::program::Desk;

const SIDE: u32 = 48;
/// Of the ball, scene units.
const RADIUS: f64 = 0.5;
const SCENE: &str = "scene:ball --cameras cameras.json --noise 0.03";

/// Six cameras on one side of a ball, with their images, in a folder.
fn desk() -> Desk {
    let desk = Desk::empty();
    let ball = ClosedForm::ball();
    let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
    let tracer = Tracer { field: &ball, marcher, background: glam::Vec3::ONE };
    let camera = |i: u32| {
        let azimuth = 0.35 * (f64::from(i) - 2.5);
        let eye = 3.0 * DVec3::new(azimuth.cos(), azimuth.sin(), 0.2);
        (format!("views/p_{i}.png"), Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, [SIDE; 2]))
    };
    let cameras: Vec<(String, Camera)> = (0..6).map(camera).collect();
    write_transforms(&desk.join("cameras.json"), &cameras).unwrap();
    std::fs::create_dir(desk.join("views")).unwrap();
    for (name, camera) in &cameras {
        let view = render_view(&tracer, camera, 0.5, &[], &Silent).unwrap();
        let color = |x, y| view.pixels[(y * SIDE + x) as usize].color.to_array().map(|v| (255.0 * v).round() as u8);
        image::RgbImage::from_fn(SIDE, SIDE, |x, y| image::Rgb(color(x, y))).save(desk.join(name)).unwrap();
    }
    desk
}

/// A map of 16 bits.
fn map(desk: &Desk, name: &str) -> Vec<f64> {
    let image = image::open(desk.join(name)).unwrap();
    assert_eq!((image.width(), image.height(), image.color()), (SIDE, SIDE, image::ColorType::L16), "{name}");
    image.into_luma16().into_raw().into_iter().map(f64::from).collect()
}

fn trust(desk: &Desk, name: &str) -> Vec<u8> {
    image::open(desk.join(name)).unwrap().into_luma8().into_raw()
}

/// Columns of a CSV by name, for its rows.
fn rows(text: &str) -> Vec<BTreeMap<String, String>> {
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<String>>());
    let head = lines.next().unwrap();
    lines.map(|row| head.iter().cloned().zip(row).collect()).collect()
}

#[test]
fn maps_hold_the_true_depth_its_deviation_and_why_it_is_not_trusted() {
    let desk = desk();
    let said = desk.said(&format!("depth {SCENE} -o out --exr"));
    assert!(said.contains("% trusted") && said.contains("scene units (in the median"), "{said}");
    assert!(!said.contains("field alone"), "the images are there: {said}");
    let camera = |i: u32| {
        let azimuth = 0.35 * (f64::from(i) - 2.5);
        let eye = 3.0 * DVec3::new(azimuth.cos(), azimuth.sin(), 0.2);
        Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.6, [SIDE; 2])
    };
    let table = rows(&desk.text("out/quality.csv"));
    assert_eq!(table.len(), 6);
    for i in 0..6 {
        let name = |end: &str| format!("out/p_{i}.{end}.png");
        let (depth, sigma, trust) =
            (map(&desk, &name("depth")), map(&desk, &name("sigma")), trust(&desk, &name("trust")));
        let mut trusted = Vec::new();
        for k in 0..(SIDE * SIDE) as usize {
            let [x, y] = [k % SIDE as usize, k / SIDE as usize].map(|n| n as f64 + 0.5);
            let ray = camera(i).ray(x, y);
            let (b, c) = (ray.origin.dot(ray.direction), ray.origin.length_squared() - RADIUS * RADIUS);
            let root = b * b - c;
            assert_eq!(trust[k] == 0, depth[k] == 0.0, "{k}");
            assert_eq!(sigma[k] == 0.0, depth[k] == 0.0, "{k}");
            if root > 0.02 {
                let truth = 1000.0 * (-b - root.sqrt());
                // Its density rises over 0.04 around the radius.
                assert!((-40.0..60.0).contains(&(depth[k] - truth)), "{i} {k}: {} for {truth}", depth[k]);
            } else if root < -0.05 {
                assert_eq!(trust[k], 0, "{i} {k}: beside the ball");
            }
            if trust[k] == 255 {
                trusted.push(sigma[k] / 1000.0);
            }
        }
        assert!(trusted.len() > 200, "{} of view {i}", trusted.len());
        trusted.sort_unstable_by(f64::total_cmp);
        // A map's step is a thousandth.
        let found: f64 = table[i as usize]["median_sigma"].parse().unwrap();
        assert!((found - trusted[trusted.len() / 2]).abs() < 1.1e-3, "{found}");
        let share: f64 = table[i as usize]["trusted"].parse().unwrap();
        let surface = trust.iter().filter(|grey| **grey > 0).count();
        assert!((share - trusted.len() as f64 / surface as f64).abs() < 1e-5);
        assert!(trust.iter().all(|grey| [0, 64, 128, 192, 255].contains(grey)));
        assert!(desk.join(format!("out/p_{i}.exr")).is_file());
    }
    // The outermost views show a part of the ball that no three others do.
    let never = |i: usize| table[i]["trusted"].parse::<f64>().unwrap();
    assert!(never(0) < never(2) && never(5) < never(3), "{table:?}");
    let page = desk.text("out/report.html");
    assert!(page.contains("three or more training cameras agree") && page.contains("<svg") && !page.contains("http"));
    assert!(page.contains("p_0.png") && page.contains("data:image/jpeg;base64,"));
}

#[test]
fn points_lie_on_the_ball_and_know_how_many_views_agree() {
    let desk = desk();
    desk.good(&format!("depth {SCENE} -o out --points 1500 --metres-per-unit 2"));
    let bytes = desk.bytes("out/points.ply");
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
    let count: usize = head.lines().find_map(|line| line.strip_prefix("element vertex ")).unwrap().parse().unwrap();
    assert!((700..=1500).contains(&count), "{count}");
    assert!(head.contains("property float scalar_sigma_m") && head.contains("property float scalar_views"), "{head}");
    let row = 6 * 4 + 3 + 2 * 4;
    assert_eq!(bytes.len(), end + count * row);
    for point in bytes[end..].chunks_exact(row) {
        let float = |at: usize| f64::from(f32::from_le_bytes(point[at..at + 4].try_into().unwrap()));
        let [x, normal] = [0, 12].map(|at| DVec3::new(float(at), float(at + 4), float(at + 8)));
        let radius = x.length() / 2.0;
        assert!((RADIUS - 0.06..RADIUS + 0.04).contains(&radius), "{radius}");
        assert!(normal == DVec3::ZERO || normal.dot(x.normalize()) > 0.5, "{normal} at {x}");
        let (sigma, views) = (float(27), float(31));
        assert!(sigma > 1e-4 && sigma < 0.5 && (3.0..=6.0).contains(&views), "{sigma} {views}");
    }
}

#[test]
fn units_scale_lengths_and_an_overflow_is_refused() {
    let desk = desk();
    desk.good(&format!("depth {SCENE} -o a --photographs 2, --no-images"));
    let of = |folder: &str| -> Value {
        let run = "depth scene:ball a/field.oct --cameras cameras.json --photographs 2, --no-images";
        desk.json(&format!(
            "{run} -o {folder} {}",
            if folder == "b" { "--metres-per-unit 3" } else { "--known 0,0,0,0,-0.5,0,1.5" }
        ))
    };
    let (b, c) = (of("b"), of("c"));
    assert_eq!((b["unit"].as_str(), b["images"].as_bool()), (Some("m"), Some(false)));
    assert_eq!(b["photographs"], c["photographs"], "two ways to say the same");
    let plain = rows(&desk.text("a/quality.csv"));
    let sigma = |text: &str| text.parse::<f64>().unwrap();
    let [in_units, in_metres] = [sigma(&plain[0]["median_sigma"]), b["photographs"][0]["sigma"][0].as_f64().unwrap()];
    assert!((in_metres / in_units - 3.0).abs() < 1e-3, "{in_units} {in_metres}");
    assert!(rows(&desk.text("b/quality.csv"))[0].contains_key("median_sigma_m"));
    let [depth, metres] = ["a/p_2.depth.png", "b/p_2.depth.png"].map(|name| map(&desk, name));
    assert!(depth.iter().zip(&metres).all(|(a, b)| (3.0 * a - b).abs() <= 2.0));
    // Along the optical axis depths are shorter, but in the middle.
    desk.good("depth scene:ball a/field.oct --cameras cameras.json --photographs 2, --no-images -o z --z-depth");
    let z = map(&desk, "z/p_2.depth.png");
    assert!(depth.iter().zip(&z).all(|(d, z)| *z <= *d && *z >= 0.97 * *d), "an angle of at most 17 degrees");
    assert!(depth.iter().zip(&z).any(|(d, z)| *z < *d));
    let run = "depth scene:ball a/field.oct --cameras cameras.json -o d --unit 0.00001";
    let (code, out, error) = desk.run(run);
    assert_eq!((code, &*out), (Some(2), ""));
    assert!(
        error.contains("--unit: expected steps of 0.0001 scene units") && error.contains("16 bits end at"),
        "{error}"
    );
    assert!(!desk.join("d/p_0.depth.png").exists());
    desk.refused("depth scene:ball a/field.oct --cameras cameras.json -o e --noise 0.1", &["--noise", "beside FIELD"]);
    let error = desk.run("depth scene:ball a/field.oct --cameras cameras.json -o e --photographs 3,9").2;
    assert!(error.contains("numbers from 0 to 5, of 6 training cameras"), "{error}");
    let (code, _, error) = desk.run("depth scene:ball a/field.oct --cameras cameras.json -o e --known 0,0,0,0,0,0,1");
    assert!(code == Some(2) && error.contains("two different points"), "{error}");
    // Maps of another program are not replaced.
    std::fs::create_dir(desk.join("f")).unwrap();
    desk.write("f/p_0.depth.png", "mine");
    desk.refused("depth scene:ball a/field.oct --cameras cameras.json -o f", &["maps of other programs"]);
}

#[test]
fn lengths_between_points_on_the_ball() {
    let desk = desk();
    desk.good(&format!("depth {SCENE} -o out --photographs 1"));
    let measure = "measure scene:ball out/field.oct";
    // Two points of the front, a little before the surface.
    let ends = "0.42,0.25,0.12 0.42,-0.25,0.12";
    let line = desk.good(&format!("{measure} {ends} --cameras cameras.json"));
    assert!(line.ends_with(" (90 %)\n") && line.contains(" scene units ± "), "{line}");
    let found = desk.json(&format!("{measure} {ends} --cameras cameras.json"));
    let number = |key: &str| found[key].as_f64().unwrap();
    let (length, sigma) = (number("length"), number("sigma"));
    assert!((length - 0.5).abs() < 0.05 && sigma > 1e-3 && sigma < 0.1, "{found}");
    let interval = [0, 1].map(|k| found["interval_90"][k].as_f64().unwrap());
    assert!((0.5 * (interval[1] - interval[0]) / sigma - 1.645).abs() < 1e-9 && interval[0] < length);
    assert!(found["points"][0]["trust"] == "trusted" && number("correlation").abs() < 0.2, "{found}");
    // One point twice: its own length is known, whatever its depth.
    let same = desk.json(&format!("{measure} 0.42,0.25,0.12 0.42,0.25,0.12 --cameras cameras.json"));
    assert!(same["length"].as_f64().unwrap() < 1e-9 && same["correlation"].as_f64().unwrap() > 0.999, "{same}");
    // In metres, from the field that it computes itself.
    let metres = desk.json(&format!("measure {SCENE} 4.2,2.5,1.2 4.2,-2.5,1.2 --metres-per-unit 10"));
    assert!((metres["length"].as_f64().unwrap() / length - 10.0).abs() < 1e-6, "{metres}");
    assert_eq!(metres["unit"], "m");
    // In the air, behind the ball, and beside everything; with a minus in front.
    let refused =
        |a: &str, words: &[&str]| desk.refused(&format!("{measure} {a} 0.42,0.25,0.12 --cameras cameras.json"), words);
    refused("-0.1,0.8,0.1", &["A: expected a point on a surface", "-0.100,0.800,0.100"]);
    refused("0.9,0.0,0.18", &["the nearest surface lies", "behind it"]);
    refused("0.0,0.0,0.0", &["in front of it"]);
    refused("0,0,900", &["no training camera sees anything"]);
    refused("0,0", &["expected x,y,z"]);
}

#[test]
fn splats_have_maps_too() {
    let desk = crate::splats::desk();
    let said = desk.said("depth scene.ply --cameras transforms.json --noise 0.05 --background black -o out");
    assert!(said.contains("% trusted") && said.contains("field alone"), "{said}");
    let quality = rows(&desk.text("out/quality.csv"));
    assert_eq!(quality.len(), 4);
    assert!(quality.iter().all(|row| row["median_sigma"].parse::<f64>().unwrap() > 0.0), "{quality:?}");
    let (code, _, error) = desk.run("depth scene.ply --cameras transforms.json -o other");
    assert!(code == Some(2) && error.contains("--noise"), "without images the noise is not known: {error}");
}

/// Colours that are off by as much everywhere are the noise of a model that does not store it.
#[test]
fn without_a_noise_the_images_beside_the_cameras_have_it() {
    let desk = desk();
    const OFF: f64 = 30.0;
    for i in 0..6 {
        let path = desk.join(format!("views/p_{i}.png"));
        let mut image = image::open(&path).unwrap().into_rgb8();
        // Where it stays within the range.
        image
            .pixels_mut()
            .for_each(|pixel| pixel.0[0] = pixel.0[0].checked_sub(OFF as u8).unwrap_or(pixel.0[0] + OFF as u8));
        image.save(&path).unwrap();
    }
    let run =
        "uncertainty scene:ball --cameras cameras.json --scale data --level 4 --rays 2000 --occupancy 32 -o f.oct";
    let said = desk.said(run);
    let noise = desk.json("info f.oct")["record"]["scale"]["data"]["noise"].as_f64().unwrap();
    // One channel of three; colours of images are rounded by up to half a step.
    let expected = OFF / 255.0 / 3_f64.sqrt();
    assert!((noise / expected - 1.0).abs() < 0.5 / OFF + 1e-3, "{noise} instead of {expected}");
    assert!(said.contains("--noise 0.06") && said.contains("dB"), "{said}");
}
