//! Φ: the map from the part of space that a lattice covers to the unit cube.
//!
//! Letters: y = (x − centre) / radius, r its norm. A box is mapped affinely. The contraction of mip-NeRF 360
//! (Barron et al. 2022, Eq. 10) keeps the ball r ≤ 1 and folds the rest of space into the shell 1 < r < 2:
//!
//! ```text
//! contract(y) = y                  r ≤ 1
//!               (2 − 1/r) y/r      r > 1          Φ(x) = (contract(y) + 2) / 4
//! ```
//!
//! The norm is Euclidean, or the largest coordinate (nerfacto's variant, whose shell fills the cube).
//! Deformations stay in scene units: Φ only decides which vertices are near.

use glam::{DVec3, Vec3};

use super::Aabb;
use crate::{Error, Result};

choices! {
    /// The norm that measures distance from the centre of a contraction.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    pub enum Norm {
        L2 = "l2", "Euclidean (mip-NeRF 360): the cube's corners stay empty";
        Linf = "linf", "Largest coordinate (nerfacto): fills the cube";
    }
}

impl Norm {
    /// Length of `y` by this norm.
    #[must_use]
    pub fn length(self, y: DVec3) -> f64 {
        match self {
            Self::L2 => y.length(),
            Self::Linf => y.abs().max_element(),
        }
    }
}

/// A part of space, or all of it, with its map to the unit cube.
///
/// ```
/// use octobayes::geometry::{Aabb, Domain, Lattice, Norm};
/// use octobayes::glam::{DVec3, Vec3};
///
/// // All of space: unchanged in a ball of radius 1, contracted outside.
/// let space = Domain::contracted(DVec3::ZERO, 1.0, Norm::L2)?;
/// let far_away = Vec3::new(1e6, 0.0, 0.0);
/// assert!(Lattice::from_domain(space, 4)?.coordinates(far_away).is_some());
/// // A box ends somewhere.
/// let cube = Domain::Box(Aabb::centered_cube(1.0));
/// assert!(Lattice::from_domain(cube, 4)?.coordinates(far_away).is_none());
/// # Ok::<(), octobayes::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Domain {
    /// A box, mapped affinely.
    Box(Aabb),
    /// All of space: the ball (or cube) around `center` is unchanged, the rest is contracted.
    Contracted {
        /// Centre, scene units.
        center: [f64; 3],
        /// Radius of the uncontracted part, scene units.
        radius: f64,
        /// Shape of that part.
        norm: Norm,
    },
}

impl Domain {
    /// All of space, contracted outside `radius` around `center`.
    ///
    /// # Errors
    /// If the centre is not finite or the radius not positive and finite.
    pub fn contracted(center: DVec3, radius: f64, norm: Norm) -> Result<Self> {
        if center.is_finite() && radius > 0.0 && radius.is_finite() {
            Ok(Self::Contracted { center: center.to_array(), radius, norm })
        } else {
            let found = format!("centre {center}, radius {radius}");
            Err(Error::setting("contraction", "a finite centre and a radius above 0", found))
        }
    }

    /// Applies the checks of the constructors to a domain read from a file.
    ///
    /// # Errors
    /// As the constructors.
    pub fn checked(self) -> Result<Self> {
        match self {
            Self::Box(b) => Aabb::new(b.min(), b.max()).map(Self::Box),
            Self::Contracted { center, radius, norm } => Self::contracted(DVec3::from(center), radius, norm),
        }
    }

    /// The box; `None` for a contracted domain.
    #[must_use]
    pub fn bounds(&self) -> Option<&Aabb> {
        match self {
            Self::Box(bounds) => Some(bounds),
            Self::Contracted { .. } => None,
        }
    }

    /// Scene lengths of the unit cube's edges along x, y and z, where the map does not contract.
    #[must_use]
    pub fn size(&self) -> DVec3 {
        match self {
            Self::Box(bounds) => bounds.size(),
            Self::Contracted { radius, .. } => DVec3::splat(4.0 * radius),
        }
    }

    /// Φ(x) in `[0, 1]`³; `None` outside a box, or if x is not finite.
    #[must_use]
    #[inline]
    pub fn to_unit(&self, x: Vec3) -> Option<DVec3> {
        let x = x.as_dvec3();
        match self {
            Self::Box(bounds) => {
                let u = (x - bounds.min()) / bounds.size();
                (u.cmpge(DVec3::ZERO).all() && u.cmple(DVec3::ONE).all()).then_some(u)
            }
            Self::Contracted { center, radius, norm } => {
                let y = (x - DVec3::from(*center)) / *radius;
                let r = norm.length(y);
                // The largest coordinate ignores NaN, so y is checked too.
                if !(y.is_finite() && r.is_finite()) {
                    return None;
                }
                let contracted = if r > 1.0 { (2.0 - 1.0 / r) / r * y } else { y };
                Some((0.25 * (contracted + 2.0)).clamp(DVec3::ZERO, DVec3::ONE))
            }
        }
    }

    /// Φ⁻¹(u), a scene position.
    ///
    /// No finite x maps to points of norm 2 or more, such as the far corners of the L2 cube. They go 10⁶
    /// radii out along their direction, as far as f32 still holds well.
    #[must_use]
    pub fn to_scene(&self, u: DVec3) -> DVec3 {
        const MAX_DISTANCE: f64 = 1e6;
        match self {
            Self::Box(bounds) => bounds.min() + u * bounds.size(),
            Self::Contracted { center, radius, norm } => {
                let y = 4.0 * u - 2.0;
                let s = norm.length(y);
                let r = if s > 1.0 { (1.0 / (2.0 - s).max(1.0 / MAX_DISTANCE)).min(MAX_DISTANCE) } else { s };
                DVec3::from(*center) + if s > 1.0 { *radius * r / s * y } else { *radius * y }
            }
        }
    }

    /// Φ'(x)ᵀ g: pulls the gradient `g` of a function on the unit cube back to scene coordinates.
    #[must_use]
    pub fn pull_back(&self, x: Vec3, g: DVec3) -> DVec3 {
        match self {
            Self::Box(bounds) => g / bounds.size(),
            Self::Contracted { center, radius, norm } => {
                let y = (x.as_dvec3() - DVec3::from(*center)) / *radius;
                let r = norm.length(y);
                let scale = 0.25 / *radius;
                if r <= 1.0 {
                    return scale * g;
                }
                // contract(y) = k(r) y with k = (2 − 1/r)/r; its Jacobian is k I + k' y ∇rᵀ.
                let (k, slope) = ((2.0 - 1.0 / r) / r, (2.0 / r - 2.0) / (r * r));
                let r_gradient = match norm {
                    Norm::L2 => y / r,
                    Norm::Linf => {
                        let axis = y.abs().max_position();
                        let mut unit = DVec3::ZERO;
                        unit[axis] = y[axis].signum();
                        unit
                    }
                };
                scale * (k * g + slope * y.dot(g) * r_gradient)
            }
        }
    }

    /// The point of the domain nearest to `x`, as f32.
    #[must_use]
    pub fn clamp(&self, x: Vec3) -> Vec3 {
        self.bounds().map_or(x, |bounds| bounds.clamp(x))
    }

    /// Factor by which lengths across the direction to the centre grow from the cube to the scene at x,
    /// relative to the uncontracted part; 1 in a box.
    ///
    /// Along the direction to the centre, the inverse of Φ's Jacobian stretches more: by r².
    #[must_use]
    pub fn stretch(&self, x: Vec3) -> f64 {
        match self {
            Self::Box(_) => 1.0,
            Self::Contracted { center, radius, norm } => {
                let r = norm.length((x.as_dvec3() - DVec3::from(*center)) / *radius);
                if r > 1.0 { r / (2.0 - 1.0 / r) } else { 1.0 }
            }
        }
    }
}

impl std::fmt::Display for Domain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Box(bounds) => write!(f, "{} to {}", bounds.min(), bounds.max()),
            Self::Contracted { center, radius, norm } => {
                let norm = if *norm == Norm::L2 { "L2" } else { "Linf" };
                write!(f, "all of space, {norm} contraction outside {radius} around {}", DVec3::from(*center))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::array::{uniform2, uniform3};
    use proptest::prelude::*;

    fn domain(norm: Norm) -> Domain {
        Domain::contracted(DVec3::new(0.5, -1.0, 2.0), 3.0, norm).unwrap()
    }

    fn norm() -> impl Strategy<Value = Norm> {
        prop_oneof![Just(Norm::L2), Just(Norm::Linf)]
    }

    proptest! {
        #[test]
        fn contraction_has_its_inverse(norm in norm(), direction in uniform3(-1.0..1.0_f32), decade in -3.0..4.0_f32) {
            let direction = Vec3::from_array(direction);
            prop_assume!(direction.length() > 0.01);
            let x = Vec3::new(0.5, -1.0, 2.0) + direction.normalize() * 3.0 * 10_f32.powf(decade);
            let back = domain(norm).to_scene(domain(norm).to_unit(x).unwrap());
            // 2 − 1/r loses the digits of 1/r below those of 2: a relative error of r ε, in lengths of 3 r,
            // over a few dozen roundings.
            let r = 10_f64.powf(f64::from(decade)).max(1.0);
            prop_assert!((back - x.as_dvec3()).length() <= 3.0 * 50.0 * f64::EPSILON * r * r, "{} became {}", x, back);
        }

        #[test]
        fn the_unit_cube_is_never_left_and_neighbours_stay_neighbours(
            norm in norm(),
            x in uniform3(-1e6..1e6_f32),
            step in uniform3(-1.0..1.0_f32),
        ) {
            let (x, step) = (Vec3::from_array(x), Vec3::from_array(step));
            let [a, b] = [x, x + step].map(|x| domain(norm).to_unit(x).unwrap());
            prop_assert!(a.cmpge(DVec3::ZERO).all() && a.cmple(DVec3::ONE).all());
            // Both contractions are at most 2-Lipschitz in the Euclidean norm: L2 has constant 1, and in L∞ a
            // change of the largest coordinate rescales the others by at most as much again. The cube spans 4 radii.
            let moved = ((x + step) - x).as_dvec3().length();
            prop_assert!((a - b).length() <= 2.0 * moved / 12.0 + 1e-9, "{}", (a - b).length());
        }

        #[test]
        fn gradients_are_pulled_back_as_differences_say(
            norm in norm(),
            direction in uniform3(-1.0..1.0_f32),
            decade in -1.0..1.5_f32,
            g in uniform3(-1.0..1.0_f64),
        ) {
            let direction = Vec3::from_array(direction);
            prop_assume!(direction.length() > 0.1);
            let x = Vec3::new(0.5, -1.0, 2.0) + direction.normalize() * 3.0 * 10_f32.powf(decade);
            // Away from the kinks: the surface r = 1, and ties between the largest coordinates.
            let y = (x - Vec3::new(0.5, -1.0, 2.0)).abs() / 3.0;
            let mut sorted = y.to_array();
            sorted.sort_by(f32::total_cmp);
            // A step is a thousandth of |x|, so that ties are near in proportion.
            let apart = 0.02 * y.length().max(1.0);
            prop_assume!((f64::from(y.length()) - 1.0).abs() > 0.02);
            prop_assume!((sorted[2] - 1.0).abs() > 0.02 && sorted[2] - sorted[1] > apart);
            let g = DVec3::from(g);
            let found = domain(norm).pull_back(x, g);
            for axis in 0..3 {
                // The step is rounded to f32, so the difference is divided by the true distance.
                let mut ends = [x, x];
                ends[0][axis] += 1e-3 * x.length();
                ends[1][axis] -= 1e-3 * x.length();
                let [a, b] = ends.map(|x| domain(norm).to_unit(x).unwrap().dot(g));
                let expected = (a - b) / f64::from(ends[0][axis] - ends[1][axis]);
                // The relative error is a few times h²/r²; r is at least a fifth of |x − centre| here.
                prop_assert!((expected - found[axis]).abs() <= 2e-4 / 12.0, "{} against {}", expected, found[axis]);
            }
        }

        #[test]
        fn stretch_is_the_inverse_jacobian_across(
            norm in norm(),
            direction in uniform2(-0.9..0.9_f64),
            decade in 0.01..2.0_f64,
        ) {
            // Points along +x, where x is the largest coordinate in both norms, are moved along y and z.
            let r = 10_f64.powf(decade);
            let x = DVec3::new(0.5 + 3.0 * r, -1.0, 2.0);
            let h = 1e-3 * r * DVec3::new(0.0, direction[0], direction[1]);
            let [a, b] = [x + h, x - h].map(|x| domain(norm).to_unit(x.as_vec3()).unwrap());
            let found = (a - b).length() * 12.0;
            let expected = 2.0 * h.length() / domain(norm).stretch(x.as_vec3());
            // The L2 difference is second order in 1e-3. Rounding x to f32 adds 6e-8 · 3r over 2e-3 r.
            let limit = 2e-4 * expected + 4e-7 / expected.max(1e-3) * 1e-3;
            prop_assert!((found - expected).abs() <= limit, "{} against {}", found, expected);
        }
    }

    #[test]
    fn known_points() {
        // Two radii out: 2 − 1/2 = 1.5, so u = (1.5 + 2) / 4.
        let x = Vec3::new(0.5 + 6.0, -1.0, 2.0);
        for norm in [Norm::L2, Norm::Linf] {
            let u = domain(norm).to_unit(x).unwrap();
            assert!((u - DVec3::new(0.875, 0.5, 0.5)).length() < 1e-12, "{u}");
            assert!(domain(norm).to_unit(Vec3::splat(f32::MAX)).is_some());
            assert!(domain(norm).to_unit(Vec3::new(f32::INFINITY, 0.0, 0.0)).is_none());
            assert!(domain(norm).to_unit(Vec3::new(f32::NAN, 0.0, 0.0)).is_none());
            assert!(domain(norm).to_scene(DVec3::ZERO).is_finite());
        }
        // On the diagonal the norms differ: one radius of L∞ is √3 of L2.
        let diagonal = Vec3::new(3.5, 2.0, 5.0);
        assert!((domain(Norm::Linf).to_unit(diagonal).unwrap() - 0.75).abs().max_element() < 1e-12);
        assert!(domain(Norm::L2).to_unit(diagonal).unwrap().max_element() < 0.75);
    }
}
