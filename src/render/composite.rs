//! Compositing along one ray, and its derivative.
//!
//! Letters, for samples i in order along the ray: `sigma` density σ_i, `c` colour, `delta` the interval length δ,
//! α_i = 1 − exp(−σ_i δ), `T_i` = exp(−Σ_{j<i} σ_j δ) transmittance before sample i, w_i = T_i α_i, `T_end` behind the last.
//! C = Σ w_i c_i + T_end · background. `S_i` = Σ_{j>i} w_j c_j + T_end · background is the colour of what lies behind i.
//!
//! All in f64: a ray has at most a few hundred samples, the field behind each costs a thousand times more.

use glam::DVec3;

use crate::field::Radiance;

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
}

/// Weights of a ray's samples, with buffers that are used again from ray to ray.
#[derive(Debug, Clone, Default)]
pub struct Quadrature {
    /// w_i.
    pub weights: Vec<f64>,
    /// T_i before each sample, and T_end as last entry: one more than there are samples.
    pub transmittance: Vec<f64>,
}

impl Quadrature {
    /// Computes the weights for `samples` at intervals `delta`; any number of samples, none included.
    pub fn set(&mut self, samples: &[Radiance], delta: f64) {
        self.weights.clear();
        self.transmittance.clear();
        self.transmittance.push(1.0);
        let mut transmittance = 1.0;
        for sample in samples {
            // exp_m1 keeps α exact where σδ is tiny; w from it and T from exp agree to an ulp, so Σ w + T_end = 1.
            let optical_depth = f64::from(sample.density) * delta;
            self.weights.push(transmittance * -(-optical_depth).exp_m1());
            transmittance *= (-optical_depth).exp();
            self.transmittance.push(transmittance);
        }
    }

    /// T_end.
    #[must_use]
    pub fn end_transmittance(&self) -> f64 {
        self.transmittance.last().copied().unwrap_or(1.0)
    }

    /// Colour, opacity and depths; `t` are the samples' distances.
    #[must_use]
    pub fn pixel(&self, samples: &[Radiance], t: &[f64], background: DVec3) -> Pixel {
        let opacity: f64 = self.weights.iter().sum();
        let mut pixel = Pixel { color: self.end_transmittance() * background, opacity, ..Pixel::default() };
        let mut so_far = 0.0;
        for ((&w, sample), &t) in self.weights.iter().zip(samples).zip(t) {
            pixel.color += w * sample.color.as_dvec3();
            if opacity > 0.0 {
                pixel.expected_depth += w * t / opacity;
                if so_far < 0.5 * opacity && so_far + w >= 0.5 * opacity {
                    pixel.median_depth = t;
                }
            }
            so_far += w;
        }
        pixel
    }

    /// ∂C/∂σ_i = δ (T_{i+1} c_i − S_i) for every sample, `[n]`, into `out`; one backward sweep.
    pub fn density_derivative(&self, samples: &[Radiance], delta: f64, background: DVec3, out: &mut Vec<DVec3>) {
        out.clear();
        out.resize(samples.len(), DVec3::ZERO);
        let mut behind = self.end_transmittance() * background;
        for i in (0..samples.len()).rev() {
            let color = samples[i].color.as_dvec3();
            out[i] = delta * (self.transmittance[i + 1] * color - behind);
            behind += self.weights[i] * color;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    fn samples() -> impl Strategy<Value = Vec<Radiance>> {
        let density = prop_oneof![Just(0.0_f32), 0.0..10.0_f32, 1e-6..1e-3_f32, 1e3..1e4_f32];
        let radiance = (density, [0.0..1.0_f32, 0.0..1.0, 0.0..1.0])
            .prop_map(|(density, color)| Radiance { density, color: Vec3::from_array(color) });
        proptest::collection::vec(radiance, 0..40)
    }

    proptest! {
        #[test]
        fn weights_and_final_transmittance_sum_to_one(samples in samples(), delta in 1e-4..0.1_f64) {
            let mut quadrature = Quadrature::default();
            quadrature.set(&samples, delta);
            let sum = quadrature.weights.iter().sum::<f64>() + quadrature.end_transmittance();
            // Two roundings per sample in T and two in w, at most 40 samples.
            prop_assert!((sum - 1.0).abs() <= 200.0 * f64::EPSILON, "{}", sum);
            prop_assert!(quadrature.weights.iter().all(|&w| w >= 0.0));
        }

        #[test]
        fn density_derivative_is_the_derivative(samples in samples(), delta in 1e-4..0.1_f64) {
            let background = DVec3::new(1.0, 0.5, 0.0);
            let t = vec![0.0; samples.len()];
            let mut quadrature = Quadrature::default();
            let mut color_at = |samples: &[Radiance]| {
                quadrature.set(samples, delta);
                quadrature.pixel(samples, &t, background).color
            };
            let mut analytic = Vec::new();
            for i in 0..samples.len() {
                // σ is f32, so the perturbation is what f32 made of it. C is a sum of exponentials of −δσ_i: the
                // second-order error is below (hδ)² relative, the rounding below 1e-15 / h.
                let h = 1e-3 * (1.0 + samples[i].density);
                let (mut up, mut down) = (samples.clone(), samples.clone());
                up[i].density += h;
                down[i].density = (down[i].density - h).max(0.0);
                let width = f64::from(up[i].density) - f64::from(down[i].density);
                let numeric = (color_at(&up) - color_at(&down)) / width;
                let one_sided = f64::from(down[i].density == 0.0);
                color_at(&samples);
                let mut q = Quadrature::default();
                q.set(&samples, delta);
                q.density_derivative(&samples, delta, background, &mut analytic);
                let limit = 2.0 * delta * (width * delta).powi(2) + one_sided * width * delta * delta + 1e-13 / width + 1e-15;
                prop_assert!((numeric - analytic[i]).abs().max_element() <= limit,
                    "sample {}: {} against {}, limit {}", i, numeric, analytic[i], limit);
            }
        }
    }

    #[test]
    fn homogeneous_slab_has_the_textbook_answer() {
        // 100 intervals of 0.01 at σ = 4: T = exp(−4), median where 1 − exp(−4t) = (1 − exp(−4)) / 2.
        let samples = vec![Radiance { density: 4.0, color: Vec3::splat(0.5) }; 100];
        let t: Vec<f64> = (0..100).map(|i| 0.01 * (f64::from(i) + 0.5)).collect();
        let mut quadrature = Quadrature::default();
        quadrature.set(&samples, 0.01);
        let pixel = quadrature.pixel(&samples, &t, DVec3::ONE);
        let end = (-4.0_f64).exp();
        assert!((pixel.opacity - (1.0 - end)).abs() < 1e-14);
        assert!((pixel.color.x - (0.5 * (1.0 - end) + end)).abs() < 1e-14);
        let median = -(1.0 - 0.5 * (1.0 - end)).ln() / 4.0;
        assert!((pixel.median_depth - median).abs() <= 0.005, "within half an interval");
    }
}
