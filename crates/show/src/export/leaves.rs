//! The leaves of a field as NumPy arrays.

use std::path::Path;

use glam::Vec3;

use super::cells::{at_centers, center, edges, in_chunks, knows, leaves};
use octobayes::Result;
use octobayes::uncertainty::{Answer, Matrices, Observability, Support, UncertaintyField};
use octobayes_data::npz::NpzWriter;

/// Writes one row per leaf, in Morton order. The arrays are those of the book's chapter on `export`; `rays` and `seen`
/// are there if the field stores them, `covariance` if its matrices are given.
///
/// # Errors
/// If the file cannot be written.
pub fn write_leaves(path: &Path, field: &UncertaintyField, matrices: Option<&Matrices>) -> Result<()> {
    let lattice = field.lattice();
    let cells = match field.support() {
        Support::Dense => None,
        Support::Octree(octree) => Some(octree.cells()),
    };
    let leaves = || leaves(lattice, cells);
    let count = leaves().count() as u64;
    let mut npz = NpzWriter::create(path)?;
    npz.array("center", &[count, 3], leaves().flat_map(|cell| center(lattice, cell).to_array()))?;
    npz.array("edge", &[count, 3], leaves().flat_map(|cell| edges(lattice, cell).to_array()))?;
    npz.array("level", &[count], leaves().map(|cell| cell.level))?;
    npz.array("index", &[count, 3], leaves().flat_map(|cell| cell.index))?;
    let [knows_rays, knows_coverage] = knows(field);
    let answers = || at_centers(field, leaves());
    let log10 = |found: Answer| found.estimate.uncertainty.log10() as f32;
    npz.array("log10_uncertainty", &[count], answers().map(log10))?;
    if knows_rays {
        npz.array("rays", &[count], answers().map(|found| found.estimate.rays.unwrap_or(0.0) as f32))?;
    }
    if knows_coverage {
        npz.array("seen", &[count], answers().map(|found| code(found.observability)))?;
    }
    if let Some(matrices) = matrices {
        let covariances = in_chunks(leaves(), |cells| {
            let centers: Vec<Vec3> = cells.iter().map(|&cell| center(lattice, cell).as_vec3()).collect();
            matrices.at(&centers)
        });
        let full = |[xx, xy, xz, yy, yz, zz]: [f64; 6]| [xx, xy, xz, xy, yy, yz, xz, yz, zz].map(|v| v as f32);
        npz.array("covariance", &[count, 3, 3], covariances.flat_map(full))?;
    }
    npz.array("prior_log10_uncertainty", &[], [field.prior().log10()])?;
    npz.finish()
}

/// What is known of a place, as a number: 0 never seen, 1 free, 2 constrained.
pub fn code(observability: Option<Observability>) -> u8 {
    match observability {
        None | Some(Observability::Unseen) => 0,
        Some(Observability::Free) => 1,
        Some(Observability::Constrained) => 2,
    }
}
