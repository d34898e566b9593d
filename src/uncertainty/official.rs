//! The official code's file: a flat f32 `.npy` of Σ_r tr(JᵀJ) on (M + 1)³ vertices.
//!
//! Its index is x·M² + y·M + z. The stride is M although there are M + 1 vertices per axis, so vertices on the
//! upper faces share entries with vertices on lower ones: (x, y, M) with (x, y + 1, 0), and (x, M, z) with
//! (x + 1, 0, z). Files are read and written with this index, which nothing else uses. Vertices inside the box
//! are exact. On its faces an entry is the sum over all vertices that share it, as in the official code itself.

use std::path::Path;

use super::{RunRecord, Support, UncertaintyField};
use crate::geometry::{Domain, Lattice};
use crate::io::{Real, npy};
use crate::posterior::{self, Covariance, VertexSums};
use crate::{Error, Result};

/// What the official file does not contain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OfficialGrid {
    /// The space that was mapped to the unit cube, in scene units: a box; for models that contract all of space, that.
    pub domain: Domain,
    /// Number of rays that were summed; the official default is 1000 batches of 4096.
    pub rays: u64,
    /// Prior precision λ, 1 / scene unit²; `None` for 1e-4 / M³ divided by the square of the longest edge.
    pub lambda: Option<f64>,
}

impl OfficialGrid {
    /// Number of rays with the official code's defaults.
    pub const DEFAULT_RAYS: u64 = 4_096_000;

    /// Reads an official `.npy` as a dense field with the `trace` covariance.
    ///
    /// # Errors
    /// If the array is not flat and of numbers, with (2^level + 1)³ finite values ≥ 0.
    pub fn read(&self, path: &Path) -> Result<UncertaintyField> {
        let stream = npy::stream::<Real>(path)?;
        stream.expect_shape(&[None])?;
        let array = stream.into_reals()?;
        let level = (1..=9_u8).find(|&level| ((1_usize << level) + 1).pow(3) == array.data.len()).ok_or_else(|| {
            let found = format!("{} values", array.data.len());
            Error::malformed(path, "data", "(2^lod + 1)^3 values, lod from 1 to 9", found)
        })?;
        if let Some(i) = array.data.iter().position(|&v| !(v >= 0.0 && v.is_finite())) {
            let found = array.data[i].to_string();
            return Err(Error::malformed(path, format!("data, element {i}"), "a finite sum of squares", found));
        }
        let lattice = Lattice::from_domain(self.domain.checked()?, level)?;
        let mut sums = Vec::with_capacity(array.data.len());
        for_each_vertex(lattice.cells_per_axis(), |_, index| {
            // Only the trace is known, so an isotropic matrix with this trace stands in.
            let third = f64::from(array.data[index]) / 3.0;
            sums.push(VertexSums::new([third, 0.0, 0.0, third, 0.0, third], 0));
        });
        let source = format!("official grid {}", path.display());
        let lambda = self.lambda.unwrap_or_else(|| lattice.default_lambda());
        let record = RunRecord::unstated(source, self.rays, lambda, Covariance::Trace);
        // An isotropic stand-in supports no other covariance, so the matrices are not kept.
        Ok(UncertaintyField::new(record, lattice, Support::Dense, sums).without_sums())
    }
}

impl UncertaintyField {
    /// Writes Σ_r tr(JᵀJ) as the official code's `.npy`.
    ///
    /// # Errors
    /// If the field has no sums and its covariance is not `trace`, its level is above 9 (1 GB), leaves were limited, or
    /// the file cannot be written.
    pub fn write_official(&self, path: &Path) -> Result<()> {
        if self.lattice.level() > 9 {
            let found = format!("level {}", self.lattice.level());
            return Err(Error::setting("export", "a level up to 9: the official grid is dense", found));
        }
        if !self.limits().is_unlimited() {
            let found = "one whose sums lie on coarser leaves";
            return Err(Error::setting("export", "a field on the finest lattice", found));
        }
        let m = self.lattice.cells_per_axis();
        let mut sums = vec![0.0_f64; self.lattice.dense_vertices() as usize];
        let mut missing = false;
        for_each_vertex(m, |point, index| match self.trace_at(point).or_else(|| self.trace_from_deviation(point)) {
            Some(trace) => sums[index] += trace,
            None => missing = true,
        });
        if missing {
            let found = format!("a field that holds `{}` only", self.record.covariance.name());
            let expected = "a field that keeps its sums, or one of `trace`, for the official code's grid; for NumPy \
                            export to `.npz`";
            return Err(Error::setting("kept sums", expected, found));
        }
        npy::write(path, &[sums.len() as u64], sums.into_iter().map(|s| s as f32))
    }

    /// tr S at a lattice point: exact at a vertex, 0 elsewhere, where it is negligible; `None` if the sums were
    /// not kept.
    pub(super) fn trace_at(&self, point: [u32; 3]) -> Option<f64> {
        let sums = self.sums()?;
        Some(self.vertex_at(point).map_or(0.0, |v| posterior::trace(&sums[v].information)))
    }

    /// tr S from σ² = 1 / (tr S / R + λ), if the covariance of the field is `trace`.
    fn trace_from_deviation(&self, point: [u32; 3]) -> Option<f64> {
        if self.record.covariance != Covariance::Trace {
            return None;
        }
        let x = self.lattice.position(glam::DVec3::from(point.map(f64::from))).as_vec3();
        let factor = self.record.scale.factor(Covariance::Trace);
        let deviation = self.query(self.lattice.domain().clamp(x)).uncertainty / factor;
        Some((self.record.rays as f64 * (deviation.powi(-2) - self.record.lambda)).max(0.0))
    }
}

/// Visits every vertex, x slowest, with its index in the official order.
fn for_each_vertex(m: u32, mut visit: impl FnMut([u32; 3], usize)) {
    for x in 0..=m {
        for y in 0..=m {
            for z in 0..=m {
                let stride = m as usize;
                visit([x, y, z], (x as usize * stride + y as usize) * stride + z as usize);
            }
        }
    }
}
