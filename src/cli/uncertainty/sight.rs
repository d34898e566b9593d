//! Checks whether the cameras see anything of the model, and whether it shows the images beside them.

use super::Args;
use crate::dataset::Frame;
use crate::estimate::{Run, Sight};
use crate::evaluate::check_images;
use crate::monitor::Monitor;
use crate::{Error, Result};

impl Args {
    /// Refuses a run in which nothing is seen. Warns of one in which little is seen.
    pub fn check_sight(&self, sight: &Sight) -> Result<()> {
        if let Some(outside) = sight.cut_off().map(|share| 100.0 * share) {
            announce!("note: {outside:.1} % of what the rays meet lies outside --box: U is the prior there");
        }
        let Some(mut causes) = sight.causes() else { return Ok(()) };
        // These models have two kinds of coordinates. If rays meet matter, but outside the domain, they are right.
        if self.model.model.ends_with(".ppng") && sight.meet_matter <= 2.0 * sight.meet_domain {
            causes.push_str(", or --coordinates (ngp or blender)");
        }
        if self.cameras.fov.is_some() {
            causes.push_str(", or --fov");
        }
        let measured = sight.measured();
        if sight.is_nothing() {
            let expected = format!("rays that meet matter in the field's domain; likely causes: {causes}");
            return Err(Error::setting("cameras", expected, format!("none: {measured}")));
        }
        announce!("warning: the cameras see little of the model: {measured}; likely causes: {causes}");
        Ok(())
    }

    /// Compares the model with the images of `frames` that are there. Refuses cameras whose images it does not show at
    /// all, unless forced. Warns if it shows them poorly.
    pub fn check_images(&self, run: &Run, frames: &[Frame], monitor: &dyn Monitor) -> Result<()> {
        let stream = run.stream();
        let Some(found) = check_images(&stream.tracer, frames, stream.pixel_offset, monitor)? else { return Ok(()) };
        if !self.force {
            found.refuse()?;
        }
        found.warnings().iter().for_each(|text| announce!("warning: {text}"));
        Ok(())
    }
}
