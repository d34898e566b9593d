//! Where in a view the gain comes from.

use super::evidence::{Viewer, samples};
use super::objective::Objective;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes::render::{ImagePoints, Outputs};
use octobayes::uncertainty::{Added, Precision};

/// Longest side of a map, pixels.
const SIDE: u32 = 256;

/// Information gain of each pixel of a view alone.
///
/// Pixels of one surface hold the same information, so that the sum over pixels is more than the view's gain.
#[derive(Debug, Clone, PartialEq)]
pub struct GainMap {
    /// Width and height.
    pub resolution: [u32; 2],
    /// `[height · width]`: nats.
    pub gains: Vec<f32>,
    /// The map's pixel (i, j) is the view's pixel (i · stride, j · stride).
    pub stride: u32,
}

impl GainMap {
    pub(super) fn of(
        camera: &Camera,
        viewer: &Viewer,
        precision: &Precision,
        objective: &Objective,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let stride = camera.resolution[0].max(camera.resolution[1]).div_ceil(SIDE);
        let offset = viewer.pixel_offset;
        let [width, height] = camera.resolution.map(|side| side.div_ceil(stride));
        // The view's own pixels: splats grow by a part of a pixel, so that those of a smaller image differ.
        let look = viewer.source.view(camera, Outputs::Derivatives);
        let mut gains = vec![0.0; width as usize * height as usize];
        monitor.begin("gain of pixels", u64::from(height));
        let sums = precision.sums();
        for row in 0..height {
            check(monitor)?;
            let at = (0..width).map(|column| [column, row].map(|i| f64::from(i * stride) + offset)).collect();
            let jitter = vec![0.5; width as usize];
            let points = ImagePoints { at, jitter, first: u64::from(row) * u64::from(width) };
            for samples in samples(&*look, &[points], monitor)? {
                sums.each_ray(&samples, |ray, touched| {
                    let added = touched.iter().map(|(point, sums)| precision.added_at(*point, *sums, 1.0));
                    let added: Vec<Added> = added.filter(|added| viewer.counts(precision.position(added))).collect();
                    gains[ray as usize] = objective.worth(&added) as f32;
                });
            }
            monitor.advance(1);
        }
        monitor.end();
        Ok(Self { resolution: [width, height], gains, stride })
    }
}
