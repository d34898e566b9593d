//! `--images`: what training left unexplained in its images.

use super::{Args, Inputs};
use crate::cli::files::CommandFiles;
use crate::cli::progress::Bars;
use crate::dataset::{Frame, image_path};
use crate::estimate::GridSettings;
use crate::evaluate::{TrueView, measure_misfit};
use crate::monitor::Monitor;
use crate::posterior::Scale;
use crate::uncertainty::Misfit;
use crate::{Error, Result};

/// About as many pixels of all images together are rendered.
const PIXELS: u64 = 1 << 18;

/// The training frames with their images below a folder.
pub struct TrainingImages(Vec<Frame>);

impl TrainingImages {
    /// Finds the images of the training frames by their names; `None` if they are not asked for.
    ///
    /// # Errors
    /// If the field will not be in the scale of its data, or if an image is missing.
    pub fn find(args: &Args, inputs: &Inputs, grid: &GridSettings) -> Result<Option<Self>> {
        let Some(folder) = &args.images else { return Ok(None) };
        let Scale::Data(_) = grid.scale else {
            let expected = "--scale data, in which depths have deviations";
            return Err(Error::setting("--images", expected, "the paper's"));
        };
        let find = |frame: &Frame| {
            // COLMAP's names start from the folder of the images, those of a transforms.json from its own.
            let places = [folder.clone(), folder.join("images")].map(|folder| image_path(&folder, &frame.name));
            let image = places.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
                let expected = "the folder from which the names of the training images start";
                let [place, other] = &places;
                Error::setting("--images", expected, format!("neither {} nor {}", place.display(), other.display()))
            })?;
            Ok(Frame { image, ..frame.clone() })
        };
        inputs.views.frames.iter().map(find).collect::<Result<_>>().map(|frames| Some(Self(frames)))
    }

    /// As files that are read.
    pub fn add_to(&self, files: CommandFiles) -> CommandFiles {
        files.inputs("an image of --images", self.0.iter().map(|frame| &frame.image))
    }

    /// Compares the model with the images.
    ///
    /// # Errors
    /// If an image cannot be read, or if the work was interrupted.
    pub fn misfit(&self, args: &Args, inputs: &Inputs, grid: &GridSettings, bars: &Bars) -> Result<Misfit> {
        let settings = args.model.image_settings();
        let tracer = settings.tracer(&*inputs.field, 0.0, bars)?;
        let offset = settings.pixel_offset.unwrap_or_else(|| inputs.field.pixel_offset());
        let pixels: u64 = self.0.iter().map(|frame| frame.camera.pixels()).sum();
        let stride = (pixels as f64 / PIXELS as f64).sqrt().ceil().max(1.0) as u32;
        let background = args.model.rays.background.as_dvec3();
        let images = self.0.iter().map(|frame| TrueView::read(frame, None, background, offset, stride));
        let rows = |frame: &Frame| u64::from(frame.camera.resolution[1].div_ceil(stride));
        bars.begin("rows of training images", self.0.iter().map(rows).sum());
        let misfit = measure_misfit(&tracer, images, &grid.lattice(inputs.domain())?, bars)?;
        bars.end();
        Ok(misfit)
    }
}
