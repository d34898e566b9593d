//! What the demo runs on: the courtyard, another built-in scene, or one of the zoo.

use glam::DVec3;

use crate::cli::report;
use crate::field::zoo::{self, Scene};
use crate::field::{ClosedForm, Intrinsics, RadianceField};
use crate::geometry::{Aabb, Camera};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The name of the scene that the demo shows unless told otherwise.
pub const COURTYARD: &str = "courtyard";
/// The courtyard's level.
const LEVEL: u8 = 7;
/// Cameras that see less than this, radians, are close-ups: pictures from anywhere else would show nothing.
const CLOSE_UP: f64 = 0.2;
/// Pixels of a picture.
const PICTURE: [u32; 2] = [220, 220];

/// A scene with its cameras, and how to show it.
pub struct Subject {
    /// As `--scene` names it.
    pub name: String,
    pub field: Box<dyn RadianceField>,
    pub cameras: Vec<Camera>,
    /// Finest level unless told otherwise.
    pub level: u8,
    /// What is to be expected, if it is one of the zoo.
    pub hard: Option<Scene>,
}

impl Subject {
    /// The scene of that name.
    ///
    /// # Errors
    /// If there is none.
    pub fn named(name: &str) -> Result<Self> {
        if let Ok(scene) = zoo::by_name(name) {
            let (field, cameras) = (Box::new(scene.field.clone()), scene.cameras());
            return Ok(Self { name: name.into(), field, cameras, level: scene.level, hard: Some(scene) });
        }
        let field = ClosedForm::named(name)?;
        let cameras = field.cameras(&Intrinsics::default())?.unwrap_or_default();
        Ok(Self { name: name.into(), field: Box::new(field), cameras, level: LEVEL, hard: None })
    }

    /// Two views: from the side x > 0, where the built-in scenes' cameras are, and from the other.
    pub fn views(&self) -> [(&'static str, Camera); 2] {
        let first = &self.cameras[0];
        let angle = 2.0 * (0.5 * f64::from(first.resolution[0]) / first.focal[0]).atan();
        if self.name == COURTYARD {
            let seen = self.cameras[self.cameras.len() / 2].resized(PICTURE);
            let target = DVec3::new(0.0, 0.0, -0.25);
            let mirrored = DVec3::new(-seen.position.x, seen.position.y, seen.position.z);
            [("seen side", seen), ("unseen side", Camera::look_at(mirrored, target, DVec3::Z, 0.8, PICTURE))]
        } else if angle < CLOSE_UP {
            let [one, other] = [0, self.cameras.len() / 2].map(|i| self.cameras[i].resized(PICTURE));
            [("one side", one), ("other side", other)]
        } else {
            let [one, other] = [1.0, -1.0].map(|side| outside(&self.field.bounds(), side));
            [("side x > 0", one), ("side x < 0", other)]
        }
    }

    /// What is hard about the scene, if something is.
    pub fn about(&self) -> Option<String> {
        let scene = self.hard.as_ref()?;
        Some(format!("expected: {}\nverdict:  {}", scene.about, scene.verdict.words()))
    }

    /// Bounds on what is to be expected of the scene, beside what was measured.
    pub fn outcome(&self, field: &UncertaintyField) -> Option<String> {
        let scene = self.hard.as_ref()?;
        let line = |claim: &zoo::Claim| {
            let (found, range) = (claim.quantity.of(field), &claim.range);
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

/// A camera outside of a box that sees all of it.
fn outside(bounds: &Aabb, side: f64) -> Camera {
    let (center, half) = (0.5 * (bounds.min() + bounds.max()), 0.5 * bounds.longest_edge());
    Camera::look_at(center + half * DVec3::new(3.4 * side, 1.1, 1.5), center, DVec3::Z, 0.8, PICTURE)
}

/// All names, with what is to be expected of the hard scenes.
pub fn list() -> String {
    let built_in = ClosedForm::NAMES.join(", ");
    let line = |scene: Scene| format!("  {:<20} {}: {}", scene.name, scene.verdict.words(), scene.about);
    let hard: Vec<String> = zoo::all().into_iter().map(line).collect();
    format!("built-in: {built_in}, city-SEED\nhard, each in one way:\n{}", hard.join("\n"))
}

/// As `Subject::named`, with an error that names `--scene`.
pub fn subject(name: &str) -> Result<Subject> {
    Subject::named(name).map_err(|_| {
        let expected = format!("{}, city-SEED, or one that `--scene list` lists", ClosedForm::NAMES.join(", "));
        Error::setting("--scene", expected, name)
    })
}
