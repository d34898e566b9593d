//! Perceptual image quality.

use glam::DVec3;
use ssimulacra2::{ColorPrimaries, Rgb, TransferCharacteristic, compute_frame_ssimulacra2};

/// SSIMULACRA 2 (Sneyers, Cloudinary): structural similarity at six scales in a perceptual colour space.
///
/// It is tuned to human judgement: 100 for identical images, 90 hardly distinguishable, 50 medium
/// quality, negative for very bad ones. Images are `[height · width]` in [0, 1], taken as sRGB. `None` if
/// they are smaller than 8 × 8 pixels.
#[must_use]
pub fn ssimulacra2([width, height]: [u32; 2], image: &[DVec3], truth: &[DVec3]) -> Option<f64> {
    let of = |pixels: &[DVec3]| {
        let data = pixels.iter().map(|p| p.clamp(DVec3::ZERO, DVec3::ONE).as_vec3().to_array()).collect();
        Rgb::new(data, width as usize, height as usize, TransferCharacteristic::SRGB, ColorPrimaries::BT709).ok()
    };
    compute_frame_ssimulacra2(of(truth)?, of(image)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_noise_is_worse_and_none_is_100() {
        let truth: Vec<DVec3> = (0..64 * 48)
            .map(|i| 0.5 + 0.3 * DVec3::new((0.2 * f64::from(i % 64)).sin(), (0.01 * f64::from(i)).cos(), 0.0))
            .collect();
        let noisy = |size: f64| -> Vec<DVec3> {
            truth
                .iter()
                .enumerate()
                .map(|(i, c)| c + size * (((i * 2_654_435_761) % 1000) as f64 / 500.0 - 1.0))
                .collect()
        };
        let score = |image: &[DVec3]| ssimulacra2([64, 48], image, &truth).unwrap();
        assert!((score(&truth) - 100.0).abs() < 1e-3);
        let scores = [0.01, 0.05, 0.2].map(|size| score(&noisy(size)));
        assert!(scores[0] > scores[1] && scores[1] > scores[2] && scores[0] < 99.0, "{scores:?}");
        let inverted: Vec<DVec3> = truth.iter().map(|c| 1.0 - *c).collect();
        assert!(score(&inverted) < scores[2] - 20.0, "{}", score(&inverted));
        assert_eq!(ssimulacra2([7, 7], &truth[..49], &truth[..49]), None);
    }
}
