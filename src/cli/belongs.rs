//! Checks that a field belongs to the model at hand, or to another field.

use std::path::Path;

use super::opened::OpenedField;
use super::options::ModelOptions;
use crate::field::RadianceField;
use crate::geometry::Aabb;
use crate::posterior::Scale;
use crate::uncertainty::{Protocol, UncertaintyField};
use crate::{Error, Result};

/// Reads a field of this model. Refuses one of another model, unless `force`, or of another box.
pub fn read_field(
    path: &Path,
    options: &ModelOptions,
    model: &dyn RadianceField,
    force: bool,
) -> Result<UncertaintyField> {
    let field = OpenedField::open(path)?.whole()?;
    check_field(path, &field, options, model, force)?;
    Ok(field)
}

/// Checks a field that was read as [`read_field`] does.
pub fn check_field(
    path: &Path,
    field: &UncertaintyField,
    options: &ModelOptions,
    model: &dyn RadianceField,
    force: bool,
) -> Result<()> {
    check_box(&options.model, &model.bounds(), field)?;
    check_model(options, path, field, force)
}

/// Refuses a field whose box does not lie in the model's.
fn check_box(name: &str, model: &Aabb, field: &UncertaintyField) -> Result<()> {
    // A contracted field covers all of space.
    let Some(bounds) = field.lattice().domain().bounds() else { return Ok(()) };
    // Some files store boxes as f32.
    let slack = 1e-5 * model.longest_edge();
    let inside =
        (bounds.min() - model.min()).min_element() >= -slack && (model.max() - bounds.max()).min_element() >= -slack;
    if inside {
        return Ok(());
    }
    let text = |b: &Aabb| format!("{} to {}", b.min(), b.max());
    Err(Error::setting(
        format!("box of the field for `{name}`"),
        format!("inside the model's, {}", text(model)),
        text(bounds),
    ))
}

/// Refuses a field that was computed for another model; with `force` only warns. Says so on stderr if it names none.
fn check_model(model: &ModelOptions, path: &Path, field: &UncertaintyField, force: bool) -> Result<()> {
    let Some(expected) = field.protocol().origin.model else {
        announce!("note: {} does not say which model it was computed from", path.display());
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
        announce!("warning: {mismatch}");
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
        announce!("warning: {}", Error::setting(what, expected, found));
    }
    if first.origin.cameras.zip(second.origin.cameras).is_some_and(|(a, b)| a != b) {
        announce!("note: the two fields were seen by different cameras");
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
