//! The loss of one ray and its derivatives with respect to the density and colour of its samples.
//!
//! Letters, for samples i along the ray: `sigma` density per unit length, `delta` interval in that unit,
//! α = 1 − exp(−σδ), T transmittance before the sample, w = Tα, C = Σ w c + T_end · background, `s` distance in that
//! unit. For any function of the weights with derivatives a_i = ∂L/∂w_i,
//! ∂L/∂σ_i = δ_i (T_{i+1} a_i − Σ_{j>i} w_j a_j − T_end a_end). Colour loss and regulariser are such functions, and
//! their a_i add up.

use glam::Vec3;

/// Colour errors count quadratically up to this and linearly beyond (Huber), as in instant-ngp.
const HUBER: f32 = 0.1;

/// A sample as the loss sees it.
#[derive(Debug, Clone, Copy, Default)]
pub struct RaySample {
    /// Density, 1 / unit.
    pub sigma: f32,
    /// Colour, in [0, 1].
    pub color: Vec3,
    /// Length of its interval, units.
    pub delta: f32,
    /// Distance along the ray, units.
    pub s: f32,
}

/// Derivatives of the loss with respect to a sample.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SampleGradient {
    /// By its density.
    pub sigma: f32,
    /// By its colour.
    pub color: Vec3,
}

/// Contribution of a ray to the loss.
#[derive(Debug, Clone, Copy, Default)]
pub struct RayLoss {
    /// The quantity that is minimised.
    pub loss: f64,
    /// Squared error of colour, summed over channels.
    pub squared_error: f64,
}

/// `[w_i, T_{i+1}]` of the samples of a ray.
#[must_use]
pub fn composite(samples: &[RaySample]) -> Vec<[f32; 2]> {
    let mut transmittance = 1.0_f32;
    let weigh = |sample: &RaySample| {
        let optical_depth = sample.sigma * sample.delta;
        let weight = transmittance * -(-optical_depth).exp_m1();
        transmittance *= (-optical_depth).exp();
        [weight, transmittance]
    };
    samples.iter().map(weigh).collect()
}

/// T_end of a ray with the weights of [`composite`].
#[must_use]
pub fn end_transmittance(weights: &[[f32; 2]]) -> f32 {
    weights.last().map_or(1.0, |[_, after]| *after)
}

/// Fills ∂L/∂σ_i for a function L of the `weights` of [`composite`], from `end` = T_end a_end and a_i.
///
/// `a` is called from the last sample to the first.
pub fn density_gradients(
    samples: &[RaySample],
    weights: &[[f32; 2]],
    end: f32,
    mut a: impl FnMut(usize) -> f32,
    gradients: &mut [SampleGradient],
) {
    let mut behind = end;
    for (i, (sample, [weight, after])) in samples.iter().zip(weights).enumerate().rev() {
        let a = a(i);
        gradients[i].sigma = sample.delta * (after * a - behind);
        behind += weight * a;
    }
}

/// Computes the loss of a ray with true colour `target` over `background`, and writes its derivatives to `gradients`
/// (`[samples]`).
///
/// `distortion` is the factor of mip-NeRF 360's distortion loss (Barron et al. 2022, Eq. 15), which concentrates
/// weights along the ray and so removes fog and floaters.
pub fn ray_loss(
    samples: &[RaySample],
    target: Vec3,
    background: Vec3,
    distortion: f32,
    gradients: &mut Vec<SampleGradient>,
) -> RayLoss {
    let weights = composite(samples);
    let mut color = Vec3::ZERO;
    let (mut total, mut first_moment) = (0.0_f32, 0.0_f32);
    for (sample, [weight, _]) in samples.iter().zip(&weights) {
        color += weight * sample.color;
        total += weight;
        first_moment += weight * sample.s;
    }
    let transmittance = end_transmittance(&weights);
    color += transmittance * background;

    let error = color - target;
    let d_color = error.clamp(Vec3::splat(-HUBER), Vec3::splat(HUBER));
    let huber = |e: f32| if e.abs() <= HUBER { 0.5 * e * e } else { HUBER * (e.abs() - 0.5 * HUBER) };
    let mut result = RayLoss {
        loss: f64::from(huber(error.x) + huber(error.y) + huber(error.z)),
        squared_error: f64::from(error.length_squared()),
    };

    gradients.clear();
    let of_color = |[weight, _]: &[f32; 2]| SampleGradient { sigma: 0.0, color: weight * d_color };
    gradients.extend(weights.iter().map(of_color));
    // Σ w and Σ w s behind a sample, from which |s_i − s_j| is summed over pairs.
    let (mut total_behind, mut moment_behind) = (0.0_f32, 0.0_f32);
    let d_weight = |i: usize| {
        let (sample, [weight, _]) = (&samples[i], weights[i]);
        let (total_before, moment_before) =
            (total - total_behind - weight, first_moment - moment_behind - weight * sample.s);
        let spread = sample.s * total_before - moment_before + moment_behind - sample.s * total_behind;
        result.loss += f64::from(distortion) * f64::from(weight * (spread + weight * sample.delta / 3.0));
        total_behind += weight;
        moment_behind += weight * sample.s;
        d_color.dot(sample.color) + distortion * (2.0 * spread + 2.0 / 3.0 * weight * sample.delta)
    };
    density_gradients(samples, &weights, transmittance * d_color.dot(background), d_weight, gradients);
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    fn random_ray(rng: &mut ChaCha8Rng) -> Vec<RaySample> {
        let mut s = 0.1;
        (0..12)
            .map(|_| {
                let delta = rng.random_range(0.01..0.1_f32);
                s += delta;
                let color = Vec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..1.0_f32)));
                RaySample { sigma: rng.random_range(0.0..20.0_f32), color, delta, s }
            })
            .collect()
    }

    /// The loss from its definition, in f64, over all pairs.
    fn loss_slowly(samples: &[RaySample], target: Vec3, background: Vec3, distortion: f64) -> f64 {
        let (mut transmittance, mut color) = (1.0, glam::DVec3::ZERO);
        let mut weights = Vec::new();
        for sample in samples {
            let alpha = 1.0 - (-f64::from(sample.sigma) * f64::from(sample.delta)).exp();
            weights.push(transmittance * alpha);
            color += transmittance * alpha * sample.color.as_dvec3();
            transmittance *= 1.0 - alpha;
        }
        let error = color + transmittance * background.as_dvec3() - target.as_dvec3();
        let huber = |e: f64| if e.abs() <= 0.1 { 0.5 * e * e } else { 0.1 * (e.abs() - 0.05) };
        let mut loss = huber(error.x) + huber(error.y) + huber(error.z);
        for (a, wa) in samples.iter().zip(&weights) {
            loss += distortion * wa * wa * f64::from(a.delta) / 3.0;
            for (b, wb) in samples.iter().zip(&weights) {
                loss += distortion * wa * wb * (f64::from(a.s) - f64::from(b.s)).abs();
            }
        }
        loss
    }

    #[test]
    fn derivatives_are_those_of_the_definition() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let background = Vec3::new(0.2, 0.9, 0.5);
        for distortion in [0.0, 0.3] {
            for target in [Vec3::splat(0.4), Vec3::new(0.9, 0.0, 0.5)] {
                let ray = random_ray(&mut rng);
                let mut found = Vec::new();
                let loss = ray_loss(&ray, target, background, distortion, &mut found);
                let slowly = |ray: &[RaySample]| loss_slowly(ray, target, background, f64::from(distortion));
                // f32 sums of a dozen terms of order 1.
                assert!((loss.loss - slowly(&ray)).abs() < 3e-6, "{} {}", loss.loss, slowly(&ray));
                for i in 0..ray.len() {
                    // The definition is f64. The step's square times a third derivative of order 1 is 1e-6
                    // relative; f32 rounds at 1e-6.
                    let difference = |change: &dyn Fn(&mut RaySample, f32)| {
                        let [low, high] = [-1e-3_f32, 1e-3].map(|h| {
                            let mut moved = ray.clone();
                            change(&mut moved[i], h);
                            slowly(&moved)
                        });
                        (high - low) / 2e-3
                    };
                    let sigma = difference(&|s, h| s.sigma += h);
                    assert!((sigma - f64::from(found[i].sigma)).abs() < 2e-5, "{i}: {sigma} {:?}", found[i]);
                    for k in 0..3 {
                        let color = difference(&|s, h| s.color[k] += h);
                        assert!((color - f64::from(found[i].color[k])).abs() < 2e-5, "{i}: {color} {:?}", found[i]);
                    }
                }
            }
        }
    }

    #[test]
    fn an_empty_ray_shows_the_background() {
        let mut gradients = vec![SampleGradient::default()];
        let result = ray_loss(&[], Vec3::ONE, Vec3::ONE, 0.1, &mut gradients);
        assert!(result.loss == 0.0 && result.squared_error == 0.0 && gradients.is_empty());
    }
}
