//! The parameters of splats while they are trained: a row of numbers for each.

use glam::{Quat, Vec3};

use octobayes::Result;
use octobayes::field::harmonics::C0;
use octobayes_splats::{RenderMode, Splats};

/// Where a row has its parts: centre, logarithms of the standard deviations, rotation (x, y, z, w), logit of the
/// opacity, spherical harmonics (red, green and blue of each coefficient).
pub const MEAN: usize = 0;
pub const SCALE: usize = 3;
pub const ROTATION: usize = 6;
pub const LOGIT: usize = 10;
pub const SH: usize = 11;
/// Numbers of a splat, with spherical harmonics of degree 3.
pub const WIDTH: usize = SH + 48;

/// The parameters of a splat, their gradient, or Adam's moments of it.
pub type Row = [f32; WIDTH];

/// Three numbers of a row.
pub fn three(row: &Row, at: usize) -> Vec3 {
    Vec3::from_slice(&row[at..at + 3])
}

/// The rotation of a row.
pub fn rotation(row: &Row) -> Quat {
    Quat::from_slice(&row[ROTATION..])
}

/// Opacity at the centre.
pub fn opacity(row: &Row) -> f32 {
    1.0 / (1.0 + (-row[LOGIT]).exp())
}

/// Coefficients of the constant function that show a colour.
pub fn constant_of(color: Vec3) -> Vec3 {
    (color - 0.5) / C0 as f32
}

/// The splats of these rows, with the spherical harmonics up to a degree.
///
/// # Errors
/// If a number is not finite.
pub fn splats(rows: &[Row], degree: u8) -> Result<Splats> {
    let coefficients = SH..SH + 3 * (usize::from(degree) + 1).pow(2);
    Splats::new(
        rows.iter().map(|row| three(row, MEAN)).collect(),
        rows.iter().map(|row| three(row, SCALE)).collect(),
        rows.iter().map(|row| rotation(row).normalize()).collect(),
        rows.iter().map(|row| row[LOGIT]).collect(),
        rows.iter().flat_map(|row| row[coefficients.clone()].iter().copied()).collect(),
        degree,
        RenderMode::Classic,
    )
}

/// The rows of these splats. Coefficients that they lack are 0.
pub fn rows(splats: &Splats) -> Vec<Row> {
    let row = |i: usize| {
        let mut row = [0.0; WIDTH];
        row[MEAN..SCALE].copy_from_slice(&splats.mean(i).to_array());
        row[SCALE..ROTATION].copy_from_slice(&splats.log_scales()[i].to_array());
        row[ROTATION..LOGIT].copy_from_slice(&splats.rotation(i).to_array());
        row[LOGIT] = splats.opacity_logits()[i];
        row[SH..SH + splats.sh(i).len()].copy_from_slice(splats.sh(i));
        row
    };
    (0..splats.len()).map(row).collect()
}

#[cfg(test)]
mod tests {
    use octobayes_splats::MAX_DEGREE;

    use super::*;

    #[test]
    fn rows_of_splats_are_those_that_they_were_made_of() {
        let number = |i: usize| (i as f32 * 0.37).sin();
        let mut row: Row = std::array::from_fn(number);
        let unit = rotation(&row).normalize().to_array();
        row[ROTATION..LOGIT].copy_from_slice(&unit);
        let found = rows(&splats(&[row], MAX_DEGREE).unwrap())[0];
        // The rotation is normalised once more.
        assert!(found.iter().zip(row).all(|(found, expected)| (found - expected).abs() <= 2.0 * f32::EPSILON));
    }
}
