//! Splats of lego that others trained, beside true depth of held-out views.

use std::path::Path;

use glam::DVec3;
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_data::Views;
use octobayes_splats::Splats;
use octobayes_train::Shot;

use common::program::Program;
use common::surface::Place;

use crate::judge::{TrueView, Truth};
use crate::methods::Judged;

/// A splat is in the air if it is nearer than the surfaces around its pixel by more than this: the true depths have
/// steps of 0.03. Scene units.
const SLACK: f64 = 0.05;
/// Pixels to either side in which surfaces are looked for.
const AROUND: i64 = 2;
/// Depth of a black pixel, scene units.
const FARTHEST: f64 = 8.0;
/// Longest edge of the bulldozer's box, scene units.
const LENGTH: f64 = 2.3;

pub const MODELS: [(&str, &str); 3] =
    [("lego_10views_5k_sh2", "10 views"), ("lego_half12_6k_sh2", "12 of one side"), ("lego_15k_sh3", "100 views")];

pub fn settings() -> String {
    format!(
        "40 held-out views of 400 × 400 pixels. A splat is in the air if one of them shows it more than {SLACK} scene \
         units in front of all surfaces within {AROUND} pixels, or where there are none."
    )
}

/// A model of lego.
pub fn judged(model: &str) -> Result<Judged> {
    let data = Program::data()?;
    let file = |end: &str| data.join(format!("splats-trained/{model}{end}"));
    let splats = Splats::read(&file(".ply"))?;
    let cameras = Views::read(&file("_transforms.json"), None)?.cameras();
    let folder = data.join("nerf-lego-400");
    let frames = Views::read(&folder.join("transforms_test.json"), None)?.frames;
    let views: Vec<TrueView> = frames
        .iter()
        .map(|frame| {
            let name = Path::new(&frame.name).file_name().unwrap_or_default().to_string_lossy().into_owned();
            let stem = name.trim_end_matches(".png");
            let colors = picture(&folder.join(format!("test/{stem}.png")))?;
            let depths = picture(&folder.join(format!("test/{stem}_depth_0001.png")))?;
            let share = |value: u8| f64::from(value) / 255.0;
            let over_white = |[r, g, b, a]: [u8; 4]| {
                share(a) * DVec3::new(share(r), share(g), share(b)) + DVec3::splat(1.0 - share(a))
            };
            let is_object: Vec<bool> = colors.iter().map(|pixel| pixel[3] > 0).collect();
            let distance = |(depth, is): (&[u8; 4], &bool)| {
                if *is { FARTHEST * (1.0 - share(depth[0])) } else { f64::INFINITY }
            };
            let distances = depths.iter().zip(&is_object).map(distance).collect();
            let colors = colors.iter().copied().map(over_white).collect();
            Ok(TrueView { camera: frame.camera, colors, distances, is_object })
        })
        .collect::<Result<_>>()?;
    let is_free = |x: DVec3| views.iter().any(|view| shows_empty(view, x));
    let place = |x: &glam::Vec3| if is_free(x.as_dvec3()) { Place::Air } else { Place::Surface };
    let places = splats.means().iter().map(place).collect();
    Ok(Judged { splats, cameras, places, truth: Truth { held_out: views, slack: SLACK, length: LENGTH } })
}

/// The images that a model was trained on.
pub fn shots(cameras: &[Camera]) -> Result<Vec<Shot>> {
    let path = Program::data()?.join("nerf-lego-400/transforms_train.json");
    let mut frames = Views::read(&path, cameras.first().map(|camera| camera.resolution))?.frames;
    frames.retain(|frame| cameras.iter().any(|own| own.position.distance(frame.camera.position) < 1e-3));
    if frames.len() != cameras.len() {
        let expected = format!("the {} cameras of the model", cameras.len());
        return Err(Error::malformed(&path, "frames", expected, frames.len().to_string()));
    }
    Shot::load(&frames, |camera| camera.resolution, &Silent)
}

/// Pixels of red, green, blue and alpha.
fn picture(path: &Path) -> Result<Vec<[u8; 4]>> {
    let image = image::open(path).map_err(|e| Error::malformed(path, "picture", "a PNG", e.to_string()))?;
    Ok(image.to_rgba8().pixels().map(|pixel| pixel.0).collect())
}

/// Whether a view shows that a place is in the air: it is nearer than all surfaces around its pixel, or there are none.
fn shows_empty(view: &TrueView, x: DVec3) -> bool {
    let Some((at, _)) = view.camera.project_inside(x) else { return false };
    let [width, height] = view.camera.resolution.map(i64::from);
    let [column, row] = at.map(|v| v.floor() as i64);
    let is_within = |v: i64, side: i64| v >= AROUND && v < side - AROUND;
    if !is_within(column, width) || !is_within(row, height) {
        return false;
    }
    let around = |v: i64| v - AROUND..=v + AROUND;
    let distances = around(row).flat_map(|y| around(column).map(move |c| (y * width + c) as usize));
    let nearest = distances.map(|i| view.distances[i]).fold(f64::INFINITY, f64::min);
    x.distance(view.camera.position) < nearest - SLACK
}
