//! Which training cameras see a point: by the depth that the model shows them, or by true depth, which is the truth
//! about what was never seen.

use glam::DVec3;
use rayon::prelude::*;

use super::DepthMeaning;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes::render::{Pixel, RenderedView, Renderer};
use octobayes_data::{DepthReadings, Frame};

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
#[derive(Debug, Clone)]
pub struct TrainingViews {
    views: Vec<SeenDepth>,
    /// What a depth may be off by, whatever the distance, scene units.
    slack: f64,
}

#[derive(Debug, Clone)]
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
            let rendered = model.strided_image(&camera, stride, pixel_offset, &[], &[], monitor)?;
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

    /// The depth that the cameras of frames with depth maps truly saw, and what the maps hold. Where a map holds no
    /// measurement, its camera saw to infinity. A stage of its own for the monitor.
    ///
    /// # Errors
    /// If a map is missing or damaged, or its size differs from its camera's; [`octobayes::Error::Interrupted`].
    pub fn from_depth_maps(
        frames: &[Frame],
        depth: &DepthMeaning,
        pixel_offset: f64,
        monitor: &dyn Monitor,
    ) -> Result<(Self, DepthReadings)> {
        let view = |frame: &Frame| {
            check(monitor)?;
            let distance = depth.read(frame, pixel_offset)?.distance;
            let mut readings = DepthReadings::default();
            distance.iter().for_each(|distance| readings.count(*distance));
            let depths = distance.into_iter().map(|d| d.map_or(f32::INFINITY, |d| d as f32)).collect();
            monitor.advance(1);
            Ok((SeenDepth { camera: frame.camera, depths }, readings))
        };
        monitor.begin("training depth maps", frames.len() as u64);
        let found: Vec<(SeenDepth, DepthReadings)> = frames.par_iter().map(view).collect::<Result<_>>()?;
        monitor.end();
        let mut readings = DepthReadings::default();
        found.iter().for_each(|(_, of_view)| readings += *of_view);
        Ok((Self { views: found.into_iter().map(|(view, _)| view).collect(), slack: 0.0 }, readings))
    }

    /// Number of cameras.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.len()
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

    /// The cameras that see the point `x`, and whether they see a surface there.
    pub fn seeing(&self, x: DVec3) -> impl Iterator<Item = (&Camera, bool)> {
        self.views.iter().filter_map(move |view| {
            let (before_surface, slack) = view.before_surface(x)?;
            let slack = slack + self.slack;
            (before_surface >= -slack).then_some((&view.camera, before_surface.abs() <= SAME_SURFACE * slack))
        })
    }

    /// How the cameras see the point `x`.
    #[must_use]
    pub fn sighting(&self, x: DVec3) -> Sighting {
        let count = |found: Sighting, (_, agrees)| Sighting {
            views: found.views + 1,
            agreeing: found.agreeing + usize::from(agrees),
        };
        self.seeing(x).fold(Sighting { views: 0, agreeing: 0 }, count)
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
    use crate::{DepthFiles, FramesWithDepth};
    use octobayes::field::{ClosedForm, RadianceField};
    use octobayes::monitor::Silent;
    use octobayes::render::{Marcher, Tracer, VolumeRenderer};
    use octobayes_data::DepthKind;

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
            let view = model.image(&camera, 0.5, &[], &[], &Silent).unwrap();
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

    #[test]
    fn by_true_depth_a_ball_is_seen_where_it_faces_a_camera() {
        const RADIUS: f64 = 1.0;
        let from = |eye: DVec3| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.9, [400; 2]);
        let cameras = [DVec3::new(3.0, 0.0, 0.5), DVec3::new(-1.0, 3.0, 0.2)].map(from);
        let folder = tempfile::tempdir().unwrap();
        let name = |i: usize| format!("images/r_{i}.png");
        let mut frames: Vec<Frame> = (0..).zip(&cameras).map(|(i, camera)| Frame::new(*camera, name(i), "")).collect();
        let files = DepthFiles {
            folder: Some(folder.path().into()),
            pattern: "{}.exr".into(),
            scale: None,
            kind: DepthKind::Euclidean,
        };
        // What programs write where there is no surface, and a far plane.
        let read = |nothing: f32| {
            let mut missed = 0;
            for (i, camera) in cameras.iter().enumerate() {
                let mut depth = |pixel: usize| {
                    let ray = camera.ray((pixel % 400) as f64 + 0.5, (pixel / 400) as f64 + 0.5);
                    let (b, c) = (ray.origin.dot(ray.direction), ray.origin.length_squared() - RADIUS * RADIUS);
                    let root = b * b - c;
                    missed += u64::from(root <= 0.0);
                    if root > 0.0 { (-b - root.sqrt()) as f32 } else { nothing }
                };
                let depths = (0..400 * 400).map(&mut depth).collect();
                let path = folder.path().join(format!("r_{i}.exr"));
                octobayes_data::write_exr(&path, [400; 2], vec![("depth.Z", depths)]).unwrap();
            }
            let FramesWithDepth { frames, encoding, .. } = files.find(folder.path(), &frames, &frames).unwrap();
            let depth = DepthMeaning { encoding, bounds: octobayes::geometry::Aabb::centered_cube(RADIUS), jump: 0.0 };
            let (views, readings) = TrainingViews::from_depth_maps(&frames, &depth, 0.5, &Silent).unwrap();
            assert_eq!((readings.measured, readings.total()), (320_000 - missed, 320_000), "{nothing}");
            views
        };
        let views = read(0.0);
        assert_eq!((views.len(), views.is_empty()), (2, false));
        for nothing in [1e10, 65504.0, f32::MAX, f32::INFINITY, f32::NAN, -1.0, 1000.0] {
            for (view, expected) in read(nothing).views.iter().zip(&views.views) {
                assert!(view.depths == expected.depths, "{nothing}");
            }
        }
        let (mut seen, mut hidden) = (0, 0);
        for i in 0..4000 {
            // A spiral over the ball.
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0;
            let (sin, cos) = (2.399_963_229_728_653 * f64::from(i)).sin_cos();
            let normal = DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
            let facing = cameras.map(|camera| normal.dot((camera.position - RADIUS * normal).normalize()));
            // A point is at most √½ of a pixel's width from the middle of its pixel, and the surface there two widths
            // nearer only if its slope exceeds 2.8: where the cosine is below 0.34.
            if facing.iter().any(|cos| cos.abs() < 0.34) {
                continue;
            }
            let expected = facing.iter().filter(|cos| **cos > 0.0).count();
            assert_eq!(views.sighting(RADIUS * normal).views, expected, "at {normal}");
            (seen, hidden) = (seen + usize::from(expected > 0), hidden + usize::from(expected == 0));
        }
        assert!(seen > 1000 && hidden > 500, "{seen} seen, {hidden} not");
        frames[1].name = "images/r_9.png".into();
        let missing = files.find(folder.path(), &frames, &frames).unwrap_err().to_string();
        assert!(missing.ends_with("none of images/r_9.exr, r_9.exr"), "{missing}");
    }
}
