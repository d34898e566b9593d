//! A zoo of hard scenes: small closed-form scenes, each hard in one way, each with stated expectations.
//!
//! They serve the tests beside them, against an oracle in f64, and `experiments/hard_cases`. Unless a scene is about
//! something else, the box is [−1, 1]³, the finest lattice has level 5 ([`CELL`] = 1/16), samples are an eighth of a
//! cell apart, and twelve cameras stand around it.
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

use octobayes::field::ClosedForm;
use octobayes::field::closed_form::{Primitive, Shape, Texture};
use octobayes::geometry::{Aabb, Camera};

pub use specimen::{Rig, Specimen, Treatment};

/// Level of the finest lattice that scenes are made for.
pub const LEVEL: u8 = 5;

/// Edge of a finest cell of the usual lattice: 2 / 2⁵.
pub const CELL: f32 = 1.0 / 16.0;

/// Outcome of a hard case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The numbers can be trusted.
    Handled,
    /// The numbers are those of the method, computed correctly, but do not mean what one would like:
    /// the method's own limit.
    Limit,
    /// No field is produced; an error says why.
    Refused,
}

/// A number that can be measured on a finished field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Decades from the prior down to the lowest U at a vertex, for covariance `diagonal`.
    Diagonal,
    /// The same for covariance `block`.
    Block,
    /// Share of the lattice's vertices whose U (`trace`) is more than a tenth of a decade below the prior.
    Lowered,
    /// Share of the rays that were dropped.
    Dropped,
}

impl Quantity {
    /// Human-readable description.
    pub fn words(self) -> &'static str {
        match self {
            Self::Diagonal => "decades from the prior down to the least U, `diagonal`",
            Self::Block => "decades from the prior down to the least U, `block`",
            Self::Lowered => "share of the lattice's vertices where U is lowered",
            Self::Dropped => "share of the rays that were dropped",
        }
    }
}

/// An expectation, in words and as bounds.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// Human-readable statement.
    pub words: &'static str,
    /// Quantity that is measured.
    pub quantity: Quantity,
    /// Range of the quantity at the scene's own level, with 2,000 rays or more.
    pub range: RangeInclusive<f64>,
}

/// A hard scene.
#[derive(Debug, Clone)]
pub struct HardScene {
    /// Name of the scene.
    pub name: &'static str,
    /// What is hard about the scene, and what to expect.
    pub about: &'static str,
    /// The field, with its training cameras.
    pub field: Specimen,
    /// Outcome.
    pub verdict: Verdict,
    /// Expectations as bounds; empty for refused scenes.
    pub claims: Vec<Claim>,
}

impl HardScene {
    /// Training cameras of the scene.
    pub fn cameras(&self) -> Vec<Camera> {
        self.field.training_cameras()
    }
}

/// All scenes of the zoo.
pub fn all() -> Vec<HardScene> {
    [surfaces::all(), views::all(), rays::all(), boxes::all(), values::all()].concat()
}

/// Finds a scene by its name.
///
/// # Panics
/// If there is no such scene.
pub fn by_name(name: &str) -> HardScene {
    all().into_iter().find(|scene| scene.name == name).unwrap_or_else(|| panic!("no scene {name}"))
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

/// Cameras with one pixel, hence one ray each, from the eyes through the targets.
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

/// A soft ball that is easy to see, for scenes that are hard for another reason.
fn ball() -> Primitive {
    Primitive {
        shape: Shape::Ball { center: Vec3::ZERO, radius: 0.5 },
        peak: 80.0,
        softness: 0.04,
        texture: waves(9.0),
    }
}

/// A smooth texture in all channels.
fn waves(frequency: f32) -> Texture {
    Texture::Waves { base: Vec3::new(0.6, 0.5, 0.4), amplitude: 0.3, frequency }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_are_unique_and_found() {
        let scenes = all();
        let names: BTreeSet<&str> = scenes.iter().map(|scene| scene.name).collect();
        assert_eq!(names.len(), scenes.len());
        for name in &names {
            assert_eq!(by_name(name).name, *name);
            assert!(!ClosedForm::NAMES.contains(name), "{name} is a built-in scene too");
        }
    }

    #[test]
    fn every_scene_has_cameras_and_what_is_not_refused_has_a_claim() {
        for scene in all() {
            assert!(!scene.cameras().is_empty(), "{}", scene.name);
            assert_eq!(scene.claims.is_empty(), scene.verdict == Verdict::Refused, "{}", scene.name);
        }
    }
}
