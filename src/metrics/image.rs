//! Pixelwise image error.

/// Peak signal-to-noise ratio in dB: −10 log10 of the mean squared error over all channels, for values in [0, 1].
///
/// ∞ for identical images; NaN for empty images or if a value is NaN.
#[must_use]
pub fn psnr(image: &[glam::DVec3], truth: &[glam::DVec3]) -> f64 {
    assert_eq!(image.len(), truth.len(), "images of one size");
    let sum: f64 = image.iter().zip(truth).map(|(a, b)| (a - b).length_squared()).sum();
    -10.0 * (sum / (3 * image.len()) as f64).log10()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn textbook_values() {
        let truth = [DVec3::ZERO, DVec3::ONE];
        assert!((psnr(&[DVec3::splat(0.1), DVec3::splat(0.9)], &truth) - 20.0).abs() < 1e-12);
        assert_eq!(psnr(&truth, &truth), f64::INFINITY);
        assert!(psnr(&[], &[]).is_nan());
    }
}
