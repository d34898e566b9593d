//! Gaussian splats as models.

use std::any::Any;
use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::render::share_too_near;
use crate::{NEAR, SplatRenderer, Splats, seen_domain};
use octobayes::Result;
use octobayes::estimate::RaySettings;
use octobayes::estimate::{Feature, Model, lacks_of_no_field};
use octobayes::geometry::{Aabb, Camera, Domain, Lattice};
use octobayes::monitor::{Message, Monitor};
use octobayes::render::Renderer;
use octobayes::uncertainty::{BakedField, is_certain};

/// A share of splats that are too near to be drawn, above which they are no mere floaters.
const MOST_TOO_NEAR: f64 = 0.02;
/// Least share of opaque splats within the box of what the cameras see. Four trainings of a hundred, ten and twelve
/// views have 0.997 to 1; with cameras at a quarter of their distance 0.51 to 0.64.
const LEAST_INSIDE: f64 = 0.8;

impl Splats {
    /// The splats that a model is, if it is of this kind.
    #[must_use]
    pub fn of(model: &dyn Model) -> Option<&Self> {
        model.concrete()?.downcast_ref()
    }
}

impl Model for Splats {
    fn kind(&self) -> &'static str {
        "splats"
    }

    fn describe(&self) -> String {
        Self::describe(self)
    }

    fn whole_box(&self) -> Aabb {
        Self::bounds(self)
    }

    fn main_box(&self) -> Aabb {
        Self::main_box(self)
    }

    /// The space in which the cameras see splats: some always lie far from all others.
    fn covered(&self, cameras: &[Camera], background: Vec3, monitor: &dyn Monitor) -> Result<(Domain, Vec<Message>)> {
        let seen = seen_domain(&SplatRenderer::new(self, background), cameras, monitor)?;
        let mut messages = Vec::new();
        if seen.behind > 0.0 {
            messages.push(Message::Note(format!(
                "{:.0} % of what the cameras see lies far behind what they stand around, as a sky does; the field \
                 leaves that out (--box or --contract covers it)",
                100.0 * seen.behind
            )));
        }
        if let Domain::Box(bounds) = seen.domain {
            let [low, high] = [bounds.min(), bounds.max()];
            messages.push(Message::Note(format!(
                "the cameras see splats from {low:.3} to {high:.3}; the field covers that (--box)"
            )));
            messages.extend((seen.behind == 0.0).then(|| share(self, &bounds)).flatten());
        }
        Ok((seen.domain, messages))
    }

    fn check_camera(&self, camera: &Camera) -> Result<()> {
        SplatRenderer::check_cameras([camera])
    }

    fn check_drawn_like(&self, other: &dyn Model) -> std::result::Result<(), [String; 2]> {
        match Splats::of(other).map(Splats::mode).filter(|mode| *mode != self.mode()) {
            None => Ok(()),
            Some(mode) => Err([format!("splats drawn in {} mode", self.mode()), mode.to_string()]),
        }
    }

    fn centers(&self) -> &[Vec3] {
        self.means()
    }

    fn remarks(&self, cameras: &[Camera]) -> Vec<Message> {
        let too_near = share_too_near(self, cameras);
        let near = (too_near > MOST_TOO_NEAR).then(|| {
            Message::Warning(format!(
                "{:.0} % of the splats in front of the cameras are nearer than {NEAR} scene units and not drawn, as in \
                 the original code; gsplat and nerfstudio draw from 0.01: scale splats and cameras up",
                100.0 * too_near
            ))
        });
        self.notes().iter().cloned().map(Message::Note).chain(near).collect()
    }

    fn leaves_background_open(&self) -> bool {
        true
    }

    fn lacks(&self, feature: Feature) -> Option<&'static str> {
        match feature {
            Feature::Pooling => Some("a volume: splats are smooth, and pooling would only smear"),
            _ => lacks_of_no_field(feature),
        }
    }

    fn for_rays<'a>(&'a self, settings: &RaySettings, _: &Lattice, _: &dyn Monitor) -> Result<Arc<dyn Renderer + 'a>> {
        Ok(Arc::new(SplatRenderer::new(self, settings.background)))
    }

    fn for_images<'a>(&'a self, settings: &RaySettings, _: &dyn Monitor) -> Result<Box<dyn Renderer + 'a>> {
        Ok(Box::new(SplatRenderer::new(self, settings.background)))
    }

    fn like<'a>(&'a self, whole: &dyn Renderer) -> Box<dyn Renderer + 'a> {
        Box::new(SplatRenderer::new(self, whole.background().as_vec3()))
    }

    fn certain_part<'a>(
        &'a self,
        uncertainty: &'a BakedField<'a>,
        threshold: f64,
    ) -> Result<Option<Box<dyn Model + 'a>>> {
        let kept = is_certain(self.means(), uncertainty, threshold);
        if !kept.contains(&true) {
            return Ok(None);
        }
        Ok(Some(Box::new(self.clone().keep(&kept)?)))
    }

    fn in_matter(&self, _step: Option<f64>, eyes: &[DVec3]) -> Vec<bool> {
        eyes.iter().map(|eye| self.is_in_one(*eye)).collect()
    }

    fn concrete(&self) -> Option<&dyn Any> {
        Some(self)
    }
}

/// A warning if the cameras, within the box of what they see, have few of the splats that training made opaque.
fn share(splats: &Splats, seen: &Aabb) -> Option<Message> {
    let opaque: Vec<usize> = (0..splats.len()).filter(|&i| splats.opacity(i) >= 0.5).collect();
    let is_inside = |&&i: &&usize| seen.contains(splats.mean(i));
    // NaN, and no warning, if none is opaque.
    let share = opaque.iter().filter(is_inside).count() as f64 / opaque.len() as f64;
    (share < LEAST_INSIDE).then(|| {
        Message::Warning(format!(
            "only {:.0} % of the opaque splats lie within what the cameras see, where a training made all of them: \
             likely causes: some of the training cameras only, or cameras of another scale or frame",
            100.0 * share
        ))
    })
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;
    use crate::RenderMode;

    #[test]
    fn few_opaque_splats_in_the_box_are_warned_of_but_not_if_none_is_opaque() {
        let warning = |logits: [f32; 5]| {
            let means = (0..5_u8).map(|i| Vec3::X * f32::from(i)).collect();
            let (scales, rotations) = (vec![Vec3::splat(-3.0); 5], vec![Quat::IDENTITY; 5]);
            let splats = Splats::new(means, scales, rotations, logits.to_vec(), vec![0.0; 15], 0, RenderMode::Classic);
            let seen = Aabb::new(DVec3::splat(-1.0), DVec3::splat(3.5)).unwrap();
            share(&splats.unwrap(), &seen).map(|message| message.to_string())
        };
        // Four of five are inside; then three of four opaque ones.
        assert_eq!(warning([1.0; 5]), None);
        assert!(warning([-1.0, 1.0, 1.0, 1.0, 1.0]).unwrap().contains("only 75 % of the opaque splats"));
        assert_eq!(warning([-1.0; 5]), None);
    }
}
