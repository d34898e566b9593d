//! Fields of density and colour as models.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::Model;
use crate::Result;
use crate::estimate::RaySettings;
use crate::field::{Intrinsics, RadianceField, TrainedField};
use crate::geometry::{Aabb, Camera, Domain, Lattice, NamedCamera};
use crate::monitor::Monitor;
use crate::render::{INSIDE_MATTER_SAMPLES, Renderer, Tracer, VolumeRenderer};
use crate::uncertainty::{BakedField, ThresholdedField};

impl<F: TrainedField> Model for F {
    fn kind(&self) -> &'static str {
        "a volume"
    }

    fn describe(&self) -> String {
        TrainedField::describe(self)
    }

    fn whole_box(&self) -> Aabb {
        RadianceField::bounds(self)
    }

    fn ends_at_its_box(&self) -> bool {
        true
    }

    fn natural_domain(&self) -> Domain {
        TrainedField::natural_domain(self)
    }

    fn stores_cameras(&self) -> bool {
        true
    }

    fn training_cameras(&self) -> &[NamedCamera] {
        TrainedField::training_cameras(self)
    }

    fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        TrainedField::cameras(self, intrinsics)
    }

    fn training_noise(&self) -> Option<f64> {
        TrainedField::training_noise(self)
    }

    fn pixel_offset(&self) -> f64 {
        TrainedField::pixel_offset(self)
    }

    fn for_rays<'a>(
        &'a self,
        settings: &RaySettings,
        lattice: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<Arc<dyn Renderer + 'a>> {
        Ok(Arc::new(settings.volume(self, lattice, monitor)?))
    }

    fn for_images<'a>(&'a self, settings: &RaySettings, monitor: &dyn Monitor) -> Result<Box<dyn Renderer + 'a>> {
        Ok(Box::new(VolumeRenderer { tracer: settings.tracer(self, 0.0, monitor)?, differentiation: None }))
    }

    fn like<'a>(&'a self, whole: &dyn Renderer) -> Box<dyn Renderer + 'a> {
        let marcher = whole.marched().expect("a part of a volume is a volume").tracer.marcher.clone();
        // The samples stay the same: removing density keeps every upper bound of it valid.
        let tracer = Tracer { field: self, marcher, background: whole.background().as_vec3() };
        Box::new(VolumeRenderer { tracer, differentiation: None })
    }

    fn certain_part<'a>(
        &'a self,
        uncertainty: &'a BakedField<'a>,
        threshold: f64,
    ) -> Result<Option<Box<dyn Model + 'a>>> {
        Ok(Some(Box::new(ThresholdedField::new(self, uncertainty, threshold))))
    }

    fn in_matter(&self, step: Option<f64>, eyes: &[DVec3]) -> Vec<bool> {
        // A model is evaluated only where it is.
        let (bounds, step) = (RadianceField::bounds(self), step.unwrap_or_else(|| self.suggested_step()));
        let inside: Vec<usize> = (0..eyes.len()).filter(|&i| bounds.contains(eyes[i].as_vec3())).collect();
        let points: Vec<Vec3> = inside.iter().map(|&i| eyes[i].as_vec3()).collect();
        let mut densities = vec![0.0; points.len()];
        self.densities(&points, &mut densities);
        let mut found = vec![false; eyes.len()];
        for (i, density) in inside.into_iter().zip(densities) {
            found[i] = f64::from(density) * INSIDE_MATTER_SAMPLES * step >= std::f64::consts::LN_2;
        }
        found
    }

    fn field(&self) -> Option<&dyn RadianceField> {
        Some(self)
    }
}
