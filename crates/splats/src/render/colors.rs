//! Colours of splats, which depend on the direction in which they are seen, and their derivatives.

use glam::DVec3;

use octobayes::field::harmonics::{gradients, values};

/// Colour of a splat with the coefficients `sh` (`[K, 3]`), seen along the unit vector `d`: ½ + Σ, not below 0.
pub fn color(sh: &[f32], d: DVec3) -> DVec3 {
    let terms = sh.chunks_exact(3).zip(values(d));
    terms.fold(DVec3::splat(0.5), |sum, (c, value)| sum + value * rgb(c)).max(DVec3::ZERO)
}

fn rgb(c: &[f32]) -> DVec3 {
    DVec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2]))
}

/// Rows (by channel) of ∂c/∂μ of that colour, `shown`, for a splat whose centre lies along the unit vector `d` at
/// `distance`: (∂SH/∂d)(I − d dᵀ) / distance, and 0 where the colour is cut off.
pub fn color_jacobian(sh: &[f32], shown: DVec3, d: DVec3, distance: f64) -> [DVec3; 3] {
    let mut rows = [DVec3::ZERO; 3];
    for (c, gradient) in sh.chunks_exact(3).zip(gradients(d)) {
        let c = rgb(c);
        (0..3).for_each(|channel| rows[channel] += c[channel] * gradient);
    }
    std::array::from_fn(|channel| match shown[channel] > 0.0 {
        true => (rows[channel] - rows[channel].dot(d) * d) / distance,
        false => DVec3::ZERO,
    })
}
