//! Scenes with known answers: sums of simple shapes with closed-form density and colour.
//!
//! A shape's density rises from 0 at signed distance d = s (softness) to its peak at d = −s along a smooth
//! ramp (a quintic, twice differentiable); for s = 0 it is a step. As in a trained field, empty space is
//! exactly empty. Densities of shapes add, and colours mix in proportion to them.

mod city;
mod columns;
mod rig;
mod scenes;
mod shapes;

pub use shapes::{Primitive, Shape, Texture};

use glam::Vec3;

use self::columns::Columns;
use self::rig::Rig;
use super::{Intrinsics, Radiance, RadianceField, TrainedField};
use crate::geometry::{Aabb, Camera};
use crate::{Error, Result};

/// A sum of primitives inside a box.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedForm {
    name: String,
    primitives: Vec<Primitive>,
    /// Lists of the primitives to add up by position; without it, all are added up.
    columns: Option<Columns>,
    bounds: Aabb,
    step: f64,
    rig: Option<Rig>,
}

impl ClosedForm {
    /// A scene of `primitives`. The density outside `bounds` counts as zero; `step` is the sample distance
    /// that resolves it, scene units.
    #[must_use]
    pub fn new(name: &str, primitives: Vec<Primitive>, bounds: Aabb, step: f64) -> Self {
        Self { name: name.to_owned(), primitives, columns: None, bounds, step, rig: None }
    }

    /// Names accepted by [`ClosedForm::named`], besides `city-SEED`.
    pub const NAMES: [&'static str; 6] = ["courtyard", "ball", "slab", "wall", "floater", "city"];

    /// The built-in scene of that name; `city` is `city-0`.
    ///
    /// # Errors
    /// If there is none.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "courtyard" => Ok(Self::courtyard()),
            "ball" => Ok(Self::ball()),
            "slab" => Ok(Self::slab(4.0)),
            "wall" => Ok(Self::wall(Vec3::X)),
            "floater" => Ok(Self::floater()),
            "city" => Self::city(0),
            other => match other.strip_prefix("city-").and_then(|seed| seed.parse().ok()) {
                Some(seed) => Self::city(seed),
                None => Err(Error::setting("scene", format!("{} or city-SEED", Self::NAMES.join(", ")), other)),
            },
        }
    }

    /// The same scene with samples `step` apart, scene units.
    #[must_use]
    pub fn with_step(self, step: f64) -> Self {
        Self { step, ..self }
    }

    /// The primitives of the scene.
    #[must_use]
    pub fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    /// Density and colour at a point of the box, summed over `primitives`.
    fn sum<'a>(x: Vec3, primitives: impl IntoIterator<Item = &'a Primitive>) -> Radiance {
        let (mut density, mut weighted) = (0.0, Vec3::ZERO);
        for primitive in primitives {
            let share = primitive.density(x);
            // Most shapes are elsewhere, and their colour would be multiplied by zero.
            if share != 0.0 {
                density += share;
                weighted += share * primitive.color(x);
            }
        }
        // Where there is no density, colour has no weight. A denormal divisor would turn it into noise.
        let color = if density > f32::MIN_POSITIVE { weighted / density } else { Vec3::splat(0.5) };
        Radiance { density, color }
    }

    /// The primitives whose indices are in a list.
    fn listed<'a>(&'a self, list: &'a [u32]) -> impl Iterator<Item = &'a Primitive> {
        list.iter().map(|&i| &self.primitives[i as usize])
    }
}

/// Sum of the primitives' bounds, in the order in which densities are added, so that rounding cannot put it
/// below the density.
fn sum_of_bounds<'a>(min: Vec3, max: Vec3, primitives: impl Iterator<Item = &'a Primitive>) -> f32 {
    primitives.fold(0.0, |sum, primitive| sum + primitive.density_bound(min, max))
}

impl RadianceField for ClosedForm {
    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn evaluate(&self, positions: &[Vec3], _directions: &[Vec3], out: &mut [Radiance]) {
        for (out, &x) in out.iter_mut().zip(positions) {
            *out = match &self.columns {
                _ if !self.bounds.contains(x) => Radiance::default(),
                None => Self::sum(x, &self.primitives),
                Some(columns) => Self::sum(x, self.listed(columns.at(x))),
            };
        }
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        let apart = min.as_dvec3().cmpgt(self.bounds.max()) | max.as_dvec3().cmplt(self.bounds.min());
        Some(match &self.columns {
            _ if apart.any() => 0.0,
            None => sum_of_bounds(min, max, self.primitives.iter()),
            Some(columns) => {
                columns.between(min, max).map(|list| sum_of_bounds(min, max, self.listed(list))).fold(0.0, f32::max)
            }
        })
    }

    fn suggested_step(&self) -> f64 {
        self.step
    }

    fn memory(&self) -> usize {
        size_of_val(self.primitives.as_slice()) + self.columns.as_ref().map_or(0, Columns::memory)
    }
}

impl TrainedField for ClosedForm {
    fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        self.rig.as_ref().map(|rig| rig.cameras(intrinsics)).transpose()
    }

    fn describe(&self) -> String {
        format!("closed-form scene `{}` of {} shapes", self.name, self.primitives.len())
    }
}

#[cfg(test)]
mod tests;
