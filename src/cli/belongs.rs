//! Checks that a field belongs to the model at hand, or to another field.

use std::path::Path;

use super::options::ModelOptions;
use crate::posterior::Scale;
use crate::uncertainty::{Protocol, UncertaintyField};
use crate::{Error, Result};

/// Refuses a field that was computed for another model; with `force` only warns. Says so on stderr if it names none.
pub fn check_model(model: &ModelOptions, path: &Path, field: &UncertaintyField, force: bool) -> Result<()> {
    let Some(expected) = field.protocol().origin.model else {
        eprintln!("note: {} does not say which model it was computed from", path.display());
        return Ok(());
    };
    let found = crate::open::checksum(&model.model, model.rays.coordinates)?;
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

/// Refuses to compare fields of different models, or of different scales; with `force` only warns. Says so on stderr if
/// they were seen by different cameras.
pub fn check_fields(a: (&Path, &Protocol), b: (&Path, &Protocol), force: bool) -> Result<()> {
    let [(path, first), (other, second)] = [a, b];
    let models = first.origin.model.zip(second.origin.model).filter(|(a, b)| a != b);
    let differences = [
        models.map(|(a, b)| ("model", format!("checksum {a:08x}"), format!("checksum {b:08x}"))),
        (first.scale != second.scale).then(|| ("scale", scale(first.scale), scale(second.scale))),
    ];
    for (what, expected, found) in differences.into_iter().flatten() {
        let (what, expected) =
            (format!("{what} of {}", other.display()), format!("{expected}, as of {}", path.display()));
        if !force {
            return Err(Error::setting(what, expected, format!("{found} (--force insists)")));
        }
        eprintln!("warning: {}", Error::setting(what, expected, found));
    }
    if first.origin.cameras.zip(second.origin.cameras).is_some_and(|(a, b)| a != b) {
        eprintln!("note: the two fields were seen by different cameras");
    }
    Ok(())
}

fn scale(scale: Scale) -> String {
    match scale {
        Scale::Paper => "`paper`".into(),
        Scale::Data(data) => format!(
            "`data` ({} pixels of noise {:.4}, prior deviation {:.4})",
            data.pixels, data.noise, data.prior_deviation
        ),
    }
}
