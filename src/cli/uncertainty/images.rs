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
    /// If one is missing.
    pub fn find(args: &Args, inputs: &Inputs) -> Result<Option<Self>> {
        let Some(folder) = &args.images else { return Ok(None) };
        let find = |frame: &Frame| {
            // COLMAP's names start from the folder of the images, those of a transforms.json from its own.
            let places = [folder.clone(), folder.join("images")].map(|folder| image_path(&folder, &frame.name));
            let image = places.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
                let expected = "the folder from which the names of the training images start";
                Error::setting("--images", expected, format!("no {}", places[0].display()))
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
    /// If the field will not be in the scale of its data, if an image cannot be read, or if the work was interrupted.
    pub fn misfit(&self, args: &Args, inputs: &Inputs, grid: &GridSettings, bars: &Bars) -> Result<Misfit> {
        let Scale::Data(_) = grid.scale else {
            let expected = "--scale data, in which depths have deviations";
            return Err(Error::setting("--images", expected, "the paper's"));
        };
        let settings = args.model.image_settings();
        let tracer = settings.tracer(&*inputs.field, 0.0, bars)?;
        let offset = settings.pixel_offset.unwrap_or_else(|| inputs.field.pixel_offset());
        let pixels: u64 = self.0.iter().map(|frame| frame.camera.pixels()).sum();
        let stride = (pixels as f64 / PIXELS as f64).sqrt().ceil().max(1.0) as u32;
        let background = args.model.rays.background.as_dvec3();
        let read = |frame: &Frame| TrueView::read(frame, None, background, offset, stride);
        let images = self.0.iter().map(read).collect::<Result<Vec<_>>>()?;
        bars.begin("rows of training images", images.iter().map(|image| u64::from(image.camera.resolution[1])).sum());
        let misfit = measure_misfit(&tracer, &images, &grid.lattice(inputs.domain())?, bars)?;
        bars.end();
        Ok(misfit)
    }
}
