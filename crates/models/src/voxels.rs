//! Voxel grids in a plain `.npz`.
//!
//! `density` f32 `[X, Y, Z]` (1 / scene unit, ≥ 0), `color` f32 `[X, Y, Z, 3]` in `[0, 1]`,
//! `box` f32 `[2, 3]` (min, max in scene units).

use std::path::Path;

use glam::DVec3;
use octobayes::field::{RadianceField, VoxelGrid};
use octobayes::geometry::Aabb;
use octobayes::{Error, Result};
use octobayes_data::Real;
use octobayes_data::npz::{NpzReader, NpzWriter};

/// Reads the three arrays of a voxel grid from an `.npz` file.
///
/// # Errors
/// If an array is missing, is not of numbers, is of another shape, or holds values outside its range.
pub fn read_voxel_grid(path: &Path) -> Result<VoxelGrid> {
    let mut npz = NpzReader::open(path)?;
    // Shapes first, which stand at the start of each member: a megabyte may unfold to a gigabyte.
    npz.stream::<Real>("box")?.expect_shape(&[Some(2), Some(3)])?;
    let density = npz.stream::<Real>("density")?;
    density.expect_shape(&[None, None, None])?;
    let shape = density.shape().to_vec();
    if shape.iter().any(|&n| n < 2) {
        let found = format!("{shape:?}");
        return Err(Error::malformed(path, "array `density`", "at least 2 grid points per axis", found));
    }
    drop(density);
    let of_color: Vec<Option<u64>> = shape.iter().copied().chain([3]).map(Some).collect();
    npz.stream::<Real>("color")?.expect_shape(&of_color)?;

    let corners = npz.reals("box")?;
    let density = npz.reals("density")?;
    let shape = [density.shape[0], density.shape[1], density.shape[2]];
    check_range(path, "density", &density.data, "finite values >= 0", |v| v >= 0.0 && v.is_finite())?;
    let color = npz.reals("color")?;
    check_range(path, "color", &color.data, "values from 0 to 1", |v| (0.0..=1.0).contains(&v))?;

    let corner = |row: usize| DVec3::from([0, 1, 2].map(|axis| f64::from(corners.data[3 * row + axis])));
    let bounds = Aabb::new(corner(0), corner(1)).map_err(|_| {
        Error::malformed(path, "array `box`", "finite min < max along x, y and z", format!("{:?}", corners.data))
    })?;
    let values = density.data.iter().zip(color.data.as_chunks::<3>().0).map(|(&d, &[r, g, b])| [r, g, b, d]).collect();
    VoxelGrid::new(bounds, shape, values)
}

/// Writes the three arrays of a voxel grid as `.npz`.
///
/// # Errors
/// If the file cannot be written.
pub fn write_voxel_grid(grid: &VoxelGrid, path: &Path) -> Result<()> {
    let mut npz = NpzWriter::create(path)?;
    let ([nx, ny, nz], bounds) = (grid.shape().map(|n| n as u64), grid.bounds());
    let corners = [bounds.min(), bounds.max()].map(|v| v.as_vec3().to_array());
    npz.array("box", &[2, 3], corners.iter().flatten().copied())?;
    npz.array("density", &[nx, ny, nz], grid.values().iter().map(|v| v[3]))?;
    npz.array("color", &[nx, ny, nz, 3], grid.values().iter().flat_map(|v| [v[0], v[1], v[2]]))?;
    npz.finish()
}

fn check_range(path: &Path, name: &str, data: &[f32], expected: &str, accept: impl Fn(f32) -> bool) -> Result<()> {
    match data.iter().position(|&v| !accept(v)) {
        Some(i) => Err(Error::malformed(path, format!("array `{name}`, element {i}"), expected, data[i].to_string())),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use octobayes::field::ClosedForm;

    use super::*;

    #[test]
    fn a_grid_survives_its_file() {
        let grid = VoxelGrid::bake(&ClosedForm::ball(), [9, 8, 7], Vec3::Z);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ball.npz");
        write_voxel_grid(&grid, &path).unwrap();
        assert_eq!(read_voxel_grid(&path).unwrap(), grid);
    }
}
