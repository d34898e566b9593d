//! Which training cameras see a point: by the depth that the model shows them, or by true depth, which is the truth
//! about what was never seen.

use glam::DVec3;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes::render::{Pixel, RenderedView, Renderer};

/// Pixels along the longer side of a camera's depth map.
const SIDE: u32 = 128;
/// A camera sees what lies no further behind its depth than this many of its pixels' widths there…
const PIXELS: f64 = 2.0;
/// … and this many marching steps.
const STEPS: f64 = 3.0;

/// It sees a surface at what lies no further from its depth than this share of that. Chosen on one scene, by the
/// coverage of its confirmed pixels (`experiments/depth.md`).
const SAME_SURFACE: f64 = 0.5;
/// Training cameras that must see a surface where a pixel's median depth is, for that depth to be confirmed. Two agree
/// by chance more often.
pub const CONFIRMING_VIEWS: usize = 3;

/// The training cameras, each with the depth to which it sees.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingViews {
    views: Vec<SeenDepth>,
    /// What a depth may be off by, whatever the distance, scene units.
    slack: f64,
}

#[derive(Debug, Clone, PartialEq)]
struct SeenDepth {
    camera: Camera,
    /// `[height · width]`: depth, scene units; infinite where nothing is seen.
    depths: Vec<f32>,
}

/// How the training cameras see a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Number of cameras that see it.
    pub views: usize,
    /// How many of them see a surface there, and not through it.
    pub agreeing: usize,
}

impl TrainingViews {
    /// Renders the depth that each camera sees, with at most 128 pixels a side; a stage of its own for the monitor. Of
    /// splats, whose images of another size would be others, these are some pixels of the camera's own image.
    ///
    /// # Errors
    /// [`octobayes::Error::Interrupted`], or if the model cannot render a camera.
    pub fn render(model: &dyn Renderer, cameras: &[Camera], pixel_offset: f64, monitor: &dyn Monitor) -> Result<Self> {
        let at_size = |camera: &Camera| match model.march_step() {
            Some(_) => (small(camera), 1),
            None => (*camera, camera.resolution[0].max(camera.resolution[1]).div_ceil(SIDE).max(1)),
        };
        let view = |camera: &Camera| {
            let (camera, stride) = at_size(camera);
            let rendered = model.strided_image(&camera, stride, pixel_offset, &[], monitor)?;
            let camera = camera.strided(stride, pixel_offset);
            let depth = |pixel: &Pixel| {
                if pixel.opacity > 0.5 { pixel.median_depth as f32 } else { f32::INFINITY }
            };
            Ok(SeenDepth { camera, depths: rendered.pixels.iter().map(depth).collect() })
        };
        let rows = |camera: &Camera| {
            let (camera, stride) = at_size(camera);
            u64::from(camera.resolution[1].div_ceil(stride))
        };
        monitor.begin("rows of training views", cameras.iter().map(rows).sum());
        let views = cameras.iter().map(view).collect::<Result<_>>()?;
        monitor.end();
        Ok(Self { views, slack: STEPS * model.march_step().unwrap_or(0.0) })
    }

    /// What cameras see whose depths are known, `[height · width]` each in scene units: infinite where nothing is seen.
    ///
    /// # Panics
    /// If a camera has not as many depths as pixels.
    #[must_use]
    pub fn of_depths(views: impl IntoIterator<Item = (Camera, Vec<f32>)>) -> Self {
        let view = |(camera, depths): (Camera, Vec<f32>)| {
            assert_eq!(depths.len() as u64, camera.pixels(), "a depth for every pixel");
            SeenDepth { camera, depths }
        };
        Self { views: views.into_iter().map(view).collect(), slack: 0.0 }
    }

    /// Number of cameras.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// A camera, with the pixels of its depth.
    #[must_use]
    pub fn camera(&self, i: usize) -> &Camera {
        &self.views[i].camera
    }

    /// Whether there are no cameras.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// Whether [`CONFIRMING_VIEWS`] cameras see a surface at the point `x`.
    fn confirm(&self, x: DVec3) -> bool {
        self.sighting(x).agreeing >= CONFIRMING_VIEWS
    }

    /// Whether [`CONFIRMING_VIEWS`] cameras see a surface at a pixel's median depth, for each pixel of a camera's view,
    /// `[height · width]`; false where nothing is shown. A deviation of depth is for such pixels: it holds how far a
    /// surface can be moved, and not whether matter that only one image needs is a surface at all.
    #[must_use]
    pub fn confirmed(&self, camera: &Camera, pixel_offset: f64, view: &RenderedView) -> Vec<bool> {
        let points = view.median_points(camera, pixel_offset);
        points.map(|(pixel, x)| pixel.opacity > 0.0 && self.confirm(x)).collect()
    }

    /// The indices of the cameras that see the point `x`, and whether they see a surface there.
    pub fn seeing(&self, x: DVec3) -> impl Iterator<Item = (usize, bool)> {
        self.views.iter().enumerate().filter_map(move |(i, view)| {
            let (before_surface, slack) = view.before_surface(x)?;
            let slack = slack + self.slack;
            (before_surface >= -slack).then_some((i, before_surface.abs() <= SAME_SURFACE * slack))
        })
    }

    /// How the cameras see the point `x`.
    #[must_use]
    pub fn sighting(&self, x: DVec3) -> Sighting {
        self.sighting_but(x, None)
    }

    /// The same without one of the cameras.
    pub(crate) fn sighting_but(&self, x: DVec3, without: Option<usize>) -> Sighting {
        let count = |found: Sighting, (_, agrees): (usize, bool)| Sighting {
            views: found.views + 1,
            agreeing: found.agreeing + usize::from(agrees),
        };
        self.seeing(x).filter(|(i, _)| Some(*i) != without).fold(Sighting { views: 0, agreeing: 0 }, count)
    }
}

fn small(camera: &Camera) -> Camera {
    let longer = camera.resolution[0].max(camera.resolution[1]).max(1);
    let side = |pixels: u32| (pixels * SIDE.min(longer)).div_ceil(longer);
    camera.resized(camera.resolution.map(side))
}

impl SeenDepth {
    /// How far a point lies before what the camera sees in its direction, negative behind it, and what that may be off
    /// by, scene units. `None` outside the image.
    fn before_surface(&self, x: DVec3) -> Option<(f64, f64)> {
        let ([column, row], _) = self.camera.project_inside(x)?;
        let distance = x.distance(self.camera.position);
        let slack = PIXELS * distance / self.camera.focal[0].min(self.camera.focal[1]);
        let depth = self.depths[row as usize * self.camera.resolution[0] as usize + column as usize];
        Some((f64::from(depth) - distance, slack))
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use octobayes::field::{ClosedForm, RadianceField};
    use octobayes::monitor::Silent;
    use octobayes::render::{Marcher, Tracer, VolumeRenderer};

    #[test]
    fn a_ball_is_seen_from_the_side_of_its_cameras() {
        let ball = ClosedForm::ball();
        let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
        let model = VolumeRenderer { tracer, differentiation: None };
        let from = |eye: DVec3| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [64; 2]);
        let cameras = [from(DVec3::new(3.0, 0.0, 0.1)), from(DVec3::new(0.0, 3.0, 0.1))];
        let views = TrainingViews::render(&model, &cameras, 0.5, &Silent).unwrap();
        // Where the rays through the middle of the pictures meet the ball.
        let hit = |towards: DVec3| {
            let camera = from(3.0 * towards);
            let view = model.image(&camera, 0.5, &[], &Silent).unwrap();
            camera.ray(32.5, 32.5).at(view.pixels[32 * 64 + 32].median_depth)
        };
        let front = views.sighting(hit(DVec3::X));
        assert_eq!((front.views, front.agreeing), (1, 1));
        let between = views.sighting(hit(DVec3::new(1.0, 1.0, 0.0).normalize()));
        assert_eq!((between.views, between.agreeing), (2, 2));
        let back = views.sighting(hit(DVec3::new(-1.0, -1.0, 0.0).normalize()));
        assert_eq!(back, Sighting { views: 0, agreeing: 0 });
        // Outside of all pictures, and behind a camera.
        assert_eq!(views.sighting(DVec3::new(0.0, 0.0, 3.0)).views, 0);
        assert_eq!(views.sighting(DVec3::new(8.0, 0.0, 0.0)).views, 0);
        // Air in front of the ball, in the picture of one camera only: it is seen through.
        let air = views.sighting(DVec3::new(1.4, 0.0, 0.0));
        assert_eq!((air.views, air.agreeing), (1, 0));
    }
}
