//! Split conformal prediction: intervals that hold by counting, whatever the errors' density.
//!
//! Letters: e an absolute error, s the deviation claimed for it, z = e / s, n the number of errors, p a probability.

/// The factor q for which |error| ≤ q s holds for a further pixel with a probability of at least p, if it and these n
/// pixels are exchangeable: the ⌈(n + 1) p⌉-th smallest z (Vovk et al. 2005; Lei et al. 2018, algorithm 2).
///
/// `None` if there are too few errors for p, if a z is NaN, or if p is not inside (0, 1).
#[must_use]
pub fn conformal_factor(ratios: &[f64], probability: f64) -> Option<f64> {
    if ratios.iter().any(|z| z.is_nan()) || !(probability > 0.0 && probability < 1.0) {
        return None;
    }
    let rank = ((ratios.len() as f64 + 1.0) * probability).ceil() as usize;
    let mut sorted = ratios.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(rank.max(1) - 1).copied().filter(|q| q.is_finite())
}

#[cfg(test)]
mod tests {
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn the_factor_is_the_next_larger_of_the_ratios() {
        let ratios = [0.4, 0.1, 0.3, 0.2];
        // (4 + 1) p = 4 at p = 0.8; beyond that four errors are too few.
        assert_eq!(conformal_factor(&ratios, 0.8), Some(0.4));
        assert_eq!(conformal_factor(&ratios, 0.5), Some(0.3));
        assert_eq!(conformal_factor(&ratios, 0.81), None);
        assert_eq!(conformal_factor(&[f64::INFINITY; 9], 0.9), None);
        assert_eq!(conformal_factor(&[f64::NAN, 1.0, 1.0], 0.1), None);
        assert_eq!(conformal_factor(&ratios, 1.0), None);
    }

    /// The guarantee: over draws of 19 errors and one more, at least p of the further ones lie inside, and no more than
    /// p + 1 / (n + 1) if no two are equal.
    #[test]
    fn further_errors_lie_inside_as_often_as_promised() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // Heavy tails: the reciprocal of a uniform number.
        let mut error = || 1.0 / random.random_range(1e-6..1.0_f64);
        let (draws, n, p) = (20_000, 19, 0.9);
        let inside = |()| {
            let ratios: Vec<f64> = (0..n).map(|_| error()).collect();
            error() <= conformal_factor(&ratios, p).unwrap()
        };
        let share = std::iter::repeat_n((), draws).map(inside).filter(|inside| *inside).count() as f64 / draws as f64;
        // Three standard errors of a share of 0.9 of 20,000 are 0.0064; (19 + 1) p is whole, so that it is p itself.
        assert!((share - p).abs() < 0.0064, "{share}");
    }
}
