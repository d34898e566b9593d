//! Camera-to-world matrices.

use glam::{DMat3, DVec3};

use octobayes::geometry::{MAX_SKEW, skew};

/// Position and rotation of a camera-to-world matrix of 3 or more rows, from which a uniform scale is removed; the
/// error names the fault.
///
/// # Errors
/// If the matrix is not a finite rigid pose times a positive scale.
pub fn rigid_pose(matrix: &[Vec<f64>]) -> Result<(DVec3, DMat3), String> {
    if matrix.len() < 3 || matrix.iter().any(|row| row.len() != 4) {
        return Err(format!("rows of {:?} numbers", matrix.iter().map(Vec::len).collect::<Vec<_>>()));
    }
    let column = |k: usize| DVec3::new(matrix[0][k], matrix[1][k], matrix[2][k]);
    let (linear, position) = (DMat3::from_cols(column(0), column(1), column(2)), column(3));
    if !linear.is_finite() || !position.is_finite() {
        return Err("numbers that are not finite".into());
    }
    // A transposed matrix also has a rotation, but its position stands here.
    let homogeneous = |row: &[f64]| row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6);
    // Some data sets repeat the last row.
    if let Some(last) = matrix[3..].iter().find(|row| !homogeneous(row)) {
        return Err(format!("a last row of {last:?} instead of [0, 0, 0, 1]"));
    }
    let determinant = linear.determinant();
    let scale = determinant.cbrt();
    if scale <= 1e-12 {
        return Err(format!("a singular or mirrored matrix (determinant {determinant:e})"));
    }
    let axes = DMat3::from_cols(linear.x_axis / scale, linear.y_axis / scale, linear.z_axis / scale);
    let largest = skew(axes);
    if largest > MAX_SKEW {
        return Err(format!("a matrix that is no rotation (off by {largest:.3})"));
    }
    Ok((position, axes))
}
