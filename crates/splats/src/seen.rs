//! What training views show of each splat.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes::render::Outputs;

use crate::{Hits, SplatRenderer};

/// A view counts if a splat's share of one of its pixels exceeds this.
pub const MIN_SHARE: f64 = 0.05;
/// A splat is in front of what a pixel shows if it is nearer by more than this part of that depth.
pub const IN_FRONT: f64 = 0.01;

/// What training views show of each splat.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenSplats {
    /// `[n]`: sum of w, its share of a pixel, over the pixels that were looked at.
    pub weights: Vec<f64>,
    /// `[n]`: number of views in which w exceeds 0.05 at one of these pixels.
    pub views: Vec<u32>,
    /// `[n]`: the part of the weight that is in front of what these pixels show, by more than [`IN_FRONT`]: nearer than
    /// where half of a pixel's light is reached. 0 where no pixel shows the splat.
    pub front: Vec<f64>,
    /// `[n]`: mean of the splat's colours in these pixels, by w; `None` where none shows it.
    pub colors: Vec<Option<Vec3>>,
    /// Number of pixels that were looked at, and of all pixels.
    pub pixels: [u64; 2],
}

impl SeenSplats {
    /// Looks at about `pixels` pixels of all cameras together, evenly spread over each image.
    ///
    /// # Errors
    /// If a lens distorts, or [`Error::Interrupted`](octobayes::Error::Interrupted).
    pub fn measure(
        renderer: &SplatRenderer,
        cameras: &[Camera],
        pixel_offset: f64,
        pixels: u64,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        SplatRenderer::check_cameras(cameras)?;
        let all: u64 = cameras.iter().map(Camera::pixels).sum();
        let stride = ((all as f64 / pixels.max(1) as f64).sqrt().round() as u32).max(1);
        let n = renderer.splats().len();
        let (weights, views, front) = (vec![0.0; n], vec![0; n], vec![0.0; n]);
        let mut found = Self { weights, views, front, colors: Vec::new(), pixels: [0, all] };
        let mut colors = vec![DVec3::ZERO; n];
        monitor.begin("training views", cameras.len() as u64);
        for camera in cameras {
            check(monitor)?;
            let view = renderer.prepare(camera, Outputs::Colors);
            let start = (stride / 2).min(camera.resolution[0] - 1).min(camera.resolution[1] - 1);
            let rows: Vec<u32> = (start..camera.resolution[1]).step_by(stride as usize).collect();
            let of_row = |&row: &u32| {
                let (mut hits, mut found) = (Hits::default(), Vec::new());
                for column in (start..camera.resolution[0]).step_by(stride as usize) {
                    view.hits([column, row].map(|i| f64::from(i) + pixel_offset), &mut hits);
                    let nearer = (1.0 - IN_FRONT) * view.half_depth(&hits);
                    found.extend(hits.list.iter().map(|hit| (view.splat(hit), hit.weight(), view.depth(hit) < nearer)));
                }
                found
            };
            let (mut is_seen, mut of_view) = (vec![false; n], vec![0.0; n]);
            // Rows in their order, so that sums do not depend on threads.
            for (splat, weight, is_in_front) in rows.par_iter().map(of_row).collect::<Vec<_>>().concat() {
                found.weights[splat] += weight;
                found.front[splat] += if is_in_front { weight } else { 0.0 };
                of_view[splat] += weight;
                is_seen[splat] |= weight > MIN_SHARE;
            }
            // A splat has one colour in a view.
            view.colors().for_each(|(splat, color)| colors[splat] += of_view[splat] * color);
            found.views.iter_mut().zip(is_seen).for_each(|(views, is_seen)| *views += u32::from(is_seen));
            found.pixels[0] += rows.len() as u64 * u64::from((camera.resolution[0] - start).div_ceil(stride));
            monitor.advance(1);
        }
        monitor.end();
        let mean = |(sum, &weight): (&DVec3, &f64)| (weight > 0.0).then(|| (*sum / weight).as_vec3());
        found.front.iter_mut().zip(&found.weights).filter(|(_, weight)| **weight > 0.0).for_each(|(f, w)| *f /= w);
        found.colors = colors.iter().zip(&found.weights).map(mean).collect();
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use octobayes::monitor::Silent;

    use super::*;
    use crate::{RenderMode, Splats};

    /// Splats of one size and no colour at these places, with these opacities.
    fn splats(placed: &[(Vec3, f32)]) -> Splats {
        let n = placed.len();
        let means = placed.iter().map(|(mean, _)| *mean).collect();
        let logits = placed.iter().map(|(_, opacity)| (opacity / (1.0 - opacity)).ln()).collect();
        let (scales, rotations) = (vec![Vec3::splat(-3.0); n], vec![Quat::IDENTITY; n]);
        Splats::new(means, scales, rotations, logits, vec![0.0; 3 * n], 0, RenderMode::Classic).unwrap()
    }

    /// A camera at the origin that looks along x, through the middle of its only pixel.
    fn look(splats: &Splats) -> SeenSplats {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 0.02, [1, 1]);
        SeenSplats::measure(&SplatRenderer::new(splats, Vec3::ZERO), &[camera], 0.5, 1, &Silent).unwrap()
    }

    #[test]
    fn what_is_nearer_than_half_of_the_light_is_in_front() {
        let at = |x: f32, opacity: f32| (Vec3::X * x, opacity);
        // Shares 0.3, 0.7 · 0.9 and less: half of 0.9… is reached at the second.
        let seen = look(&splats(&[at(4.0, 0.9), at(2.0, 0.3), at(5.0, 0.8), at(3.985, 0.01)]));
        let expected = [0.7 * 0.99 * 0.9, 0.3, 0.7 * 0.99 * 0.1 * 0.8, 0.7 * 0.01];
        for (found, expected) in seen.weights.iter().zip(expected) {
            // The pixel looks at the splats' centres; opacities are logits in f32.
            assert!((found - expected).abs() < 1e-6, "{:?}", seen.weights);
        }
        // The fourth is nearer by less than a hundredth.
        assert_eq!(seen.front, [0.0, 1.0, 0.0, 0.0]);
        // Half of all light is reached at the nearer one, if little is behind it.
        assert_eq!(look(&splats(&[at(4.0, 0.2), at(2.0, 0.3)])).front, [0.0, 0.0]);
        // Behind the camera.
        let unseen = look(&splats(&[at(-4.0, 0.9)]));
        assert_eq!((unseen.front, unseen.weights, unseen.colors), (vec![0.0], vec![0.0], vec![None]));
    }

    #[test]
    fn the_share_is_that_of_all_pixels_together() {
        // A small floater before the left half of a wall, whose right half it does not touch.
        let wall = (0..400).map(|i| (Vec3::new(4.0, (i % 20) as f32 / 10.0 - 1.0, (i / 20) as f32 / 10.0 - 1.0), 0.95));
        let placed: Vec<_> = wall.chain([(Vec3::new(2.0, 0.25, 0.0), 0.4)]).collect();
        let splats = splats(&placed);
        let cameras = [0.0, 0.1, -0.1]
            .map(|y| Camera::look_at(DVec3::new(0.0, y, 0.0), DVec3::X * 4.0, DVec3::Z, 0.45, [32, 32]));
        let seen =
            SeenSplats::measure(&SplatRenderer::new(&splats, Vec3::ZERO), &cameras, 0.5, u64::MAX, &Silent).unwrap();
        assert!(seen.front[400] > 0.99 && seen.views[400] == 3, "{} in front", seen.front[400]);
        assert!(seen.front[..400].iter().all(|front| *front < 0.05), "the wall");
    }
}
