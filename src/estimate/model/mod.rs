//! What a run, an image, an evaluation, a threshold and a next view need of a model.
//!
//! Every [`RadianceField`] is a model. Another kind of model, such as Gaussian splats, is one more implementation of
//! [`Model`], with the [`Renderer`] that it hands out.

mod volume;

use std::any::Any;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::RaySettings;
use crate::Result;
use crate::field::{Intrinsics, RadianceField};
use crate::geometry::{Aabb, Camera, Domain, Lattice, NamedCamera};
use crate::monitor::{Message, Monitor};
use crate::render::Renderer;
use crate::uncertainty::BakedField;

/// What not every model has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Feature {
    /// Rays that are marched, and derivatives of a density: steps, cutoffs, an occupancy grid, an audit.
    March,
    /// Rays in any order, so that the first are like all others: a run to a mean error.
    AnyOrder,
    /// A density, near which the octree is refined.
    Density,
    /// Sums of neighbours that may be pooled.
    Pooling,
}

/// A trained model.
pub trait Model: Send + Sync {
    /// What it is, for messages: `a volume`, `splats`.
    fn kind(&self) -> &'static str;

    /// One human-readable line: architecture and size.
    fn describe(&self) -> String;

    /// The box of all of it, scene units.
    fn whole_box(&self) -> Aabb;

    /// The box of nearly all of it, where single parts may lie far away.
    fn main_box(&self) -> Aabb {
        self.whole_box()
    }

    /// Whether there is nothing outside [`Model::whole_box`], so that a field must lie inside.
    fn ends_at_its_box(&self) -> bool {
        false
    }

    /// The space that the model covers.
    fn natural_domain(&self) -> Domain {
        Domain::Box(self.whole_box())
    }

    /// The space that a field covers if the user names no other, and what is worth saying of it.
    ///
    /// # Errors
    /// If a camera cannot be rendered, or [`crate::Error::Interrupted`].
    fn covered(
        &self,
        _cameras: &[Camera],
        _background: Vec3,
        _monitor: &dyn Monitor,
    ) -> Result<(Domain, Vec<Message>)> {
        Ok((self.natural_domain(), Vec::new()))
    }

    /// `[n]`: the centres of what the model is made of, scene units; empty if it is a field.
    fn centers(&self) -> &[Vec3] {
        &[]
    }

    /// The cameras that it was trained on, with all intrinsics; empty if they are not known.
    fn training_cameras(&self) -> &[NamedCamera] {
        &[]
    }

    /// Whether models of this kind store the cameras that they were trained on.
    fn stores_cameras(&self) -> bool {
        false
    }

    /// Refuses a camera that the model cannot render.
    ///
    /// # Errors
    /// If it is one.
    fn check_camera(&self, _camera: &Camera) -> Result<()> {
        Ok(())
    }

    /// Whether its images depend on the size of a pixel, so that they look right only at the size of the training.
    fn depends_on_pixels(&self) -> bool {
        self.field().is_none()
    }

    /// Whether another model of the same kind is drawn in the same way.
    ///
    /// # Errors
    /// What was expected and found, if not.
    fn check_drawn_like(&self, _other: &dyn Model) -> std::result::Result<(), [String; 2]> {
        Ok(())
    }

    /// The cameras that come with the model, with the intrinsics that it lacks. `None` if it has none.
    ///
    /// # Errors
    /// As [`TrainedField::cameras`](crate::field::TrainedField::cameras).
    fn cameras(&self, _intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        Ok(None)
    }

    /// Root mean square error of the training pixels' colours (0..1) after training, if the model records it.
    fn training_noise(&self) -> Option<f64> {
        None
    }

    /// Where in a pixel the training rays went: ½ for the centre.
    fn pixel_offset(&self) -> f64 {
        0.5
    }

    /// What a user should know of the model, and of it in front of `cameras`.
    fn remarks(&self, _cameras: &[Camera]) -> Vec<Message> {
        Vec::new()
    }

    /// Whether the background of the training has to be found out, because models of this kind were trained with any.
    fn leaves_background_open(&self) -> bool {
        false
    }

    /// The kind of models that would have a feature, in words, if this one does not. What is no field is not marched,
    /// and its rays are ordered by camera.
    fn lacks(&self, feature: Feature) -> Option<&'static str> {
        if self.field().is_some() { None } else { lacks_of_no_field(feature) }
    }

    /// The model for training rays, differentiated for `lattice`.
    ///
    /// # Errors
    /// If it does not provide the requested derivatives, if the spacing of f32 positions exceeds the
    /// finite-difference step, if a setting is out of range, or [`crate::Error::Interrupted`].
    fn for_rays<'a>(
        &'a self,
        settings: &RaySettings,
        lattice: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<Arc<dyn Renderer + 'a>>;

    /// The model for images in front of the background of `settings`.
    ///
    /// # Errors
    /// If a setting is out of range, or [`crate::Error::Interrupted`].
    fn for_images<'a>(&'a self, settings: &RaySettings, monitor: &dyn Monitor) -> Result<Box<dyn Renderer + 'a>>;

    /// The model for images as `whole` has them, if the model is a part of that one.
    fn like<'a>(&'a self, whole: &dyn Renderer) -> Box<dyn Renderer + 'a>;

    /// The part of the model at which log10 U is at most `threshold` (the paper, Sec. 5.2); `None` if nothing is left.
    ///
    /// # Errors
    /// If the part cannot be made.
    fn certain_part<'a>(
        &'a self,
        uncertainty: &'a BakedField<'a>,
        threshold: f64,
    ) -> Result<Option<Box<dyn Model + 'a>>>;

    /// `[eyes]`: which cameras would stand in matter, whatever they look at. Samples of a march are `step` apart, or as
    /// the model suggests.
    fn in_matter(&self, step: Option<f64>, eyes: &[DVec3]) -> Vec<bool>;

    /// The volume, for what only volumes have.
    fn field(&self) -> Option<&dyn RadianceField> {
        None
    }

    /// The model as its own type, for what only this kind has, such as files of its format.
    fn concrete(&self) -> Option<&dyn Any> {
        None
    }
}

/// What a model [lacks](Model::lacks) that is no field; an implementation may lack more.
#[must_use]
pub fn lacks_of_no_field(feature: Feature) -> Option<&'static str> {
    match feature {
        Feature::March => Some("a volume, whose rays are marched and whose density is differentiated"),
        Feature::AnyOrder => {
            Some("a volume: rays of other models are ordered by camera; a part of them does not sample all views")
        }
        Feature::Density => Some("a volume, which has a density"),
        Feature::Pooling => None,
    }
}

/// Refuses a model that lacks a feature which `what` needs.
///
/// # Errors
/// If it does.
pub fn require(model: &dyn Model, feature: Feature, what: &str) -> Result<()> {
    match model.lacks(feature) {
        None => Ok(()),
        Some(expected) => Err(crate::Error::setting(what, expected, model.kind())),
    }
}

/// For each camera, the index of the same one among those that the model was trained on ([`Camera::is_like`], seen from
/// the far side of the model's box).
pub fn known_cameras<'a>(model: &dyn Model, cameras: impl IntoIterator<Item = &'a Camera>) -> Vec<Option<usize>> {
    let (known, length) = (model.training_cameras(), model.whole_box().longest_edge());
    let index = |camera: &Camera| known.iter().position(|known| known.camera.is_like(camera, length));
    cameras.into_iter().map(index).collect()
}
