//! A closed-form scene, with a treatment of its values and a placement in space.

use glam::{DVec3, Vec3};
use half::f16;
use octobayes::Result;
use octobayes::field::{ClosedForm, Differentiable, Radiance, RadianceField, TrainedField, VoxelGrid};
use octobayes::geometry::{Aabb, Camera};

/// Viewpoints, and the lens that all of them share.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// Eye and look-at point, scene units; z is up.
    pub viewpoints: Vec<(DVec3, DVec3)>,
    /// Horizontal angle of view, radians.
    pub fov_x: f64,
    /// Width and height, pixels.
    pub resolution: [u32; 2],
}

/// Treatment of the values of a closed-form scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Treatment {
    /// Nothing.
    Exact,
    /// Each colour c passes through a sigmoid that is flat there: 1 / (1 + exp(−(o + 8 (c − ½)))), with o = 20 for
    /// red and green, −20 for blue. In f32, red and green become 1.
    Saturated,
    /// Values at `points`³ grid points that include the faces of the box, trilinear in between ([`VoxelGrid`]).
    /// Gradients jump from cell to cell, like those of a hash grid.
    Grid {
        /// Points per axis.
        points: usize,
    },
    /// Density and colour rounded to f16, like the output of a network in half precision.
    Half,
    /// The density inside a ball is replaced.
    Fault {
        /// The density inside.
        density: f32,
        /// Centre of the ball, before the scene is moved.
        center: Vec3,
        /// Radius of the ball.
        radius: f32,
    },
}

/// A closed-form scene, treated, then scaled about the origin and shifted.
///
/// Lengths grow with the scale while densities shrink, so that a pixel of a camera moved along
/// shows the same as before.
#[derive(Debug, Clone, PartialEq)]
pub struct Specimen {
    shapes: ClosedForm,
    treatment: Treatment,
    /// The treated values, if they come from a grid.
    grid: Option<VoxelGrid>,
    scale: f64,
    shift: DVec3,
    bounds: Aabb,
    rig: Rig,
}

impl Specimen {
    /// Makes a specimen of `shapes` with this `treatment`, seen by the cameras of `rig`.
    pub fn new(shapes: ClosedForm, treatment: Treatment, rig: Rig) -> Self {
        let grid = match treatment {
            Treatment::Grid { points } => Some(VoxelGrid::bake(&shapes, [points; 3], Vec3::Z)),
            _ => None,
        };
        let bounds = shapes.bounds();
        Self { shapes, treatment, grid, scale: 1.0, shift: DVec3::ZERO, bounds, rig }
    }

    /// Moves the scene: x becomes `scale` · x + `shift`.
    ///
    /// # Errors
    /// If its box would no longer be valid.
    pub fn moved(self, scale: f64, shift: DVec3) -> Result<Self> {
        let bounds = self.shapes.bounds();
        let bounds = Aabb::new(scale * bounds.min() + shift, scale * bounds.max() + shift)?;
        Ok(Self { scale, shift, bounds, ..self })
    }

    /// The cameras of the rig, moved with the scene.
    pub fn training_cameras(&self) -> Vec<Camera> {
        let Rig { viewpoints, fov_x, resolution } = &self.rig;
        let camera = |&(eye, target): &(DVec3, DVec3)| {
            let camera = Camera::look_at(eye, target, DVec3::Z, *fov_x, *resolution);
            Camera { position: self.scale * camera.position + self.shift, ..camera }
        };
        viewpoints.iter().map(camera).collect()
    }

    /// The shapes, before treatment and placement.
    pub fn shapes(&self) -> &ClosedForm {
        &self.shapes
    }

    /// Treatment of the shapes' values.
    pub fn treatment(&self) -> Treatment {
        self.treatment
    }

    /// Scale and shift: the point x of the shapes lies at scale · x + shift.
    pub fn placement(&self) -> (f64, DVec3) {
        (self.scale, self.shift)
    }

    /// The point of the shapes that lies at `x`. Its coordinates never fall as those of `x` rise, even with rounding.
    fn own(&self, x: Vec3) -> Vec3 {
        // Rounding may put the image of a point of the box outside the box of the shapes.
        self.shapes.bounds().clamp(((x.as_dvec3() - self.shift) / self.scale).as_vec3())
    }

    /// Treats the value of the shapes at one of their own points.
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

    fn suggested_step(&self) -> f64 {
        self.scale * self.shapes.suggested_step()
    }

    fn memory(&self) -> usize {
        self.shapes.memory() + self.grid.as_ref().map_or(0, VoxelGrid::memory)
    }
}

impl TrainedField for Specimen {
    fn describe(&self) -> String {
        format!("zoo: {}", self.shapes.describe())
    }
}
