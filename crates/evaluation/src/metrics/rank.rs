//! Ranks make measures of different scales comparable.

/// Percentile of each value: the share of the other values that it exceeds, where ties count half.
///
/// 0 for the smallest, 1 for the largest, ½ if all are equal. Increasing functions of the values leave it unchanged.
/// NaN stays NaN and is left out of the other values.
#[must_use]
pub fn percentiles(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).filter(|&i| !values[i].is_nan()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut out = vec![f64::NAN; values.len()];
    let others = order.len().saturating_sub(1);
    let mut first = 0;
    while first < order.len() {
        let tied = order[first..].iter().take_while(|&&i| values[i] == values[order[first]]).count();
        let rank = first as f64 + 0.5 * (tied - 1) as f64;
        for &i in &order[first..first + tied] {
            out[i] = if others == 0 { 0.5 } else { rank / others as f64 };
        }
        first += tied;
    }
    out
}

/// Spearman's rank correlation of two measures of the same pixels: 1 if they order them alike, −1 if the other way.
///
/// `None` if there are fewer than two pixels, if a value is NaN, or if all values of one measure are equal.
///
/// # Panics
/// If the lengths differ.
#[must_use]
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    assert_eq!(a.len(), b.len(), "two measures of the same pixels");
    if a.iter().chain(b).any(|v| v.is_nan()) {
        return None;
    }
    // Percentiles have the mean ½, whatever is tied.
    let [a, b] = [a, b].map(|values| percentiles(values).into_iter().map(|p| p - 0.5).collect::<Vec<f64>>());
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let scale = (product(&a, &a) * product(&b, &b)).sqrt();
    (scale > 0.0).then(|| product(&a, &b) / scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn rank_correlation_is_that_of_scipy() {
        // scipy.stats.spearmanr([1, 2, 3, 4, 5], [5, 6, 7, 8, 7])
        let found = spearman(&[1.0, 2.0, 3.0, 4.0, 5.0], &[5.0, 6.0, 7.0, 8.0, 7.0]).unwrap();
        assert!((found - 0.820_782_681_668_123_3).abs() < 1e-12, "{found}");
        assert_eq!(spearman(&[1.0, 2.0, 3.0], &[9.0, 4.0, 1.0]), Some(-1.0));
        assert_eq!(spearman(&[1.0, 1.0], &[2.0, 3.0]), None);
        assert_eq!(spearman(&[1.0], &[2.0]), None);
    }

    #[test]
    fn ties_share_their_place() {
        assert_eq!(percentiles(&[5.0, -1.0, 7.0]), [0.5, 0.0, 1.0]);
        assert_eq!(percentiles(&[2.0, 1.0, 2.0, 9.0, 2.0]), [0.5, 0.0, 0.5, 1.0, 0.5]);
        assert_eq!(percentiles(&[4.0; 3]), [0.5; 3]);
        let found = percentiles(&[f64::NAN, 3.0, f64::NEG_INFINITY]);
        assert!(found[0].is_nan() && found[1..] == [1.0, 0.0]);
        assert!(percentiles(&[]).is_empty());
    }

    proptest! {
        #[test]
        fn as_counted_one_by_one(values in proptest::collection::vec(0..6_i32, 2..60)) {
            let values: Vec<f64> = values.into_iter().map(f64::from).collect();
            let found = percentiles(&values);
            for (&v, &p) in values.iter().zip(&found) {
                let below = values.iter().filter(|o| **o < v).count() as f64;
                let equal = values.iter().filter(|o| **o == v).count() as f64 - 1.0;
                prop_assert!((p - (below + 0.5 * equal) / (values.len() - 1) as f64).abs() < 1e-12);
            }
        }
    }
}
