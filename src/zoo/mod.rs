//! A zoo of hard scenes: closed form, small, each hard in one way, each with what is to be expected of it.
//!
//! Used by the tests (`tests/zoo`, against an oracle in f64), by `experiments/hard_cases`, and by people: `octobayes demo --scene
//! NAME`, or `scene:NAME` where a verb wants a model. Unless a scene is about something else, the box is [−1, 1]³, the finest lattice has
//! level 5 ([`CELL`] = 1/16), samples are an eighth of a cell apart, and twelve cameras stand around it.
//!
//! | module | hard because of |
//! |---|---|
//! | [`mod@surfaces`] | what is seen: no texture, too much of it, steps, sheets, fog, flat colours |
//! | [`mod@views`] | who sees it: one camera, two alike, none, one inside |
//! | [`mod@rays`] | where rays run: on lattice lines, through vertices, in faces, past the box |
//! | [`mod@boxes`] | the box: matter on its face, nothing in it, one cell of it; its size and place |
//! | [`mod@values`] | what the field returns: kinks, f16, NaN, ∞, negative and denormal numbers |

pub mod boxes;
mod measure;
pub mod rays;
mod specimen;
pub mod surfaces;
pub mod values;
pub mod views;

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};

pub use specimen::{Specimen, Treatment};

use crate::field::closed_form::rig::Rig;
use crate::field::closed_form::{Primitive, Shape, Texture};
use crate::field::{ClosedForm, Intrinsics, RadianceField};
use crate::geometry::{Aabb, Camera};
use crate::{Error, Result};

/// Edge of a finest cell of the usual lattice: 2 / 2⁵.
pub const CELL: f32 = 1.0 / 16.0;

/// What becomes of a hard case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The numbers can be believed.
    Handled,
    /// The numbers are what the method says, computed correctly, but they do not mean what one would like: a limit of the method itself.
    Limit,
    /// No field comes out; an error says why.
    Refused,
}

impl Verdict {
    /// For people.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Handled => "handled",
            Self::Limit => "the method's own limit",
            Self::Refused => "refused with an error",
        }
    }
}

/// A number that a finished field can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Decades from the prior down to the least U at a vertex, covariance `diagonal`.
    Diagonal,
    /// The same, covariance `block`.
    Block,
    /// Shard of the lattice's vertices whose U (`trace`) is more than a tenth of a decade below the prior.
    Moved,
    /// Shard of the rays that were dropped.
    Dropped,
}

impl Quantity {
    /// For people.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Diagonal => "decades from the prior down to the least U, `diagonal`",
            Self::Block => "decades from the prior down to the least U, `block`",
            Self::Moved => "share of the lattice's vertices that moved",
            Self::Dropped => "share of the rays that were dropped",
        }
    }
}

/// What is to be expected, in words and as a bound.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// For people.
    pub words: &'static str,
    /// What is measured.
    pub quantity: Quantity,
    /// Between what it lies, at the scene's own level, with 2,000 rays or more.
    pub range: RangeInclusive<f64>,
}

/// A hard scene.
#[derive(Debug, Clone)]
pub struct Scene {
    /// What it is called.
    pub name: &'static str,
    /// What is hard about it, and what is to be expected.
    pub about: &'static str,
    /// The field; it brings its training cameras.
    pub field: Specimen,
    /// Level of the finest lattice that it is made for.
    pub level: u8,
    /// What becomes of it.
    pub verdict: Verdict,
    /// What is to be expected, as bounds; of scenes that are refused, nothing.
    pub claims: Vec<Claim>,
}

impl Scene {
    /// The training cameras.
    #[must_use]
    pub fn cameras(&self) -> Vec<Camera> {
        // The rig's own lens is one that it accepts, and a specimen always has a rig.
        self.field.cameras(&Intrinsics::default()).ok().flatten().unwrap_or_default()
    }
}

/// All scenes.
#[must_use]
pub fn all() -> Vec<Scene> {
    [surfaces::all(), views::all(), rays::all(), boxes::all(), values::all()].concat()
}

/// Their names.
#[must_use]
pub fn names() -> Vec<&'static str> {
    all().iter().map(|scene| scene.name).collect()
}

/// The scene of that name.
///
/// # Errors
/// If there is none.
pub fn by_name(name: &str) -> Result<Scene> {
    let mut scenes = all();
    match scenes.iter().position(|scene| scene.name == name) {
        Some(i) => Ok(scenes.swap_remove(i)),
        None => Err(Error::setting("scene", "the name of a scene of the zoo", name)),
    }
}

fn claim(words: &'static str, quantity: Quantity, range: RangeInclusive<f64>) -> Claim {
    Claim { words, quantity, range }
}

/// Twelve cameras around the scene, at three heights.
fn ring() -> Rig {
    let eye = |i: u32| {
        let (sin, cos) = (PI / 6.0 * f64::from(i)).sin_cos();
        DVec3::new(2.8 * cos, 2.8 * sin, [0.9, -0.6, 1.7][i as usize % 3])
    };
    Rig { viewpoints: (0..12).map(|i| (eye(i), DVec3::ZERO)).collect(), fov_x: 0.8, resolution: [64, 64] }
}

/// Cameras of one pixel, hence of one ray each, from the eyes through the targets.
fn single_rays(viewpoints: Vec<(DVec3, DVec3)>) -> Rig {
    Rig { viewpoints, fov_x: 0.8, resolution: [1, 1] }
}

/// A scene of one shape in the usual box, with samples an eighth of a usual cell apart.
fn one(name: &str, primitive: Primitive) -> ClosedForm {
    several(name, vec![primitive])
}

fn several(name: &str, primitives: Vec<Primitive>) -> ClosedForm {
    ClosedForm::new(name, primitives, Aabb::centered_cube(1.0), f64::from(CELL) / 8.0)
}

/// A soft ball that is easy to see, for scenes that are hard because of something else.
fn ball() -> Primitive {
    Primitive {
        shape: Shape::Ball { center: Vec3::ZERO, radius: 0.5 },
        peak: 80.0,
        softness: 0.04,
        texture: waves(9.0),
    }
}

/// Smooth texture in all channels.
fn waves(frequency: f32) -> Texture {
    Texture::Waves { base: Vec3::new(0.6, 0.5, 0.4), amplitude: 0.3, frequency }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_unique_and_found() {
        let scenes = all();
        let names: BTreeSet<&str> = scenes.iter().map(|scene| scene.name).collect();
        assert_eq!(names.len(), scenes.len());
        for name in &names {
            assert_eq!(by_name(name).unwrap().name, *name);
            assert!(!ClosedForm::NAMES.contains(name), "{name} is a built-in scene too");
        }
        assert!(by_name("teapot").is_err());
    }

    #[test]
    fn every_scene_has_cameras_and_what_is_not_refused_has_a_claim() {
        for scene in all() {
            assert!(!scene.cameras().is_empty(), "{}", scene.name);
            assert_eq!(scene.claims.is_empty(), scene.verdict == Verdict::Refused, "{}", scene.name);
        }
    }
}
