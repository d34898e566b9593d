//! `uncertainty --images`, from the command line.

use crate::program::Desk;
use octobayes::field::{ClosedForm, RadianceField, TrainedField};
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Tracer, render_view};
use octobayes::uncertainty::{Conformal, Residuals};
use octobayes_data::Views;

const SIDE: u32 = 48;
/// What the images are off by in one channel, of 255.
const OFF: f64 = 20.0;

const RUN: &str = "uncertainty scene:ball --cameras cameras.json --level 4 --rays 4000 --resolution 48 --occupancy 32";
const DATA: &str = "--scale data --noise 0.0316 --covariance block --keep-sums";

/// Two views of a ball from opposite sides; images of them whose red is off, in a folder beside.
fn views() -> Desk {
    let desk = Desk::empty();
    let pose = |x: f64| [[0.0, 0.0, x, 3.0 * x], [x, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let frame = |name, x| serde_json::json!({ "file_path": name, "transform_matrix": pose(x) });
    let frames = [frame("./a", 1.0), frame("./b", -1.0)];
    let file = serde_json::json!({ "camera_angle_x": 0.7, "w": SIDE, "h": SIDE, "frames": frames });
    desk.write("cameras.json", file.to_string());
    let images = desk.join("pictures");
    std::fs::create_dir(&images).unwrap();
    let ball = ClosedForm::ball();
    let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
    let tracer = Tracer { field: &ball, marcher, background: glam::Vec3::ONE };
    for (frame, name) in Views::read(&desk.join("cameras.json"), None).unwrap().frames.iter().zip(["a.png", "b.png"]) {
        let view = render_view(&tracer, &frame.camera, ball.pixel_offset(), &[], &Silent).unwrap();
        let image = image::RgbImage::from_fn(SIDE, SIDE, |x, y| {
            let color = 255.0 * view.pixels[(y * SIDE + x) as usize].color;
            // Where it stays within the range.
            let red = if color.x < 128.0 { color.x + OFF } else { color.x - OFF };
            image::Rgb([red, color.y, color.z].map(|value| value.round() as u8))
        });
        image.save(images.join(name)).unwrap();
    }
    desk
}

#[test]
fn deviations_of_depth_count_what_images_show_and_the_model_does_not() {
    let desk = views();
    desk.good(&format!("{RUN} {DATA} -o plain.oct"));
    desk.good(&format!("{RUN} {DATA} --images pictures -o joined.oct"));
    let read = |name: &str| desk.field(name);
    let (plain, joined) = (read("plain.oct"), read("joined.oct"));
    assert!(plain.residuals().is_none() && plain.deviations() == joined.deviations());

    // One channel of three is off by as much everywhere; pictures round by up to half a step.
    let residuals = joined.residuals().unwrap();
    let m = OFF / 255.0 / 3_f64.sqrt();
    assert!((residuals.mean() / m - 1.0).abs() < 0.5 / OFF, "{} and {m}", residuals.mean());
    assert_eq!(residuals.level(), 4);
    let json = desk.json("info joined.oct");
    assert_eq!(json["residuals"]["root_mean_square"].as_f64(), Some(residuals.mean()));
    // From opposite sides, they show no place alike but at the rim.
    let spread = joined.color_spread().unwrap();
    assert_eq!((json["color_spread"]["root_mean_square"].as_f64(), spread.level()), (Some(spread.mean()), 4));
    assert!(plain.color_spread().is_none());

    // Along a ray to the front, on top of what was there.
    let deviation = |field: &str| -> f64 {
        let csv = desk.good(&format!("query {field} --ray 3,0.05,0.1,-1,0,0 --model scene:ball"));
        let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
        let column = rows[0].iter().position(|name| *name == "depth_error").unwrap();
        rows[1][column].parse().unwrap()
    };
    let edge = ClosedForm::ball().bounds().longest_edge();
    let (before, after) = (deviation("plain.oct"), deviation("joined.oct"));
    let added = (after * after - before * before).sqrt();
    let expected = Residuals::LENGTH_SHARE * edge * m;
    assert!((added / expected - 1.0).abs() < 0.5 / OFF, "{added} and {expected}");

    // Without the matrices, by one thread, of two seeds: it stays what it is.
    desk.good(&format!("{RUN} {DATA} --images pictures --threads 1 --seed 7 -o other.oct"));
    assert!(read("other.oct").residuals() == Some(residuals) && read("other.oct").color_spread() == Some(spread));
    desk.good("merge joined.oct other.oct --keep-sums -o both.oct");
    assert!(read("both.oct").residuals() == Some(residuals));
    assert!(joined.clone().without_sums().residuals() == Some(residuals));
    // One that knows it is enough.
    desk.good("merge plain.oct other.oct -o some.oct");
    assert!(read("some.oct").residuals() == Some(residuals) && read("some.oct").color_spread() == Some(spread));
}

#[test]
fn it_stays_with_what_it_holds_for() {
    let desk = views();
    // Below a folder of their own, as COLMAP's are.
    std::fs::create_dir(desk.join("set")).unwrap();
    std::fs::rename(desk.join("pictures"), desk.join("set/images")).unwrap();
    desk.good(&format!("{RUN} {DATA} --images set -o joined.oct"));
    let joined = desk.field("joined.oct");
    let residuals = joined.residuals().unwrap().clone();
    // An interval was of other deviations.
    let conformal = Conformal { probability: 0.9, factor: 1.5, pixels: 100, views: 2 };
    let calibrated = joined.clone().with_conformal(conformal);
    assert!(calibrated.conformal().is_some());
    assert!(calibrated.with_residuals(residuals.clone()).unwrap().conformal().is_none());
    // The scale of the paper has no lengths.
    let lambda = joined.record().lambda;
    let paper = joined.clone().with_lambda(2.0 * lambda).unwrap();
    assert!(paper.residuals().is_none());
    assert!(paper.with_residuals(residuals.clone()).unwrap_err().to_string().contains("the scale of its data"));
    // Another lattice.
    desk.good(&format!("{} {DATA} -o fine.oct", RUN.replace("--level 4", "--level 5")));
    let said = desk.field("fine.oct").with_residuals(residuals).unwrap_err().to_string();
    assert!(said.contains("on the field's lattice"), "{said}");
}

#[test]
fn what_it_needs_is_said() {
    let desk = views();
    let images = format!("{RUN} {DATA} -o x.oct --images");
    desk.refused(&format!("{RUN} --images pictures -o x.oct"), &["--images", "--scale data"]);
    desk.refused(&format!("{images} ."), &["training images", "././a.png"]);
    // What is read is not written.
    desk.refused(&format!("{images} pictures --dump-samples pictures/a.png"), &["--dump-samples", "a.png"]);
    // Images of another size.
    image::RgbImage::new(8, 8).save(desk.join("pictures/b.png")).unwrap();
    desk.refused(&format!("{images} pictures"), &["b.png", "48 x 48", "8 x 8"]);
}
