//! The variance of a pixel's depth: the posterior of the displacements, propagated to the expected depth.
//!
//! Letters: g_v = Σ_i φ_v(x_i) ∂d/∂x_i, the gradient of a ray's expected depth with respect to the displacement of
//! vertex v; C_v the covariance of that displacement. Displacements of different vertices are independent in this
//! posterior, so to first order Var(d) = Σ_v g_vᵀ C_v g_v. C_v is computed from the sums as U is: pooled, and on leaves
//! that were kept coarser divided by their volume. The hat of a leaf k levels coarser gathers 8ᵏ times the information.
//! Without the division, the deviation of depth would be √8ᵏ times smaller than that of the finest lattice from the
//! same rays. The photometric residual ([`Residuals`](super::Residuals)) is no displacement and is added separately.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use super::UncertaintyField;
use crate::octree::{Leaves, MaxLevels, masters, trilinear};
use crate::posterior::{LocalSums, Scale, VertexSums};
use crate::render::{DepthSample, DepthVariance};
use crate::{Error, Result};

/// The posterior of the displacements, ready for rays.
pub struct DepthPosterior<'a> {
    field: &'a UncertaintyField,
    /// If they were kept.
    sums: Option<LocalSums<'a>>,
    /// Of the leaves on which rays were summed.
    limits: MaxLevels,
    /// From the paper's scale to that of the data, squared.
    scale: f64,
}

impl UncertaintyField {
    /// The posterior that gives depths their variance.
    ///
    /// With kept sums, C_v is the whole matrix that the field's covariance gives ([`Covariance::matrix`]). Without,
    /// only its trace is known, σ_v², and C_v is taken for the same in all directions.
    ///
    /// [`Covariance::matrix`]: crate::posterior::Covariance::matrix
    ///
    /// # Errors
    /// If the field is in the paper's scale, in which deviations are no lengths.
    pub fn depth_posterior(&self) -> Result<DepthPosterior<'_>> {
        let Scale::Data(_) = self.record.scale else {
            return Err(Error::setting(
                "scale",
                "a field computed with it, because deviations of depth need scene units (`uncertainty --for depth`)",
                "one in the paper's scale",
            ));
        };
        let scale = self.record.scale.factor(self.record.covariance).powi(2);
        Ok(DepthPosterior { field: self, sums: self.local_sums(&self.record.reading()), limits: self.limits(), scale })
    }
}

impl DepthVariance for DepthPosterior<'_> {
    /// Outside the lattice's box only the prior constrains matter, every sample independently.
    fn variance(&self, samples: &[DepthSample]) -> f64 {
        let mut gradients: FxHashMap<[u32; 3], DVec3> = FxHashMap::default();
        let mut outside = 0.0;
        for DepthSample { position, gradient } in samples {
            let Some(u) = self.field.lattice.coordinates(*position) else {
                outside += gradient.length_squared();
                continue;
            };
            // The leaves on which rays were summed: of the finest level, unless there are limits.
            let limits = &self.limits;
            let (origin, edge) = limits.leaf(self.field.lattice.cell(u).0).extent(limits.finest());
            let offset = (u - DVec3::from(origin.map(f64::from))) / f64::from(edge);
            for (c, weight) in (0_u32..).zip(trilinear(offset)).filter(|(_, weight)| *weight > 0.0) {
                let point = std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1));
                if limits.is_unlimited() {
                    *gradients.entry(point).or_default() += weight * *gradient;
                    continue;
                }
                let corner = masters(limits, point);
                let share = weight / corner.points().len() as f64;
                for &point in corner.points() {
                    *gradients.entry(point).or_default() += share * *gradient;
                }
            }
        }
        let inside: f64 = gradients.into_iter().map(|(point, gradient)| self.of_vertex(point, gradient)).sum();
        inside + self.field.prior().powi(2) / 3.0 * outside
    }

    fn unexplained(&self, x: Vec3) -> f64 {
        self.field.residuals().map_or(0.0, |residuals| residuals.depth_deviation(x).powi(2))
    }
}

impl DepthPosterior<'_> {
    /// gᵀ C_v g of the vertex at a lattice point.
    fn of_vertex(&self, point: [u32; 3], g: DVec3) -> f64 {
        let UncertaintyField { record, deviations, .. } = self.field;
        let vertex = self.field.vertex_at(point);
        let isotropic = |deviation: f64| deviation * deviation / 3.0 * g.length_squared();
        match (&self.sums, vertex) {
            (Some(sums), _) => {
                let sums = vertex.map_or_else(VertexSums::default, |v| sums.at(v));
                let [xx, xy, xz, yy, yz, zz] = record.covariance.matrix(&sums, record.rays, record.lambda);
                let squares = xx * g.x * g.x + yy * g.y * g.y + zz * g.z * g.z;
                self.scale * (squares + 2.0 * (xy * g.x * g.y + xz * g.x * g.z + yz * g.y * g.z))
            }
            (None, Some(v)) => isotropic(deviations.get(v)),
            (None, None) => isotropic(self.field.prior()),
        }
    }
}
