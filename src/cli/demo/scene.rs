//! What the demo shows: a model trained on the courtyard, a built-in scene itself, or one of the zoo.

use glam::DVec3;

use crate::cli::report;
use crate::field::{ClosedForm, HashGrid, Intrinsics, RadianceField};
use crate::geometry::{Aabb, Camera};
use crate::uncertainty::UncertaintyField;
use crate::zoo::{self, HardScene};
use crate::{Error, Result};

/// Cameras of the courtyard, all on one side.
const CAMERAS: u32 = 40;
/// Finest level, unless a hard scene has its own.
const LEVEL: u8 = 7;
/// Rays for the trained model, and for closed-form scenes, which are faster.
const RAYS: [u64; 2] = [40_000, 200_000];
/// Distance between samples along the trained model's rays, over the distance that it suggests. A model trained
/// for seconds is foggy, and its pictures are small.
const COARSER: f64 = 2.0;
/// Decades below the prior at which colour bars begin, and at which clean-up starts to remove density.
const BELOW_PRIOR: [f64; 2] = [4.0, 1.0];
/// Cameras with a smaller angle of view than this, radians, are close-ups. Pictures from anywhere else would show
/// nothing.
const CLOSE_UP: f64 = 0.2;
/// Width and height of a picture, pixels.
const PICTURE: [u32; 2] = [220, 220];

/// A scene with its cameras, and how to show it.
pub struct DemoScene {
    pub field: Box<dyn RadianceField>,
    pub cameras: Vec<Camera>,
    /// Finest level, unless the user names one.
    pub level: u8,
    /// Rays, unless the user names a number.
    pub rays: u64,
    /// Distance between samples over the suggested one.
    pub coarser: f64,
    /// From where the scene was seen, in words. Empty if there is nothing to say.
    pub side: &'static str,
    /// Name of the model in the protocol.
    pub source: String,
    /// How U is shown; `None` for [`Shown::below`] its prior.
    pub shown: Option<Shown>,
    /// The scene of the zoo with its expectations, if it is one.
    pub hard: Option<HardScene>,
}

/// How U is shown.
#[derive(Clone, Copy)]
pub struct Shown {
    /// Ends of the colour bars, log10 U.
    pub log10: [f64; 2],
    /// log10 U above which clean-up removes density.
    pub threshold: f64,
}

impl Shown {
    /// For the trained model: from the best seen surface to the prior of level 7, rounded. Most of what cameras
    /// saw lies below the threshold, most of what the model made up lies above.
    const TRAINED: Self = Self { log10: [2.0, 6.0], threshold: 4.4 };

    /// Colour bars and threshold by [`BELOW_PRIOR`], from log10 U of the prior.
    pub fn below(prior: f64) -> Self {
        Self { log10: [prior - BELOW_PRIOR[0], prior], threshold: prior - BELOW_PRIOR[1] }
    }
}

/// The courtyard, with cameras on one side.
pub fn courtyard() -> (ClosedForm, Vec<Camera>) {
    (ClosedForm::courtyard(), ClosedForm::half_circle(CAMERAS, [200, 200]))
}

impl DemoScene {
    /// The scene of that name.
    ///
    /// # Errors
    /// If there is none.
    pub fn named(name: &str) -> Result<Self> {
        let hard = zoo::by_name(name).ok();
        let (field, cameras): (Box<dyn RadianceField>, _) = match &hard {
            Some(scene) => (Box::new(scene.field.clone()), scene.cameras()),
            None => {
                let field = ClosedForm::named(name)?;
                let cameras = field.cameras(&Intrinsics::default())?.unwrap_or_default();
                (Box::new(field), cameras)
            }
        };
        let level = hard.as_ref().map_or(LEVEL, |scene| scene.level);
        let (rays, source) = (RAYS[1], format!("scene:{name}"));
        Ok(Self { field, cameras, level, rays, coarser: 1.0, side: "", source, shown: None, hard })
    }

    /// The model trained on pictures of the courtyard.
    pub fn trained(model: HashGrid, cameras: Vec<Camera>) -> Self {
        let (source, shown) = (model.describe(), Some(Shown::TRAINED));
        let (rays, side, field) = (RAYS[0], " from one side only", Box::new(model));
        Self { field, cameras, level: LEVEL, rays, coarser: COARSER, side, source, shown, hard: None }
    }

    /// Two views. The trained model is shown from the seen and from the unseen side, a close-up by two of its
    /// cameras. Other scenes are shown from x > 0, the side of the courtyard's cameras, and from x < 0.
    pub fn views(&self) -> [(&'static str, Camera); 2] {
        let first = &self.cameras[0];
        let angle = 2.0 * (0.5 * f64::from(first.resolution[0]) / first.focal[0]).atan();
        if !self.side.is_empty() {
            let seen = self.cameras[self.cameras.len() / 2].resized(PICTURE);
            let target = DVec3::new(0.0, 0.0, -0.25);
            let mirrored = DVec3::new(-seen.position.x, seen.position.y, seen.position.z);
            [("seen", seen), ("unseen", Camera::look_at(mirrored, target, DVec3::Z, 0.8, PICTURE))]
        } else if angle < CLOSE_UP {
            let [one, other] = [0, self.cameras.len() / 2].map(|i| self.cameras[i].resized(PICTURE));
            [("one side", one), ("other side", other)]
        } else {
            let [one, other] = [1.0, -1.0].map(|side| outside(&self.field.bounds(), side));
            [("side x > 0", one), ("side x < 0", other)]
        }
    }

    /// What is hard about the scene, if anything is.
    pub fn about(&self) -> Option<String> {
        let scene = self.hard.as_ref()?;
        Some(format!("expected: {}\nverdict:  {}", scene.about, scene.verdict.words()))
    }

    /// What to expect of a hard scene, beside what was measured.
    pub fn outcome(&self, field: &UncertaintyField) -> Option<String> {
        let scene = self.hard.as_ref()?;
        let line = |claim: &zoo::Claim| {
            let (found, range) = (claim.quantity.read(field), &claim.range);
            let judged = if range.contains(&found) { "as expected" } else { "NOT as expected" };
            let [low, high, found] = [*range.start(), *range.end(), found].map(report::short);
            format!(
                "  {}: {}: {low} to {high} expected, {found} measured: {judged}",
                claim.words,
                claim.quantity.words()
            )
        };
        let lines: Vec<String> = scene.claims.iter().map(line).collect();
        Some(format!("expected at level {}, with 2000 rays or more\n{}", scene.level, lines.join("\n")))
    }
}

/// A camera outside a box that sees all of it.
fn outside(bounds: &Aabb, side: f64) -> Camera {
    let (center, half) = (0.5 * (bounds.min() + bounds.max()), 0.5 * bounds.longest_edge());
    Camera::look_at(center + half * DVec3::new(3.4 * side, 1.1, 1.5), center, DVec3::Z, 0.8, PICTURE)
}

/// All names, and what to expect of the hard scenes.
pub fn list() -> String {
    let built_in = ClosedForm::NAMES.join(", ");
    let line = |scene: HardScene| format!("  {:<20} {}: {}", scene.name, scene.verdict.words(), scene.about);
    let hard: Vec<String> = zoo::all().into_iter().map(line).collect();
    format!("built-in: {built_in}, city-SEED\nhard, each in one way:\n{}", hard.join("\n"))
}

/// As [`DemoScene::named`], with an error that names `--scene`.
pub fn subject(name: &str) -> Result<DemoScene> {
    DemoScene::named(name).map_err(|_| {
        let expected = format!("{}, city-SEED, or one that `--scene list` lists", ClosedForm::NAMES.join(", "));
        Error::setting("--scene", expected, name)
    })
}
