//! A model with its training cameras, ready for depths with their deviations.

use std::path::{Path, PathBuf};

use crate::files::CommandFiles;
use crate::opened::{baked, open_field};
use crate::options::{CameraOptions, FrameOptions, TrainingOptions, heading};
use crate::progress::Bars;
use crate::streams::tell;
use octobayes::estimate::{Checkpoint, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes::posterior::{Covariance, DataScale};
use octobayes::render::{GradientMethod, Renderer};
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_data::{Frame, Part, Views};
use octobayes_depth::{DepthDeviation, LEVEL, Photograph, Surveyor, Sweep, TrainingViews};
use octobayes_evaluation::check_images;
use octobayes_session::{Choices, OpenedModel, ScaleKind, Session, image_settings};
use rayon::prelude::*;

/// Rays of a field that is computed: about as many as those of the fields by which the factors of σ were fitted.
const RAYS: u64 = 500_000;

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
    settings: RaySettings,
    uses_images: bool,
}

/// What is looked at.
pub struct Look<'a> {
    /// The training frames.
    pub frames: &'a [Frame],
    /// The field.
    pub field: &'a UncertaintyField,
    /// Who looks.
    pub surveyor: Surveyor<'a>,
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
        let settings = image_settings(&field);
        let uses_images = !self.no_images;
        Ok(Scene { opened, field, views, settings, uses_images })
    }

    fn compute(
        &self,
        opened: &OpenedModel,
        views: &Views,
        source: &str,
        save: Option<&Path>,
        bars: &Bars,
    ) -> Result<UncertaintyField> {
        let noise = self.noise.map_or_else(|| self.noise_of_images(opened, views, bars), |noise| Ok(Some(noise)))?;
        let choices = Choices {
            level: Some(LEVEL),
            covariance: Some(Covariance::Block),
            scale: Some(ScaleKind::Data),
            noise,
            keep_sums: Some(false),
            purpose: None,
        };
        let session = Session::new(views.clone(), format!("{} seen by {source}", opened.source))?
            .checksum(Some(opened.checksum))
            .rays(RaySettings::default().rays(RAYS).gradient(GradientMethod::Auto))
            .background(self.training.background)
            .model_file(Some(PathBuf::from(&opened.name)))
            .choices(choices)
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

    /// The noise of the training images by some of their pixels, if the model does not store it and images are there.
    fn noise_of_images(&self, opened: &OpenedModel, views: &Views, bars: &Bars) -> Result<Option<f64>> {
        let model = &*opened.model;
        if model.training_noise().is_some() {
            return Ok(None);
        }
        let settings = RaySettings::for_images();
        let settings = self.training.background.map_or(settings, |background| settings.background(background));
        let (renderer, offset) = (model.for_images(&settings, None, bars)?, settings.offset_for(model));
        let found = check_images(&*renderer, model.training_cameras(), &views.frames, offset, None, bars)?;
        let Some(found) = found.filter(|found| found.psnr.is_finite()) else { return Ok(None) };
        // In front of white or black, if that is not known.
        let open = model.leaves_background_open() && self.training.background.is_none();
        let [white, black] = found.backgrounds;
        let psnr = if open { found.psnr.max(white).max(black) } else { found.psnr };
        announce!("note: the model shows its training images with {psnr:.1} dB, by {} pixels (--noise)", found.pixels);
        let (least, most) = DataScale::NOISE.into_inner();
        Ok(Some(DataScale::noise_of(psnr).clamp(least, most)))
    }
}

impl Scene {
    /// The training frames.
    pub fn frames(&self) -> &[Frame] {
        &self.views.frames
    }

    /// Looks at the model from its training cameras, with their images if all are there. About `pixels` are queried.
    pub fn look<T>(&self, pixels: u64, bars: &Bars, work: impl FnOnce(&Look) -> Result<T>) -> Result<T> {
        let model = &*self.opened.model;
        let renderer = model.for_images(&self.settings, None, bars)?;
        let pixel_offset = self.settings.offset_for(model);
        let cameras: Vec<Camera> = self.views.frames.iter().map(|frame| frame.camera).collect();
        let photographs = self.photographs(&*renderer, pixel_offset, bars)?;
        let training = TrainingViews::render(&*renderer, &cameras, pixel_offset, bars)?;
        let field: BakedField = baked(&self.field, pixels);
        let sweep = photographs.as_ref().map(|photographs| Sweep::new(photographs, &training));
        let deviation = DepthDeviation::new(&field, sweep)?;
        let surveyor = Surveyor {
            renderer: &*renderer,
            cameras: &cameras,
            training: &training,
            deviation: &deviation,
            pixel_offset,
        };
        work(&Look { frames: &self.views.frames, field: &self.field, surveyor, bars })
    }

    /// The training images; `None` with a note if one is missing.
    fn photographs(&self, renderer: &dyn Renderer, pixel_offset: f64, bars: &Bars) -> Result<Option<Vec<Photograph>>> {
        let frames = &self.views.frames;
        if !self.uses_images {
            return Ok(None);
        }
        if let Some(missing) = frames.iter().find(|frame| !frame.image.is_file()) {
            let name = octobayes::error::printable(&missing.name);
            announce!(
                "note: the image of {name} is not there: deviations follow from the field alone, less precisely \
                 (--cameras names a data set with its images)"
            );
            return Ok(None);
        }
        bars.begin("training images", frames.len() as u64);
        let read = |frame: &Frame| -> Result<Photograph> {
            octobayes::monitor::check(bars)?;
            let photograph = Photograph::read(frame, renderer.background(), pixel_offset)?;
            bars.advance(1);
            Ok(photograph)
        };
        let photographs = frames.par_iter().map(read).collect::<Result<_>>()?;
        bars.end();
        Ok(Some(photographs))
    }
}
