//! FisherRF (Jiang, Lei, Daniilidis, ECCV 2024) on the parameters of a hash grid: the diagonal of the Gauss-Newton
//! matrix H = Σ over pixels and colour channels of (∂C/∂θ)².

use std::ops::Range;

use crate::pixel_gradient::{PixelGradient, PixelGradients};

/// λ of the authors' program.
pub const LAMBDA: f64 = 1e-6;
/// The outputs of a pixel that its image constrains.
pub const COLOR: Range<usize> = 0..3;

/// The diagonal of H without λ.
#[derive(Clone)]
pub struct Diagonal {
    /// `[entries][features]`.
    pub entries: Vec<[f64; 4]>,
    pub weights: Vec<f64>,
}

impl Diagonal {
    /// Without any pixel.
    #[must_use]
    pub fn new(pixels: &PixelGradients) -> Self {
        Self { entries: vec![[0.0; 4]; pixels.entries()], weights: vec![0.0; PixelGradients::weights()] }
    }

    /// Adds a pixel that stands for `share` of them.
    pub fn add(&mut self, pixel: &PixelGradient, share: f64) {
        for (entry, derivatives) in &pixel.entries {
            for derivatives in &derivatives[COLOR] {
                for (sum, d) in self.entries[*entry as usize].iter_mut().zip(derivatives) {
                    *sum += share * f64::from(*d).powi(2);
                }
            }
        }
        for derivatives in &pixel.weights[COLOR] {
            for (sum, d) in self.weights.iter_mut().zip(derivatives) {
                *sum += share * f64::from(*d).powi(2);
            }
        }
    }

    /// Σ d² / (H + λ) of one output.
    #[must_use]
    pub fn variance(&self, pixel: &PixelGradient, output: usize, lambda: f64) -> f64 {
        let term = |(sum, d): (&f64, &f32)| f64::from(*d).powi(2) / (sum + lambda);
        let of_entry = |(entry, derivatives): &(u32, [[f32; 4]; PixelGradient::OUTPUTS])| -> f64 {
            self.entries[*entry as usize].iter().zip(&derivatives[output]).map(term).sum()
        };
        let of_weights: f64 = self.weights.iter().zip(&pixel.weights[output]).map(term).sum();
        pixel.entries.iter().map(of_entry).sum::<f64>() + of_weights
    }
}
