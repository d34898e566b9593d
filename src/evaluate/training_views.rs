//! Which training cameras see a point of the model, and from how different a direction.
//!
//! A control that needs no Hessian: a place that many cameras see from near is known.

use std::f64::consts::PI;

use glam::DVec3;

use crate::Result;
use crate::geometry::Camera;
use crate::monitor::Monitor;
use crate::render::{Tracer, render_view};

/// Pixels along the longer side of a camera's depth map.
const SIDE: u32 = 128;
/// A camera sees what lies no further behind its depth than this many of its pixels' widths there…
const PIXELS: f64 = 2.0;
/// … and this many marching steps.
const STEPS: f64 = 3.0;

/// The training cameras, each with the depth to which it sees into the model.
#[derive(Debug, Clone)]
pub struct TrainingViews {
    views: Vec<SeenDepth>,
    /// What a depth may be off by, whatever the distance, scene units.
    slack: f64,
}

#[derive(Debug, Clone)]
struct SeenDepth {
    camera: Camera,
    /// `[height · width]`: median depth, scene units; infinite where the model shows nothing.
    depths: Vec<f64>,
}

/// What the training cameras know of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Number of cameras that see it.
    pub views: usize,
    /// Smallest angle between the direction it is looked at from and that of a camera that sees it, radians; π if none
    /// does.
    pub angle: f64,
}

impl TrainingViews {
    /// Renders the depth that each camera sees, with at most 128 pixels a side. Advances the monitor by one per row.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn render(tracer: &Tracer, cameras: &[Camera], pixel_offset: f64, monitor: &dyn Monitor) -> Result<Self> {
        let view = |camera: &Camera| {
            let camera = small(camera);
            let rendered = render_view(tracer, &camera, pixel_offset, &[], monitor)?;
            let depth = |pixel: &crate::render::Pixel| {
                if pixel.opacity > 0.5 { pixel.median_depth } else { f64::INFINITY }
            };
            Ok(SeenDepth { camera, depths: rendered.pixels.iter().map(depth).collect() })
        };
        let views = cameras.iter().map(view).collect::<Result<_>>()?;
        Ok(Self { views, slack: STEPS * tracer.marcher.step })
    }

    /// Rows that [`TrainingViews::render`] renders.
    #[must_use]
    pub fn rows(cameras: &[Camera]) -> u64 {
        cameras.iter().map(|camera| u64::from(small(camera).resolution[1])).sum()
    }

    /// What the cameras know of the point `x`, looked at from `eye`.
    #[must_use]
    pub fn sighting(&self, x: DVec3, eye: DVec3) -> Sighting {
        let mut found = Sighting { views: 0, angle: PI };
        for view in self.views.iter().filter(|view| view.sees(x, self.slack)) {
            found.views += 1;
            found.angle = found.angle.min((eye - x).angle_between(view.camera.position - x));
        }
        found
    }
}

fn small(camera: &Camera) -> Camera {
    let longer = camera.resolution[0].max(camera.resolution[1]).max(1);
    let side = |pixels: u32| (pixels * SIDE.min(longer)).div_ceil(longer);
    camera.resized(camera.resolution.map(side))
}

impl SeenDepth {
    fn sees(&self, x: DVec3, slack: f64) -> bool {
        let Some(([column, row], _)) = self.camera.project(x) else { return false };
        let [width, height] = self.camera.resolution.map(f64::from);
        if !(0.0..width).contains(&column) || !(0.0..height).contains(&row) {
            return false;
        }
        let distance = x.distance(self.camera.position);
        let behind = PIXELS * distance / self.camera.focal[0].min(self.camera.focal[1]) + slack;
        distance <= self.depths[row as usize * self.camera.resolution[0] as usize + column as usize] + behind
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::field::{ClosedForm, RadianceField};
    use crate::monitor::Silent;
    use crate::render::Marcher;

    #[test]
    fn a_ball_is_seen_from_the_side_of_its_cameras() {
        let ball = ClosedForm::ball();
        let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
        let from = |eye: DVec3| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [64; 2]);
        let cameras = [from(DVec3::new(3.0, 0.0, 0.1)), from(DVec3::new(0.0, 3.0, 0.1))];
        let views = TrainingViews::render(&tracer, &cameras, 0.5, &Silent).unwrap();
        assert_eq!(TrainingViews::rows(&cameras), 128);
        // Where the rays through the middle of the pictures meet the ball.
        let hit = |towards: DVec3| {
            let camera = from(3.0 * towards);
            let view = render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap();
            camera.ray(32.5, 32.5).at(view.pixels[32 * 64 + 32].median_depth)
        };
        let front = views.sighting(hit(DVec3::X), DVec3::new(3.0, 0.0, 0.1));
        assert!(front.views == 1 && front.angle < 0.05, "{front:?}");
        let between = views.sighting(hit(DVec3::new(1.0, 1.0, 0.0).normalize()), DVec3::new(2.0, 2.0, 0.0));
        assert!(between.views == 2 && (0.6..1.2).contains(&between.angle), "{between:?}");
        let back = views.sighting(hit(DVec3::new(-1.0, -1.0, 0.0).normalize()), DVec3::new(-3.0, -3.0, 0.0));
        assert_eq!(back, Sighting { views: 0, angle: PI });
        // Outside of all pictures, and behind a camera.
        assert_eq!(views.sighting(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO).views, 0);
        assert_eq!(views.sighting(DVec3::new(8.0, 0.0, 0.0), DVec3::ZERO).views, 0);
        // Air in front of the ball, in the picture of one camera only.
        assert_eq!(views.sighting(DVec3::new(1.4, 0.0, 0.0), DVec3::ZERO).views, 1);
    }
}
