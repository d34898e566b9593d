//! Whether the cameras see anything of the model.

use super::Args;
use crate::cli::progress::Bars;
use crate::estimate::Sight;
use crate::geometry::Domain;
use crate::rays::RayStream;
use crate::{Error, Result};

impl Args {
    /// Refuses a run in which nothing is seen, and warns of one in which little is.
    pub(super) fn check_sight(&self, stream: &RayStream, domain: &Domain, bars: &Bars) -> Result<()> {
        let sight = Sight::of(stream, domain, bars)?;
        let Some(mut causes) = sight.causes() else { return Ok(()) };
        // These models have two kinds of coordinates. If matter is met and lies elsewhere, they are right.
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
        eprintln!("warning: the cameras see little of the model: {measured}; likely causes: {causes}");
        Ok(())
    }
}
