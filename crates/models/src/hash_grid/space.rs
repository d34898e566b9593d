//! The space that a trained field covers.

use glam::{DVec3, Vec3};

use octobayes::Result;
use octobayes::geometry::{Aabb, Domain};

/// Samples across the longest edge of the domain: about two per cell of the finest level by default.
const STEPS: f64 = 512.0;
/// Half edge of the box of a contracted field, in radii of the uncontracted part. Contraction maps it to 94 %
/// of the way to infinity.
const REACH: f64 = 8.0;

/// The part of space that a trained field covers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space {
    pub domain: Domain,
    /// The density is zero outside of it.
    pub bounds: Aabb,
}

impl Space {
    /// All of a box, or the part of a contracted domain that [`REACH`] covers.
    ///
    /// # Errors
    /// If the domain fails the checks of its constructors, or its bounds are not finite.
    pub fn new(domain: Domain) -> Result<Self> {
        let domain = domain.checked()?;
        let bounds = match domain {
            Domain::Box(bounds) => bounds,
            Domain::Contracted { center, radius, .. } => {
                let (center, half) = (DVec3::from(center), DVec3::splat(REACH * radius));
                Aabb::new(center - half, center + half)?
            }
        };
        Ok(Self { domain, bounds })
    }

    /// Position u in the unit cube; `None` outside the bounds.
    #[must_use]
    pub fn unit(&self, x: Vec3) -> Option<[f32; 3]> {
        let inside = match self.domain {
            Domain::Box(_) => true,
            Domain::Contracted { .. } => self.bounds.contains(x),
        };
        self.domain.to_unit(x).filter(|_| inside).map(|u| u.as_vec3().to_array())
    }

    /// Distance between samples where the domain is not contracted, scene units.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.domain.size().max_element() / STEPS
    }

    /// Length per which densities are trained, scene units. It lets scenes have any scale.
    #[must_use]
    pub fn unit_length(&self) -> f64 {
        self.domain.size().max_element()
    }
}
