//! Where splats lie. Some of a trained scene always lie far from all others, where hardly any ray meets them.

use glam::DVec3;
use rayon::prelude::*;

use super::project::Projector;
use super::{Hits, SplatRenderer, Use};
use crate::Result;
use crate::geometry::{Aabb, Camera, Domain, Norm};
use crate::monitor::{Monitor, check};
use crate::splats::Splats;

/// Cameras that are looked through, and about how many pixels of each.
const CAMERAS: usize = 16;
const PIXELS: f64 = 4096.0;
/// Parts of what is seen that lie beyond either side of the box along an axis, before it grows.
const BEYOND: f64 = 0.005;
/// Parts of an edge by which the box grows at either side.
const MARGIN: f64 = 0.1;
/// Parts of what is seen that lie beyond either side of the core along an axis.
const BEYOND_CORE: f64 = 0.1;
/// A scene counts as unbounded if its box is more than this many times as long as its core; for an object or a room the
/// two are similar.
const FAR: f64 = 4.0;

/// The value below which the share `share` of the weights lies.
fn quantile(values: &mut [(f64, f64)], share: f64) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    for &(value, weight) in values.iter() {
        sum += weight;
        if sum >= share * total {
            return value;
        }
    }
    values.last().map_or(0.0, |(value, _)| *value)
}

/// A box that is not flat.
fn solid(low: DVec3, high: DVec3) -> Option<Aabb> {
    let least = 1e-3 * (high - low).max_element();
    let grow = 0.5 * (DVec3::splat(least) - (high - low)).max(DVec3::ZERO);
    Aabb::new(low - grow, high + grow).ok()
}

impl Splats {
    /// The box of nearly all centres: the 99 % of each axis that lie in the middle, and a fifth more.
    #[must_use]
    pub fn main_box(&self) -> Aabb {
        boxed(&self.means().iter().map(|x| (x.as_dvec3(), 1.0)).collect::<Vec<_>>(), BEYOND)
            .unwrap_or_else(|| self.bounds())
    }
}

/// The corners of the middle of weighted points along each axis, without the parts `beyond` at either side.
pub fn middle(points: &[(DVec3, f64)], beyond: f64) -> [DVec3; 2] {
    [beyond, 1.0 - beyond].map(|share| {
        DVec3::from(std::array::from_fn(|axis| {
            quantile(&mut points.iter().map(|(x, weight)| (x[axis], *weight)).collect::<Vec<_>>(), share)
        }))
    })
}

/// The box of that middle, a tenth longer at either side; `None` if it has no volume at all.
pub fn boxed(points: &[(DVec3, f64)], beyond: f64) -> Option<Aabb> {
    let [low, high] = middle(points, beyond);
    let margin = MARGIN * (high - low);
    solid(low - margin, high + margin)
}

/// Sixteen of the cameras, evenly spread, or all.
fn some(cameras: &[Camera]) -> impl Iterator<Item = &Camera> {
    let used = cameras.len().min(CAMERAS);
    (0..used).map(move |i| &cameras[i * cameras.len() / used])
}

/// The share of the splats in front of `cameras` that are nearer than [`NEAR`](super::NEAR), where the original code
/// draws none, though other programs do.
#[must_use]
pub fn share_too_near(splats: &Splats, cameras: &[Camera]) -> f64 {
    let counts = some(cameras).map(|camera| Projector::new(splats, camera).too_near());
    let [all, near] = counts.fold([0, 0], |[a, b], [c, d]| [a + c, b + d]);
    near as f64 / all.max(1) as f64
}

/// The space in which `cameras` see splats: the default domain of their uncertainty.
///
/// Sixteen of the cameras are looked through. Normally it is a box: along each axis it holds the middle 99 % of what
/// they see, weighted by its share of the pixels, and a tenth more at either side. If that is more than four times as
/// long as the middle 80 %, the scene has no bounds: then it is all of space, contracted outside the ball around the
/// middle on which the cameras stand.
///
/// # Errors
/// If a lens distorts, or [`Error::Interrupted`](crate::Error::Interrupted).
pub fn seen_domain(renderer: &SplatRenderer, cameras: &[Camera], monitor: &dyn Monitor) -> Result<Domain> {
    SplatRenderer::check_cameras(cameras)?;
    let splats = renderer.splats();
    let mut weights = vec![0.0_f64; splats.len()];
    for camera in some(cameras) {
        check(monitor)?;
        let view = renderer.prepare(camera, Use::Colors);
        let stride = ((camera.pixels() as f64 / PIXELS).sqrt() as u32).max(1);
        let rows: Vec<u32> = (stride / 2..camera.resolution[1]).step_by(stride as usize).collect();
        let of_row = |&row: &u32| {
            let (mut hits, mut found) = (Hits::default(), Vec::new());
            for column in (stride / 2..camera.resolution[0]).step_by(stride as usize) {
                view.hits([column, row].map(|i| f64::from(i) + 0.5), &mut hits);
                found.extend(hits.list.iter().map(|hit| (view.splat(hit), hit.weight())));
            }
            found
        };
        for (splat, weight) in rows.par_iter().map(of_row).collect::<Vec<_>>().concat() {
            weights[splat] += weight;
        }
    }
    let seen: Vec<(DVec3, f64)> =
        splats.means().iter().map(|x| x.as_dvec3()).zip(weights).filter(|(_, weight)| *weight > 0.0).collect();
    if seen.is_empty() {
        return Ok(Domain::Box(splats.main_box()));
    }
    let Some(bounds) = boxed(&seen, BEYOND) else { return Ok(Domain::Box(splats.bounds())) };
    if boxed(&seen, BEYOND_CORE).is_none_or(|core| bounds.longest_edge() <= FAR * core.longest_edge()) {
        return Ok(Domain::Box(bounds));
    }
    let middle = DVec3::from(std::array::from_fn(|axis| {
        quantile(&mut seen.iter().map(|(x, weight)| (x[axis], *weight)).collect::<Vec<_>>(), 0.5)
    }));
    let mut distances: Vec<(f64, f64)> =
        cameras.iter().map(|camera| ((camera.position - middle).length(), 1.0)).collect();
    Domain::contracted(middle, quantile(&mut distances, 0.5), Norm::L2)
}
