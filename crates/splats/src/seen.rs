//! What training views show of each splat.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes::render::Outputs;

use crate::{Hits, SplatRenderer};

/// How much of training views each splat makes up, and in which colour.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenSplats {
    /// `[n]`: sum of w, its share of a pixel, over the pixels that were looked at.
    pub weights: Vec<f64>,
    /// `[n]`: mean of the splat's colours in these pixels, by w; `None` where none shows it.
    pub colors: Vec<Option<Vec3>>,
}

/// One of so many pixels along each side of images, so that at most `pixels` of all are looked at.
#[doc(hidden)]
#[must_use]
pub fn stride_for(all: u64, pixels: u64) -> u32 {
    ((all as f64 / pixels.max(1) as f64).sqrt().ceil() as u32).max(1)
}

/// Columns and rows of an image that are looked at; both begin at the same number, in the middle of the first stride.
#[doc(hidden)]
#[must_use]
pub fn strided_pixels(camera: &Camera, stride: u32) -> [Vec<u32>; 2] {
    let start = camera.resolution.into_iter().fold(stride / 2, |start, side| start.min(side - 1));
    camera.resolution.map(|side| (start..side).step_by(stride as usize).collect())
}

impl SeenSplats {
    /// Looks at up to `pixels` pixels of all cameras together, evenly spread over each image.
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
        let stride = stride_for(cameras.iter().map(Camera::pixels).sum(), pixels);
        let n = renderer.splats().len();
        let (mut weights, mut colors) = (vec![0.0; n], vec![DVec3::ZERO; n]);
        monitor.begin("training views", cameras.len() as u64);
        for camera in cameras {
            check(monitor)?;
            let view = renderer.prepare(camera, Outputs::Colors);
            let [columns, rows] = strided_pixels(camera, stride);
            let of_row = |&row: &u32| {
                let (mut hits, mut found) = (Hits::default(), Vec::new());
                for &column in &columns {
                    view.hits([column, row].map(|i| f64::from(i) + pixel_offset), &mut hits);
                    found.extend(hits.list.iter().map(|hit| (view.splat(hit), hit.weight())));
                }
                found
            };
            let mut of_view = vec![0.0; n];
            // Rows in their order, so that sums do not depend on threads.
            for (splat, weight) in rows.par_iter().map(of_row).collect::<Vec<_>>().concat() {
                of_view[splat] += weight;
            }
            // A splat has one colour in a view.
            view.colors().for_each(|(splat, color)| colors[splat] += of_view[splat] * color);
            weights.iter_mut().zip(of_view).for_each(|(sum, weight)| *sum += weight);
            monitor.advance(1);
        }
        monitor.end();
        let mean = |(sum, &weight): (&DVec3, &f64)| (weight > 0.0).then(|| (*sum / weight).as_vec3());
        let colors = colors.iter().zip(&weights).map(mean).collect();
        Ok(Self { weights, colors })
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use octobayes::monitor::Silent;

    use super::*;
    use crate::{RenderMode, Splats};

    #[test]
    fn weights_are_shares_of_pixels() {
        // Front to back shares 0.3, 0.7 · 0.9 and what is left; the last is behind the camera.
        let placed = [(4.0_f32, 0.9_f32), (2.0, 0.3), (5.0, 0.8), (-4.0, 0.9)];
        let means = placed.map(|(x, _)| Vec3::X * x).to_vec();
        let logits = placed.map(|(_, opacity)| (opacity / (1.0 - opacity)).ln()).to_vec();
        let (scales, rotations) = (vec![Vec3::splat(-3.0); 4], vec![Quat::IDENTITY; 4]);
        let splats = Splats::new(means, scales, rotations, logits, vec![0.0; 12], 0, RenderMode::Classic).unwrap();
        let camera = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 0.02, [1, 1]);
        let renderer = SplatRenderer::new(&splats, Vec3::ZERO);
        let seen = SeenSplats::measure(&renderer, &[camera], 0.5, 1, &Silent).unwrap();
        for (found, expected) in seen.weights.iter().zip([0.7 * 0.9, 0.3, 0.7 * 0.1 * 0.8, 0.0]) {
            // The pixel looks at the splats' centres; opacities are logits in f32.
            assert!((found - expected).abs() < 1e-6, "{:?}", seen.weights);
        }
        assert_eq!(seen.colors, [Some(Vec3::splat(0.5)), Some(Vec3::splat(0.5)), Some(Vec3::splat(0.5)), None]);
    }

    #[test]
    fn pixels_are_spread_and_not_more_than_wanted() {
        let camera = |resolution| Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 0.5, resolution);
        for (resolution, wanted) in [([40, 30], 1200), ([40, 30], 1199), ([40, 30], 70), ([3, 500], 20), ([1, 1], 9)] {
            let camera = camera(resolution);
            let stride = stride_for(camera.pixels(), wanted);
            let [columns, rows] = strided_pixels(&camera, stride);
            assert_eq!(columns[0], rows[0]);
            assert!(columns.iter().all(|i| *i < resolution[0]) && rows.iter().all(|i| *i < resolution[1]));
            // Half of what is wanted, unless a side is shorter than the stride.
            let count = (columns.len() * rows.len()) as u64;
            assert!(count <= wanted.max(rows.len() as u64) && 4 * count >= wanted.min(camera.pixels()), "{count}");
        }
    }
}
