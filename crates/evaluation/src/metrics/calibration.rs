//! Calibration: do errors lie within the deviations that are claimed for them as often as they should?
//!
//! Letters: e an absolute error, s the standard deviation claimed for it, z = e / s.

use super::normal;

/// Probabilities whose intervals are reported.
pub const PROBABILITIES: [f64; 4] = [0.5, 0.68, 0.9, 0.95];

/// Points of the reliability curve: nominal probabilities 1/100, 2/100, …, 99/100.
const POINTS: usize = 99;

/// How well deviations predict the size of errors, which are taken to be normal.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Calibration {
    /// Mean of e / s.
    pub mean_ratio: f64,
    /// Each of [`PROBABILITIES`] (nominal), and the coverage of its interval.
    pub coverage: [[f64; 2]; PROBABILITIES.len()],
    /// `[99]`: nominal probability and the share found, for the reliability diagram.
    pub reliability: Vec<[f64; 2]>,
    /// Area between the reliability curve and the diagonal (Gustafsson et al. 2020): 0 is perfect, ½ the worst.
    pub auce: f64,
    /// Mean negative log likelihood, nats.
    pub nll: f64,
    /// The same if all deviations are multiplied by the one factor that suits these errors best: what is lost by not
    /// knowing their common scale.
    pub nll_best_scale: f64,
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
        let log_deviation = deviation.iter().map(|s| s.ln()).sum::<f64>() / n;
        // By the ratios' order their probabilities are sorted, too.
        let found: Vec<f64> = ratios.iter().map(|&z| normal::within(z)).collect();
        let share = |probability: f64| found.partition_point(|p| *p <= probability) as f64 / n;
        let nominal = (1..=POINTS).map(|k| k as f64 / (POINTS + 1) as f64);
        let reliability: Vec<[f64; 2]> = nominal.map(|p| [p, share(p)]).collect();
        let scaled = |factor: f64| {
            let sum: f64 = ratios.iter().map(|z| normal::negative_log(z / factor)).sum();
            sum / n + factor.ln() + log_deviation
        };
        Some(Self {
            mean_ratio: ratios.iter().sum::<f64>() / n,
            coverage: PROBABILITIES.map(|p| [p, share(p)]),
            auce: reliability.iter().map(|[p, found]| (p - found).abs()).sum::<f64>() / POINTS as f64,
            reliability,
            nll: scaled(1.0),
            nll_best_scale: least(|log| scaled(log.exp())),
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
    fn errors(n: usize, scale: f64) -> (Vec<f64>, Vec<f64>) {
        let deviations: Vec<f64> = (0..n).map(|i| 0.1 + (i * 7 % 13) as f64).collect();
        let quantile = |i: usize| normal::deviations((i as f64 + 0.5) / n as f64);
        let errors = (0..n).map(|i| scale * deviations[i] * quantile(i)).collect();
        (errors, deviations)
    }

    #[test]
    fn normal_errors_are_calibrated() {
        let (errors, deviations) = errors(4000, 1.0);
        let found = Calibration::new(&errors, &deviations).unwrap();
        for [expected, found] in found.coverage {
            assert!((found - expected).abs() < 1e-3, "{found} instead of {expected}");
        }
        assert!(found.auce < 1e-3 && (found.nll - found.nll_best_scale).abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn a_wrong_scale_is_found() {
        let (right, deviations) = errors(4000, 1.0);
        let found = Calibration::new(&right, &deviations).unwrap();
        // The mean of a half normal variable; the entropy of a normal one.
        let pi = std::f64::consts::PI;
        assert!((found.mean_ratio - (2.0 / pi).sqrt()).abs() < 1e-3, "{found:?}");
        let log = deviations.iter().map(|s| s.ln()).sum::<f64>() / 4000.0;
        assert!((found.nll - 0.5 - 0.5 * (2.0 * pi).ln() - log).abs() < 2e-3, "{found:?}");

        // Deviations a third of what they should be: one in three within one of them, and the scale mends it.
        let (large, deviations) = errors(4000, 3.0);
        let narrow = Calibration::new(&large, &deviations).unwrap();
        let within = normal::within(1.0 / 3.0);
        // 68 % are within 0.9945 deviations, not 1: 0.0014 less. Quantiles stand 1 / 4000 apart.
        let one = narrow.reliability[67][1];
        assert!((one - within).abs() < 2e-3, "{one} instead of {within}");
        assert!(narrow.auce > 0.25 && narrow.nll > narrow.nll_best_scale + 2.0, "{narrow:?}");
        assert!((narrow.nll_best_scale - found.nll - 3_f64.ln()).abs() < 1e-3, "{narrow:?}");
    }

    #[test]
    fn what_cannot_be_compared_has_no_calibration() {
        assert!(Calibration::new(&[], &[]).is_none());
        assert!(Calibration::new(&[1.0], &[0.0]).is_none());
        assert!(Calibration::new(&[f64::NAN], &[1.0]).is_none());
    }
}
