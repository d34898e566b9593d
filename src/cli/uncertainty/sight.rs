//! Checks whether the cameras see anything of the model.

use super::Args;
use crate::estimate::Sight;
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
}
