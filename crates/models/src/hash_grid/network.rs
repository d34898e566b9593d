//! The two tiny networks that follow the features, and their derivatives.
//!
//! Letters: `f` features (32), `a` and `b` hidden layers, `g` outputs of the density network (g₀ = log σ),
//! `v` the viewing direction's contribution to b, `c` colour before the sigmoid; `d_x` the derivative of a
//! scalar with respect to x. Layers have no bias.
//!
//! ```text
//! f -> density0 -> a = relu -> density1 -> g -> σ = exp(min(g₀, 15))
//!                                          g -> color_geometry -> + v -> b = relu -> color1 -> c -> sigmoid
//!                      spherical harmonics -> color_view ----------^
//! ```
//! Weights are `[in, out]`. v depends on the ray alone, so it is an input here, computed once per ray.

#![allow(
    clippy::needless_range_loop,
    reason = "lanes of several fixed arrays go together; plain loops over them become vector code"
)]

use std::ops::AddAssign;

use super::config::{N_GEOMETRY, N_NEURONS};
use super::encoding::WIDTH;
use crate::elementary::exp;

/// Number of spherical harmonics.
pub const N_VIEW: usize = 16;
/// Outputs of the last layer; the fourth is padding.
pub const N_COLOR: usize = 4;
/// Upper limit of log σ, as in instant-ngp.
const LOG_DENSITY_LIMIT: f32 = 15.0;
/// Number of points whose sums are kept in registers together.
const TILE: usize = 4;
/// Number of outputs whose sums are kept in registers together.
const LANES: usize = 16;

/// Weights, their derivatives, or anything else with one number per weight.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    pub density0: [[f32; N_NEURONS]; WIDTH],
    pub density1: [[f32; N_GEOMETRY]; N_NEURONS],
    pub color_geometry: [[f32; N_NEURONS]; N_GEOMETRY],
    pub color_view: [[f32; N_NEURONS]; N_VIEW],
    pub color1: [[f32; N_COLOR]; N_NEURONS],
}

/// Name of each layer in files, with its inputs and outputs.
pub const LAYERS: [(&str, [usize; 2]); 5] = [
    ("density0", [WIDTH, N_NEURONS]),
    ("density1", [N_NEURONS, N_GEOMETRY]),
    ("color_geometry", [N_GEOMETRY, N_NEURONS]),
    ("color_view", [N_VIEW, N_NEURONS]),
    ("color1", [N_NEURONS, N_COLOR]),
];

impl Network {
    /// All zero.
    #[must_use]
    pub const fn zero() -> Self {
        Self {
            density0: [[0.0; N_NEURONS]; WIDTH],
            density1: [[0.0; N_GEOMETRY]; N_NEURONS],
            color_geometry: [[0.0; N_NEURONS]; N_GEOMETRY],
            color_view: [[0.0; N_NEURONS]; N_VIEW],
            color1: [[0.0; N_COLOR]; N_NEURONS],
        }
    }

    /// The layers in the order of [`LAYERS`].
    #[must_use]
    pub fn layers(&self) -> [&[f32]; 5] {
        [
            self.density0.as_flattened(),
            self.density1.as_flattened(),
            self.color_geometry.as_flattened(),
            self.color_view.as_flattened(),
            self.color1.as_flattened(),
        ]
    }

    /// [`Network::layers`], mutable.
    pub fn layers_mut(&mut self) -> [&mut [f32]; 5] {
        [
            self.density0.as_flattened_mut(),
            self.density1.as_flattened_mut(),
            self.color_geometry.as_flattened_mut(),
            self.color_view.as_flattened_mut(),
            self.color1.as_flattened_mut(),
        ]
    }

    /// Zeroes the padding, which nothing reads.
    pub fn clear_padding(&mut self) {
        for row in &mut self.color1 {
            row[N_COLOR - 1] = 0.0;
        }
    }

    /// a and g of points with features `f`.
    #[inline(always)]
    pub fn density(&self, f: &[[f32; WIDTH]], a: &mut [[f32; N_NEURONS]], g: &mut [[f32; N_GEOMETRY]]) {
        a.fill([0.0; N_NEURONS]);
        add_product(&self.density0, f, a);
        relu(a);
        g.fill([0.0; N_GEOMETRY]);
        add_product(&self.density1, a, g);
    }

    /// v of directions with harmonics `sh`.
    #[inline(always)]
    pub fn view(&self, sh: &[[f32; N_VIEW]], v: &mut [[f32; N_NEURONS]]) {
        v.fill([0.0; N_NEURONS]);
        add_product(&self.color_view, sh, v);
    }

    /// Colours. `b` holds v before and b after.
    #[inline(always)]
    pub fn color(&self, g: &[[f32; N_GEOMETRY]], b: &mut [[f32; N_NEURONS]], color: &mut [[f32; N_COLOR]]) {
        add_product(&self.color_geometry, g, b);
        relu(b);
        color.fill([0.0; N_COLOR]);
        add_narrow_product(&self.color1, b, color);
        for color in color.iter_mut() {
            for k in 0..N_COLOR {
                color[k] = 1.0 / (1.0 + exp(-color[k]));
            }
        }
    }
}

/// σ from g₀; NaN stays NaN.
#[inline(always)]
pub fn density(g0: f32) -> f32 {
    exp(if g0 > LOG_DENSITY_LIMIT { LOG_DENSITY_LIMIT } else { g0 })
}

/// dσ/dg₀ where the density is σ; 0 beyond the limit, where the density is constant.
#[must_use]
pub fn density_derivative(g0: f32, sigma: f32) -> f32 {
    if g0 > LOG_DENSITY_LIMIT { 0.0 } else { sigma }
}

impl AddAssign<&Self> for Network {
    /// Adds the numbers of `other` to those of `self`.
    fn add_assign(&mut self, other: &Self) {
        for (sum, other) in self.layers_mut().into_iter().zip(other.layers()) {
            for (sum, other) in sum.iter_mut().zip(other) {
                *sum += other;
            }
        }
    }
}

/// The transposed weights, which take derivatives backwards through the layers.
#[derive(Debug, Clone)]
pub struct Transposed {
    density0: [[f32; WIDTH]; N_NEURONS],
    density1: [[f32; N_NEURONS]; N_GEOMETRY],
    color_geometry: [[f32; N_GEOMETRY]; N_NEURONS],
    color1: [[f32; N_NEURONS]; N_COLOR],
}

/// Activations of a block of points from the forward pass, as backpropagation needs them.
#[derive(Clone, Copy)]
pub struct Forward<'a> {
    pub f: &'a [[f32; WIDTH]],
    pub a: &'a [[f32; N_NEURONS]],
    pub g: &'a [[f32; N_GEOMETRY]],
    pub b: &'a [[f32; N_NEURONS]],
}

/// Derivatives with respect to activations. `g` and `c` come in with the derivatives of the loss by g₀ and c;
/// the rest is filled.
pub struct Backward<'a> {
    pub f: &'a mut [[f32; WIDTH]],
    pub a: &'a mut [[f32; N_NEURONS]],
    pub g: &'a mut [[f32; N_GEOMETRY]],
    /// This is also the derivative with respect to v.
    pub b: &'a mut [[f32; N_NEURONS]],
    pub c: &'a [[f32; N_COLOR]],
}

impl Transposed {
    #[must_use]
    pub fn new(network: &Network) -> Self {
        Self {
            density0: transpose(&network.density0),
            density1: transpose(&network.density1),
            color_geometry: transpose(&network.color_geometry),
            color1: transpose(&network.color1),
        }
    }

    /// Fills d_b, d_a and d_f, and adds to the d_g that is there.
    #[inline(always)]
    pub fn backpropagate(&self, forward: Forward, back: &mut Backward) {
        back.b.fill([0.0; N_NEURONS]);
        add_product(&self.color1, back.c, back.b);
        relu_derivative(forward.b, back.b);
        add_product(&self.color_geometry, back.b, back.g);
        self.backpropagate_density(forward.a, back.g, back.a, back.f);
    }

    /// The density network's part: fills d_a and d_f.
    #[inline(always)]
    pub fn backpropagate_density(
        &self,
        a: &[[f32; N_NEURONS]],
        d_g: &[[f32; N_GEOMETRY]],
        d_a: &mut [[f32; N_NEURONS]],
        d_f: &mut [[f32; WIDTH]],
    ) {
        d_a.fill([0.0; N_NEURONS]);
        add_product(&self.density1, d_g, d_a);
        relu_derivative(a, d_a);
        d_f.fill([0.0; WIDTH]);
        add_product(&self.density0, d_a, d_f);
    }
}

impl Network {
    /// Adds the derivatives by the weights, except those of `color_view`, after
    /// [`Transposed::backpropagate`].
    #[inline(always)]
    pub fn add_gradient(&mut self, forward: Forward, back: &Backward) {
        add_outer(forward.f, back.a, &mut self.density0);
        add_outer(forward.a, back.g, &mut self.density1);
        add_outer(forward.g, back.b, &mut self.color_geometry);
        add_narrow_outer(forward.b, back.c, &mut self.color1);
    }

    /// Adds the derivatives by `color_view`, from the harmonics of rays and d_v summed over each ray's samples.
    #[inline(always)]
    pub fn add_view_gradient(&mut self, sh: &[[f32; N_VIEW]], d_v: &[[f32; N_NEURONS]]) {
        add_outer(sh, d_v, &mut self.color_view);
    }
}

fn transpose<const IN: usize, const OUT: usize>(weights: &[[f32; OUT]; IN]) -> [[f32; IN]; OUT] {
    std::array::from_fn(|o| std::array::from_fn(|i| weights[i][o]))
}

#[inline(always)]
fn relu<const N: usize>(x: &mut [[f32; N]]) {
    for x in x.as_flattened_mut() {
        // f32::max would turn NaN into 0.
        *x = if *x < 0.0 { 0.0 } else { *x };
    }
}

#[inline(always)]
fn relu_derivative<const N: usize>(y: &[[f32; N]], d: &mut [[f32; N]]) {
    for (y, d) in y.as_flattened().iter().zip(d.as_flattened_mut()) {
        *d = if *y > 0.0 { *d } else { 0.0 };
    }
}

/// outputs += inputs · weights for every point, [`LANES`] outputs at a time.
#[inline(always)]
fn add_product<const IN: usize, const OUT: usize>(
    weights: &[[f32; OUT]; IN],
    inputs: &[[f32; IN]],
    outputs: &mut [[f32; OUT]],
) {
    let (tiles, rest) = inputs.as_chunks::<TILE>();
    let (out_tiles, out_rest) = outputs.as_chunks_mut::<TILE>();
    for (inputs, outputs) in tiles.iter().zip(out_tiles) {
        add_tile(weights, inputs, outputs);
    }
    for (input, output) in rest.iter().zip(out_rest) {
        add_tile(weights, &[*input; 1], std::array::from_mut(output));
    }
}

#[inline(always)]
fn add_tile<const IN: usize, const OUT: usize, const P: usize>(
    weights: &[[f32; OUT]; IN],
    inputs: &[[f32; IN]; P],
    outputs: &mut [[f32; OUT]; P],
) {
    for block in 0..OUT / LANES {
        let mut sums = [[0.0; LANES]; P];
        for p in 0..P {
            sums[p] = outputs[p].as_chunks::<LANES>().0[block];
        }
        for i in 0..IN {
            let row = &weights[i].as_chunks::<LANES>().0[block];
            for p in 0..P {
                for o in 0..LANES {
                    sums[p][o] = row[o].mul_add(inputs[p][i], sums[p][o]);
                }
            }
        }
        for p in 0..P {
            outputs[p].as_chunks_mut::<LANES>().0[block] = sums[p];
        }
    }
}

/// [`add_product`] for a layer of four outputs.
#[inline(always)]
fn add_narrow_product<const IN: usize>(
    weights: &[[f32; N_COLOR]; IN],
    inputs: &[[f32; IN]],
    outputs: &mut [[f32; N_COLOR]],
) {
    for (input, output) in inputs.iter().zip(outputs) {
        // Two alternating sums: a single one would wait for itself.
        let mut sums = [[0.0; N_COLOR]; 2];
        for i in 0..IN / 2 {
            for half in 0..2 {
                for o in 0..N_COLOR {
                    sums[half][o] = weights[2 * i + half][o].mul_add(input[2 * i + half], sums[half][o]);
                }
            }
        }
        for o in 0..N_COLOR {
            output[o] += sums[0][o] + sums[1][o];
        }
    }
}

/// gradient += Σ over points of input · outputᵀ.
#[inline(always)]
fn add_outer<const IN: usize, const OUT: usize>(
    inputs: &[[f32; IN]],
    outputs: &[[f32; OUT]],
    gradient: &mut [[f32; OUT]; IN],
) {
    for (rows, gradient) in gradient.as_chunks_mut::<TILE>().0.iter_mut().enumerate() {
        for block in 0..OUT / LANES {
            let mut sums = [[0.0; LANES]; TILE];
            for (input, output) in inputs.iter().zip(outputs) {
                let x = &input.as_chunks::<TILE>().0[rows];
                let y = &output.as_chunks::<LANES>().0[block];
                for r in 0..TILE {
                    for o in 0..LANES {
                        sums[r][o] = y[o].mul_add(x[r], sums[r][o]);
                    }
                }
            }
            for r in 0..TILE {
                let row = &mut gradient[r].as_chunks_mut::<LANES>().0[block];
                for o in 0..LANES {
                    row[o] += sums[r][o];
                }
            }
        }
    }
}

/// [`add_outer`] for a layer of four outputs.
#[inline(always)]
fn add_narrow_outer<const IN: usize>(
    inputs: &[[f32; IN]],
    outputs: &[[f32; N_COLOR]],
    gradient: &mut [[f32; N_COLOR]; IN],
) {
    for (rows, gradient) in gradient.as_chunks_mut::<{ 2 * TILE }>().0.iter_mut().enumerate() {
        let mut sums = [[0.0; N_COLOR]; 2 * TILE];
        for (input, y) in inputs.iter().zip(outputs) {
            let x = &input.as_chunks::<{ 2 * TILE }>().0[rows];
            for r in 0..2 * TILE {
                for o in 0..N_COLOR {
                    sums[r][o] = y[o].mul_add(x[r], sums[r][o]);
                }
            }
        }
        for r in 0..2 * TILE {
            for o in 0..N_COLOR {
                gradient[r][o] += sums[r][o];
            }
        }
    }
}
