//! Area under the sparsification error (AUSE): how well does the uncertainty rank the error?
//!
//! Pixels are removed in 100 equal steps, most uncertain first, while the mean error of the rest is recorded. The
//! oracle removes the largest errors first. Both curves are divided by their common maximum. The area between them
//! follows from the trapezoid rule over the removed shares 0, 0.01, …, 0.99 (Ilg et al. 2018; exactly the procedure
//! of the Bayes' Rays code, which took it from CF-NeRF). 0 is a perfect ranking. Each of several pixels of equal
//! uncertainty counts with their mean error, as in any order on average; the original keeps the order of the frames.

/// Number of points of a curve.
pub const STEPS: usize = 100;

/// Which error is averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ErrorKind {
    /// Mean absolute error.
    Mae,
    /// Mean squared error.
    Mse,
    /// Root of the mean squared error.
    Rmse,
}

impl ErrorKind {
    /// All kinds of error.
    pub const ALL: [Self; 3] = [Self::Mae, Self::Mse, Self::Rmse];
}

/// Two sparsification curves and the area between them.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Sparsification {
    /// `[STEPS]`: share of the pixels removed.
    pub removed: Vec<f64>,
    /// `[STEPS]`: error left after the most uncertain pixels are removed, relative to the common maximum.
    pub by_uncertainty: Vec<f64>,
    /// `[STEPS]`: error left after the largest errors are removed, relative to the common maximum.
    pub by_error: Vec<f64>,
    /// Area under the sparsification error.
    pub area: f64,
    /// Common maximum of both curves, in scene units (squared for [`ErrorKind::Mse`]).
    pub largest: f64,
}

impl Sparsification {
    /// Risk: the error left, averaged over the removed shares, scene units (squared for [`ErrorKind::Mse`]). The area
    /// under the risk–coverage curve, where coverage is the share of pixels that are kept.
    #[must_use]
    pub fn risk(&self) -> f64 {
        self.largest * self.by_uncertainty.iter().sum::<f64>() / STEPS as f64
    }

    /// How far the curve by uncertainty rises above its start, where all pixels are left, in parts of the start; 0 if it
    /// does not. Where it rises, the common maximum is larger than the start, and the [area](Self::area) smaller than
    /// one in units of the start: a ranking that keeps the largest errors for the end gains by it.
    #[must_use]
    pub fn rise(&self) -> f64 {
        self.by_uncertainty.iter().fold(0.0_f64, |most, &error| most.max(error)) / self.by_uncertainty[0] - 1.0
    }

    /// The area if both curves are divided by their start, which they share.
    #[must_use]
    pub fn area_from_start(&self) -> f64 {
        self.area / self.by_uncertainty[0]
    }

    /// The least risk that an order of these pixels can have: the oracle's.
    #[must_use]
    pub fn least_risk(&self) -> f64 {
        self.largest * self.by_error.iter().sum::<f64>() / STEPS as f64
    }
}

/// Computes the curves from the absolute errors and the uncertainties of the same pixels.
///
/// Only the order of the uncertainties matters. `None` if there are fewer than [`STEPS`] pixels (the last step would
/// average nothing), if a value is NaN, or if all errors are zero (there is nothing to rank).
///
/// ```
/// use octobayes_evaluation::metrics::{ErrorKind, sparsification};
///
/// let errors: Vec<f64> = (0..1000).map(f64::from).collect();
/// // An uncertainty that ranks pixels as their errors do leaves no area; the reverse order leaves much.
/// let reversed: Vec<f64> = errors.iter().map(|e| -e).collect();
/// let area = |uncertainty: &[f64]| sparsification(uncertainty, &errors, ErrorKind::Mae).map(|s| s.area);
/// assert_eq!(area(&errors), Some(0.0));
/// assert!(area(&reversed) > Some(0.45));
/// ```
#[must_use]
pub fn sparsification(uncertainty: &[f64], absolute_error: &[f64], kind: ErrorKind) -> Option<Sparsification> {
    assert_eq!(uncertainty.len(), absolute_error.len(), "one uncertainty per error");
    let n = uncertainty.len();
    if n < STEPS || uncertainty.iter().chain(absolute_error).any(|v| v.is_nan()) {
        return None;
    }
    let cost = |i: usize| match kind {
        ErrorKind::Mae => absolute_error[i],
        ErrorKind::Mse | ErrorKind::Rmse => absolute_error[i] * absolute_error[i],
    };
    // Multiples of 0.01, truncated as in the original: for some of them (1 − r) n is a hair below a whole number.
    let removed: Vec<f64> = (0..STEPS).map(|k| k as f64 * (1.0 / STEPS as f64)).collect();
    let curve = |key: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let mut order: Vec<usize> = (0..n).collect();
        // By cost as well, so that not even the rounding of sums depends on the order of the pixels.
        order.sort_by(|&a, &b| key(a).total_cmp(&key(b)).then(cost(a).total_cmp(&cost(b))));
        // Sums of the costs of the first k pixels, k = 0 … n.
        let mut sums = vec![0.0];
        for equal in order.chunk_by(|&a, &b| key(a) == key(b)) {
            let mean = equal.iter().map(|&i| cost(i)).sum::<f64>() / equal.len() as f64;
            let before = sums[sums.len() - 1];
            sums.extend((1..=equal.len()).map(|k| before + k as f64 * mean));
        }
        let left = |share: f64| ((1.0 - share) * n as f64) as usize;
        let mean = |share: f64| sums[left(share)] / left(share) as f64;
        removed.iter().map(|&r| if kind == ErrorKind::Rmse { mean(r).sqrt() } else { mean(r) }).collect()
    };
    let mut by_uncertainty = curve(&|i| uncertainty[i]);
    let mut by_error = curve(&|i| absolute_error[i]);
    let largest = by_uncertainty.iter().chain(&by_error).fold(0.0_f64, |m, &v| m.max(v));
    if largest <= 0.0 {
        return None;
    }
    by_uncertainty.iter_mut().chain(&mut by_error).for_each(|v| *v /= largest);
    let between = |k: usize| by_uncertainty[k] - by_error[k];
    let area = (1..STEPS).map(|k| 0.5 * (between(k) + between(k - 1)) * (removed[k] - removed[k - 1])).sum();
    Some(Sparsification { removed, by_uncertainty, by_error, area, largest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_perfect_ranking_has_area_zero() {
        let error: Vec<f64> = (0..1000).map(f64::from).collect();
        assert_eq!(sparsification(&error, &error, ErrorKind::Mae).unwrap().area, 0.0);
    }

    #[test]
    fn risk_is_the_mean_error_left() {
        let error: Vec<f64> = (0..1000).map(f64::from).collect();
        let constant = vec![3.0; 1000];
        // Of 1000 − 10 k errors 0, 1, 2, … the mean is (999 − 10 k) / 2: 252 in the mean over k. Where (1 − r) n is a
        // hair below a whole number, one pixel less is left, and ½ less in the mean.
        let found = sparsification(&error, &error, ErrorKind::Mae).unwrap();
        assert!((251.5..=252.0).contains(&found.risk()) && found.risk() == found.least_risk(), "{}", found.risk());
        let constant = sparsification(&error, &constant, ErrorKind::Mae).unwrap();
        assert!((constant.risk() - 3.0).abs() < 1e-12 && (constant.least_risk() - 3.0).abs() < 1e-12);
    }

    /// A ranking that leaves the largest errors for the end: its own curve rises, so that the common maximum is large
    /// and the area small. In units of the start it is not.
    #[test]
    fn a_curve_that_rises_gains_nothing_from_the_start() {
        let error: Vec<f64> = (0..1000).map(|i| if i < 10 { 1000.0 } else { f64::from(i) / 1000.0 }).collect();
        let kept: Vec<f64> = error.iter().map(|e| if *e > 1.0 { -1.0 } else { *e }).collect();
        let (bad, perfect) = (
            sparsification(&kept, &error, ErrorKind::Mae).unwrap(),
            sparsification(&error, &error, ErrorKind::Mae).unwrap(),
        );
        // From 10.5 in the mean of all to 1000 in the last ten, which are the disasters.
        let mean = error.iter().sum::<f64>() / 1000.0;
        assert!((bad.rise() - (1000.0 / mean - 1.0)).abs() < 1e-9, "{}", bad.rise());
        assert!(perfect.rise().abs() < 1e-12 && perfect.area_from_start() == 0.0);
        assert!(bad.area < 0.1 && bad.area_from_start() > 4.0, "{} {}", bad.area, bad.area_from_start());
        assert!((bad.area_from_start() - bad.area * (1.0 + bad.rise())).abs() < 1e-9);
    }

    #[test]
    fn agrees_with_numpy() {
        // Computed with NumPy 2 by the original's steps: sort, slice to int((1 - r) * n),
        // mean, common maximum, trapezoid.
        let error: Vec<f64> = (0..1000).map(f64::from).collect();
        let reversed: Vec<f64> = error.iter().map(|e| -e).collect();
        let scattered: Vec<f64> = error.iter().map(|i| (i * 0.618_033_988_749_894_9) % 1.0).collect();
        let related: Vec<f64> = (0..1000)
            .map(|i| {
                (f64::from(i) * 0.754_877_666_246_692_7 + 0.3 * scattered[i as usize]) % 1.0
                    + 0.5 * scattered[i as usize]
            })
            .collect();
        let expected = [
            (&reversed, &error, [0.493_041_729_512_317_8, 0.495_268_556_279_659_43, 0.476_101_636_668_403_55]),
            (&related, &scattered, [0.249_619_949_646_894_32, 0.314_616_269_432_270_6, 0.277_199_092_984_935_6]),
        ];
        for (uncertainty, error, areas) in expected {
            for (kind, area) in ErrorKind::ALL.into_iter().zip(areas) {
                let found = sparsification(uncertainty, error, kind).unwrap().area;
                assert!((found - area).abs() < 1e-12, "{kind:?}: {found} against {area}");
            }
        }
    }

    #[test]
    fn pixels_of_equal_uncertainty_have_no_order() {
        // 600 pixels of equal uncertainty, with errors 1 to 600; the other 400 are more certain, without error.
        let (uncertainty, mut error) = ([vec![1.0; 600], vec![0.0; 400]].concat(), vec![0.0; 1000]);
        error.iter_mut().zip(1..=600).for_each(|(error, i)| *error = f64::from(i));
        let found = sparsification(&uncertainty, &error, ErrorKind::Mae).unwrap();
        // At half, 100 of the 600 are left, of 300.5 on average.
        assert!((found.by_uncertainty[50] * found.largest - 100.0 * 300.5 / 500.0).abs() < 1e-9, "{found:?}");
        for kind in ErrorKind::ALL {
            let found = sparsification(&uncertainty, &error, kind).unwrap();
            let [u, e] = [&uncertainty, &error].map(|values| values.iter().rev().copied().collect::<Vec<f64>>());
            assert_eq!(sparsification(&u, &e, kind).unwrap(), found, "the other way round");
        }
    }

    #[test]
    fn nothing_to_rank_is_no_number() {
        assert!(sparsification(&[0.0; 99], &[1.0; 99], ErrorKind::Mae).is_none());
        assert!(sparsification(&[0.0; 200], &[0.0; 200], ErrorKind::Rmse).is_none());
        let mut error = vec![1.0; 200];
        error[7] = f64::NAN;
        assert!(sparsification(&[0.0; 200], &error, ErrorKind::Mae).is_none());
    }

    proptest! {
        #[test]
        fn only_the_ranking_counts(values in proptest::collection::vec((0.0..1.0_f64, 0.0..1.0_f64), 100..300)) {
            let (uncertainty, error): (Vec<f64>, Vec<f64>) = values.into_iter().unzip();
            let monotone: Vec<f64> = uncertainty.iter().map(|u| 3.0 * u.powi(3) - 7.0).collect();
            for kind in ErrorKind::ALL {
                let a = sparsification(&uncertainty, &error, kind).unwrap();
                let b = sparsification(&monotone, &error, kind).unwrap();
                prop_assert_eq!(a.area, b.area);
                prop_assert!((-1e-12..=1.0).contains(&a.area));
                // The oracle's curve never rises.
                prop_assert!(a.by_error.windows(2).all(|w| w[1] <= w[0] + 1e-12));
            }
        }
    }
}
