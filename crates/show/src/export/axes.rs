//! Principal axes of a covariance: Jacobi's rotations, which keep small axes right beside ones a million times as long.
//! Crates that find them in f64 bring a whole linear algebra with them.

use glam::{DMat3, DVec3};

use octobayes::posterior::Information;

/// Sweeps over the three pairs of axes; the off-diagonal falls quadratically, and is gone after four or five.
const SWEEPS: usize = 12;

/// The principal axes of a covariance matrix, the longest first, each as long as one standard deviation along it.
pub fn principal_axes([xx, xy, xz, yy, yz, zz]: Information) -> [DVec3; 3] {
    let mut matrix = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
    let mut vectors = DMat3::IDENTITY;
    for (p, q) in [(0, 1), (0, 2), (1, 2)].into_iter().cycle().take(3 * SWEEPS) {
        let off = matrix.col(q)[p];
        if off == 0.0 {
            continue;
        }
        // The rotation by the smaller angle that takes the entry (p, q) to zero.
        let theta = (matrix.col(q)[q] - matrix.col(p)[p]) / (2.0 * off);
        let tangent = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
        let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
        let sine = tangent * cosine;
        let mut rotation = DMat3::IDENTITY;
        rotation.col_mut(p)[p] = cosine;
        rotation.col_mut(q)[q] = cosine;
        rotation.col_mut(q)[p] = sine;
        rotation.col_mut(p)[q] = -sine;
        matrix = rotation.transpose() * matrix * rotation;
        vectors *= rotation;
        // What rounding leaves there would be taken for information.
        (matrix.col_mut(q)[p], matrix.col_mut(p)[q]) = (0.0, 0.0);
    }
    let mut axes = [0, 1, 2].map(|k| matrix.col(k)[k].max(0.0).sqrt() * vectors.col(k));
    axes.sort_by(|a, b| b.length_squared().total_cmp(&a.length_squared()));
    axes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn axes_give_the_matrix_back(
            lengths in [1e-6..1e3_f64, 1e-6..1e3, 1e-6..1e3],
            angles in [-3.0..3.0_f64, -3.0..3.0, -3.0..3.0],
        ) {
            let rotation = DMat3::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
            let squares = DMat3::from_diagonal(DVec3::from(lengths) * DVec3::from(lengths));
            let m = rotation * squares * rotation.transpose();
            let axes = principal_axes([m.col(0)[0], m.col(1)[0], m.col(2)[0], m.col(1)[1], m.col(2)[1], m.col(2)[2]]);
            let back = axes.iter().fold(DMat3::ZERO, |sum, &a| sum + DMat3::from_cols(a * a.x, a * a.y, a * a.z));
            let largest = lengths.iter().fold(0.0_f64, |m, &l| m.max(l)).powi(2);
            // A few dozen rotations of f64, each with a few roundings of the largest entry.
            for (a, b) in back.to_cols_array().into_iter().zip(m.to_cols_array()) {
                prop_assert!((a - b).abs() <= 1e-13 * largest, "{} against {}", a, b);
            }
            prop_assert!(axes[0].length() >= axes[1].length() && axes[1].length() >= axes[2].length());
            prop_assert!(axes[0].dot(axes[1]).abs() <= 1e-12 * axes[0].length_squared());
        }
    }
}
