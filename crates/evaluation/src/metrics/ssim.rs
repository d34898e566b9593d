//! Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004).
//!
//! The window is an 11 × 11 Gaussian with standard deviation 1.5; K₁ = 0.01, K₂ = 0.03; values lie in [0, 1];
//! variances are population variances. The mean is taken over the three channels and all windows inside the
//! image. This is scikit-image's `structural_similarity` with `gaussian_weights=True,
//! use_sample_covariance=False, data_range=1`.

use glam::DVec3;

/// Pixels on each side of a window's centre.
const RADIUS: usize = 5;
/// Pixels across a window.
const WINDOW: usize = 2 * RADIUS + 1;
const DEVIATION: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Weights of the window along one axis, normalised.
fn window() -> [f64; WINDOW] {
    let weights: [f64; WINDOW] = std::array::from_fn(|i| {
        let x = i as f64 - RADIUS as f64;
        (-0.5 * x * x / (DEVIATION * DEVIATION)).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// SSIM of one window, from its means, variances and covariance.
fn similarity(mean: [f64; 2], variance: [f64; 2], covariance: f64) -> f64 {
    let [x, y] = mean;
    (2.0 * x * y + C1) * (2.0 * covariance + C2) / ((x * x + y * y + C1) * (variance[0] + variance[1] + C2))
}

/// Mean SSIM of two images `[height · width]` in [0, 1]; 1 if they are identical, `None` if smaller than a window.
#[must_use]
pub fn ssim([width, height]: [u32; 2], image: &[DVec3], truth: &[DVec3]) -> Option<f64> {
    let (width, height) = (width as usize, height as usize);
    assert!(image.len() == width * height && truth.len() == width * height, "images of one size");
    if width < WINDOW || height < WINDOW {
        return None;
    }
    // The window is separable: sum along rows, then along columns. Each row holds x, y, x², y², xy.
    let weights = window();
    let columns = width - WINDOW + 1;
    let moments = |a: DVec3, b: DVec3| [a, b, a * a, b * b, a * b];
    let along_row = |row: usize, column: usize| {
        let mut sums = [DVec3::ZERO; 5];
        for (k, w) in weights.iter().enumerate() {
            let i = row * width + column + k;
            sums.iter_mut().zip(moments(image[i], truth[i])).for_each(|(s, m)| *s += *w * m);
        }
        sums
    };
    let rows: Vec<[DVec3; 5]> = (0..height)
        .flat_map(|row| (0..columns).map(move |column| (row, column)))
        .map(|(r, c)| along_row(r, c))
        .collect();
    let mut total = 0.0;
    for row in 0..=height - WINDOW {
        for column in 0..columns {
            let mut sums = [DVec3::ZERO; 5];
            for (k, w) in weights.iter().enumerate() {
                sums.iter_mut().zip(rows[(row + k) * columns + column]).for_each(|(s, m)| *s += *w * m);
            }
            let [x, y, xx, yy, xy] = sums;
            for c in 0..3 {
                let variance = [xx[c] - x[c] * x[c], yy[c] - y[c] * y[c]];
                total += similarity([x[c], y[c]], variance, xy[c] - x[c] * y[c]);
            }
        }
    }
    Some(total / (3 * columns * (height - WINDOW + 1)) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computes every window on its own, straight from the definition.
    fn slowly([width, height]: [usize; 2], image: &[DVec3], truth: &[DVec3]) -> f64 {
        let w = window();
        let (mut total, mut count) = (0.0, 0.0);
        for top in 0..=height - WINDOW {
            for left in 0..=width - WINDOW {
                for c in 0..3 {
                    let pixels: Vec<(f64, f64, f64)> = (0..WINDOW * WINDOW)
                        .map(|k| {
                            let i = (top + k / WINDOW) * width + left + k % WINDOW;
                            (w[k / WINDOW] * w[k % WINDOW], image[i][c], truth[i][c])
                        })
                        .collect();
                    let mean = |f: &dyn Fn(f64, f64) -> f64| pixels.iter().map(|p| p.0 * f(p.1, p.2)).sum::<f64>();
                    let (x, y) = (mean(&|a, _| a), mean(&|_, b| b));
                    let variance = [mean(&|a, _| (a - x).powi(2)), mean(&|_, b| (b - y).powi(2))];
                    total += similarity([x, y], variance, mean(&|a, b| (a - x) * (b - y)));
                    count += 1.0;
                }
            }
        }
        total / count
    }

    fn image(size: [usize; 2], phase: f64) -> Vec<DVec3> {
        let pixel = |i: usize| {
            let (x, y) = ((i % size[0]) as f64, (i / size[0]) as f64);
            DVec3::new((0.7 * x + phase).sin(), (0.3 * x * y + phase).cos(), (0.11 * y * y - phase).sin())
        };
        (0..size[0] * size[1]).map(|i| 0.5 + 0.5 * pixel(i)).collect()
    }

    #[test]
    fn agrees_with_the_definition() {
        for size in [[11, 11], [17, 13]] {
            let (a, b) = (image(size, 0.0), image(size, 0.4));
            let found = ssim(size.map(|n| n as u32), &a, &b).unwrap();
            assert!((found - slowly(size, &a, &b)).abs() < 1e-12 && (0.1..0.999).contains(&found), "{found}");
            assert!((ssim(size.map(|n| n as u32), &a, &a).unwrap() - 1.0).abs() < 1e-12);
        }
        assert_eq!(ssim([10, 40], &[DVec3::ONE; 400], &[DVec3::ONE; 400]), None);
    }

    #[test]
    fn constant_images_have_the_closed_form() {
        // Without variance only the term of the means is left: (2ab + C₁) / (a² + b² + C₁).
        let [a, b] = [0.25, 0.75].map(|v| vec![DVec3::splat(v); 400]);
        let expected = (2.0 * 0.25 * 0.75 + C1) / (0.0625 + 0.5625 + C1);
        // Variances are differences of numbers near ½: rounding of 1e-16 against C₂ = 9e-4.
        assert!((ssim([20, 20], &a, &b).unwrap() - expected).abs() < 1e-11);
    }
}
