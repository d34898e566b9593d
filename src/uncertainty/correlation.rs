//! How displacements at two points go together.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use super::UncertaintyField;
use crate::octree::{Leaves, masters, trilinear};

impl UncertaintyField {
    /// Correlation, 0 to 1, of one component of the displacements at two scene points.
    ///
    /// With φ_v the trilinear functions of the leaves on which rays were summed, the displacement at x is
    /// Σ_v φ_v(x) u_v. Displacements u_v of different vertices are independent in this posterior, and taken for the same
    /// in all directions, so that the covariance at a and b is in proportion to Σ_v φ_v(a) φ_v(b) σ_v². Outside the box
    /// nothing is shared.
    #[must_use]
    pub fn correlation(&self, a: Vec3, b: Vec3) -> f64 {
        let (Some(a), Some(b)) = (self.functions(a), self.functions(b)) else { return 0.0 };
        let covariance = |one: &FxHashMap<[u32; 3], f64>, other: &FxHashMap<[u32; 3], f64>| -> f64 {
            let shared = |(point, value): (&[u32; 3], &f64)| Some(value * other.get(point)? * self.variance_at(*point));
            one.iter().filter_map(shared).sum()
        };
        let product = covariance(&a, &a) * covariance(&b, &b);
        if product > 0.0 { (covariance(&a, &b) / product.sqrt()).min(1.0) } else { 0.0 }
    }

    /// φ_v at a scene point, by lattice point; `None` outside the box.
    fn functions(&self, x: Vec3) -> Option<FxHashMap<[u32; 3], f64>> {
        let (u, limits) = (self.lattice.coordinates(x)?, self.limits());
        // The leaves on which rays were summed: of the finest level, unless there are limits.
        let (origin, edge) = limits.leaf(self.lattice.cell(u).0).extent(limits.finest());
        let offset = (u - DVec3::from(origin.map(f64::from))) / f64::from(edge);
        let mut functions = FxHashMap::default();
        for (c, weight) in (0_u32..).zip(trilinear(offset)).filter(|(_, weight)| *weight > 0.0) {
            let corner = masters(&limits, std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1)));
            let share = weight / corner.points().len() as f64;
            corner.points().iter().for_each(|point| *functions.entry(*point).or_default() += share);
        }
        Some(functions)
    }

    /// σ_v² of the vertex at a lattice point; the prior's where there is none.
    fn variance_at(&self, point: [u32; 3]) -> f64 {
        self.vertex_at(point).map_or(self.prior(), |v| self.deviations.get(v)).powi(2)
    }
}
