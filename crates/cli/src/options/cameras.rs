//! Where cameras come from: files, or the model.

use std::path::{Path, PathBuf};

use clap::Args;
use glam::Vec3;

use super::heading;
use super::parse::{choice, parse_background, parse_fov, parse_resolution, parse_views};
use crate::streams::tell;
use octobayes::estimate::Model;
use octobayes::{Error, Result};
use octobayes_data::{Part, Selection, Views, camera_file, passed_over};
use octobayes_session::{CameraSource, Resolution, TrainingCameras};
use octobayes_splats::RenderMode;

/// A camera file.
#[derive(Args)]
pub struct CameraFile {
    /// Camera file: transforms.json, or a COLMAP model (or the folder of either)
    ///
    /// transforms.json has intrinsics and camera-to-world poses with OpenGL axes. A COLMAP model is the folder of
    /// cameras and images, .bin or .txt, or one above that has sparse/0. In a folder, transforms_test.json comes first.
    /// SCENE/images_4 means the cameras of SCENE with these pictures. Cameras have the size of pictures that are there.
    #[arg(long, value_name = "PATH", help_heading = heading::INPUT)]
    pub cameras: PathBuf,

    /// Image size, WxH, or W alone to keep the aspect ratio [default: that of the pictures, else from the
    /// camera file, else 400x400]
    #[arg(
        long,
        value_name = "SIZE",
        value_parser = parse_resolution,
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub resolution: Option<Resolution>,
}

/// Which frames of a camera file to use.
#[derive(Args)]
pub struct FrameOptions {
    /// Use these frames of the camera file: N frames spread evenly, or a list such as 0,7,31 (`7,` is one frame), or
    /// `all` [default: the training frames; in `evaluate`, the held-out frames]
    ///
    /// Frames are numbered from 0 in the order of the file, as in `render --frame`. Frames without an image are left
    /// out, unless no frame has one. If neither the file lists its training frames nor the model stores its cameras,
    /// frames are held out as the usual programs do: of a COLMAP model every eighth by name, from the first, of other
    /// files a tenth, as in nerfstudio; not of a cameras.json. A note names them.
    #[arg(
        long,
        value_name = "N|I,J,...|all",
        value_parser = parse_views,
        requires = "cameras",
        help_heading = heading::INPUT,
    )]
    pub views: Option<Selection>,
}

/// What lay behind a model in its training, how it is drawn, and whether images may differ.
#[derive(Args)]
pub struct TrainingOptions {
    /// Background colour of the training: white, black or r,g,b in [0, 1] [default: white, or what lies beside splats]
    ///
    /// It enters the derivatives wherever a ray passes the scene without becoming opaque. For splats the `cfg_args` of
    /// the original code decides, or else white or black, if the images beside the cameras clearly fit one better.
    #[arg(long, value_name = "COLOR", value_parser = parse_background, help_heading = heading::INPUT)]
    pub background: Option<Vec3>,

    /// Use the cameras even if the model does not show the images that lie beside them
    ///
    /// Before the run, a few hundred pixels of at most 8 of these images are compared with the model: below 15 dB a
    /// warning names likely causes, such as cameras of another scene or another background; below 8 dB the cameras are
    /// refused.
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    pub force: bool,

    /// How splats smaller than a pixel are drawn: as they were trained [default: as stated in their file, else classic]
    #[arg(
        long,
        value_name = "MODE",
        value_parser = choice::<RenderMode>(),
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub splat_mode: Option<RenderMode>,
}

/// Options of a run that computes the field which a verb was not given.
#[derive(Args)]
pub struct RunOptions {
    #[command(flatten)]
    pub training: TrainingOptions,

    /// Root mean square error of colours that training left, 10^(-PSNR/20) [default: that which the model stores, or
    /// by the images beside the cameras]
    #[arg(
        long,
        value_name = "NOISE",
        value_parser = super::parse_noise,
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub noise: Option<f64>,

    /// Start the field over, and discard the state of a run that was interrupted
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    pub restart: bool,
}

impl RunOptions {
    /// Refuses options of a run beside a field.
    pub fn check(&self, has_field: bool) -> Result<()> {
        let given = [
            ("--noise", self.noise.is_some()),
            ("--background", self.training.background.is_some()),
            ("--splat-mode", self.training.splat_mode.is_some()),
            ("--restart", self.restart),
        ];
        match given.iter().find(|(_, is_given)| *is_given && has_field) {
            Some((option, _)) => Err(Error::setting(*option, "none beside FIELD, which is computed already", "one")),
            None => Ok(()),
        }
    }
}

/// The camera file that a path means for a part. Says so on stderr if a folder has cameras elsewhere, too.
pub fn of_folder(path: &Path, part: Part) -> PathBuf {
    let file = camera_file(path, part);
    passed_over(path, &file).inspect(|text| announce!("note: {text}"));
    file
}

impl CameraFile {
    /// Of a folder, takes the file of held-out cameras.
    pub fn find(&mut self) {
        self.cameras = of_folder(&self.cameras, Part::HeldOut);
    }

    /// Reads the file.
    pub fn read(&self) -> Result<Views> {
        let file = Some(self.cameras.clone());
        let source = CameraSource { file, resolution: self.resolution, ..CameraSource::default() };
        source.read(None, &mut tell)
    }
}

/// A camera file, or the cameras that come with the model.
#[derive(Args)]
pub struct CameraOptions {
    /// Training cameras: transforms.json, a COLMAP model (or the folder of either), the cameras.json of Gaussian
    /// splatting, or the cameras.xml of Metashape [default: the cameras that the model stores]
    ///
    /// transforms.json has intrinsics and camera-to-world poses with OpenGL axes. A COLMAP model is the folder of
    /// cameras and images, .bin or .txt, or one above that has sparse/0. In a folder, transforms_train.json will do.
    /// For splats of nerfstudio pass the run's dataparser_transforms.json, which moves the data set's cameras to their
    /// frame.
    /// SCENE/images_4 means the cameras of SCENE with these pictures. Cameras have the size of pictures that are there.
    #[arg(long, value_name = "PATH", help_heading = heading::INPUT)]
    pub cameras: Option<PathBuf>,

    /// Horizontal angle of view of the model's own cameras, degrees
    #[arg(
        long,
        value_name = "DEGREES",
        value_parser = parse_fov,
        conflicts_with = "cameras",
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub fov: Option<f64>,

    /// Image size, WxH, or W alone to keep the aspect ratio [default: that of the pictures, else from the
    /// camera file, else 400x400]
    #[arg(
        long,
        value_name = "SIZE",
        value_parser = parse_resolution,
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub resolution: Option<Resolution>,
}

impl CameraOptions {
    /// Of a folder, takes the file of a part.
    pub fn find(&mut self, part: Part) {
        self.cameras = self.cameras.take().map(|path| of_folder(&path, part));
    }

    fn source(&self) -> CameraSource {
        CameraSource { file: self.cameras.clone(), fov: self.fov, resolution: self.resolution, model_file: None }
    }

    /// Reads the camera file, or else takes the cameras of the model `name`.
    pub fn read(&self, model: Option<&dyn Model>, name: &str) -> Result<Views> {
        self.source().read(model.map(|model| (model, name)), &mut tell)
    }

    /// The cameras that the model was trained on: its own, or the training frames of the camera file. Says on stderr
    /// which.
    pub fn training(&self, options: &FrameOptions, model: Option<&dyn Model>, name: &str) -> Result<TrainingCameras> {
        let selection = options.views.clone().unwrap_or_default();
        let source = CameraSource { model_file: Some(PathBuf::from(name)), ..self.source() };
        let cameras = source.training(&selection, model.map(|model| (model, name)), &mut tell)?;
        announce!("note: {}", cameras.used);
        Ok(cameras)
    }
}
