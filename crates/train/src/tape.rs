//! The samples of some rays on their way through the networks and back.

use glam::Vec3;

use super::loss::{RaySample, SampleGradient};
use super::march::Walk;
use super::occupancy::OccupancyGrid;
use octobayes_models::hash_grid::{
    BLOCK, Backward, Forward, N_COLOR, N_GEOMETRY, N_NEURONS, N_VIEW, Network, Parameters, Space, Transposed, WIDTH,
    backward_pass, color_pass, density_derivative, density_pass, view_gradient_pass, view_pass,
};

/// Samples taken per ray between two checks of its transmittance.
const ROUND: usize = 8;
/// Rays end when their transmittance falls below this.
const OPAQUE: f32 = 1e-4;

/// Activations of all samples, in the order in which they were taken.
#[derive(Default)]
pub struct Tape {
    /// Index of the ray of each sample.
    pub owner: Vec<u32>,
    /// Positions in the unit cube.
    pub u: Vec<[f32; 3]>,
    delta: Vec<f32>,
    s: Vec<f32>,
    f: Vec<[f32; WIDTH]>,
    a: Vec<[f32; N_NEURONS]>,
    g: Vec<[f32; N_GEOMETRY]>,
    sigma: Vec<f32>,
    b: Vec<[f32; N_NEURONS]>,
    color: Vec<[f32; N_COLOR]>,
}

impl Tape {
    /// Samples rays whose directions have the harmonics `sh` (`[rays]`), each until it ends or is opaque.
    ///
    /// `window` multiplies the density at a position. It is folded into the interval, because only their product counts
    /// in compositing. The loss of distortion, which uses the interval alone, needs a window of 1.
    pub fn record(
        space: &Space,
        occupancy: &OccupancyGrid,
        parameters: &Parameters,
        walks: &mut [Walk],
        sh: &[[f32; N_VIEW]],
        window: impl Fn([f32; 3]) -> f32,
    ) -> Self {
        let unit_length = space.unit_length();
        let mut v = vec![[0.0; N_NEURONS]; walks.len()];
        view_pass(&parameters.network, sh, &mut v);
        let mut tape = Self::default();
        let mut optical_depth = vec![0.0_f32; walks.len()];
        let limit = -OPAQUE.ln();
        loop {
            let start = tape.u.len();
            for (owner, walk) in walks.iter_mut().enumerate() {
                if optical_depth[owner] > limit {
                    continue;
                }
                for _ in 0..ROUND {
                    let Some(sample) = walk.next(space, occupancy) else { break };
                    tape.owner.push(owner as u32);
                    tape.delta.push((sample.delta / unit_length) as f32 * window(sample.u));
                    tape.s.push((sample.t / unit_length) as f32);
                    tape.u.push(sample.u);
                    tape.b.push(v[owner]);
                }
            }
            let end = tape.u.len();
            if end == start {
                return tape;
            }
            tape.f.resize(end, [0.0; WIDTH]);
            tape.a.resize(end, [0.0; N_NEURONS]);
            tape.g.resize(end, [0.0; N_GEOMETRY]);
            tape.sigma.resize(end, 0.0);
            tape.color.resize(end, [0.0; N_COLOR]);
            let (f, a, g) = (&mut tape.f[start..], &mut tape.a[start..], &mut tape.g[start..]);
            density_pass(parameters, &tape.u[start..], f, a, g, &mut tape.sigma[start..]);
            color_pass(&parameters.network, g, &mut tape.b[start..], &mut tape.color[start..]);
            for i in start..end {
                optical_depth[tape.owner[i] as usize] += tape.sigma[i] * tape.delta[i];
            }
        }
    }

    /// Number of samples.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "nobody needs it")]
    pub fn len(&self) -> usize {
        self.u.len()
    }

    /// Sample `i` as the loss sees it.
    #[must_use]
    pub fn sample(&self, i: usize) -> RaySample {
        let [r, g, b, _] = self.color[i];
        RaySample { sigma: self.sigma[i], color: Vec3::new(r, g, b), delta: self.delta[i], s: self.s[i] }
    }

    /// Derivatives of a function by the networks' weights and by the features of the samples (`[samples]`), from those
    /// by density and colour of the samples (`[samples]`) and the harmonics of the rays (`[rays]`).
    #[must_use]
    pub fn backpropagate(
        &self,
        transposed: &Transposed,
        gradients: &[SampleGradient],
        sh: &[[f32; N_VIEW]],
    ) -> (Box<Network>, Vec<[f32; WIDTH]>) {
        let n = self.len();
        let mut weights = Box::new(Network::zero());
        let mut features = vec![[0.0; WIDTH]; n];
        let (mut d_a, mut d_b) = ([[0.0; N_NEURONS]; BLOCK], [[0.0; N_NEURONS]; BLOCK]);
        let (mut d_g, mut d_c) = ([[0.0; N_GEOMETRY]; BLOCK], [[0.0; N_COLOR]; BLOCK]);
        let mut d_v = vec![[0.0; N_NEURONS]; sh.len()];
        for start in (0..n).step_by(BLOCK) {
            let end = (start + BLOCK).min(n);
            let m = end - start;
            for (i, p) in (start..end).zip(0..m) {
                d_g[p] = [0.0; N_GEOMETRY];
                d_g[p][0] = gradients[i].sigma * density_derivative(self.g[i][0], self.sigma[i]);
                for ((d_c, d_color), c) in d_c[p].iter_mut().zip(gradients[i].color.to_array()).zip(self.color[i]) {
                    // The derivative of the sigmoid.
                    *d_c = d_color * c * (1.0 - c);
                }
            }
            let forward = Forward {
                f: &self.f[start..end],
                a: &self.a[start..end],
                g: &self.g[start..end],
                b: &self.b[start..end],
            };
            let mut back = Backward {
                f: &mut features[start..end],
                a: &mut d_a[..m],
                g: &mut d_g[..m],
                b: &mut d_b[..m],
                c: &d_c[..m],
            };
            backward_pass(transposed, forward, &mut back, Some(&mut weights));
            for (&owner, d_b) in self.owner[start..end].iter().zip(&d_b) {
                for (sum, d) in d_v[owner as usize].iter_mut().zip(d_b) {
                    *sum += d;
                }
            }
        }
        view_gradient_pass(&mut weights, sh, &d_v);
        (weights, features)
    }
}
