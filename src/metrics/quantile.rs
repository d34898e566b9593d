//! Values that a share of others does not exceed.

/// Quantile by nearest rank: the smallest value that is not exceeded by at least this share of the ascending values.
///
/// NaN if there are no values.
#[must_use]
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied().unwrap_or(f64::NAN)
}

/// Median: the middle value, or the mean of the two in the middle. NaN if there are no values.
#[must_use]
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let half = sorted.len() / 2;
    sorted.get(half).map_or(f64::NAN, |upper| 0.5 * (sorted[sorted.len() - 1 - half] + upper))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_of_nearest_rank() {
        let values = [1.0, 2.0, 3.0, 4.0];
        let shares = [0.0, 0.25, 0.26, 0.5, 0.75, 0.76, 1.0];
        assert_eq!(shares.map(|share| quantile(&values, share)), [1.0, 1.0, 2.0, 2.0, 3.0, 4.0, 4.0]);
        assert_eq!(quantile(&[7.0], 0.95), 7.0);
        assert!(quantile(&[], 0.5).is_nan());
        assert_eq!([median([7.0, 1.0, 2.0]), median([7.0, 1.0, 2.0, 4.0])], [2.0, 3.0]);
        assert!(median([]).is_nan());
    }
}
