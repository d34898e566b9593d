//! The leaves of a field as NumPy arrays.

use std::path::Path;

use glam::Vec3;

use super::cells::{center, edges, estimates, in_chunks, leaves};
use crate::Result;
use crate::io::npz::NpzWriter;
use crate::uncertainty::{Knowledge, UncertaintyField};

/// Writes one row per leaf, in Morton order. The arrays are those of the book's chapter on `export`; `rays`, `seen` and
/// `covariance` are there if the field knows them.
///
/// # Errors
/// If the file cannot be written.
pub fn write_leaves(path: &Path, field: &UncertaintyField) -> Result<()> {
    let lattice = field.lattice();
    let count = leaves(field).count() as u64;
    let mut npz = NpzWriter::create(path)?;
    npz.array("center", &[count, 3], leaves(field).flat_map(|cell| center(lattice, cell).to_array()))?;
    npz.array("edge", &[count, 3], leaves(field).flat_map(|cell| edges(lattice, cell).to_array()))?;
    npz.array("level", &[count], leaves(field).map(|cell| cell.level))?;
    npz.array("index", &[count, 3], leaves(field).flat_map(|cell| cell.index))?;
    let at_centers = || estimates(field, leaves(field));
    npz.array("log10_uncertainty", &[count], at_centers().map(|(_, found)| found.uncertainty.log10() as f32))?;
    if !field.rays().is_empty() {
        npz.array("rays", &[count], at_centers().map(|(_, found)| found.rays.unwrap_or(0.0) as f32))?;
    }
    if field.visits().is_some() {
        let seen = at_centers().map(|(x, found)| code(field.knowledge(x, found.uncertainty)));
        npz.array("seen", &[count], seen)?;
    }
    if field.sums().is_some() {
        let matrices = field.matrices(field.protocol().covariance)?;
        let covariances = in_chunks(leaves(field), |cells| {
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
pub fn code(knowledge: Option<Knowledge>) -> u8 {
    match knowledge {
        None | Some(Knowledge::Unseen) => 0,
        Some(Knowledge::Free) => 1,
        Some(Knowledge::Constrained) => 2,
    }
}
