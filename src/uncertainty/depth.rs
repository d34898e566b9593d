//! The variance of a pixel's depth: the posterior of the displacements, pushed through to expected depth.
//!
//! Letters: g_v = Σ_i φ_v(x_i) ∂d/∂x_i, the gradient of a ray's expected depth with respect to the displacement of
//! vertex v; C_v the covariance of that displacement. Displacements of different vertices are independent in this
//! posterior, so to first order Var(d) = Σ_v g_vᵀ C_v g_v. If a field has [draws](super::Correlations) u of all
//! displacements together, Var(d) is the mean of (Σ_v g_v · u_v)² over them. What training left unexplained
//! ([`Misfit`](super::Misfit)) is no displacement and stands beside it.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use super::{Correlations, Support, UncertaintyField};
use crate::octree::{Leaves, masters, trilinear};
use crate::posterior::{Scale, VertexSums};
use crate::render::{DepthSample, DepthVariance};
use crate::{Error, Result};

/// The posterior of the displacements, ready for rays.
#[derive(Clone, Copy)]
pub struct DepthPosterior<'a> {
    field: &'a UncertaintyField,
    /// From the paper's scale to that of the data, squared.
    scale: f64,
}

impl UncertaintyField {
    /// The posterior that gives depths their variance.
    ///
    /// With [correlations](UncertaintyField::correlations) vertices move together. Else, with kept sums, C_v is the
    /// whole matrix that the field's covariance gives ([`Covariance::matrix`]). Without, only
    /// its trace is known, σ_v², and C_v is taken for the same in all directions.
    ///
    /// [`Covariance::matrix`]: crate::posterior::Covariance::matrix
    ///
    /// # Errors
    /// If the field is in the paper's scale, in which deviations are no lengths.
    pub fn depth_posterior(&self) -> Result<DepthPosterior<'_>> {
        let Scale::Data(_) = self.protocol.scale else {
            return Err(Error::setting(
                "scale",
                "a field in the scale of its data, for errors of depth",
                "the paper's",
            ));
        };
        Ok(DepthPosterior { field: self, scale: self.protocol.scale.factor(self.protocol.covariance).powi(2) })
    }
}

impl DepthVariance for DepthPosterior<'_> {
    /// What lies outside the lattice's box is held by the prior alone, every sample by itself.
    fn variance(&self, samples: &[DepthSample]) -> f64 {
        let mut gradients: FxHashMap<[u32; 3], DVec3> = FxHashMap::default();
        let mut outside = 0.0;
        for DepthSample { position, gradient } in samples {
            let Some(u) = self.field.lattice.coordinates(*position) else {
                outside += gradient.length_squared();
                continue;
            };
            // The leaves on which rays were summed: of the finest level, unless there are limits.
            let limits = &self.field.limits;
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
        let gradients = gradients.into_iter();
        let inside: f64 = match &self.field.correlations {
            Some(correlations) => self.together(correlations, gradients),
            None => gradients.map(|(point, gradient)| self.of_vertex(point, gradient)).sum(),
        };
        inside + self.field.prior().powi(2) / 3.0 * outside
    }

    fn unexplained(&self, x: Vec3) -> f64 {
        self.field.misfit.as_ref().map_or(0.0, |misfit| misfit.depth_deviation(x).powi(2))
    }
}

impl DepthPosterior<'_> {
    /// Mean of (Σ_v g_v · u_v)² over the draws.
    fn together(&self, correlations: &Correlations, gradients: impl Iterator<Item = ([u32; 3], DVec3)>) -> f64 {
        let mut moved = vec![0.0; correlations.draws()];
        let mut held_by_prior = 0.0;
        for (point, g) in gradients {
            if !self.field.vertex_at(point).is_some_and(|v| correlations.add(v, g, &mut moved)) {
                held_by_prior += g.length_squared();
            }
        }
        moved.iter().map(|d| d * d).sum::<f64>() / moved.len() as f64 + self.field.prior().powi(2) / 3.0 * held_by_prior
    }

    /// gᵀ C_v g of the vertex at a lattice point.
    fn of_vertex(&self, point: [u32; 3], g: DVec3) -> f64 {
        let UncertaintyField { protocol, support, sums, deviations, .. } = self.field;
        let lambda = match support {
            Support::Dense => protocol.lambda,
            Support::Octree(octree) => protocol.prior.at(protocol.lambda, octree, point),
        };
        let vertex = self.field.vertex_at(point);
        let isotropic = |deviation: f64| deviation * deviation / 3.0 * g.length_squared();
        match (sums, vertex) {
            (Some(sums), _) => {
                let sums = vertex.map_or_else(VertexSums::default, |v| sums[v]);
                let [xx, xy, xz, yy, yz, zz] = protocol.covariance.matrix(&sums, protocol.rays, lambda);
                let squares = xx * g.x * g.x + yy * g.y * g.y + zz * g.z * g.z;
                self.scale * (squares + 2.0 * (xy * g.x * g.y + xz * g.x * g.z + yz * g.y * g.z))
            }
            (None, Some(v)) => isotropic(deviations.get(v)),
            (None, None) => isotropic(protocol.deviation(&VertexSums::default(), lambda)),
        }
    }
}
