//! How cameras stand towards a box, by geometry alone.

use crate::geometry::{Aabb, Camera, Ray, inverted, opencv};
use crate::io::evenly;

/// Approximate number of rays, a thousandth of a default run's. The standard error of a fraction is at most 0.008, so
/// it is known to within 0.016 (two standard errors, at ½).
pub(super) const RAYS: usize = 4096;
/// Maximal number of cameras used, evenly spread over all.
const CAMERAS: usize = 512;
/// Fractions of rays below this are small. `crates/models/tests/data/sight_on_data.rs` has values for correct and wrong
/// settings of real models.
pub(super) const SMALL_SHARE: f64 = 0.05;
/// Fractions of cameras from this value on are large.
pub(super) const LARGE_SHARE: f64 = 0.25;
/// Distance of cameras that look at a scene from around it, in half diagonals of its box.
const USUAL_DISTANCE: f64 = 1.5;

/// The position of cameras relative to a box.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Framing {
    /// Number of rays.
    pub rays: u64,
    /// Fraction of them that pass through the box.
    pub meet_box: f64,
    /// Fraction of the cameras that look away from the box: they stand outside, and none of their rays meets it.
    pub looking_away: f64,
    /// Fraction of the rays that would meet the box if the cameras' axes were OpenCV's (y down, looking along +z).
    pub turned: f64,
    /// The same if the poses were world-to-camera, with OpenGL's or OpenCV's axes, whichever is more.
    pub inverted: f64,
    /// Mean distance of the cameras from the centre of the box, in half diagonals of the box.
    pub distance: f64,
}

/// A likely cause in words.
pub(super) const WORLD_TO_CAMERA: &str = "world-to-camera matrices in place of camera-to-world";

/// A camera and its rays.
pub(super) struct View {
    pub camera: Camera,
    pub rays: Vec<Ray>,
    /// Where on the image these are, pixels.
    pub points: Vec<[f64; 2]>,
}

/// About `count` rays, equally many from each camera. All cameras use the same low-discrepancy sequence
/// over the image.
pub(super) fn views(cameras: &[Camera], count: usize, pixel_offset: f64) -> Vec<View> {
    let used = cameras.len().min(CAMERAS);
    let each = count.div_ceil(used.max(1)).max(8);
    let view = |i: usize| {
        let camera = cameras[i * cameras.len() / used];
        let pixel =
            |n: usize, axis: usize| (evenly(n)[axis] * f64::from(camera.resolution[axis])).floor() + pixel_offset;
        let points: Vec<[f64; 2]> = (0..each).map(|n| [pixel(n, 0), pixel(n, 1)]).collect();
        View { camera, rays: points.iter().map(|&[x, y]| camera.ray(x, y)).collect(), points }
    };
    (0..used).map(view).collect()
}

impl Framing {
    /// Measures how `cameras` relate to `bounds`.
    #[must_use]
    pub fn from_cameras(cameras: &[Camera], bounds: &Aabb) -> Self {
        Self::from_views(&views(cameras, RAYS, 0.5), bounds)
    }

    pub(super) fn from_views(views: &[View], bounds: &Aabb) -> Self {
        let middle = 0.5 * (bounds.min() + bounds.max());
        let mut sums = [0.0; 6];
        for View { camera, rays, .. } in views {
            let meets = |ray: &Ray| bounds.clip(ray).is_some();
            // The share of the rays that meet the box if another camera took the picture.
            let share = |other: &Camera| {
                let axes = other.axes * camera.axes.transpose();
                let met = rays.iter().filter(|ray| meets(&Ray::new(other.position, axes * ray.direction))).count();
                met as f64 / rays.len() as f64
            };
            let met = share(camera);
            let [gl, cv] = inverted(camera).map(|other| share(&other));
            let turned = share(&opencv(camera));
            let distance = (camera.position - middle).length() / (0.5 * bounds.size().length());
            let of_view = [met, f64::from(u8::from(met == 0.0)), turned, gl, cv, distance];
            sums.iter_mut().zip(of_view).for_each(|(sum, value)| *sum += value);
        }
        let [meet_box, looking_away, turned, gl, cv, distance] = sums.map(|sum| sum / views.len().max(1) as f64);
        let rays = views.iter().map(|view| view.rays.len() as u64).sum();
        Self { rays, meet_box, looking_away, turned, inverted: gl.max(cv), distance }
    }

    /// Whether no ray meets the box.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.meet_box == 0.0
    }

    /// Whether few rays meet the box, or many cameras look away.
    #[must_use]
    pub fn is_below_threshold(&self) -> bool {
        self.meet_box < SMALL_SHARE || self.looking_away >= LARGE_SHARE
    }

    /// Describes what was measured.
    #[must_use]
    pub fn measured(&self) -> String {
        let [met, away] = [self.meet_box, self.looking_away].map(|share| 100.0 * share);
        format!("of {} rays {met:.1} % meet the model's box, {away:.0} % of the cameras look away from it", self.rays)
    }

    /// The likely causes, if little is seen.
    #[must_use]
    pub fn causes(&self) -> Option<String> {
        let [turned, inverted] = [self.turned, self.inverted].map(|share| 100.0 * share);
        let enough = (2.0 * self.meet_box).max(SMALL_SHARE);
        if !self.is_below_threshold() {
            None
        } else if self.inverted > enough.max(self.turned) {
            Some(format!("{WORLD_TO_CAMERA}: inverted, {inverted:.0} % of the rays meet the box"))
        } else if self.turned > enough {
            Some(format!("OpenCV's camera axes instead of OpenGL's: turned, {turned:.0} % of the rays meet the box"))
        } else if let Some(units) = self.units() {
            Some(units)
        } else {
            let distance = self.distance;
            Some(format!(
                "units, origin or axes of the cameras, which stand {distance:.1} half diagonals of the box from it"
            ))
        }
    }

    /// Other units of the cameras as a likely cause, if they are off by about a power of ten.
    pub(super) fn units(&self) -> Option<String> {
        let power = (self.distance / USUAL_DISTANCE).log10().round();
        let (length, distance) = (if power > 0.0 { "smaller" } else { "larger" }, self.distance);
        let times = 10_f64.powf(power.abs());
        (power != 0.0 && power.is_finite()).then(|| {
            format!(
                "units: the cameras stand {distance:.3} half diagonals of the box from its middle, as if their unit \
                 were {times} times {length} than the model's"
            )
        })
    }
}
