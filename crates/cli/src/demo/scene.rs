//! What the demo shows: a model trained on the courtyard, or a built-in scene itself.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::model::DemoModel;
use octobayes::field::closed_form::{Primitive, Shape, Texture};
use octobayes::field::{ClosedForm, Intrinsics, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Camera};
use octobayes::{Error, Result};

/// Cameras of the courtyard, all on one side.
const CAMERAS: u32 = 40;
/// The angle over which they are spread, as seen from the middle of the scene, radians.
const ARC: f64 = 2.0 / 3.0 * PI;
/// Distance of the cameras from the axis of the scene, scene units.
const DISTANCE: f64 = 2.8;
/// The point that they look at.
const TARGET: DVec3 = DVec3::new(0.0, 0.0, -0.25);
/// The point at which pictures of the trained model look, and their angle of view, radians. The scene just fits.
const PICTURED: (DVec3, f64) = (DVec3::new(0.0, 0.0, -0.75), 0.68);
/// Half the width of a surface of the courtyard, scene units.
const SOFTNESS: f32 = 0.016;
/// Distance from true matter within which matter of the model counts as true, scene units: the width of a surface.
/// At level 7 these are two cells.
pub const TOLERANCE: f32 = 2.0 * SOFTNESS;
/// Width and height of a picture, pixels.
const PICTURE: [u32; 2] = [400, 330];

/// A scene with its cameras, and how to show it.
pub struct DemoScene {
    pub field: Box<dyn TrainedField>,
    /// Name of each camera's picture, and the camera.
    pub cameras: Vec<(String, Camera)>,
    /// Name of the model in the record.
    pub source: String,
    /// What the model was trained on, if it was.
    pub truth: Option<Truth>,
}

/// The scene that a model was trained on, and cameras to compare the model with it.
pub struct Truth {
    pub scene: ClosedForm,
    /// Cameras between those of training.
    pub held_out: Vec<Camera>,
    /// Cameras on the side that no camera of training saw.
    pub behind: Vec<Camera>,
}

impl Truth {
    /// `cameras` are those of the scene; the `held_out` ones among them were not trained on.
    pub fn new(scene: ClosedForm, cameras: &[Camera], held_out: Vec<Camera>) -> Self {
        Self { scene, held_out, behind: cameras.iter().map(mirrored).collect() }
    }

    /// Returns true if the scene has matter within [`TOLERANCE`] of a point, along each axis.
    pub fn has_matter_near(&self, x: Vec3) -> bool {
        self.scene.density_bound(x - TOLERANCE, x + TOLERANCE).is_none_or(|bound| bound > 0.0)
    }
}

/// The same view from the other side of the plane x = 0.
fn mirrored(camera: &Camera) -> Camera {
    let mirror = DVec3::new(-1.0, 1.0, 1.0);
    let fov_x = 2.0 * (0.5 * f64::from(camera.resolution[0]) / camera.focal[0]).atan();
    let (eye, forward) = (mirror * camera.position, -mirror * camera.axes.z_axis);
    Camera::look_at(eye, eye + forward, DVec3::Z, fov_x, camera.resolution)
}

/// A courtyard with texture everywhere, and cameras on one side of it, with pictures of that width and height.
///
/// It differs from [`ClosedForm::courtyard`] in what a stranger would take for an error of the method: the cloud, which
/// is true and looks like a floater, and the ball without texture, on which sliding goes unnoticed. Its surfaces
/// are half as thick, and the floor ends within the box.
pub fn courtyard(resolution: u32) -> (ClosedForm, Vec<Camera>) {
    let solid = |shape, [r, g, b]: [f32; 3], frequency| {
        let texture = Texture::Waves { base: Vec3::new(r, g, b), amplitude: 0.25, frequency };
        Primitive { shape, peak: 300.0, softness: SOFTNESS, texture }
    };
    let block =
        |z, half, color, frequency| solid(Shape::Box { center: Vec3::new(0.0, 0.0, z), half }, color, frequency);
    let ball =
        |x, y, color, frequency| solid(Shape::Ball { center: Vec3::new(x, y, -0.35), radius: 0.25 }, color, frequency);
    let primitives = vec![
        block(-0.7, Vec3::new(0.8, 0.8, 0.1), [0.55, 0.5, 0.42], 14.0),
        block(-0.25, Vec3::new(0.15, 0.15, 0.35), [0.5, 0.35, 0.6], 16.0),
        ball(0.5, 0.5, [0.7, 0.3, 0.25], 18.0),
        ball(-0.5, 0.5, [0.3, 0.55, 0.3], 22.0),
        ball(0.5, -0.5, [0.3, 0.4, 0.7], 26.0),
        ball(-0.5, -0.5, [0.7, 0.65, 0.3], 20.0),
    ];
    let scene = ClosedForm::new("courtyard", primitives, Aabb::centered_cube(1.0), 1.0 / 256.0);
    let camera = |i: u32| {
        let azimuth = ARC * ((f64::from(i) + 0.5) / f64::from(CAMERAS) - 0.5);
        let height = if i.is_multiple_of(2) { 0.9 } else { 1.7 };
        let eye = DVec3::new(DISTANCE * azimuth.cos(), DISTANCE * azimuth.sin(), height);
        Camera::look_at(eye, TARGET, DVec3::Z, 0.8, [resolution; 2])
    };
    (scene, (0..CAMERAS).map(camera).collect())
}

impl DemoScene {
    /// The scene of that name.
    pub fn named(name: &str) -> Result<Self> {
        let field = ClosedForm::named(name)?;
        let cameras = field.cameras(&Intrinsics::default())?.unwrap_or_default();
        let cameras = cameras.into_iter().enumerate().map(|(i, camera)| (format!("train/r_{i}"), camera)).collect();
        Ok(Self { field: Box::new(field), cameras, source: format!("scene:{name}"), truth: None })
    }

    /// The model trained on pictures of the courtyard.
    pub fn trained(model: DemoModel) -> Self {
        let DemoModel { field, truth, .. } = model;
        let cameras = field.training_cameras().iter().map(|named| (named.name.clone(), named.camera)).collect();
        let (source, field) = (field.describe(), Box::new(field));
        Self { field, cameras, source, truth: Some(truth) }
    }

    /// The cameras without their names.
    pub fn poses(&self) -> Vec<Camera> {
        self.cameras.iter().map(|named| named.1).collect()
    }

    /// Two views. The trained model is shown by a camera that was held out, and from behind. Other scenes are shown
    /// from x > 0, the side of the courtyard's cameras, and from x < 0.
    pub fn views(&self) -> [(&'static str, Camera); 2] {
        if let Some(truth) = &self.truth {
            let seen = truth.held_out[truth.held_out.len() / 2];
            let seen = Camera::look_at(seen.position, PICTURED.0, DVec3::Z, PICTURED.1, PICTURE);
            [("seen side", seen), ("from behind", mirrored(&seen))]
        } else {
            let [one, other] = [1.0, -1.0].map(|side| outside(&self.field.bounds(), side));
            [("side x > 0", one), ("side x < 0", other)]
        }
    }
}

/// A camera outside a box that sees all of it.
fn outside(bounds: &Aabb, side: f64) -> Camera {
    let (center, half) = (0.5 * (bounds.min() + bounds.max()), 0.5 * bounds.longest_edge());
    Camera::look_at(center + half * DVec3::new(3.4 * side, 1.1, 1.5), center, DVec3::Z, 0.8, PICTURE)
}

/// As [`DemoScene::named`], with an error that names `--scene`.
pub fn subject(name: &str) -> Result<DemoScene> {
    DemoScene::named(name)
        .map_err(|_| Error::setting("--scene", format!("{} or city-SEED", ClosedForm::NAMES.join(", ")), name))
}
