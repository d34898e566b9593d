//! Derivatives by position: back through the networks to the features, then through the slopes of the features.
//!
//! Letters: `f` features, `slopes` ∂f/∂u, `d_f` derivatives of a function by f, w window, σ̂ density of the
//! network, s density scale. ∇σ = s (σ̂ ∇w + w ∇σ̂), with the chain rule through Φ.

use glam::{Mat3, Vec3};
use multiversion::multiversion;

use super::network::density_derivative;
use super::{
    BLOCK, Backward, Buffers, Encoding, Forward, HashGrid, N_COLOR, N_GEOMETRY, N_NEURONS, Transposed, WIDTH,
    backward_pass,
};
use octobayes::field::{Differentiable, RadianceJet};

/// Number of partial sums of a scalar product.
const LANES: usize = 16;

/// Fills ∂f/∂u, `[n][axis]`.
#[multiversion(targets("x86_64+avx2+fma"))]
fn slope_pass(encoding: &Encoding, u: &[[f32; 3]], slopes: &mut [[[f32; WIDTH]; 3]]) {
    encoding.slopes(u, slopes);
}

/// Fills the derivatives by u of the function that has derivatives `d_f` by the features.
#[multiversion(targets("x86_64+avx2+fma"))]
fn chain_pass(slopes: &[[[f32; WIDTH]; 3]], d_f: &[[f32; WIDTH]], out: &mut [Vec3]) {
    for ((slopes, d_f), out) in slopes.iter().zip(d_f).zip(out) {
        for (axis, slope) in slopes.iter().enumerate() {
            let mut sums = [0.0_f32; LANES];
            for (slope, d) in slope.as_chunks::<LANES>().0.iter().zip(d_f.as_chunks::<LANES>().0) {
                for lane in 0..LANES {
                    sums[lane] = slope[lane].mul_add(d[lane], sums[lane]);
                }
            }
            out[axis] = sums.iter().sum();
        }
    }
}

/// Backpropagates dσ̂/dg₀ to d_f.
#[multiversion(targets("x86_64+avx2+fma"))]
fn density_backward_pass(
    transposed: &Transposed,
    a: &[[f32; N_NEURONS]],
    d_g: &[[f32; N_GEOMETRY]],
    d_a: &mut [[f32; N_NEURONS]],
    d_f: &mut [[f32; WIDTH]],
) {
    transposed.backpropagate_density(a, d_g, d_a, d_f);
}

/// Buffers for the derivatives of one block of points.
struct BackBuffers {
    transposed: Transposed,
    slopes: [[[f32; WIDTH]; 3]; BLOCK],
    d_f: [[f32; WIDTH]; BLOCK],
    d_a: [[f32; N_NEURONS]; BLOCK],
    d_g: [[f32; N_GEOMETRY]; BLOCK],
    d_b: [[f32; N_NEURONS]; BLOCK],
    d_c: [[f32; N_COLOR]; BLOCK],
    /// Gradients by u: of σ̂, then of each colour channel.
    gradients: [[Vec3; BLOCK]; 4],
}

impl BackBuffers {
    fn new(field: &HashGrid) -> Box<Self> {
        Box::new(Self {
            transposed: Transposed::new(&field.parameters.network),
            slopes: [[[0.0; WIDTH]; 3]; BLOCK],
            d_f: [[0.0; WIDTH]; BLOCK],
            d_a: [[0.0; N_NEURONS]; BLOCK],
            d_g: [[0.0; N_GEOMETRY]; BLOCK],
            d_b: [[0.0; N_NEURONS]; BLOCK],
            d_c: [[0.0; N_COLOR]; BLOCK],
            gradients: [[Vec3::ZERO; BLOCK]; 4],
        })
    }

    /// Fills the slopes of the features and the gradient of the density, after [`Buffers::density`].
    fn density(&mut self, encoding: &Encoding, forward: &Buffers, n: usize) {
        slope_pass(encoding, &forward.u[..n], &mut self.slopes[..n]);
        for p in 0..n {
            self.d_g[p] = [0.0; N_GEOMETRY];
            self.d_g[p][0] = density_derivative(forward.g[p][0], forward.sigma[p]);
        }
        let (d_g, d_a, d_f) = (&self.d_g[..n], &mut self.d_a[..n], &mut self.d_f[..n]);
        density_backward_pass(&self.transposed, &forward.a[..n], d_g, d_a, d_f);
        chain_pass(&self.slopes[..n], &self.d_f[..n], &mut self.gradients[0][..n]);
    }

    /// Fills the gradients of the colours, after [`Buffers::color`] and [`BackBuffers::density`].
    fn color(&mut self, forward: &Buffers, n: usize) {
        for channel in 0..3 {
            for p in 0..n {
                let color = forward.color[p][channel];
                self.d_g[p] = [0.0; N_GEOMETRY];
                self.d_c[p] = [0.0; N_COLOR];
                // The sigmoid's derivative.
                self.d_c[p][channel] = color * (1.0 - color);
            }
            let known = Forward { f: &forward.f[..n], a: &forward.a[..n], g: &forward.g[..n], b: &forward.b[..n] };
            let mut back = Backward {
                f: &mut self.d_f[..n],
                a: &mut self.d_a[..n],
                g: &mut self.d_g[..n],
                b: &mut self.d_b[..n],
                c: &self.d_c[..n],
            };
            backward_pass(&self.transposed, known, &mut back, None);
            chain_pass(&self.slopes[..n], &self.d_f[..n], &mut self.gradients[1 + channel][..n]);
        }
    }
}

impl HashGrid {
    /// ∇σ at `x` = Φ⁻¹(`u`), where the network gives σ̂ (`sigma`) and its gradient by u.
    fn density_gradient(&self, x: Vec3, u: [f32; 3], sigma: f32, gradient: Vec3) -> Vec3 {
        let (w, w_gradient) = self.window.at_with_gradient(Vec3::from_array(u) - 0.5);
        self.pulled_back(x, self.density_scale() * (sigma * w_gradient + w * gradient))
    }

    /// Pulls a gradient by u back to one by x.
    fn pulled_back(&self, x: Vec3, gradient: Vec3) -> Vec3 {
        self.space.domain.pull_back(x, gradient.as_dvec3()).as_vec3()
    }
}

impl Differentiable for HashGrid {
    /// Runs backwards through the networks once for density and once for each colour channel.
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        let (mut buffers, mut back) = (Buffers::new(), BackBuffers::new(self));
        let mut windows = [0.0; BLOCK];
        let parts = positions.chunks(BLOCK).zip(directions.chunks(BLOCK)).zip(out.chunks_mut(BLOCK));
        for ((positions, directions), out) in parts {
            let n = positions.len();
            for (p, &x) in positions.iter().enumerate() {
                (windows[p], buffers.u[p]) = self.place(x);
            }
            buffers.density(&self.parameters, n);
            buffers.color(&self.parameters.network, directions);
            back.density(&self.parameters.encoding, &buffers, n);
            back.color(&buffers, n);
            for (p, (out, &x)) in out.iter_mut().zip(positions).enumerate() {
                *out = RadianceJet { value: self.radiance(&buffers, windows[p], p), ..RadianceJet::default() };
                let Some(u) = self.space.unit(x) else { continue };
                out.density_gradient = self.density_gradient(x, u, buffers.sigma[p], back.gradients[0][p]);
                let channels = [1, 2, 3].map(|function: usize| self.pulled_back(x, back.gradients[function][p]));
                let axes = Mat3::from_cols(channels[0], channels[1], channels[2]).transpose();
                out.color_gradients = [axes.x_axis, axes.y_axis, axes.z_axis];
            }
        }
    }

    fn density_jets(&self, positions: &[Vec3], densities: &mut [f32], gradients: &mut [Vec3]) {
        let (mut buffers, mut back) = (Buffers::new(), BackBuffers::new(self));
        let mut windows = [0.0; BLOCK];
        let parts = positions.chunks(BLOCK).zip(densities.chunks_mut(BLOCK)).zip(gradients.chunks_mut(BLOCK));
        for ((positions, densities), gradients) in parts {
            let n = positions.len();
            for (p, &x) in positions.iter().enumerate() {
                (windows[p], buffers.u[p]) = self.place(x);
            }
            buffers.density(&self.parameters, n);
            back.density(&self.parameters.encoding, &buffers, n);
            for (p, &x) in positions.iter().enumerate() {
                let sigma = buffers.sigma[p];
                densities[p] = self.density_scale() * windows[p] * sigma;
                let gradient = |u| self.density_gradient(x, u, sigma, back.gradients[0][p]);
                gradients[p] = self.space.unit(x).map_or(Vec3::ZERO, gradient);
            }
        }
    }
}
