//! The parameters of splats while they are trained: a row of numbers for each.

use glam::{Quat, Vec3};

use octobayes::Result;
use octobayes::field::harmonics::C0;
use octobayes_splats::{MAX_DEGREE, RenderMode, Splats};

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

/// The splats of these rows.
///
/// # Errors
/// If a number is not finite.
pub fn splats(rows: &[Row]) -> Result<Splats> {
    Splats::new(
        rows.iter().map(|row| three(row, MEAN)).collect(),
        rows.iter().map(|row| three(row, SCALE)).collect(),
        rows.iter().map(|row| rotation(row).normalize()).collect(),
        rows.iter().map(|row| row[LOGIT]).collect(),
        rows.iter().flat_map(|row| row[SH..].iter().copied()).collect(),
        MAX_DEGREE,
        RenderMode::Classic,
    )
}
