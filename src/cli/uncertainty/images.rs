//! `--images`: what training left unexplained in its images.

use super::{Args, Inputs};
use crate::cli::progress::Bars;
use crate::estimate::GridSettings;
use crate::evaluate::TrainingImages;
use crate::geometry::Lattice;
use crate::posterior::Scale;
use crate::uncertainty::Misfit;
use crate::{Error, Result};

/// Finds the images of the training frames by their names; `None` if they are not asked for.
///
/// # Errors
/// If the field will not be in the scale of its data, or if an image is missing.
pub fn find(args: &Args, inputs: &Inputs, grid: &GridSettings) -> Result<Option<TrainingImages>> {
    let Some(folder) = &args.images else { return Ok(None) };
    let Scale::Data(_) = grid.scale else {
        let expected = "--scale data, in which depths have deviations";
        return Err(Error::setting("--images", expected, "the paper's"));
    };
    TrainingImages::find(folder, &inputs.views.frames).map(Some)
}

/// Compares the model with the images.
///
/// # Errors
/// If an image cannot be read, or if the work was interrupted.
pub fn misfit(images: &TrainingImages, args: &Args, inputs: &Inputs, lattice: &Lattice, bars: &Bars) -> Result<Misfit> {
    let settings = args.model.image_settings();
    let tracer = settings.tracer(&*inputs.field, 0.0, bars)?;
    images.misfit(&tracer, settings.offset_for(&*inputs.field), lattice, bars)
}
