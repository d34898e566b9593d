//! The official code's file: a flat f32 `.npy` of Σ_r tr(JᵀJ) on (M + 1)³ vertices.
//!
//! Its index is x·M² + y·M + z. The stride is M although there are M + 1 vertices per axis, so vertices on the
//! upper faces share entries with vertices on lower ones: (x, y, M) with (x, y + 1, 0), and (x, M, z) with
//! (x + 1, 0, z). Files are read and written with this index, which nothing else uses. Vertices inside the box
//! are exact. On its faces an entry is the sum over all vertices that share it, as in the official code itself.

use std::path::Path;

use crate::{Real, npy};
use octobayes::geometry::{Domain, Lattice};
use octobayes::posterior;
use octobayes::posterior::{Covariance, VertexSums};
use octobayes::uncertainty::{RunRecord, Support, UncertaintyField};
use octobayes::{Error, Result};

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

/// Writes Σ_r tr(JᵀJ) of a field as the official code's `.npy`.
///
/// # Errors
/// If the field has no sums and its covariance is not `trace`, its level is above 9 (1 GB), leaves were limited, or
/// the file cannot be written.
pub fn write_official(field: &UncertaintyField, path: &Path) -> Result<()> {
    let (lattice, record) = (field.lattice(), field.record());
    if lattice.level() > 9 {
        let found = format!("level {}", lattice.level());
        return Err(Error::setting("export", "a level up to 9: the official grid is dense", found));
    }
    if !field.limits().is_unlimited() {
        let found = "one whose sums lie on coarser leaves";
        return Err(Error::setting("export", "a field on the finest lattice", found));
    }
    let m = lattice.cells_per_axis();
    let mut sums = vec![0.0_f64; lattice.dense_vertices() as usize];
    let mut missing = false;
    for_each_vertex(m, |point, index| match trace_at(field, point).or_else(|| trace_from_deviation(field, point)) {
        Some(trace) => sums[index] += trace,
        None => missing = true,
    });
    if missing {
        let found = format!("a field that holds `{}` only", record.covariance.name());
        let expected = "a field that keeps its sums, or one of `trace`, for the official code's grid; for NumPy \
                        export to `.npz`";
        return Err(Error::setting("kept sums", expected, found));
    }
    npy::write(path, &[sums.len() as u64], sums.into_iter().map(|s| s as f32))
}

/// tr S at a lattice point: exact at a vertex, 0 elsewhere, where it is negligible; `None` if the sums were
/// not kept.
fn trace_at(field: &UncertaintyField, point: [u32; 3]) -> Option<f64> {
    let sums = field.sums()?;
    Some(field.vertex_at(point).map_or(0.0, |v| posterior::trace(&sums[v].information)))
}

/// tr S from σ² = 1 / (tr S / R + λ), if the covariance of the field is `trace`.
fn trace_from_deviation(field: &UncertaintyField, point: [u32; 3]) -> Option<f64> {
    let (lattice, record) = (field.lattice(), field.record());
    if record.covariance != Covariance::Trace {
        return None;
    }
    let x = lattice.position(glam::DVec3::from(point.map(f64::from))).as_vec3();
    let factor = record.scale.factor(Covariance::Trace);
    let deviation = field.query(lattice.domain().clamp(x)).uncertainty / factor;
    Some((record.rays as f64 * (deviation.powi(-2) - record.lambda)).max(0.0))
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

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use octobayes::geometry::Aabb;
    use octobayes::posterior::{DensePosterior, Posterior};
    use octobayes::render::{RaySample, RaySamples};

    use super::*;

    /// A few rays through a box of edge 2.
    fn field() -> UncertaintyField {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 5).unwrap();
        let mut samples = RaySamples::default();
        for i in 0..40_u64 {
            let t = i as f32 / 40.0;
            let position = Vec3::new(0.9 * (7.0 * t).sin(), 0.5 * (11.0 * t).cos(), 0.3 - 0.2 * t);
            let jacobian = std::array::from_fn(|k| ((k as f32 + 1.0) * (3.0 * t + 1.0)).sin());
            samples.push(i / 3, RaySample { position, jacobian, weight: 0.3 });
        }
        let mut dense = DensePosterior::new(lattice);
        dense.add(&[samples]);
        let record = RunRecord::unstated("test".into(), 20, lattice.default_lambda(), Covariance::Trace);
        UncertaintyField::new(record, lattice, Support::Dense, dense.into_sums())
    }

    #[test]
    fn official_file_has_its_own_index_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("unc.npy");
        let dense = field();
        write_official(&dense, &path).unwrap();
        let flat = npy::stream::<Real>(&path).unwrap().into_reals().unwrap();
        let m = 32_usize;
        assert_eq!(flat.shape, [(m + 1).pow(3)]);
        // A vertex away from the upper faces has the entry x·M² + y·M + z to itself.
        let inner = (1..31_u32).flat_map(|x| (1..31).flat_map(move |y| (1..31).map(move |z| [x, y, z])));
        let point =
            inner.max_by(|&a, &b| trace_at(&dense, a).unwrap().total_cmp(&trace_at(&dense, b).unwrap())).unwrap();
        let index = (point[0] as usize * m + point[1] as usize) * m + point[2] as usize;
        let trace = trace_at(&dense, point).unwrap();
        assert!(trace > 0.0 && (f64::from(flat.data[index]) / trace - 1.0).abs() < 1e-6);

        let domain = Domain::Box(Aabb::centered_cube(1.0));
        let read = OfficialGrid { domain, rays: 20, lambda: None }.read(&path).unwrap();
        for x in [Vec3::new(0.25, -0.25, 0.2), Vec3::new(-0.4, 0.1, 0.3), Vec3::ZERO] {
            assert!((read.log10(x) - dense.log10(x)).abs() < 1e-6, "{x}");
        }
    }
}
