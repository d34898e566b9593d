//! Uncertainty from a posterior over the model's own parameters, by the Gauss-Newton matrix of the training pixels.
//!
//! H = Σ over training pixels and colour channels of (∂C/∂θ)(∂C/∂θ)ᵀ, from a sample of the pixels, plus λ. The measure
//! of a pixel is tr(J H⁻¹ Jᵀ), where J has the derivatives of its three colour channels, or that of its expected depth.
//!
//! - FisherRF (Jiang, Lei, Daniilidis, ECCV 2024): all parameters, the diagonal of H only, λ of the authors' program.
//!   They chose it for Gaussians, so depth is measured with the λ of the other method, too.
//! - Last-layer Laplace (Daxberger et al., NeurIPS 2021): the last layers of both networks, all of H. With colours of
//!   the noise that training left and a prior of variance 1 for each weight, λ is the noise's square.

use std::ops::Range;

use common::pixel_gradient::{PixelGradient, PixelGradients};
use faer::linalg::solvers::Llt;
use faer::{Mat, Side};
use glam::Vec3;
use octobayes::geometry::Camera;
use octobayes::rays::{PixelSequence, Pixels};
use octobayes::{Error, Result};
use octobayes_evaluation::{EvaluatedView, TrueView};
use octobayes_models::HashGrid;
use rayon::prelude::*;

use common::fisher::{COLOR, Diagonal, LAMBDA};

/// Training pixels in the sum, which stands for all of them.
const PIXELS: u64 = 100_000;
/// Pixels that are differentiated before they are summed.
const BATCH: usize = 250;
/// Shift of the samples of held-out rays, in steps.
const JITTER: f64 = 0.5;
/// The output that training pixels do not constrain.
const DEPTH: usize = 3;
const OUTPUTS: usize = PixelGradient::OUTPUTS;

/// Derivatives by the last layers, a column for each of these outputs of each pixel.
fn last_layers(pixels: &[PixelGradient], outputs: Range<usize>) -> Mat<f64> {
    let places: Vec<usize> = PixelGradients::last_layers().into_iter().flatten().collect();
    let n = outputs.len();
    Mat::from_fn(places.len(), n * pixels.len(), |i, column| {
        let weights = &pixels[column / n].weights[outputs.start + column % n];
        weights.get(places[i]).map_or(0.0, |d| f64::from(*d))
    })
}

/// Both posteriors over the parameters of a model.
pub struct ParameterPosteriors<'a> {
    pixels: PixelGradients<'a>,
    diagonal: Diagonal,
    last: Llt<f64>,
    /// The square of the training noise.
    lambda: f64,
}

impl<'a> ParameterPosteriors<'a> {
    /// Names of the measures, in the order of [`ParameterPosteriors::of`].
    pub const NAMES: [&'static str; 5] = [
        "FisherRF (parameters)",
        "FisherRF (parameters), depth",
        "FisherRF (parameters), depth, λ of the noise",
        "last-layer Laplace",
        "last-layer Laplace, depth",
    ];

    /// Sums over pixels of the training cameras. `noise` is that of colours from 0 to 1.
    pub fn fit(field: &'a HashGrid, cameras: &[Camera], pixel_offset: f64, noise: f64) -> Result<Self> {
        let pixels = PixelGradients::new(field, Vec3::ONE);
        let all: u64 = cameras.iter().map(Camera::pixels).sum();
        let share = all as f64 / PIXELS as f64;
        let sequence = PixelSequence::new(Pixels::Sobol, 0, cameras.iter().map(|camera| camera.resolution).collect());
        let mut diagonal = Diagonal::new(&pixels);
        let width = PixelGradients::last_layers().map(|layer| layer.len()).iter().sum();
        let mut precision = Mat::<f64>::zeros(width, width);
        for picks in sequence.picks(0, PIXELS).chunks(BATCH) {
            let differentiated = picks.par_iter().map(|pick| {
                let [x, y] = pick.pixel.map(|i| f64::from(i) + pixel_offset);
                pixels.of(&cameras[pick.camera].ray(x, y), pick.jitter)
            });
            // In the order of the picks, so that sums do not depend on threads.
            let mut found: Vec<PixelGradient> = differentiated.collect();
            found.retain(|pixel| !pixel.entries.is_empty());
            found.iter().for_each(|pixel| diagonal.add(pixel, share));
            let columns = last_layers(&found, COLOR);
            precision += faer::Scale(share) * (&columns * columns.transpose());
        }
        let lambda = noise.powi(2);
        for i in 0..width {
            precision[(i, i)] += lambda;
        }
        let last = precision
            .llt(Side::Lower)
            .map_err(|_| Error::setting("noise", "one that keeps H positive definite", noise.to_string()))?;
        Ok(Self { pixels, diagonal, last, lambda })
    }

    /// The measures of the pixels of a held-out view.
    pub fn of(&self, truth: &TrueView, view: &EvaluatedView) -> [Vec<f64>; 5] {
        let width = truth.camera.resolution[0] as usize;
        let mut measures: [Vec<f64>; 5] = Default::default();
        for pixels in view.pixels.chunks(BATCH) {
            let differentiated = pixels.par_iter().map(|i| {
                let [x, y] = [i % width, i / width].map(|n| n as f64 + truth.pixel_offset);
                self.pixels.of(&truth.camera.ray(x, y), JITTER)
            });
            let found: Vec<PixelGradient> = differentiated.collect();
            for pixel in &found {
                let variance = |output, lambda| self.diagonal.variance(pixel, output, lambda);
                measures[0].push(COLOR.map(|output| variance(output, LAMBDA)).sum());
                measures[1].push(variance(DEPTH, LAMBDA));
                measures[2].push(variance(DEPTH, self.lambda));
            }
            // tr(J H⁻¹ Jᵀ) is the sum of squares of L⁻¹ Jᵀ with H = L Lᵀ.
            let mut columns = last_layers(&found, 0..OUTPUTS);
            self.last.L().solve_lower_triangular_in_place(columns.as_mut());
            let variance = |column: usize| columns.col_as_slice(column).iter().map(|v| v * v).sum::<f64>();
            for p in 0..found.len() {
                measures[3].push(COLOR.map(|output| variance(OUTPUTS * p + output)).sum());
                measures[4].push(variance(OUTPUTS * p + DEPTH));
            }
        }
        measures
    }
}
