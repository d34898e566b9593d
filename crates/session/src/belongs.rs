//! Checks that a field belongs to the model at hand, or to another field.

use std::iter;
use std::path::Path;

use glam::Vec3;

use super::OpenedModel;
use octobayes::estimate::RaySettings;
use octobayes::geometry::Aabb;
use octobayes::monitor::Message;
use octobayes::posterior::Scale;
use octobayes::uncertainty::{RunRecord, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_models::Coordinates;
use octobayes_splats::RenderMode;

/// Priors that differ by less, in decades, are the same.
const SAME_PRIOR: f64 = 0.05;

impl OpenedModel {
    /// Opens the model `name` that `field`, of the file `path`, was computed from, in the coordinates that it had then.
    ///
    /// # Errors
    /// As [`OpenedModel::open`] and [`OpenedModel::check`].
    pub fn of_field(
        field: &UncertaintyField,
        path: &Path,
        name: &str,
        force: bool,
        tell: &mut dyn FnMut(Message),
    ) -> Result<Self> {
        let checksum = field.record().model_checksum;
        let opened = Self::open(name, coordinates_of(name, checksum)?, mode_of(name, checksum)?)?;
        opened.check(field, path, force, tell)?;
        Ok(opened)
    }

    /// Checks that `field`, of the file `path`, belongs to the model. With `force` another model is only warned of.
    ///
    /// # Errors
    /// If it was computed from another model, or if its box does not lie in the model's.
    pub fn check(
        &self,
        field: &UncertaintyField,
        path: &Path,
        force: bool,
        tell: &mut dyn FnMut(Message),
    ) -> Result<()> {
        if self.model.ends_at_its_box() {
            check_box(&self.name, &self.model.whole_box(), field)?;
        }
        let Some(expected) = field.record().model_checksum else {
            tell(Message::Note(format!(
                "{} has no checksum of its model: it cannot be verified that they belong together",
                path.display()
            )));
            return Ok(());
        };
        if expected == self.checksum {
            return Ok(());
        }
        let expected = format!("checksum {expected:08x}, as in \"{}\"", field.record().source);
        let (found, more) = (format!("checksum {:08x} of `{}`", self.checksum, self.name), ", another model");
        refuse(format!("model of {}", path.display()), &expected, &found, more, force, tell)
    }
}

/// Settings for images: with the background and the position of rays in their pixels that a field was computed with.
#[must_use]
pub fn image_settings(field: &UncertaintyField) -> RaySettings {
    let RunRecord { background, pixel_offset, .. } = *field.record();
    let images = RaySettings::for_images();
    images.background(background.map_or(images.background, Vec3::from)).pixel_offset(pixel_offset)
}

/// An error, or with `force` a warning.
fn refuse(
    what: String,
    expected: &str,
    found: &str,
    more: &str,
    force: bool,
    tell: &mut dyn FnMut(Message),
) -> Result<()> {
    if !force {
        return Err(Error::setting(what, expected, format!("{found}{more} (override with --force)")));
    }
    tell(Message::Warning(Error::setting(what, expected, found).to_string()));
    Ok(())
}

/// The coordinates in which a model of several kinds has a checksum; its file's own if it is another model.
fn coordinates_of(name: &str, checksum: Option<u32>) -> Result<Option<Coordinates>> {
    if !octobayes_models::has_coordinates(name) {
        return Ok(None);
    }
    for coordinates in Coordinates::ALL {
        if checksum == Some(octobayes_models::checksum(name, Some(coordinates), None)?) {
            return Ok(Some(coordinates));
        }
    }
    Ok(Some(Coordinates::default()))
}

/// The mode of drawing with which a file of splats has a checksum, if not its own.
fn mode_of(name: &str, checksum: Option<u32>) -> Result<Option<RenderMode>> {
    if !octobayes_models::is_of_splats(name) {
        return Ok(None);
    }
    for mode in iter::once(None).chain(RenderMode::ALL.map(Some)) {
        if checksum == Some(octobayes_models::checksum(name, None, mode)?) {
            return Ok(mode);
        }
    }
    Ok(None)
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

/// Refuses to compare fields of different models, or of different scales; with `force` only warns. Notes if they were
/// seen by different cameras. Each has a path.
///
/// # Errors
/// If that is so.
pub fn check_fields(
    [(path, first), (other, second)]: [(&Path, &UncertaintyField); 2],
    force: bool,
    tell: &mut dyn FnMut(Message),
) -> Result<()> {
    let priors = [first, second].map(|field| field.prior().log10());
    let [first, second] = [first, second].map(UncertaintyField::record);
    let models = first.model_checksum.zip(second.model_checksum).filter(|(a, b)| a != b);
    let differences = [
        models.map(|(a, b)| ("model", format!("checksum {a:08x}"), format!("checksum {b:08x}"))),
        (first.scale != second.scale).then(|| ("scale", scale(first.scale), scale(second.scale))),
    ];
    for (what, expected, found) in differences.into_iter().flatten() {
        let expected = format!("{expected}, as of {}", path.display());
        refuse(format!("{what} of {}", other.display()), &expected, &found, "", force, tell)?;
    }
    if first.scale == second.scale
        && first.covariance == second.covariance
        && (priors[0] - priors[1]).abs() > SAME_PRIOR
    {
        tell(Message::Warning(format!(
            "U of one field is on another scale than that of the other: where nothing was seen, log10 U is {:.2} \
             and {:.2}, as with another --level or --lambda; compare fields with these in common, or of --scale data",
            priors[0], priors[1]
        )));
    }
    if first.covariance != second.covariance {
        let [first, second] = [first, second].map(|record| record.covariance.name());
        tell(Message::Warning(format!("`{first}` of one field is compared with `{second}` of the other")));
    }
    if first.cameras_checksum.zip(second.cameras_checksum).is_some_and(|(a, b)| a != b) {
        tell(Message::Note("the two fields were seen by different cameras".into()));
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
