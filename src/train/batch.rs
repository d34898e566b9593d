//! The rays of one step: forward pass, loss, backward pass. Groups of rays are independent, so the sums do not
//! depend on the number of threads.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::loss::{RaySample, SampleGradient, ray_loss};
use super::march::Walk;
use super::occupancy::OccupancyGrid;
use super::{Background, Shot};
use crate::field::hash_grid::{
    BLOCK, Backward, Forward, N_COLOR, N_GEOMETRY, N_NEURONS, N_VIEW, Network, Parameters, Space, Transposed, WIDTH,
    backward_pass, color_pass, density_derivative, density_pass, harmonics, view_gradient_pass, view_pass,
};
use crate::geometry::Ray;
use crate::rays::PixelSequence;

/// Rays that go through the networks together. The sum over a group is one summand of the step.
pub const GROUP: u64 = 32;
/// Samples taken per ray between two checks of its transmittance.
const ROUND: usize = 8;
/// Rays end when their transmittance falls below this.
const OPAQUE: f32 = 1e-4;

/// Everything that does not change during a step.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    pub shots: &'a [Shot],
    pub pixels: &'a PixelSequence,
    pub space: &'a Space,
    pub occupancy: &'a OccupancyGrid,
    pub parameters: &'a Parameters,
    pub transposed: &'a Transposed,
    pub background: Background,
    pub distortion: f32,
    pub seed: u64,
}

/// Gradient and loss, summed over a group of rays.
pub struct GroupGradient {
    pub weights: Box<Network>,
    /// Positions in the unit cube, `[samples]`.
    pub u: Vec<[f32; 3]>,
    /// Derivatives of the loss with respect to the features at these positions, `[samples]`.
    pub features: Vec<[f32; WIDTH]>,
    pub loss: f64,
    pub squared_error: f64,
}

/// Activations of all samples, in the order in which they were taken.
#[derive(Default)]
struct Tape {
    owner: Vec<u32>,
    delta: Vec<f32>,
    s: Vec<f32>,
    u: Vec<[f32; 3]>,
    f: Vec<[f32; WIDTH]>,
    a: Vec<[f32; N_NEURONS]>,
    g: Vec<[f32; N_GEOMETRY]>,
    sigma: Vec<f32>,
    b: Vec<[f32; N_NEURONS]>,
    color: Vec<[f32; N_COLOR]>,
}

/// True colour of a ray, and the background that it was composited over.
struct Target {
    color: Vec3,
    background: Vec3,
}

/// Computes the gradient of the rays `first..first + count`.
pub fn group(scene: &Scene, first: u64, count: u64) -> GroupGradient {
    let unit_length = scene.space.unit_length();
    let mut rng = ChaCha8Rng::seed_from_u64(scene.seed ^ 0xbac6);
    rng.set_stream(first);
    let mut targets = Vec::new();
    let mut rays = Vec::new();
    let mut walks = Vec::new();
    for pick in scene.pixels.picks(first, count) {
        let shot = &scene.shots[pick.camera];
        let [x, y] = pick.pixel;
        let ray = shot.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let background = match scene.background {
            Background::Random => Vec3::from_array(std::array::from_fn(|_| rng.random())),
            Background::Fixed(color) => Vec3::from_array(color),
        };
        let pixel = (y * shot.camera.resolution[0] + x) as usize;
        let color = shot.image.over(pixel, background.as_dvec3()).as_vec3();
        targets.push(Target { color, background });
        rays.push(ray);
        walks.push(Walk::new(scene.space, ray, pick.jitter));
    }
    let sh: Vec<[f32; N_VIEW]> = rays.iter().map(|ray: &Ray| harmonics(ray.direction.as_vec3())).collect();
    let mut v = vec![[0.0; N_NEURONS]; rays.len()];
    view_pass(&scene.parameters.network, &sh, &mut v);

    let mut tape = Tape::default();
    let mut optical_depth = vec![0.0_f32; rays.len()];
    let limit = -OPAQUE.ln();
    loop {
        let start = tape.u.len();
        for (owner, walk) in walks.iter_mut().enumerate() {
            if optical_depth[owner] > limit {
                continue;
            }
            for _ in 0..ROUND {
                let Some(sample) = walk.next(scene.space, scene.occupancy) else { break };
                tape.owner.push(owner as u32);
                tape.delta.push((sample.delta / unit_length) as f32);
                tape.s.push((sample.t / unit_length) as f32);
                tape.u.push(sample.u);
                tape.b.push(v[owner]);
            }
        }
        let end = tape.u.len();
        if end == start {
            break;
        }
        tape.f.resize(end, [0.0; WIDTH]);
        tape.a.resize(end, [0.0; N_NEURONS]);
        tape.g.resize(end, [0.0; N_GEOMETRY]);
        tape.sigma.resize(end, 0.0);
        tape.color.resize(end, [0.0; N_COLOR]);
        let (f, a, g) = (&mut tape.f[start..], &mut tape.a[start..], &mut tape.g[start..]);
        density_pass(scene.parameters, &tape.u[start..], f, a, g, &mut tape.sigma[start..]);
        color_pass(&scene.parameters.network, g, &mut tape.b[start..], &mut tape.color[start..]);
        for i in start..end {
            optical_depth[tape.owner[i] as usize] += tape.sigma[i] * tape.delta[i];
        }
    }
    backward(scene, tape, &targets, &sh)
}

/// Losses of all rays, and their derivatives with respect to weights and features.
fn backward(scene: &Scene, tape: Tape, targets: &[Target], sh: &[[f32; N_VIEW]]) -> GroupGradient {
    let n = tape.u.len();
    // Samples by ray, in order along it.
    let mut of_ray = vec![Vec::new(); targets.len()];
    for (i, &owner) in tape.owner.iter().enumerate() {
        of_ray[owner as usize].push(i);
    }
    let mut d_g = vec![[0.0; N_GEOMETRY]; n];
    let mut d_c = vec![[0.0; N_COLOR]; n];
    let (mut loss, mut squared_error) = (0.0, 0.0);
    let (mut samples, mut gradients) = (Vec::new(), Vec::<SampleGradient>::new());
    for (target, of_ray) in targets.iter().zip(&of_ray) {
        samples.clear();
        samples.extend(of_ray.iter().map(|&i| {
            let [r, g, b, _] = tape.color[i];
            RaySample { sigma: tape.sigma[i], color: Vec3::new(r, g, b), delta: tape.delta[i], s: tape.s[i] }
        }));
        let ray = ray_loss(&samples, target.color, target.background, scene.distortion, &mut gradients);
        loss += ray.loss;
        squared_error += ray.squared_error;
        for (&i, gradient) in of_ray.iter().zip(&gradients) {
            d_g[i][0] = gradient.sigma * density_derivative(tape.g[i][0], tape.sigma[i]);
            for ((d_c, d_color), c) in d_c[i].iter_mut().zip(gradient.color.to_array()).zip(tape.color[i]) {
                // The derivative of the sigmoid.
                *d_c = d_color * c * (1.0 - c);
            }
        }
    }

    let mut weights = Box::new(Network::zero());
    let mut features = vec![[0.0; WIDTH]; n];
    let (mut d_a, mut d_b) = ([[0.0; N_NEURONS]; BLOCK], [[0.0; N_NEURONS]; BLOCK]);
    let mut d_v = vec![[0.0; N_NEURONS]; targets.len()];
    for start in (0..n).step_by(BLOCK) {
        let end = (start + BLOCK).min(n);
        let m = end - start;
        let forward =
            Forward { f: &tape.f[start..end], a: &tape.a[start..end], g: &tape.g[start..end], b: &tape.b[start..end] };
        let mut back = Backward {
            f: &mut features[start..end],
            a: &mut d_a[..m],
            g: &mut d_g[start..end],
            b: &mut d_b[..m],
            c: &d_c[start..end],
        };
        backward_pass(scene.transposed, forward, &mut back, Some(&mut weights));
        for (&owner, d_b) in tape.owner[start..end].iter().zip(&d_b) {
            for (sum, d) in d_v[owner as usize].iter_mut().zip(d_b) {
                *sum += d;
            }
        }
    }
    view_gradient_pass(&mut weights, sh, &d_v);
    GroupGradient { weights, u: tape.u, features, loss, squared_error }
}
