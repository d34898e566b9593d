//! Checks that a field belongs to the model at hand.

use std::path::Path;

use super::options::ModelOptions;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Refuses a field that was computed for another model; with `force` only warns. Fields that name no model pass.
pub fn check_model(model: &ModelOptions, path: &Path, field: &UncertaintyField, force: bool) -> Result<()> {
    let Some(expected) = field.protocol().origin.model else { return Ok(()) };
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
