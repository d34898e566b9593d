//! The space that a trained field covers.

use glam::{DVec3, Vec3};

use crate::Result;
use crate::geometry::{Aabb, Domain};

/// Samples across the longest edge of the domain: about one per cell of the finest level.
const STEPS: f64 = 512.0;
/// Half edge of the box of a contracted field, in radii of the part that is not contracted: contraction puts 94 % of the way to
/// infinity inside.
const REACH: f64 = 8.0;

/// The part of space that a trained field covers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space {
    pub domain: Domain,
    /// Outside of it the density is zero.
    pub bounds: Aabb,
}

impl Space {
    /// All of a box; of all of space what [`REACH`] covers.
    ///
    /// # Errors
    /// If the domain is none that its constructors make, or its bounds are not finite.
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

    /// u, `None` outside the bounds.
    pub fn unit(&self, x: Vec3) -> Option<[f32; 3]> {
        let inside = match self.domain {
            Domain::Box(_) => true,
            Domain::Contracted { .. } => self.bounds.contains(x),
        };
        self.domain.to_unit(x).filter(|_| inside).map(|u| u.as_vec3().to_array())
    }

    /// Distance between samples where the domain is not contracted, scene units.
    pub fn step(&self) -> f64 {
        self.domain.size().max_element() / STEPS
    }

    /// Densities are trained per this length, so that scenes may have any scale: scene units.
    pub fn unit_length(&self) -> f64 {
        self.domain.size().max_element()
    }
}
