//! Covariance matrices at points: in which directions a place could be displaced.

use std::borrow::Cow;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{RunRecord, Support, UncertaintyField};
use crate::octree::{VertexId, trilinear};
use crate::posterior::{Covariance, Information, LocalSums, trace};
use crate::{Error, Result};

/// Points that a thread looks up one after the other.
const CHUNK: usize = 1024;

/// Covariance matrices of a field's displacements, for queries at points.
pub struct Matrices<'a> {
    field: Cow<'a, UncertaintyField>,
    local: LocalSums<'a>,
    covariance: Covariance,
}

impl UncertaintyField {
    /// Covariance matrices of the displacement at many points: [`Matrices::at`].
    ///
    /// # Errors
    /// If the sums were not kept.
    pub fn covariances(&self, points: &[Vec3], covariance: Covariance) -> Result<Vec<Information>> {
        Ok(self.matrices(covariance)?.at(points))
    }

    /// The covariance matrices of the displacement under `covariance`, for many calls.
    ///
    /// # Errors
    /// If the sums were not kept.
    pub fn matrices(&self, covariance: Covariance) -> Result<Matrices<'_>> {
        let Some(local) = self.local_sums(&self.record.reading()) else {
            let found = format!("one of `{}` only", self.record().covariance.name());
            return Err(Error::setting("kept sums", "a field that keeps its sums, to give matrices", found));
        };
        let field = if covariance == self.record().covariance {
            Cow::Borrowed(self)
        } else {
            Cow::Owned(self.clone().with_covariance(covariance)?)
        };
        Ok(Matrices { field, local, covariance })
    }
}

impl Matrices<'_> {
    /// Covariance matrices of the displacement at many points, squared scene units (xx, xy, xz, yy, yz, zz).
    ///
    /// The trace of a matrix is U². Its proportions are those of the vertices' matrices ([`Covariance::matrix`]),
    /// interpolated with the weights that interpolate U. Outside the box it is the prior's.
    #[must_use]
    pub fn at(&self, points: &[Vec3]) -> Vec<Information> {
        let RunRecord { rays, lambda, .. } = self.field.record;
        let matrix = |v: usize| self.covariance.matrix(&self.local.at(v), rays, lambda);
        let mut out = vec![[0.0; 6]; points.len()];
        let chunks = points.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK));
        chunks.for_each(|(points, out)| {
            for (&x, out) in points.iter().zip(out) {
                *out = self.field.covariance_at(x, &matrix);
            }
        });
        out
    }
}

impl UncertaintyField {
    /// The matrix at a point, given those of vertices.
    fn covariance_at(&self, x: Vec3, matrix: &dyn Fn(usize) -> Information) -> Information {
        let shape = match self.lattice.coordinates(x) {
            Some(u) => self.interpolated(u, matrix),
            None => [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
        };
        let scale = self.query(x).uncertainty.powi(2) / trace(&shape);
        shape.map(|entry| scale * entry)
    }

    /// Matrices at the corners around lattice coordinates `u`, interpolated.
    fn interpolated(&self, u: DVec3, matrix: &dyn Fn(usize) -> Information) -> Information {
        let mut sum = [0.0; 6];
        let mut add = |weight: f64, vertex: usize| {
            sum.iter_mut().zip(matrix(vertex)).for_each(|(sum, entry)| *sum += weight * entry);
        };
        match &self.support {
            Support::Dense => {
                let (cell, offset) = self.lattice.cell(u);
                for (c, weight) in (0_u32..).zip(trilinear(offset)) {
                    let point = std::array::from_fn(|axis| cell[axis] + (c >> axis & 1));
                    add(weight, self.lattice.dense_index(point));
                }
            }
            Support::Octree(octree) => {
                let mut cursor = octree.cursor();
                cursor.seek(u);
                for (corner, weight) in cursor.corners().iter().zip(cursor.weights(u)) {
                    let masters = corner.masters();
                    masters.iter().for_each(|VertexId(v)| add(weight / masters.len() as f64, *v as usize));
                }
            }
        }
        sum
    }
}
