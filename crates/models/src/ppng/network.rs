//! The two tiny networks that follow the features.
//!
//! Letters: `h` the density network's 16 outputs (h₀ is log σ), `sh` 16 real spherical harmonics of the
//! viewing direction.
//!
//! ```text
//! features (32) -> density -> h -> σ = exp(min(h₀, 11))
//!                             h ++ sh -> color0 -> relu -> color1 -> sigmoid
//! ```
//! No layer has a bias. Weights are stored `[in, out]`: a point's outputs are lanes of one sum over its inputs.

#![allow(
    clippy::needless_range_loop,
    reason = "lanes of several fixed arrays go together; plain loops over them become vector code"
)]

use super::features::{BLOCK, JET, WIDTH};
use crate::elementary::exp;
use octobayes::field::harmonics::spherical_harmonics;

/// Outputs of both hidden layers, and the number of spherical harmonics.
pub const HIDDEN: usize = 16;
/// Outputs of the last layer; the fourth is padding.
pub const OUTPUTS: usize = 4;
/// Upper limit of log σ, as in training.
pub const LOG_DENSITY_LIMIT: f32 = 11.0;
/// Number of points whose sums are kept in registers together. Each weight is then loaded once for all of them.
const TILE: usize = 4;
/// Number of rows that are summed side by side, to hide the latency of each row's chain of additions.
const CHAINS: usize = 8;

/// Weights of the two networks.
#[derive(Debug, Clone)]
pub struct Network {
    density: [[f32; HIDDEN]; WIDTH],
    color0: [[f32; HIDDEN]; 2 * HIDDEN],
    color1: [[f32; OUTPUTS]; HIDDEN],
}

/// A layer `[IN][OUT]` from the file's 4 × 4 blocks: W[4 ob + r][4 ib + c] = a[(ib · OUT/4 + ob) · 16 + 4 r + c].
fn unblock<const IN: usize, const OUT: usize>(blocks: &[f32]) -> [[f32; OUT]; IN] {
    std::array::from_fn(|i| std::array::from_fn(|o| blocks[(i / 4 * (OUT / 4) + o / 4) * 16 + 4 * (o % 4) + i % 4]))
}

impl Network {
    /// Number of weights of each of the three layers in the file.
    pub const SIZES: [usize; 3] = [WIDTH * HIDDEN, 2 * HIDDEN * HIDDEN, HIDDEN * OUTPUTS];

    /// Builds the networks from the three layers as stored in the file, of [`Self::SIZES`] numbers.
    pub fn new([density, color0, color1]: [&[f32]; 3]) -> Self {
        Self { density: unblock(density), color0: unblock(color0), color1: unblock(color1) }
    }

    /// h of the first `count` rows, `[row][16]`. It is linear, so rows may be derivatives.
    #[inline(always)]
    pub fn hidden(&self, features: &[[f32; WIDTH]; BLOCK], count: usize, hidden: &mut [[f32; HIDDEN]; BLOCK]) {
        for first in (0..count).step_by(TILE) {
            let mut sums = [[0.0; HIDDEN]; TILE];
            for i in 0..WIDTH {
                add_input(&mut sums, &self.density[i], |p| features[first + p][i]);
            }
            hidden[first..first + TILE].copy_from_slice(&sums);
        }
    }

    /// h₀ of the first `count` rows, all that a density needs: as [`Network::hidden`] computes it, bit for bit.
    #[inline(always)]
    pub fn log_density(&self, features: &[[f32; WIDTH]; BLOCK], count: usize, hidden: &mut [[f32; HIDDEN]; BLOCK]) {
        for first in (0..count).step_by(CHAINS) {
            let mut sums = [0.0; CHAINS];
            for i in 0..WIDTH {
                for p in 0..CHAINS {
                    sums[p] = self.density[i][0].mul_add(features[first + p][i], sums[p]);
                }
            }
            for p in 0..CHAINS {
                hidden[first + p][0] = sums[p];
            }
        }
    }

    /// Fills colours, `[point][red, green, blue, padding]`, of points with outputs `hidden`.
    ///
    /// They are seen along `directions` (`[axis][point]`).
    #[inline(always)]
    pub fn color(
        &self,
        hidden: &[[f32; HIDDEN]; BLOCK],
        directions: &[[f32; BLOCK]; 3],
        count: usize,
        colors: &mut [[f32; OUTPUTS]; BLOCK],
    ) {
        let harmonics = harmonics(directions);
        for first in (0..count).step_by(TILE) {
            let mut sums = [[0.0; HIDDEN]; TILE];
            for i in 0..HIDDEN {
                add_input(&mut sums, &self.color0[i], |p| hidden[first + p][i]);
            }
            for i in 0..HIDDEN {
                add_input(&mut sums, &self.color0[HIDDEN + i], |p| harmonics[i][first + p]);
            }
            let mut outputs = [[0.0; OUTPUTS]; TILE];
            for i in 0..HIDDEN {
                // f32::max would turn NaN into 0.
                add_input(&mut outputs, &self.color1[i], |p| if sums[p][i] < 0.0 { 0.0 } else { sums[p][i] });
            }
            for p in 0..TILE {
                for k in 0..OUTPUTS {
                    colors[first + p][k] = sigmoid(outputs[p][k]);
                }
            }
        }
    }

    /// Fills colours and their derivatives from `hidden` with the same rows.
    ///
    /// The shape is `[point · JET + row][red, green, blue, padding]`.
    #[inline(always)]
    pub fn color_jets<const N: usize>(
        &self,
        hidden: &[[f32; HIDDEN]; BLOCK],
        directions: &[[f32; N]; 3],
        count: usize,
        colors: &mut [[f32; OUTPUTS]; BLOCK],
    ) {
        const { assert!(TILE == JET && N * JET == BLOCK) };
        let harmonics = harmonics(directions);
        for p in 0..count {
            let first = JET * p;
            let mut sums = [[0.0; HIDDEN]; JET];
            for i in 0..HIDDEN {
                add_input(&mut sums, &self.color0[i], |row| hidden[first + row][i]);
            }
            // The direction is fixed, so it has no derivatives.
            for i in 0..HIDDEN {
                for o in 0..HIDDEN {
                    sums[0][o] = self.color0[HIDDEN + i][o].mul_add(harmonics[i][p], sums[0][o]);
                }
            }
            for i in 0..HIDDEN {
                if sums[0][i] < 0.0 {
                    for row in &mut sums {
                        row[i] = 0.0;
                    }
                }
            }
            let mut outputs = [[0.0; OUTPUTS]; JET];
            for i in 0..HIDDEN {
                add_input(&mut outputs, &self.color1[i], |row| sums[row][i]);
            }
            for k in 0..OUTPUTS {
                let color = sigmoid(outputs[0][k]);
                colors[first][k] = color;
                for row in 1..JET {
                    colors[first + row][k] = color * (1.0 - color) * outputs[row][k];
                }
            }
        }
    }
}

/// Spherical harmonics of N directions, `[harmonic][point]`.
#[inline(always)]
fn harmonics<const N: usize>(directions: &[[f32; N]; 3]) -> [[f32; N]; HIDDEN] {
    let mut harmonics = [[0.0; N]; HIDDEN];
    for p in 0..N {
        let values = spherical_harmonics(directions[0][p], directions[1][p], directions[2][p]);
        for k in 0..HIDDEN {
            harmonics[k][p] = values[k];
        }
    }
    harmonics
}

#[inline(always)]
fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// Adds one input of [`TILE`] points to their outputs.
#[inline(always)]
fn add_input<const OUT: usize>(sums: &mut [[f32; OUT]; TILE], weights: &[f32; OUT], input: impl Fn(usize) -> f32) {
    for p in 0..TILE {
        let x = input(p);
        for o in 0..OUT {
            sums[p][o] = weights[o].mul_add(x, sums[p][o]);
        }
    }
}

/// σ from h₀; NaN stays NaN.
#[inline(always)]
pub fn density(h0: f32) -> f32 {
    exp(if h0 > LOG_DENSITY_LIMIT { LOG_DENSITY_LIMIT } else { h0 })
}

/// dσ/dh₀ from σ and h₀.
#[inline(always)]
pub fn density_slope(density: f32, h0: f32) -> f32 {
    if h0 > LOG_DENSITY_LIMIT { 0.0 } else { density }
}
