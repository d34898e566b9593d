//! From a field and its training cameras to its uncertainty, in one call.
//!
//! [`RaySettings`] say which rays are drawn and how they are differentiated, [`GridSettings`] what their information is gathered
//! on. [`estimate`] joins the two; [`FieldBuilder`] is the second half alone, for samples that come from elsewhere.

mod builder;
mod grid;
mod rays;

pub use builder::{FieldBuilder, Provenance};
pub use grid::{GridKind, GridSettings};
pub use rays::RaySettings;

use crate::field::RadianceField;
use crate::geometry::{Camera, Domain};
use crate::monitor::Monitor;
use crate::posterior::{Share, Tally};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The uncertainty of `field` as seen by its training `cameras`, over the field's own box.
///
/// # Errors
/// If a setting is out of range, there is no camera, the field is not finite on too many rays, or the work was interrupted.
pub fn estimate(
    field: &dyn RadianceField,
    cameras: &[Camera],
    rays: &RaySettings,
    grid: &GridSettings,
    monitor: &dyn Monitor,
) -> Result<(UncertaintyField, Tally)> {
    if cameras.is_empty() {
        return Err(Error::setting("cameras", "at least one", "none"));
    }
    let mut builder = FieldBuilder::new(*grid, Domain::Box(field.bounds()))?;
    let stream = rays.stream(field, cameras, builder.lattice(), monitor)?;
    let tally = stream.run(Share::whole(rays.rays), Tally::default(), monitor, |batches, _| {
        builder.add(batches);
        Ok(())
    })?;
    let provenance =
        Provenance { source: field.describe(), tally, share: Some(Share::whole(rays.rays)), stream: Some(&stream) };
    Ok((builder.finish(&provenance), tally))
}

#[cfg(test)]
mod tests;
