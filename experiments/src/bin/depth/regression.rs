//! A regression of residuals on coverage, fitted on training views only, in the manner of PRIMU and U-3DGS.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use glam::DVec3;
use octobayes::Result;
use octobayes::monitor::Silent;
use octobayes::uncertainty::Residuals;
use octobayes_evaluation::{EvaluatedView, Evaluator, TrueView};

use crate::baselines::Baselines;
use crate::judge::pixel_residuals;

/// The weight of coefficients of zero, in pixels.
const RIDGE: f64 = 1.0;
/// Variance of the ray's weights, the baselines but for the angle to a training view, which is 0 on training views and
/// explains nothing there, residuals, and one.
const WIDTH: usize = 8;
/// The smallest residual: half a step of 8 bits.
const LEAST: f64 = 0.5 / 255.0;

/// log10 of the residual of colour as a linear function of features.
pub struct Regression {
    mean: [f64; WIDTH],
    deviation: [f64; WIDTH],
    coefficients: [f64; WIDTH],
}

impl Regression {
    /// Fits residuals of these training images.
    pub fn fit(evaluator: &Evaluator, baselines: &Baselines, shown: &Residuals, images: &[TrueView]) -> Result<Self> {
        let (mut rows, mut residuals) = (Vec::new(), Vec::new());
        for image in images {
            let view = evaluator.evaluate(image, 0, &Silent)?;
            let of_images = pixel_residuals(evaluator, shown, image, &view);
            rows.extend(features(&view, &baselines.of(image, &view), &of_images));
            let residual = |&i: &usize| color_error(view.rendered.pixels[i].color, image.colors[i]);
            residuals.extend(view.pixels.iter().map(residual));
        }
        let n = rows.len().max(1) as f64;
        let column = |k: usize| rows.iter().map(move |row: &[f64; WIDTH]| row[k]);
        let mut mean: [f64; WIDTH] = std::array::from_fn(|k| column(k).sum::<f64>() / n);
        let spread = |k: usize| (column(k).map(|v| (v - mean[k]).powi(2)).sum::<f64>() / n).sqrt();
        // What does not vary explains nothing, whatever it is divided by.
        let mut deviation: [f64; WIDTH] = std::array::from_fn(|k| spread(k).max(1e-9));
        (mean[WIDTH - 1], deviation[WIDTH - 1]) = (0.0, 1.0);
        let mut fitted = Self { mean, deviation, coefficients: [0.0; WIDTH] };
        let mut normal = Mat::<f64>::zeros(WIDTH, WIDTH);
        let mut right = Mat::<f64>::zeros(WIDTH, 1);
        for (row, residual) in rows.iter().zip(&residuals) {
            let row = fitted.standard(row);
            for i in 0..WIDTH {
                right[(i, 0)] += row[i] * residual;
                for j in 0..WIDTH {
                    normal[(i, j)] += row[i] * row[j];
                }
            }
        }
        for i in 0..WIDTH - 1 {
            normal[(i, i)] += RIDGE;
        }
        let factors = normal.llt(Side::Lower).expect("a ridge and a pixel make it positive definite");
        let solution = factors.solve(&right);
        fitted.coefficients = std::array::from_fn(|i| solution[(i, 0)]);
        Ok(fitted)
    }

    fn standard(&self, row: &[f64; WIDTH]) -> [f64; WIDTH] {
        std::array::from_fn(|k| (row[k] - self.mean[k]) / self.deviation[k])
    }

    /// The residual that is expected at each pixel of a view.
    pub fn of(&self, view: &EvaluatedView, baselines: &[Vec<f64>; 6], pixel_residuals: &[f64]) -> Vec<f64> {
        let expected = |row: [f64; WIDTH]| self.standard(&row).iter().zip(self.coefficients).map(|(x, c)| x * c).sum();
        features(view, baselines, pixel_residuals).map(expected).collect()
    }
}

fn color_error(found: DVec3, truth: DVec3) -> f64 {
    found.distance(truth).max(LEAST).log10()
}

/// Features of the pixels of a view, the last of them one.
fn features<'a>(
    view: &'a EvaluatedView,
    [entropy, transparency, count, coverage, views, _]: &'a [Vec<f64>; 6],
    pixel_residuals: &'a [f64],
) -> impl Iterator<Item = [f64; WIDTH]> + 'a {
    let log10 = |value: f64| value.max(1e-12).log10();
    let rays = |value: f64| (1.0 - value).log10();
    view.pixels.iter().zip(pixel_residuals).enumerate().map(move |(k, (&i, &residuals))| {
        let variance = log10(view.rendered.pixels[i].depth_variance);
        [variance, entropy[k], transparency[k], rays(count[k]), rays(coverage[k]), views[k], log10(residuals), 1.0]
    })
}
