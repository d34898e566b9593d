//! A model in front of its training cameras, for depths with their deviations.

use octobayes::Result;
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::{Message, Monitor};
use octobayes::posterior::Covariance;
use octobayes::render::{GradientMethod, Renderer};
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::Frame;
use octobayes_depth::{DepthDeviation, LEVEL, Photograph, Surveyor, Sweep, TrainingViews};

use super::memory::baked;
use super::{Choices, ScaleKind, Session};

impl Session {
    /// Sets what a field for depths needs.
    #[must_use]
    pub fn for_depths(self, noise: Option<f64>) -> Self {
        // What `--for depth` sets, without a note.
        let choices = Choices {
            purpose: None,
            level: Some(LEVEL),
            covariance: Some(Covariance::Block),
            scale: Some(ScaleKind::Data),
            noise,
            keep_sums: Some(false),
        };
        self.rays(RaySettings::default().rays(Survey::RAYS).gradient(GradientMethod::Auto)).choices(choices)
    }
}

/// What a [`Surveyor`] is made of.
pub struct Survey<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// Its uncertainty, in the scale of its data.
    pub field: &'a UncertaintyField,
    /// The training frames.
    pub frames: &'a [Frame],
    /// How images are rendered.
    pub settings: RaySettings,
    /// Whether the frames' images are used, if all are there.
    pub uses_images: bool,
}

impl Survey<'_> {
    /// Rays of a field for depths. The fields by which σ was fitted had about as many.
    pub const RAYS: u64 = 500_000;

    /// Looks at the model from its training cameras. `work` will query about so many `pixels`.
    ///
    /// # Errors
    /// As [`DepthDeviation::new`], if an image is damaged, if a camera cannot be rendered, and those of the work.
    pub fn look<T>(
        &self,
        pixels: u64,
        monitor: &dyn Monitor,
        tell: &mut dyn FnMut(Message),
        work: impl FnOnce(&Surveyor) -> Result<T>,
    ) -> Result<T> {
        let renderer = self.model.for_images(&self.settings, monitor)?;
        let pixel_offset = self.settings.offset_for(self.model);
        let cameras: Vec<Camera> = self.frames.iter().map(|frame| frame.camera).collect();
        let photographs = self.photographs(&*renderer, pixel_offset, monitor, tell)?;
        let training = TrainingViews::render(&*renderer, &cameras, pixel_offset, monitor)?;
        let field = baked(self.field, pixels);
        let sweep = photographs.as_ref().map(|photographs| Sweep::new(photographs, &training));
        let deviation = DepthDeviation::new(&field, sweep)?;
        work(&Surveyor {
            renderer: &*renderer,
            cameras: &cameras,
            training: &training,
            deviation: &deviation,
            pixel_offset,
        })
    }

    /// The training images; `None` with a note if one is missing.
    fn photographs(
        &self,
        renderer: &dyn Renderer,
        pixel_offset: f64,
        monitor: &dyn Monitor,
        tell: &mut dyn FnMut(Message),
    ) -> Result<Option<Vec<Photograph>>> {
        if !self.uses_images {
            return Ok(None);
        }
        if let Some(missing) = self.frames.iter().find(|frame| !frame.image.is_file()) {
            let name = octobayes::error::printable(&missing.name);
            tell(Message::Note(format!(
                "the image of {name} is not there: deviations follow from the field alone, less precisely (--cameras \
                 names a data set with its images)"
            )));
            return Ok(None);
        }
        Photograph::read_all(self.frames, renderer.background(), pixel_offset, monitor).map(Some)
    }
}
