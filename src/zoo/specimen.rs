//! A closed-form scene, what is done to its values, and where in space it is put.

use glam::{DVec3, Vec3};
use half::f16;

use crate::Result;
use crate::field::closed_form::rig::Rig;
use crate::field::{ClosedForm, Differentiable, Intrinsics, Radiance, RadianceField, VoxelGrid};
use crate::geometry::{Aabb, Camera};

/// What is done to the values of a closed-form scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Treatment {
    /// Nothing.
    Exact,
    /// Each colour c goes through a sigmoid that is flat there: 1 / (1 + exp(−(o + 8 (c − ½)))), o = 20 for red and green, −20 for
    /// blue. In f32 red and green are 1.
    Saturated,
    /// Values at `points`³ grid points that include the faces of the box, trilinear in between ([`VoxelGrid`]): gradients jump from cell
    /// to cell, as those of a hash grid do.
    Grid {
        /// Points per axis.
        points: usize,
    },
    /// Density and colour rounded to f16, as a network that runs in half precision returns them.
    Half,
    /// Inside a ball the density is replaced.
    Fault {
        /// What it is replaced by.
        density: f32,
        /// The ball's centre, before the scene is moved.
        center: Vec3,
        /// Its radius.
        radius: f32,
    },
}

/// A closed-form scene, treated, then scaled about the origin and shifted. Lengths grow with the scale, densities shrink: a pixel
/// of a camera that was moved along shows what it showed before.
#[derive(Debug, Clone, PartialEq)]
pub struct Specimen {
    shapes: ClosedForm,
    treatment: Treatment,
    /// The treated values, if they are those of a grid.
    grid: Option<VoxelGrid>,
    scale: f64,
    shift: DVec3,
    bounds: Aabb,
    rig: Rig,
}

impl Specimen {
    /// `shapes` with this `treatment`, seen by the cameras of `rig`.
    pub(super) fn new(shapes: ClosedForm, treatment: Treatment, rig: Rig) -> Self {
        let grid = match treatment {
            Treatment::Grid { points } => Some(VoxelGrid::bake(&shapes, [points; 3], Vec3::Z)),
            _ => None,
        };
        let bounds = shapes.bounds();
        Self { shapes, treatment, grid, scale: 1.0, shift: DVec3::ZERO, bounds, rig }
    }

    /// The same scene, x → `scale` x + `shift`.
    ///
    /// # Errors
    /// If its box would not be one any more.
    pub fn moved(self, scale: f64, shift: DVec3) -> Result<Self> {
        let bounds = self.shapes.bounds();
        let bounds = Aabb::new(scale * bounds.min() + shift, scale * bounds.max() + shift)?;
        Ok(Self { scale, shift, bounds, ..self })
    }

    /// The shapes, before they are treated and moved.
    #[must_use]
    pub fn shapes(&self) -> &ClosedForm {
        &self.shapes
    }

    /// What is done to their values.
    #[must_use]
    pub fn treatment(&self) -> Treatment {
        self.treatment
    }

    /// Scale and shift: x of the shapes is at scale · x + shift.
    #[must_use]
    pub fn placement(&self) -> (f64, DVec3) {
        (self.scale, self.shift)
    }

    /// The point of the shapes that is put at x. No coordinate falls where x's rises, rounding included.
    fn own(&self, x: Vec3) -> Vec3 {
        // Rounding may put the image of a point of the box beside the shapes' box.
        self.shapes.bounds().clamp(((x.as_dvec3() - self.shift) / self.scale).as_vec3())
    }

    /// Values of the shapes at one of their own points.
    fn treat(&self, x: Vec3, value: Radiance) -> Radiance {
        match self.treatment {
            Treatment::Exact | Treatment::Grid { .. } => value,
            Treatment::Saturated => {
                let logit = Vec3::new(20.0, 20.0, -20.0) + 8.0 * (value.color - 0.5);
                Radiance { color: logit.map(|y| 1.0 / (1.0 + (-y).exp())), ..value }
            }
            Treatment::Half => {
                let round = |v: f32| f16::from_f32(v).to_f32();
                Radiance { density: round(value.density), color: value.color.map(round) }
            }
            Treatment::Fault { density, center, radius } => {
                if x.distance_squared(center) < radius * radius {
                    Radiance { density, ..value }
                } else {
                    value
                }
            }
        }
    }
}

impl RadianceField for Specimen {
    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let there: Vec<Vec3> = positions.iter().map(|&x| self.own(x)).collect();
        match &self.grid {
            Some(grid) => grid.evaluate(&there, directions, out),
            None => self.shapes.evaluate(&there, directions, out),
        }
        for ((out, x), there) in out.iter_mut().zip(positions).zip(there) {
            *out = if self.bounds.contains(*x) { self.treat(there, *out) } else { Radiance::default() };
            out.density /= self.scale as f32;
        }
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        let is_moved = self.scale != 1.0 || self.shift != DVec3::ZERO;
        self.grid.as_ref().filter(|_| !is_moved).and_then(VoxelGrid::differentiable)
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        match self.treatment {
            Treatment::Exact | Treatment::Saturated => {
                let bound = self.shapes.density_bound(self.own(min), self.own(max))?;
                Some(bound / self.scale as f32)
            }
            // A black box, like most models.
            Treatment::Grid { .. } | Treatment::Half | Treatment::Fault { .. } => None,
        }
    }

    fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        let moved = |c: Camera| Camera { position: self.scale * c.position + self.shift, ..c };
        Ok(Some(self.rig.cameras(intrinsics)?.into_iter().map(moved).collect()))
    }

    fn suggested_step(&self) -> f64 {
        self.scale * self.shapes.suggested_step()
    }

    fn memory(&self) -> usize {
        self.shapes.memory() + self.grid.as_ref().map_or(0, VoxelGrid::memory)
    }

    fn describe(&self) -> String {
        format!("zoo: {}", self.shapes.describe())
    }
}
