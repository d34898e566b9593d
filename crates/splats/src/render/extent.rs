//! Where splats lie. Some of a trained scene always lie far from all others, where hardly any ray meets them.

use glam::DVec3;
use rayon::prelude::*;

use super::project::Projector;
use super::{Hits, SplatRenderer};
use crate::Splats;
use octobayes::Result;
use octobayes::geometry::{Aabb, Camera, Domain, Norm};
use octobayes::monitor::{Monitor, check};
use octobayes::render::Outputs;

/// Cameras that are looked through, and about how many pixels of each.
const CAMERAS: usize = 16;
const PIXELS: f64 = 4096.0;
/// Parts of what is seen that lie beyond either side of the box along an axis, before it grows.
const OUTLIER_SHARE: f64 = 0.005;
/// Parts of an edge by which the box grows at either side.
const MARGIN: f64 = 0.1;
/// Parts of what is seen that lie beyond either side of the core along an axis.
const BEYOND_CORE: f64 = 0.1;
/// A scene counts as unbounded if its box is more than this many times as long as its core; for an object or a room the
/// two are similar.
const UNBOUNDED_RATIO: f64 = 4.0;
/// A gap is where the distance from the cameras grows by this factor, and hardly anything is seen.
const GAP: f64 = 2.0;
/// Least part of what is seen that lies in front of a gap, and behind it. Half of it may lie between.
const MIN_GAP_SHARE: f64 = 0.02;
/// Parts of what is seen that are nearer than the nearest that counts, and times its distance that are nearby.
const NEAREST: f64 = 0.05;
const NEARBY: f64 = 3.0;

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
        boxed(&self.means().iter().map(|x| (x.as_dvec3(), 1.0)).collect::<Vec<_>>(), OUTLIER_SHARE)
            .unwrap_or_else(|| self.bounds())
    }

    /// Whether a splat takes half of the light or more where the eye is.
    #[must_use]
    #[doc(hidden)]
    pub fn is_in_one(&self, eye: DVec3) -> bool {
        let takes_half = |i: usize| {
            let opacity = f64::from(self.opacity(i));
            // o exp(-q/2) >= 1/2, with q the squared distance in standard deviations.
            let reach = 2.0 * (2.0 * opacity).ln();
            let away = (self.rotation(i).inverse() * (eye.as_vec3() - self.mean(i))).as_dvec3();
            opacity >= 0.5 && (away / self.scale(i).as_dvec3()).length_squared() <= reach
        };
        (0..self.len()).into_par_iter().with_min_len(4096).any(takes_half)
    }
}

/// The corners of the middle of weighted points along each axis, without the parts `beyond` at either side.
#[must_use]
pub fn middle(points: &[(DVec3, f64)], beyond: f64) -> [DVec3; 2] {
    [beyond, 1.0 - beyond].map(|share| {
        DVec3::from(std::array::from_fn(|axis| {
            quantile(&mut points.iter().map(|(x, weight)| (x[axis], *weight)).collect::<Vec<_>>(), share)
        }))
    })
}

/// The box of that middle, a tenth longer at either side; `None` if it has no volume at all.
#[must_use]
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
    let counts = some(cameras).map(|camera| Projector::new(camera).too_near(splats));
    let [all, near] = counts.fold([0, 0], |[a, b], [c, d]| [a + c, b + d]);
    near as f64 / all.max(1) as f64
}

/// What `cameras` see of splats, and the default domain of their uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SeenSpace {
    /// The space that a field covers.
    pub domain: Domain,
    /// Part of what the cameras see that lies far behind it, as a sky does; 0 if there is none.
    pub behind: f64,
}

/// The space in which `cameras` see splats.
///
/// Sixteen of the cameras are looked through. Normally it is a box: along each axis it holds the middle 99 % of what
/// they see, weighted by its share of the pixels, and a tenth more at either side.
///
/// Cameras that stand around an object may also see a sky, which fills more of their images than the object. It is left
/// out: everything behind a gap, in which distances from the cameras double, if the cameras stand outside the box of
/// what is nearer, and if that is less than a quarter as long as the box of all.
///
/// If the box is more than four times as long as the middle 80 %, or as that of what is nearest, the scene has no
/// bounds: then it is all of space, contracted outside the ball around the middle on which the cameras stand.
///
/// # Errors
/// If a lens distorts, or [`Error::Interrupted`](octobayes::Error::Interrupted).
pub fn seen_domain(renderer: &SplatRenderer, cameras: &[Camera], monitor: &dyn Monitor) -> Result<SeenSpace> {
    SplatRenderer::check_cameras(cameras)?;
    let splats = renderer.splats();
    let seen = Seen::through(renderer, cameras, monitor)?;
    let box_alone = |bounds| Ok(SeenSpace { domain: Domain::Box(bounds), behind: 0.0 });
    if seen.points.is_empty() {
        return box_alone(splats.main_box());
    }
    let Some(all) = boxed(&seen.points, OUTLIER_SHARE) else { return box_alone(splats.bounds()) };
    let stand_around = |count: &usize| {
        boxed(&seen.points[..*count], OUTLIER_SHARE).is_some_and(|near| {
            let outside = cameras.iter().filter(|camera| !near.contains(camera.position.as_vec3())).count();
            2 * outside >= cameras.len() && UNBOUNDED_RATIO * near.longest_edge() < all.longest_edge()
        })
    };
    let object = seen.gaps().into_iter().find(stand_around).unwrap_or(seen.points.len());
    let behind = 1.0 - seen.sums[object] / seen.total();
    let points = &seen.points[..object];
    let bounds = boxed(points, OUTLIER_SHARE).unwrap_or(all);
    let nearest = &points[..seen.nearest().min(object)];
    let is_far = |points| {
        boxed(points, BEYOND_CORE).is_some_and(|core| bounds.longest_edge() > UNBOUNDED_RATIO * core.longest_edge())
    };
    if !is_far(points) && !is_far(nearest) {
        return Ok(SeenSpace { domain: Domain::Box(bounds), behind });
    }
    let [middle, _] = middle(nearest, 0.5);
    let mut distances: Vec<(f64, f64)> =
        cameras.iter().map(|camera| ((camera.position - middle).length(), 1.0)).collect();
    Ok(SeenSpace { domain: Domain::contracted(middle, quantile(&mut distances, 0.5), Norm::L2)?, behind })
}

/// Splats that cameras see, from the nearest to the farthest.
struct Seen {
    /// Centres, and shares of pixels.
    points: Vec<(DVec3, f64)>,
    /// Mean distances from the cameras that see them.
    distances: Vec<f64>,
    /// `[points + 1]`: sums of the shares of those before.
    sums: Vec<f64>,
}

impl Seen {
    fn through(renderer: &SplatRenderer, cameras: &[Camera], monitor: &dyn Monitor) -> Result<Self> {
        let means = renderer.splats().means();
        // Shares of pixels, and the same times distances.
        let mut weights = vec![[0.0_f64; 2]; means.len()];
        for camera in some(cameras) {
            check(monitor)?;
            let view = renderer.prepare(camera, Outputs::Colors);
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
                weights[splat][0] += weight;
                weights[splat][1] += weight * (means[splat].as_dvec3() - camera.position).length();
            }
        }
        let mut seen: Vec<(f64, DVec3, f64)> = means
            .iter()
            .zip(weights)
            .filter(|(_, [weight, _])| *weight > 0.0)
            .map(|(x, [weight, far])| (far / weight, x.as_dvec3(), weight))
            .collect();
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut sums = vec![0.0];
        seen.iter().for_each(|(_, _, weight)| sums.push(sums[sums.len() - 1] + weight));
        let distances = seen.iter().map(|(distance, ..)| *distance).collect();
        Ok(Self { points: seen.into_iter().map(|(_, x, weight)| (x, weight)).collect(), distances, sums })
    }

    fn total(&self) -> f64 {
        self.sums[self.points.len()]
    }

    /// How many splats lie in front of each gap, the farthest gap first.
    fn gaps(&self) -> Vec<usize> {
        let least = MIN_GAP_SHARE * self.total();
        let mut gaps = Vec::new();
        let mut behind = 0;
        for count in 1..self.points.len() {
            while behind < self.points.len() && self.distances[behind] < GAP * self.distances[count - 1] {
                behind += 1;
            }
            let between = self.sums[behind.max(count)] - self.sums[count];
            let [front, back] = [self.sums[count], self.total() - self.sums[behind]];
            if between <= 0.5 * least && front >= least && back >= least {
                // The last count of several is in front of the same gap without the few splats in it.
                if gaps.last() == Some(&(count - 1)) {
                    gaps.pop();
                }
                gaps.push(count);
            }
        }
        gaps.reverse();
        gaps
    }

    /// How many splats are at most three times as far away as the nearest.
    fn nearest(&self) -> usize {
        let first = self.sums.partition_point(|sum| *sum < NEAREST * self.total());
        let limit = NEARBY * self.distances[first.min(self.distances.len() - 1)];
        self.distances.partition_point(|distance| *distance <= limit)
    }
}
