//! U at one point: the deviations at the corners of its cell, interpolated.

use glam::{DVec3, Vec3};

use super::{Support, UncertaintyField};
use crate::octree::{VertexId, trilinear};

/// U at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// U, scene units.
    pub uncertainty: f64,
    /// Root mean square error of log10 U due to the number of rays, decades.
    ///
    /// `None` if the field has no error bars, or too few rays passed here for an estimate
    /// ([`ErrorBars`](super::ErrorBars)). Vertices share rays, so between them the errors of their σ are added without
    /// cancellation: an upper bound to first order.
    pub log10_error: Option<f64>,
    /// Number of rays that support this estimate, interpolated from the vertices'
    /// [`UncertaintyField::rays`](super::UncertaintyField::rays). `None` if they are unknown.
    pub rays: Option<f64>,
    /// Level of the leaf around the point (the finest level on a dense grid); 0 outside the box.
    pub level: u8,
    /// Whether the point is inside the box. Outside, `uncertainty` is the prior's.
    pub inside: bool,
}

impl UncertaintyField {
    /// U at a scene point. Outside the box, or for NaN, it is the prior, marked as outside.
    #[must_use]
    pub fn query(&self, x: Vec3) -> Estimate {
        let Some(u) = self.lattice.coordinates(x) else { return self.outside() };
        match &self.support {
            Support::Dense => self.query_dense(u),
            Support::Octree(octree) => {
                let mut cursor = octree.cursor();
                cursor.seek(u);
                self.interpolate(&self.leaf_values(&cursor), &cursor, u)
            }
        }
    }

    /// Number of training rays that support U at a scene point, interpolated; NaN if the field has no counts, 0 outside
    /// the box.
    #[must_use]
    pub fn support_at(&self, x: Vec3) -> f64 {
        let found = self.query(x);
        if found.inside { found.rays.unwrap_or(f64::NAN) } else { 0.0 }
    }

    /// log10 U at a scene point.
    #[must_use]
    pub fn log10(&self, x: Vec3) -> f64 {
        self.query(x).uncertainty.log10()
    }

    fn query_dense(&self, u: DVec3) -> Estimate {
        let (cell, offset) = self.lattice.cell(u);
        let vertices: [[VertexId; 1]; 8] = std::array::from_fn(|c| {
            let corner = std::array::from_fn(|axis| cell[axis] + (c as u32 >> axis & 1));
            [VertexId(self.lattice.dense_index(corner) as u32)]
        });
        let values = self.corner_values(vertices.each_ref().map(|vertex| &vertex[..]));
        self.interpolated_at(&values, &trilinear(offset), self.lattice.level())
    }
}
