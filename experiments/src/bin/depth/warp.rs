//! Consistency of the training views, warped into a held-out one, in the manner of WarpRF (arXiv 2506.22433).
//!
//! A point that the model shows in a new view is looked up in its own pictures from the training cameras. Nothing is
//! trained, and any field that can be rendered will do.

use glam::DVec3;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::render::{Pixel, Tracer, render_view};

/// Every so many pixels of the training views are rendered, along x and y.
const STRIDE: u32 = 2;
/// What a camera sees may lie so much nearer than what is looked up, of its depth, and still be the same surface.
const SLACK: f64 = 0.02;
/// The worst difference of two colours, and the depth where nothing is shown.
const WORST: f64 = 1.8;

/// The model's own pictures from its training cameras.
pub struct Warp(Vec<(Camera, Vec<Pixel>)>);

/// How far the training views disagree with what a pixel shows.
pub struct Disagreement {
    /// Least difference of depth over the cameras that have the point in their picture, scene units.
    pub depth: f64,
    /// Mean difference of colour over those of them that see it.
    pub color: f64,
}

impl Warp {
    pub fn render(tracer: &Tracer, cameras: &[Camera], pixel_offset: f64) -> Result<Self> {
        let view = |camera: &Camera| {
            let camera = camera.strided(STRIDE, pixel_offset);
            Ok((camera, render_view(tracer, &camera, pixel_offset, &[], &Silent)?.pixels))
        };
        cameras.iter().map(view).collect::<Result<_>>().map(Self)
    }

    /// What the cameras say of a point that is shown in this colour.
    pub fn at(&self, x: DVec3, color: DVec3) -> Disagreement {
        let mut found = Disagreement { depth: WORST, color: 0.0 };
        let mut seen = 0.0;
        for (camera, pixels) in &self.0 {
            let Some(([column, row], _)) = camera.project_inside(x) else { continue };
            let pixel = &pixels[row as usize * camera.resolution[0] as usize + column as usize];
            let distance = x.distance(camera.position);
            if pixel.opacity > 0.5 {
                found.depth = found.depth.min((pixel.median_depth - distance).abs());
            }
            if pixel.opacity <= 0.5 || pixel.median_depth > distance * (1.0 - SLACK) {
                found.color += pixel.color.distance(color);
                seen += 1.0;
            }
        }
        found.color = if seen > 0.0 { found.color / seen } else { WORST };
        found
    }
}
