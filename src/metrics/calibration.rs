//! Calibration: do errors lie within the deviations that are claimed for them as often as they should?
//!
//! Letters: e an absolute error, s the standard deviation claimed for it, z = e / s. If errors are normal, the share
//! p(z) = erf(z / √2) of them is smaller than z deviations.

use std::f64::consts::{LN_2, PI, SQRT_2};

/// Probabilities whose intervals are reported.
pub const PROBABILITIES: [f64; 4] = [0.5, 0.68, 0.9, 0.95];

/// Points of the reliability curve: nominal probabilities 1/100, 2/100, …, 99/100.
const POINTS: usize = 99;

/// Degrees of freedom of [`ErrorDensity::Student`].
const FREEDOM: f64 = 3.0;

/// The shape of the errors' density, of standard deviation s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ErrorDensity {
    /// Normal.
    Gauss,
    /// Two exponentials.
    Laplace,
    /// Student's t with three degrees of freedom: heavy tails.
    Student,
}

impl ErrorDensity {
    /// All shapes.
    pub const ALL: [Self; 3] = [Self::Gauss, Self::Laplace, Self::Student];

    /// Negative logarithm of the density at an error of `z` deviations, for deviation 1.
    #[must_use]
    pub fn negative_log(self, z: f64) -> f64 {
        match self {
            Self::Gauss => 0.5 * (2.0 * PI).ln() + 0.5 * z * z,
            // Of scale 1/√2.
            Self::Laplace => 0.5 * LN_2 + SQRT_2 * z.abs(),
            // Of scale √((ν − 2) / ν); for ν = 3 the density is 2 / (π (1 + z²)²).
            Self::Student => (0.5 * PI).ln() + 0.5 * (FREEDOM + 1.0) * (z * z / (FREEDOM - 2.0)).ln_1p(),
        }
    }
}

/// How well deviations tell the size of errors.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Calibration {
    /// Each of [`PROBABILITIES`], and the share of the errors within the interval that should hold it.
    pub coverage: [[f64; 2]; PROBABILITIES.len()],
    /// `[99]`: nominal probability and the share found, for the reliability diagram.
    pub reliability: Vec<[f64; 2]>,
    /// Area between the reliability curve and the diagonal (Gustafsson et al. 2020): 0 is perfect, ½ the worst.
    pub auce: f64,
    /// Mean of e / s.
    pub mean_ratio: f64,
    /// Mean negative log likelihood for each [`ErrorDensity`], nats.
    pub nll: [f64; 3],
    /// The same if all deviations are multiplied by the one factor that suits these errors best: what is lost by not
    /// knowing their common scale.
    pub nll_best_scale: [f64; 3],
}

impl Calibration {
    /// Compares absolute errors with the deviations claimed for them, in the same unit.
    ///
    /// `None` if there are no errors, or if a value is not finite or a deviation not above 0.
    ///
    /// # Panics
    /// If the lengths differ.
    #[must_use]
    pub fn new(absolute_error: &[f64], deviation: &[f64]) -> Option<Self> {
        assert_eq!(absolute_error.len(), deviation.len(), "one deviation for each error");
        let sound = |(e, s): (&f64, &f64)| *e >= 0.0 && e.is_finite() && *s > 0.0 && s.is_finite();
        if absolute_error.is_empty() || !absolute_error.iter().zip(deviation).all(sound) {
            return None;
        }
        let n = absolute_error.len() as f64;
        let mut ratios: Vec<f64> = absolute_error.iter().zip(deviation).map(|(e, s)| e / s).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        // By the ratios' order their probabilities are sorted, too.
        let found: Vec<f64> = ratios.iter().map(|z| libm::erf(z / SQRT_2)).collect();
        let share = |probability: f64| found.partition_point(|p| *p <= probability) as f64 / n;
        let nominal = (1..=POINTS).map(|k| k as f64 / (POINTS + 1) as f64);
        let reliability: Vec<[f64; 2]> = nominal.map(|p| [p, share(p)]).collect();
        let auce = reliability.iter().map(|[p, found]| (p - found).abs()).sum::<f64>() / POINTS as f64;
        let log_deviations = deviation.iter().map(|s| s.ln()).sum::<f64>() / n;
        let scaled = |density: ErrorDensity, factor: f64| {
            let sum: f64 = ratios.iter().map(|z| density.negative_log(z / factor)).sum();
            sum / n + factor.ln() + log_deviations
        };
        Some(Self {
            coverage: PROBABILITIES.map(|p| [p, share(p)]),
            reliability,
            auce,
            mean_ratio: ratios.iter().sum::<f64>() / n,
            nll: ErrorDensity::ALL.map(|density| scaled(density, 1.0)),
            nll_best_scale: ErrorDensity::ALL.map(|density| least(|log| scaled(density, log.exp()))),
        })
    }
}

/// The least value of a function with one minimum over factors e⁻²⁰ to e²⁰, by golden sections.
fn least(f: impl Fn(f64) -> f64) -> f64 {
    let golden = 0.5 * (5_f64.sqrt() - 1.0);
    let (mut low, mut high) = (-20.0, 20.0);
    // 40 · 0.618⁵⁰ is 1e-9: the value at the minimum is then right to rounding.
    for _ in 0..50 {
        let width = golden * (high - low);
        if f(high - width) < f(low + width) { high = low + width } else { low = high - width }
    }
    f(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of |e| for normal errors of these deviations: errors without chance.
    fn normal_errors(n: usize, scale: f64) -> (Vec<f64>, Vec<f64>) {
        let quantile = |p: f64| {
            let (mut low, mut high) = (0.0, 10.0);
            for _ in 0..60 {
                let middle: f64 = 0.5 * (low + high);
                if libm::erf(middle / SQRT_2) < p { low = middle } else { high = middle }
            }
            low
        };
        let deviations: Vec<f64> = (0..n).map(|i| 0.1 + (i * 7 % 13) as f64).collect();
        let errors = (0..n).map(|i| scale * deviations[i] * quantile((i as f64 + 0.5) / n as f64)).collect();
        (errors, deviations)
    }

    #[test]
    fn normal_errors_are_calibrated_and_a_wrong_scale_is_found() {
        let (errors, deviations) = normal_errors(4000, 1.0);
        let found = Calibration::new(&errors, &deviations).unwrap();
        for [expected, found] in found.coverage {
            assert!((found - expected).abs() < 1e-3, "{found} instead of {expected}");
        }
        // The mean of a half normal variable; the entropy of a normal one.
        assert!(found.auce < 1e-3 && (found.mean_ratio - (2.0 / PI).sqrt()).abs() < 1e-3, "{found:?}");
        let log = deviations.iter().map(|s| s.ln()).sum::<f64>() / 4000.0;
        assert!((found.nll[0] - 0.5 - 0.5 * (2.0 * PI).ln() - log).abs() < 2e-3, "{found:?}");
        assert!((found.nll[0] - found.nll_best_scale[0]).abs() < 1e-3);

        // Deviations a third of what they should be: one in three within one of them, and the scale mends it.
        let (errors, deviations) = normal_errors(4000, 3.0);
        let narrow = Calibration::new(&errors, &deviations).unwrap();
        let within = libm::erf(1.0 / (3.0 * SQRT_2));
        // 68 % are within 0.9945 deviations, not 1: 0.0014 less. Quantiles stand 1 / 4000 apart.
        let one = narrow.reliability[67][1];
        assert!((one - within).abs() < 2e-3, "{one} instead of {within}");
        assert!(narrow.auce > 0.25 && narrow.nll[0] > narrow.nll_best_scale[0] + 2.0, "{narrow:?}");
        assert!((narrow.nll_best_scale[0] - found.nll[0] - 3_f64.ln()).abs() < 1e-3, "{narrow:?}");
    }

    #[test]
    fn densities_integrate_to_one_with_deviation_one() {
        for density in ErrorDensity::ALL {
            let (mut mass, mut variance) = (0.0, 0.0);
            // Student's tail holds 2e-7 of the mass and 4e-3 of the variance beyond 300.
            let width = 1e-3;
            for i in 0..600_000 {
                let z = -300.0 + width * (f64::from(i) + 0.5);
                let p = (-density.negative_log(z)).exp() * width;
                (mass, variance) = (mass + p, variance + p * z * z);
            }
            assert!((mass - 1.0).abs() < 1e-5 && (variance - 1.0).abs() < 6e-3, "{density:?}: {mass}, {variance}");
        }
    }

    #[test]
    fn what_cannot_be_compared_has_no_calibration() {
        assert!(Calibration::new(&[], &[]).is_none());
        assert!(Calibration::new(&[1.0], &[0.0]).is_none());
        assert!(Calibration::new(&[f64::NAN], &[1.0]).is_none());
    }
}
