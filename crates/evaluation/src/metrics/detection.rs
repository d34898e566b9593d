//! Does a score separate two kinds of pixels, such as those of surfaces that no training view saw?

/// How well a score detects what is positive.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Detection {
    /// Area under the receiver operating characteristic: the chance that a positive has a larger score than a
    /// negative, ties counted half. 1 is perfect, ½ is chance.
    pub auroc: f64,
    /// Area under the precision–recall curve, as average precision. 1 is perfect, the share of positives is chance.
    pub aupr: f64,
    /// Share of positives.
    pub positives: f64,
}

impl Detection {
    /// Judges a score (larger: more likely positive) against the truth.
    ///
    /// `None` if one of the two kinds is missing, or if a score is NaN.
    ///
    /// # Panics
    /// If the lengths differ.
    #[must_use]
    pub fn new(score: &[f64], is_positive: &[bool]) -> Option<Self> {
        assert_eq!(score.len(), is_positive.len(), "one score for each truth");
        let positives = is_positive.iter().filter(|positive| **positive).count();
        let negatives = is_positive.len() - positives;
        if positives == 0 || negatives == 0 || score.iter().any(|s| s.is_nan()) {
            return None;
        }
        let mut order: Vec<usize> = (0..score.len()).collect();
        order.sort_unstable_by(|&a, &b| score[b].total_cmp(&score[a]));
        let (mut hits, mut alarms, mut pairs, mut precision) = (0.0, 0.0, 0.0, 0.0);
        // Equal scores are one step of both curves.
        for tied in order.chunk_by(|&a, &b| score[a] == score[b]) {
            let new_hits = tied.iter().filter(|&&i| is_positive[i]).count() as f64;
            let new_alarms = tied.len() as f64 - new_hits;
            pairs += new_alarms * (hits + 0.5 * new_hits);
            (hits, alarms) = (hits + new_hits, alarms + new_alarms);
            precision += new_hits * hits / (hits + alarms);
        }
        let (positives, negatives) = (positives as f64, negatives as f64);
        Some(Self {
            auroc: pairs / (positives * negatives),
            aupr: precision / positives,
            positives: positives / (positives + negatives),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn agrees_with_scikit_learn() {
        // roc_auc_score and average_precision_score of scikit-learn's documentation.
        let found = Detection::new(&[0.1, 0.4, 0.35, 0.8], &[false, false, true, true]).unwrap();
        assert_eq!(found.auroc, 0.75);
        assert!((found.aupr - 0.833_333_333_333).abs() < 1e-9, "{found:?}");
        assert_eq!(found.positives, 0.5);
    }

    #[test]
    fn what_cannot_be_told_is_chance() {
        let found = Detection::new(&[1.0; 8], &[true, false, false, false, true, false, false, false]).unwrap();
        assert_eq!([found.auroc, found.aupr], [0.5, 0.25]);
        assert!(Detection::new(&[1.0, 2.0], &[true, true]).is_none());
        assert!(Detection::new(&[1.0, f64::NAN], &[true, false]).is_none());
    }

    proptest! {
        #[test]
        fn as_counted_pair_by_pair(pixels in proptest::collection::vec((0..5_i32, any::<bool>()), 2..60)) {
            let (score, positive): (Vec<f64>, Vec<bool>) = pixels.iter().map(|&(s, p)| (f64::from(s), p)).unzip();
            let of = |kind: bool| score.iter().zip(&positive).filter(move |(_, p)| **p == kind).map(|(s, _)| *s);
            let pairs = of(true).flat_map(|p| {
                of(false).map(move |n| if p > n { 1.0 } else if p == n { 0.5 } else { 0.0 })
            });
            let pairs: Vec<f64> = pairs.collect();
            let found = Detection::new(&score, &positive);
            prop_assert_eq!(found.is_some(), !pairs.is_empty());
            if let Some(found) = found {
                let mean = pairs.iter().sum::<f64>() / pairs.len() as f64;
                prop_assert!((found.auroc - mean).abs() < 1e-12, "{} against {mean}", found.auroc);
                prop_assert!(found.aupr >= 0.0 && found.aupr <= 1.0 + 1e-12);
            }
        }
    }
}
