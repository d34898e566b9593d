//! The rays of one step: forward pass, loss, backward pass. Groups of rays are independent, so the sums do not
//! depend on the number of threads.

use glam::Vec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::loss::{SampleGradient, ray_loss};
use super::march::Walk;
use super::occupancy::OccupancyGrid;
use super::tape::Tape;
use super::{Background, Shot};
use octobayes::rays::PixelSequence;
use octobayes_models::hash_grid::{N_VIEW, Network, Parameters, Space, Transposed, WIDTH, harmonics};

/// Rays that go through the networks together. The sum over a group is one summand of the step.
pub const GROUP: u64 = 32;

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

/// True colour of a ray, and the background that it was composited over.
struct Target {
    color: Vec3,
    background: Vec3,
}

/// Computes the gradient of the rays `first..first + count`.
pub fn group(scene: &Scene, first: u64, count: u64) -> GroupGradient {
    let mut rng = ChaCha8Rng::seed_from_u64(scene.seed ^ 0xbac6);
    rng.set_stream(first);
    let mut targets = Vec::new();
    let mut sh = Vec::new();
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
        sh.push(harmonics(ray.direction.as_vec3()));
        walks.push(Walk::new(scene.space, ray, pick.jitter));
    }
    let tape = Tape::record(scene.space, scene.occupancy, scene.parameters, &mut walks, &sh, |_| 1.0);
    backward(scene, tape, &targets, &sh)
}

/// Losses of all rays, and their derivatives with respect to weights and features.
fn backward(scene: &Scene, tape: Tape, targets: &[Target], sh: &[[f32; N_VIEW]]) -> GroupGradient {
    // Samples by ray, in order along it.
    let mut of_ray = vec![Vec::new(); targets.len()];
    for (i, &owner) in tape.owner.iter().enumerate() {
        of_ray[owner as usize].push(i);
    }
    let (mut loss, mut squared_error) = (0.0, 0.0);
    let (mut samples, mut gradients) = (Vec::new(), Vec::<SampleGradient>::new());
    let mut all = vec![SampleGradient::default(); tape.len()];
    for (target, of_ray) in targets.iter().zip(&of_ray) {
        samples.clear();
        samples.extend(of_ray.iter().map(|&i| tape.sample(i)));
        let ray = ray_loss(&samples, target.color, target.background, scene.distortion, &mut gradients);
        loss += ray.loss;
        squared_error += ray.squared_error;
        for (&i, gradient) in of_ray.iter().zip(&gradients) {
            all[i] = *gradient;
        }
    }
    let (weights, features) = tape.backpropagate(scene.transposed, &all, sh);
    GroupGradient { weights, u: tape.u, features, loss, squared_error }
}
