//! Densities that errors of depth may have around the depth that is rendered.
//!
//! All have standard deviation 1; z counts deviations.

use std::f64::consts::{FRAC_2_PI, LN_2, PI, SQRT_2};

/// Degrees of freedom of [`ErrorDensity::Student`], ν.
const FREEDOM: f64 = 5.0;

/// The shape of the errors' density.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ErrorDensity {
    /// Normal.
    Gauss,
    /// Two exponentials.
    Laplace,
    /// Student's t with five degrees of freedom: heavy tails.
    Student,
}

impl ErrorDensity {
    /// All shapes.
    pub const ALL: [Self; 3] = [Self::Gauss, Self::Laplace, Self::Student];

    /// The density of depth's predictive distribution.
    ///
    /// Errors of depth have heavier tails than normal ones. That five degrees of freedom suit them was read off some
    /// scenes and holds on others (`experiments/depth.md`).
    pub const PREDICTIVE: Self = Self::Student;

    /// Negative logarithm of the density at an error of `z` deviations, for deviation 1.
    #[must_use]
    pub fn negative_log(self, z: f64) -> f64 {
        match self {
            Self::Gauss => 0.5 * (2.0 * PI).ln() + 0.5 * z * z,
            // Of scale 1/√2.
            Self::Laplace => 0.5 * LN_2 + SQRT_2 * z.abs(),
            // Of scale √((ν − 2) / ν). Γ((ν + 1)/2) / (√(π (ν − 2)) Γ(ν/2)) is 8 / (3π √3) for ν = 5.
            Self::Student => {
                let peak = 8.0 / (3.0 * PI * 3_f64.sqrt());
                0.5 * (FREEDOM + 1.0) * (z * z / (FREEDOM - 2.0)).ln_1p() - peak.ln()
            }
        }
    }

    /// The share of errors that are smaller than `z` deviations.
    #[must_use]
    pub fn within(self, z: f64) -> f64 {
        match self {
            Self::Gauss => libm::erf(z / SQRT_2),
            Self::Laplace => -(-SQRT_2 * z).exp_m1(),
            // Abramowitz and Stegun 26.7.3 for ν = 5; tan θ = t / √ν, where t = z √(ν / (ν − 2)).
            Self::Student => {
                let theta = (z / (FREEDOM - 2.0).sqrt()).atan();
                let (sin, cos) = theta.sin_cos();
                FRAC_2_PI * (theta + sin * cos * (1.0 + 2.0 / 3.0 * cos * cos))
            }
        }
    }

    /// The number of deviations within which the share `probability` of the errors lies; inverse of
    /// [`ErrorDensity::within`].
    ///
    /// # Panics
    /// If the probability is not in [0, 1).
    #[must_use]
    pub fn deviations(self, probability: f64) -> f64 {
        assert!((0.0..1.0).contains(&probability), "a probability below one, not {probability}");
        let (mut low, mut high) = (0.0, 1.0);
        while self.within(high) < probability {
            high *= 2.0;
        }
        // Bisection until the numbers are neighbours.
        loop {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                return high;
            }
            if self.within(middle) < probability { low = middle } else { high = middle }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_integrate_to_one_with_deviation_one_and_to_what_lies_within() {
        for density in ErrorDensity::ALL {
            let (mut mass, mut variance) = (0.0, 0.0);
            // Of Student's t 1e-9 of the mass and 1e-5 of the variance lie beyond 100.
            let width = 1e-3;
            for i in 0..100_000 {
                let z = width * (f64::from(i) + 0.5);
                let p = 2.0 * (-density.negative_log(z)).exp() * width;
                (mass, variance) = (mass + p, variance + p * z * z);
                if i % 500 == 499 && i < 10_000 {
                    // The middle rule is off by less than width² / 24 · |p''| ≤ 1e-7.
                    let within = density.within(z + 0.5 * width);
                    assert!((mass - within).abs() < 2e-7, "{density:?} at {z}: {mass} against {within}");
                }
            }
            assert!((mass - 1.0).abs() < 1e-6 && (variance - 1.0).abs() < 2e-5, "{density:?}: {mass}, {variance}");
        }
    }

    #[test]
    fn deviations_hold_what_they_are_asked_to() {
        // Tables of the normal distribution, and of Student's t with ν = 5: 2.015 and 2.571, times √(3/5).
        let known = [
            (ErrorDensity::Gauss, 0.95, 1.959_964),
            (ErrorDensity::Student, 0.90, 2.015_048 * 0.6_f64.sqrt()),
            (ErrorDensity::Student, 0.95, 2.570_582 * 0.6_f64.sqrt()),
            (ErrorDensity::Laplace, 0.95, 20_f64.ln() / SQRT_2),
        ];
        for (density, probability, expected) in known {
            let found = density.deviations(probability);
            assert!((found - expected).abs() < 1e-5, "{density:?}: {found} instead of {expected}");
            assert!((density.within(found) - probability).abs() < 1e-14);
        }
    }
}
