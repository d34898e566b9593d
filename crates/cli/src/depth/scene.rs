//! A model with its training cameras, ready for depths with their deviations.

use std::path::Path;

use crate::files::CommandFiles;
use crate::opened::{compute_field, open_field};
use crate::options::{CameraOptions, FrameOptions, RunOptions, heading};
use crate::progress::Bars;
use crate::streams::tell;
use octobayes::Result;
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes_data::{Frame, Part, Views};
use octobayes_depth::{DepthDeviation, Surveyor};
use octobayes_session::{OpenedModel, Session, Survey, image_settings};

/// Where a model's depths come from.
#[derive(clap::Args)]
pub struct SceneOptions {
    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    frames: FrameOptions,

    #[command(flatten)]
    run: RunOptions,

    /// Do not use the images beside the cameras: deviations then follow from the field alone
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    no_images: bool,
}

/// A model, its field, and the cameras of its training.
pub struct Scene {
    opened: OpenedModel,
    field: UncertaintyField,
    views: Views,
    uses_images: bool,
}

/// What is looked at.
pub struct Look<'a> {
    /// The training frames.
    pub frames: &'a [Frame],
    /// The field.
    pub field: &'a UncertaintyField,
    /// Who looks.
    pub surveyor: &'a Surveyor<'a>,
    /// Progress.
    pub bars: &'a Bars,
}

impl SceneOptions {
    /// The files that are read. Refuses options of a run beside a field.
    pub fn files(&mut self, model: &str, field: Option<&Path>) -> Result<CommandFiles> {
        self.cameras.find(Part::Training);
        self.run.check(field.is_some())?;
        let files = CommandFiles::default().input("MODEL", model).inputs("FIELD", field);
        Ok(files.cameras(self.cameras.cameras.as_deref()))
    }

    /// Opens the model, and reads its field or computes it. `files` are those of the command; `check` is called before
    /// any work with the training frames, and with the files and the frames' images. `save` is where a field that was
    /// computed goes.
    pub fn open(
        &self,
        model: &str,
        field: Option<&Path>,
        files: &CommandFiles,
        check: impl FnOnce(&[Frame], CommandFiles) -> Result<()>,
        save: Option<&Path>,
        bars: &Bars,
    ) -> Result<Scene> {
        let known = field.map(open_field).transpose()?;
        if let Some(known) = &known {
            DepthDeviation::new(&BakedField::unbaked(known), None)?;
        }
        let opened = match known.as_ref().zip(field) {
            Some((known, path)) => OpenedModel::of_field(known, path, model, self.run.training.force, &mut tell)?,
            None => OpenedModel::for_cameras(model, self.cameras.cameras.is_some(), self.run.training.splat_mode)?,
        };
        let cameras = self.cameras.training(&self.frames, Some(&*opened.model), model)?;
        check(&cameras.views.frames, files.clone().images(&cameras.views))?;
        let field = match known {
            Some(known) => known,
            None => compute_field(&opened, (&self.cameras, &cameras), &self.run, Session::for_depths, save, bars)?,
        };
        let views = cameras.views;
        let uses_images = !self.no_images;
        Ok(Scene { opened, field, views, uses_images })
    }
}

impl Scene {
    /// The training frames.
    pub fn frames(&self) -> &[Frame] {
        &self.views.frames
    }

    /// Looks at the model from its training cameras, with their images if all are there. About `pixels` are queried.
    pub fn look<T>(&self, pixels: u64, bars: &Bars, work: impl FnOnce(&Look) -> Result<T>) -> Result<T> {
        let (field, frames) = (&self.field, &self.views.frames[..]);
        let survey = Survey {
            model: &*self.opened.model,
            field,
            frames,
            settings: image_settings(field),
            uses_images: self.uses_images,
        };
        survey.look(pixels, bars, &mut tell, |surveyor| work(&Look { frames, field, surveyor, bars }))
    }
}
