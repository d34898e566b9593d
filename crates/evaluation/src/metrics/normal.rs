//! The normal distribution, which errors of depth are taken to have around the depth that is rendered
//! ([`octobayes_depth::DepthDeviation`]). Deviation 1; z counts deviations.

use std::f64::consts::{PI, SQRT_2};

/// Negative logarithm of the density at an error of `z` deviations.
#[must_use]
pub fn negative_log(z: f64) -> f64 {
    0.5 * (2.0 * PI).ln() + 0.5 * z * z
}

/// The share of errors that are smaller than `z` deviations.
#[must_use]
pub fn within(z: f64) -> f64 {
    libm::erf(z / SQRT_2)
}

/// The number of deviations within which the share `probability` of the errors lies; inverse of [`within`].
///
/// # Panics
/// If the probability is not in [0, 1).
#[must_use]
pub fn deviations(probability: f64) -> f64 {
    assert!((0.0..1.0).contains(&probability), "a probability below one, not {probability}");
    let (mut low, mut high) = (0.0, 1.0);
    while within(high) < probability {
        high *= 2.0;
    }
    // Bisection until the numbers are neighbours.
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return high;
        }
        if within(middle) < probability { low = middle } else { high = middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_density_integrates_to_one_with_deviation_one_and_to_what_lies_within() {
        let (mut mass, mut variance) = (0.0, 0.0);
        let width = 1e-3;
        for i in 0..10_000 {
            let z = width * (f64::from(i) + 0.5);
            let p = 2.0 * (-negative_log(z)).exp() * width;
            (mass, variance) = (mass + p, variance + p * z * z);
            if i % 500 == 499 {
                // The middle rule is off by less than width² / 24 · |p''| ≤ 1e-7.
                let within = within(z + 0.5 * width);
                assert!((mass - within).abs() < 2e-7, "at {z}: {mass} against {within}");
            }
        }
        assert!((mass - 1.0).abs() < 1e-6 && (variance - 1.0).abs() < 2e-6, "{mass}, {variance}");
    }

    #[test]
    fn deviations_are_those_of_tables() {
        for (probability, expected) in [(0.5, 0.674_490), (0.9, 1.644_854), (0.95, 1.959_964), (0.99, 2.575_829)] {
            let found = deviations(probability);
            assert!((found - expected).abs() < 1e-6, "{found} instead of {expected}");
            assert!((within(found) - probability).abs() < 1e-14);
        }
    }
}
