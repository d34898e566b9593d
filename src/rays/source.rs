//! What rays are drawn through: a volume, or splats.

use glam::DVec3;

use crate::geometry::Aabb;
use crate::render::{Differentiation, GradientMethod, Tracer};
use crate::splats::SplatRenderer;

/// A model as training rays see it.
#[derive(Clone)]
pub enum RaySource<'a> {
    /// A field, whose rays are traced one by one.
    Volume(Box<VolumeRays<'a>>),
    /// Splats, whose rays are drawn camera by camera.
    Splats(SplatRenderer<'a>),
}

/// A volume and how its rays are differentiated.
#[derive(Clone)]
pub struct VolumeRays<'a> {
    /// Field, sampling and background.
    pub tracer: Tracer<'a>,
    /// The method of differentiating the field.
    pub differentiation: Differentiation<'a>,
}

impl<'a> RaySource<'a> {
    /// The volume, if it is one.
    #[must_use]
    pub fn volume(&self) -> Option<&VolumeRays<'a>> {
        match self {
            Self::Volume(volume) => Some(volume.as_ref()),
            Self::Splats(_) => None,
        }
    }

    /// The splats, if the model is made of them.
    #[must_use]
    pub fn splats(&self) -> Option<&SplatRenderer<'a>> {
        match self {
            Self::Volume(_) => None,
            Self::Splats(splats) => Some(splats),
        }
    }

    /// The box of the model, scene units.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        match self {
            Self::Volume(volume) => volume.tracer.field.bounds(),
            Self::Splats(splats) => splats.bounds(),
        }
    }

    /// Colour behind the model.
    #[must_use]
    pub fn background(&self) -> [f32; 3] {
        match self {
            Self::Volume(volume) => volume.tracer.background.to_array(),
            Self::Splats(splats) => splats.background().to_array(),
        }
    }

    /// Source of the derivatives. Those of splats are their own.
    #[must_use]
    pub fn method(&self) -> GradientMethod {
        self.volume().map_or(GradientMethod::Analytic, |volume| volume.differentiation.method())
    }

    /// Finite-difference step along the axes, scene units; 0 where there is none.
    #[must_use]
    pub fn step(&self) -> DVec3 {
        self.volume().map_or(DVec3::ZERO, |volume| volume.differentiation.differences.step)
    }

    /// Size of the model, bytes; 0 if nobody knows.
    #[must_use]
    pub fn memory(&self) -> usize {
        match self {
            Self::Volume(volume) => volume.tracer.field.memory(),
            Self::Splats(splats) => splats.splats().memory(),
        }
    }

    /// Smallest efficient batch, in points; 0 if a few hundred are enough.
    pub(super) fn batch(&self) -> usize {
        self.volume().map_or(0, |volume| volume.tracer.field.batch())
    }
}
