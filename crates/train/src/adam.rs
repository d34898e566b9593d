//! Adam (Kingma, Ba, 2015) with instant-ngp's constants.

/// Decay of the mean gradient.
const BETA1: f32 = 0.9;
/// Decay of the mean square.
const BETA2: f32 = 0.99;
/// So small that the tiny gradients of rarely visited cells still count.
const EPSILON: f32 = 1e-15;

/// The bias-corrected step at one time.
#[derive(Debug, Clone, Copy)]
pub struct Adam {
    rate: f32,
    /// 1 / √(1 − β₂ᵗ).
    correction: f32,
}

impl Adam {
    /// The step of number `step`, from 1.
    pub fn new(rate: f32, step: u64) -> Self {
        let power = |beta: f32| 1.0 - f64::from(beta).powi(step.min(1 << 20) as i32);
        Self { rate: (f64::from(rate) / power(BETA1)) as f32, correction: (1.0 / power(BETA2).sqrt()) as f32 }
    }

    /// Moves parameters `[n]` against their gradients `[n]`, and updates their moments `[n]`.
    pub fn update(&self, parameters: &mut [f32], gradients: &[f32], means: &mut [f32], squares: &mut [f32]) {
        for (((p, g), m), v) in parameters.iter_mut().zip(gradients).zip(means).zip(squares) {
            self.update_one(p, *g, m, v);
        }
    }

    #[inline(always)]
    fn update_one(&self, p: &mut f32, g: f32, m: &mut f32, v: &mut f32) {
        *m = BETA1 * *m + (1.0 - BETA1) * g;
        *v = BETA2 * *v + (1.0 - BETA2) * g * g;
        *p -= self.rate * *m / (v.sqrt() * self.correction + EPSILON);
    }

    /// Like [`Adam::update`], for the entries of a hash table. A step visits few of them.
    ///
    /// The other entries keep their moments, as in instant-ngp. Gradients are cleared for the next step.
    pub fn update_visited<const F: usize>(
        &self,
        entries: &mut [[f32; F]],
        gradients: &mut [[f32; F]],
        means: &mut [[f32; F]],
        squares: &mut [[f32; F]],
    ) {
        for (((entry, gradient), mean), square) in entries.iter_mut().zip(gradients).zip(means).zip(squares) {
            if gradient.iter().any(|g| *g != 0.0) {
                for k in 0..F {
                    self.update_one(&mut entry[k], gradient[k], &mut mean[k], &mut square[k]);
                }
                *gradient = [0.0; F];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_the_paper() {
        // Algorithm 1 in f64, three steps on one number.
        let (mut m, mut v, mut p) = (0.0_f64, 0.0_f64, 1.0_f64);
        let (mut found, mut mean, mut square) = ([1.0_f32, 5.0], [0.0; 2], [0.0; 2]);
        for (t, g) in [(1, 0.5), (2, -0.1), (3, 0.7)] {
            m = 0.9 * m + 0.1 * g;
            v = 0.99 * v + 0.01 * g * g;
            let (mh, vh) = (m / (1.0 - 0.9_f64.powi(t)), v / (1.0 - 0.99_f64.powi(t)));
            p -= 0.01 * mh / (vh.sqrt() + 1e-15);
            let mut gradient = [[g as f32, 0.0], [0.0, 0.0]];
            let mut entries = [found, [2.0, 2.0]];
            let (mut means, mut squares) = ([mean, [9.0; 2]], [square, [9.0; 2]]);
            Adam::new(0.01, t as u64).update_visited(&mut entries, &mut gradient, &mut means, &mut squares);
            (found, mean, square) = (entries[0], means[0], squares[0]);
            assert!(gradient == [[0.0; 2]; 2] && entries[1] == [2.0; 2] && means[1] == [9.0; 2], "not visited");
            // Three roundings of f32 per operation on numbers below 1.
            assert!((f64::from(found[0]) - p).abs() < 1e-6, "{found:?} {p}");
        }
    }
}
