//! A field as verbs take it.

use std::path::Path;

use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_models::refuse_model;

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
