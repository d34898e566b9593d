//! A field as verbs take it.

use std::path::Path;

use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_models::refuse_model;
use octobayes_session::memory::available;

/// Free bytes if the system does not report them.
const DEFAULT_ROOM: u64 = 4 << 30;

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

/// The field with the values of its leaves side by side, if a quarter of what is free has room for them, and so many
/// questions are to come that gathering them pays.
pub fn baked(field: &UncertaintyField, questions: u64) -> BakedField<'_> {
    if questions < field.deviations().len() as u64 {
        return BakedField::unbaked(field);
    }
    BakedField::within((available().unwrap_or(DEFAULT_ROOM) / 4) as usize, field)
}
