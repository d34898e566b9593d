//! A field as verbs take it.

use std::path::{Path, PathBuf};

use octobayes::estimate::Checkpoint;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_models::refuse_model;
use octobayes_session::{OpenedModel, Session, TrainingCameras};

use super::options::{CameraOptions, RunOptions};
use super::progress::Bars;
use super::streams::tell;

/// Reads a field.
pub fn open_field(path: &Path) -> Result<UncertaintyField> {
    refuse_model(path)?;
    if path.extension().is_some_and(|extension| extension == "npy") {
        let name = path.display();
        let expected =
            format!("`.oct`; of a grid of the official code, `export {name} -o FIELD.oct --box=BOX` makes one");
        return Err(Error::malformed(path, "file name", expected, "`.npy`"));
    }
    UncertaintyField::read(path)
}

/// Computes the field that a verb was not given, with the settings of `purpose`, and writes it to `save`, beside which
/// the state of an interrupted run lies.
pub fn compute_field(
    opened: &OpenedModel,
    (cameras, training): (&CameraOptions, &TrainingCameras),
    options: &RunOptions,
    purpose: impl FnOnce(Session, Option<f64>) -> Session,
    save: Option<&Path>,
    bars: &Bars,
) -> Result<UncertaintyField> {
    let session = Session::new(training.views.clone(), format!("{} seen by {}", opened.source, training.source))?;
    let session = purpose(session.checksum(Some(opened.checksum)), options.noise)
        .background(options.training.background)
        .model_file(Some(PathBuf::from(&opened.name)))
        .checkpoint(save.map(|path| Checkpoint::new(path.with_extension("checkpoint")).restart(options.restart)))
        .force(options.training.force)
        .has_chosen_coordinates(opened.coordinates.is_some() && cameras.cameras.is_some())
        .has_given_fov(cameras.fov.is_some());
    let finished = session.prepare(&*opened.model, bars, &mut tell)?.finish(&mut tell)?;
    if let Some(path) = save {
        finished.save(path)?;
    }
    Ok(finished.field)
}
