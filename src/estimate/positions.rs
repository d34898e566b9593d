//! Checks whether f32 holds positions finely enough: far from the origin its numbers are far apart.

use glam::Vec3;

use super::rays::resolution;
use crate::Result;
use crate::geometry::{Aabb, Lattice};
use crate::monitor::Monitor;
use crate::rays::RayStream;

/// Parts of a lattice edge from which the distance between positions is bad. Each sample is then off by up to a
/// hundredth of an edge, and so is the share of its vertices: at level 8 this moves log10 U by 0.01 in the mean.
const BAD_SPACING: f64 = 1.0 / 64.0;
/// Parts of a lattice edge below which densities are not looked at. Near the origin nothing is this coarse.
const FINE_SPACING: f64 = 1.0 / 4096.0;

/// How finely f32 holds positions in a field's box.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct PositionCheck {
    /// The coordinate that is farthest from the origin.
    pub farthest: f32,
    /// Distance between f32 numbers there, scene units.
    pub apart: f64,
    /// The same in edges of the finest lattice.
    pub edges: f64,
    /// Mean change of density at visible surfaces from one such number to the next, relative to the mean density; 0
    /// if numbers are so near that it does not matter.
    pub change: f64,
    /// Whether either moves log10 U by more than the tolerance.
    pub is_bad: bool,
}

impl PositionCheck {
    /// Measures positions of a field's box on a lattice.
    pub(super) fn of_box(lattice: &Lattice, bounds: &Aabb) -> Self {
        let on_axis = |axis: usize| {
            let (farthest, apart) = resolution(lattice.domain(), bounds, axis);
            let edges = apart / lattice.edge()[axis];
            Self { farthest, apart, edges, change: 0.0, is_bad: edges >= BAD_SPACING }
        };
        (0..3).map(on_axis).reduce(|a, b| if b.edges > a.edges { b } else { a }).expect("three axes")
    }

    /// Measures positions, and what they do to densities where the cameras of `stream` see surfaces.
    pub(super) fn measure(
        stream: &RayStream,
        lattice: &Lattice,
        tolerance: f64,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let mut found = Self::of_box(lattice, &stream.source.bounds());
        // Splats are where they are: they have no density that changes between two positions.
        let Some(volume) = stream.source.marched().filter(|_| !found.is_bad && found.edges >= FINE_SPACING) else {
            return Ok(found);
        };
        let field = volume.tracer.field;
        let points = super::step::surface_points(stream, super::step::SEED, monitor)?;
        let next = |(i, x): (usize, &Vec3)| *x + found.apart as f32 * Vec3::AXES[i % 3];
        let moved: Vec<Vec3> = points.iter().enumerate().map(next).collect();
        let [here, there] = [&points, &moved].map(|points| {
            let mut densities = vec![0.0; points.len()];
            field.densities(points, &mut densities);
            densities
        });
        let sum = here.iter().map(|&density| f64::from(density)).sum::<f64>();
        let change: f64 = here.iter().zip(&there).map(|(&a, &b)| (f64::from(b) - f64::from(a)).abs()).sum();
        if sum > 0.0 && change.is_finite() {
            found.change = change / sum;
            found.is_bad = found.change * std::f64::consts::LOG10_E > tolerance;
        }
        Ok(found)
    }

    /// The warning, if positions are too far apart.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let Self { farthest, apart, edges, change, .. } = self;
        let effect = if *edges >= BAD_SPACING {
            format!("{edges:.3} edges of the finest lattice")
        } else {
            format!("in which density changes by {:.1} %", 100.0 * change)
        };
        self.is_bad.then(|| {
            format!(
                "the scene is far from the origin: f32 positions are {apart:.1e} scene units apart at {farthest:.1e}, \
                 {effect}, so U is off; move the scene nearer to the origin"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::Domain;

    /// A box of edge 1.6 around x, and what a floater at 9000 units does to the box of all splats.
    #[test]
    fn only_positions_within_the_domain_count() {
        let around = |x: f64| Aabb::new(DVec3::new(x - 0.8, -0.8, -0.8), DVec3::new(x + 0.8, 0.8, 0.8)).unwrap();
        let check = |domain: Aabb, splats: Aabb| {
            PositionCheck::of_box(&Lattice::from_domain(Domain::Box(domain), 7).unwrap(), &splats)
        };
        let with_floater = Aabb::new(DVec3::splat(-0.8), DVec3::new(9000.0, 0.8, 0.8)).unwrap();
        assert_eq!(check(around(0.0), with_floater), check(around(0.0), around(0.0)));
        assert!(check(around(0.0), with_floater).warning().is_none());
        // Numbers at 9000 are 2⁻¹⁰ apart, a thirteenth of an edge.
        let far = check(around(9000.0), around(9000.0));
        assert!((far.edges - 128.0 / 1.6 / 1024.0).abs() < 1e-9 && far.warning().is_some(), "{far:?}");
        assert!(check(around(9000.0), with_floater).warning().is_some());
    }
}
