//! Checks that a field belongs to the model at hand.

use std::path::Path;

use super::options::ModelOptions;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Refuses a field that was computed for another model; with `force` only warns. Says so on stderr if it names none.
pub fn check_model(model: &ModelOptions, path: &Path, field: &UncertaintyField, force: bool) -> Result<()> {
    let Some(expected) = field.protocol().origin.model else {
        eprintln!("note: {} does not say which model it was computed from", path.display());
        return Ok(());
    };
    let found = crate::open::checksum(&model.model, model.coordinates)?;
    if expected == found {
        return Ok(());
    }
    let what = format!("model of {}", path.display());
    let expected = format!("checksum {expected:08x}, as in \"{}\"", field.protocol().source);
    let found = format!("checksum {found:08x} of `{}`", model.model);
    if force {
        let mismatch = Error::setting(what, expected, found);
        eprintln!("warning: {mismatch}");
        Ok(())
    } else {
        Err(Error::setting(what, expected, format!("{found}, another model or other --coordinates (--force insists)")))
    }
}
