//! Compositing along a ray, and its derivative.
//!
//! Letters, for samples i in order along the ray: `sigma` density σ_i, `c` colour, `delta` interval length δ,
//! α_i = 1 − exp(−σ_i δ), `T_i` = exp(−Σ_{j<i} σ_j δ) transmittance before sample i, w_i = T_i α_i, `T_end`
//! transmittance behind the last sample. C = Σ w_i c_i + T_end · background. `S_i` = Σ_{j>i} w_j c_j + T_end ·
//! background is the colour of what lies behind i.
//!
//! Everything is f64: a ray has a few hundred samples at most, and evaluating the field costs a thousand times more.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::trace::TracedRays;

/// What a ray shows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pixel {
    /// C, background included.
    pub color: DVec3,
    /// Σ w = 1 − T_end.
    pub opacity: f64,
    /// Σ w t / Σ w, distance from the origin in scene units; 0 where nothing was hit.
    pub expected_depth: f64,
    /// Distance at which half of Σ w is reached; 0 where nothing was hit.
    pub median_depth: f64,
    /// [`depth_variance`] of the weights, squared scene units; 0 where nothing was hit.
    pub depth_variance: f64,
}

/// Variance of the depth at which a ray ends, given that it ends, in squared scene units; 0 without weights.
///
/// Σ w (t − t̄)² / Σ w with t̄ = Σ w t / Σ w, from the `weights` and distances `t` of the ray's samples.
#[must_use]
pub fn depth_variance(weights: &[f64], t: &[f64]) -> f64 {
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return 0.0;
    }
    let mean = weights.iter().zip(t).map(|(w, t)| w * t).sum::<f64>() / total;
    weights.iter().zip(t).map(|(w, t)| w * (t - mean) * (t - mean)).sum::<f64>() / total
}

/// Weights of the samples of a group of rays, in order. The buffers are reused from group to group.
#[derive(Debug, Clone, Default)]
pub struct CompositingWeights {
    /// w_i of each sample.
    pub weights: Vec<f64>,
    /// T_{i+1}, the transmittance behind each sample.
    pub transmittance_after: Vec<f64>,
}

impl CompositingWeights {
    /// Computes the weights of all samples of `traced` for intervals of length `delta`.
    pub fn set(&mut self, traced: &TracedRays, delta: f64) {
        self.weights.clear();
        self.transmittance_after.clear();
        for ray in 0..traced.rays() {
            self.push_ray(&traced.densities[traced.samples(ray)], delta);
        }
    }

    /// Appends a ray with any number of samples, including none.
    fn push_ray(&mut self, densities: &[f32], delta: f64) {
        let mut transmittance = 1.0;
        for &density in densities {
            // exp_m1 keeps α exact where σδ is tiny. T is what w leaves over, so that Σ w + T_end = 1. Where α
            // rounds to 1, T is wrong by an ulp of 1, but nothing can be seen through such a sample.
            let alpha = -(f64::from(density) * -delta).exp_m1();
            let weight = transmittance * alpha;
            transmittance -= weight;
            self.weights.push(weight);
            self.transmittance_after.push(transmittance);
        }
    }

    /// T_end of the ray that owns `samples`.
    #[must_use]
    pub fn end_transmittance(&self, samples: &Range<usize>) -> f64 {
        self.transmittance_after[samples.clone()].last().copied().unwrap_or(1.0)
    }

    /// Composites the ray that owns `samples`. `colors` (linear RGB in `[0, 1]`) and
    /// distances `t` are those of all samples.
    #[must_use]
    pub fn pixel(&self, samples: &Range<usize>, colors: &[Vec3], t: &[f64], background: DVec3) -> Pixel {
        let weights = &self.weights[samples.clone()];
        let opacity: f64 = weights.iter().sum();
        let mut pixel = Pixel { color: self.end_transmittance(samples) * background, opacity, ..Pixel::default() };
        let mut so_far = 0.0;
        for ((&w, color), &t) in weights.iter().zip(&colors[samples.clone()]).zip(&t[samples.clone()]) {
            pixel.color += w * color.as_dvec3();
            if opacity > 0.0 {
                pixel.expected_depth += w * t / opacity;
                if so_far < 0.5 * opacity && so_far + w >= 0.5 * opacity {
                    pixel.median_depth = t;
                }
            }
            so_far += w;
        }
        pixel.depth_variance = depth_variance(weights, &t[samples.clone()]);
        pixel
    }

    /// Writes ∂C/∂σ_i = δ (T_{i+1} c_i − S_i) for the samples of a ray into `out` (of all
    /// samples), in one backward sweep.
    pub fn density_derivative(
        &self,
        samples: &Range<usize>,
        colors: &[Vec3],
        delta: f64,
        background: DVec3,
        out: &mut [DVec3],
    ) {
        let mut behind = self.end_transmittance(samples) * background;
        for i in samples.clone().rev() {
            let color = colors[i].as_dvec3();
            out[i] = delta * (self.transmittance_after[i] * color - behind);
            behind += self.weights[i] * color;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Densities and colours along a ray.
    fn samples() -> impl Strategy<Value = (Vec<f32>, Vec<Vec3>)> {
        let density = prop_oneof![Just(0.0_f32), 0.0..10.0_f32, 1e-6..1e-3_f32, 1e3..1e4_f32];
        let color = [0.0..1.0_f32, 0.0..1.0, 0.0..1.0].prop_map(Vec3::from_array);
        proptest::collection::vec((density, color), 0..40).prop_map(|samples| samples.into_iter().unzip())
    }

    fn one_ray(densities: &[f32], delta: f64) -> (CompositingWeights, Range<usize>) {
        let mut quadrature = CompositingWeights::default();
        quadrature.push_ray(densities, delta);
        (quadrature, 0..densities.len())
    }

    proptest! {
        #[test]
        fn weights_and_final_transmittance_sum_to_one((densities, _) in samples(), delta in 1e-4..0.1_f64) {
            let (quadrature, ray) = one_ray(&densities, delta);
            let sum = quadrature.weights.iter().sum::<f64>() + quadrature.end_transmittance(&ray);
            // One rounding per sample in T and one in the sum, at most 40 samples.
            prop_assert!((sum - 1.0).abs() <= 80.0 * f64::EPSILON, "{}", sum);
            prop_assert!(quadrature.weights.iter().chain(&quadrature.transmittance_after).all(|&w| w >= 0.0));
        }

        #[test]
        fn transmittance_is_the_exponential_of_the_optical_depth((densities, _) in samples(), delta in 1e-4..0.1_f64) {
            let (quadrature, _) = one_ray(&densities, delta);
            let mut depth = 0.0;
            for (i, &density) in densities.iter().enumerate() {
                let before = f64::exp(-depth);
                depth += f64::from(density) * delta;
                // One rounding of T and one of α per sample, 40 samples.
                prop_assert!((quadrature.transmittance_after[i] - f64::exp(-depth)).abs() <= 80.0 * f64::EPSILON);
                let alpha = -(-f64::from(density) * delta).exp_m1();
                prop_assert!((quadrature.weights[i] - before * alpha).abs() <= 80.0 * f64::EPSILON * alpha);
            }
        }

        #[test]
        fn density_derivative_is_the_derivative((densities, colors) in samples(), delta in 1e-4..0.1_f64) {
            let background = DVec3::new(1.0, 0.5, 0.0);
            let t = vec![0.0; densities.len()];
            let color_at = |densities: &[f32]| {
                let (quadrature, ray) = one_ray(densities, delta);
                quadrature.pixel(&ray, &colors, &t, background).color
            };
            let (quadrature, ray) = one_ray(&densities, delta);
            let mut analytic = vec![DVec3::ZERO; densities.len()];
            quadrature.density_derivative(&ray, &colors, delta, background, &mut analytic);
            for i in ray {
                // σ is f32, so the perturbation is what f32 makes of it. C is a sum of exponentials of −δσ_i: the
                // second-order error is below (hδ)² relative, the rounding error below 1e-15 / h.
                let h = 1e-3 * (1.0 + densities[i]);
                let (mut up, mut down) = (densities.clone(), densities.clone());
                up[i] += h;
                down[i] = (down[i] - h).max(0.0);
                let width = f64::from(up[i]) - f64::from(down[i]);
                let numeric = (color_at(&up) - color_at(&down)) / width;
                let one_sided = f64::from(down[i] == 0.0);
                let limit = 2.0 * delta * (width * delta).powi(2)
                    + one_sided * width * delta * delta
                    + 1e-13 / width
                    + 1e-15;
                prop_assert!((numeric - analytic[i]).abs().max_element() <= limit,
                    "sample {}: {} against {}, limit {}", i, numeric, analytic[i], limit);
            }
        }
    }

    #[test]
    fn homogeneous_slab_has_the_textbook_answer() {
        // 100 intervals of 0.01 at σ = 4: T = exp(−4), median where 1 − exp(−4t) = (1 − exp(−4)) / 2.
        let colors = vec![Vec3::splat(0.5); 100];
        let t: Vec<f64> = (0..100).map(|i| 0.01 * (f64::from(i) + 0.5)).collect();
        let (quadrature, ray) = one_ray(&[4.0; 100], 0.01);
        let pixel = quadrature.pixel(&ray, &colors, &t, DVec3::ONE);
        let end = (-4.0_f64).exp();
        assert!((pixel.opacity - (1.0 - end)).abs() < 1e-14);
        assert!((pixel.color.x - (0.5 * (1.0 - end) + end)).abs() < 1e-14);
        let median = -(1.0 - 0.5 * (1.0 - end)).ln() / 4.0;
        assert!((pixel.median_depth - median).abs() <= 0.005, "within half an interval");
    }

    #[test]
    fn spread_of_two_surfaces_and_of_a_slab() {
        // A half-transparent wall at 2, an opaque one at 5: mean 3.5, variance 2.25.
        assert!((depth_variance(&[0.5, 0.0, 0.5], &[2.0, 3.0, 5.0]) - 2.25).abs() < 1e-15);
        // The same through a veil: the variance is that of what is hit.
        assert!((depth_variance(&[0.25, 0.25], &[2.0, 5.0]) - 2.25).abs() < 1e-15);
        // Nothing hit, or one surface hit: certain.
        assert_eq!([depth_variance(&[], &[]), depth_variance(&[1.0], &[7.0])], [0.0, 0.0]);

        // In an endless homogeneous medium the depth is exponentially distributed, with variance 1 / σ².
        let (sigma, delta, n) = (4.0_f64, 0.01, 2000_u32);
        let (quadrature, _) = one_ray(&vec![sigma as f32; n as usize], delta);
        let t: Vec<f64> = (0..n).map(|i| delta * (f64::from(i) + 0.5)).collect();
        let variance = depth_variance(&quadrature.weights, &t);
        // A geometric variable in steps of δ: δ² (1 − α) / α².
        let alpha = -(-sigma * delta).exp_m1();
        assert!((variance - delta * delta * (1.0 - alpha) / (alpha * alpha)).abs() < 1e-12, "{variance}");
        assert!((variance * sigma * sigma - 1.0).abs() < (sigma * delta).powi(2));
    }
}
