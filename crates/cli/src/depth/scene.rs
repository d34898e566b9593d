//! A model with its training cameras, ready for depths with their deviations.

use std::path::{Path, PathBuf};

use crate::files::CommandFiles;
use crate::opened::open_field;
use crate::options::{CameraOptions, FrameOptions, TrainingOptions, heading};
use crate::progress::Bars;
use crate::streams::tell;
use octobayes::estimate::Checkpoint;
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
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
    training: TrainingOptions,

    /// Root mean square error of colours that training left, 10^(-PSNR/20) [default: that which the model stores, or
    /// by the images beside the cameras]
    #[arg(
        long,
        value_name = "NOISE",
        value_parser = crate::options::parse_noise,
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    noise: Option<f64>,

    /// Do not use the images beside the cameras: deviations then follow from the field alone
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    no_images: bool,

    /// Start the field over, and discard the state of a run that was interrupted
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    restart: bool,
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
        let given = [
            ("--noise", self.noise.is_some()),
            ("--background", self.training.background.is_some()),
            ("--splat-mode", self.training.splat_mode.is_some()),
            ("--restart", self.restart),
        ];
        if let Some((option, _)) = given.iter().find(|(_, is_given)| *is_given && field.is_some()) {
            return Err(Error::setting(*option, "none beside FIELD, which is computed already", "one"));
        }
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
            Some((known, path)) => OpenedModel::of_field(known, path, model, self.training.force, &mut tell)?,
            None => OpenedModel::for_cameras(model, self.cameras.cameras.is_some(), self.training.splat_mode)?,
        };
        let cameras = self.cameras.training(&self.frames, Some(&*opened.model), model)?;
        check(&cameras.views.frames, files.clone().images(&cameras.views))?;
        let views = cameras.views;
        let field = match known {
            Some(known) => known,
            None => self.compute(&opened, &views, &cameras.source, save, bars)?,
        };
        let uses_images = !self.no_images;
        Ok(Scene { opened, field, views, uses_images })
    }

    fn compute(
        &self,
        opened: &OpenedModel,
        views: &Views,
        source: &str,
        save: Option<&Path>,
        bars: &Bars,
    ) -> Result<UncertaintyField> {
        let session = Session::new(views.clone(), format!("{} seen by {source}", opened.source))?
            .checksum(Some(opened.checksum))
            .for_depths(self.noise)
            .background(self.training.background)
            .model_file(Some(PathBuf::from(&opened.name)))
            .checkpoint(save.map(|path| Checkpoint::new(path.with_extension("checkpoint")).restart(self.restart)))
            .force(self.training.force)
            .has_chosen_coordinates(opened.coordinates.is_some() && self.cameras.cameras.is_some())
            .has_given_fov(self.cameras.fov.is_some());
        let finished = session.prepare(&*opened.model, bars, &mut tell)?.finish(&mut tell)?;
        if let Some(path) = save {
            finished.save(path)?;
        }
        Ok(finished.field)
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
