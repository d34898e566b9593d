//! How many of what is looked for a score finds.

/// The largest share of what `is_positive` that a threshold of the score finds, of all thresholds above which at least
/// `precision` of them are; 0 if there is none.
#[must_use]
pub fn recall_at(precision: f64, score: &[f64], is_positive: &[bool]) -> f64 {
    let all = is_positive.iter().filter(|is| **is).count().max(1) as f64;
    let found = marked(score, is_positive).filter(|[marked, hits]| *hits >= precision * marked);
    found.last().map_or(0.0, |[_, hits]| hits / all)
}

/// The share of what `is_positive` above the highest threshold of the score that finds `recall` of it all.
#[must_use]
pub fn precision_of(recall: f64, score: &[f64], is_positive: &[bool]) -> f64 {
    let all = is_positive.iter().filter(|is| **is).count() as f64;
    let found = marked(score, is_positive).find(|[_, hits]| *hits >= recall * all);
    found.map_or(1.0, |[marked, hits]| hits / marked)
}

/// For each threshold of the score, from the highest, how many are above it, and how many of these `is_positive`.
fn marked<'a>(score: &'a [f64], is_positive: &'a [bool]) -> impl Iterator<Item = [f64; 2]> {
    let mut order: Vec<usize> = (0..score.len()).collect();
    order.sort_by(|&a, &b| score[b].total_cmp(&score[a]));
    let equal: Vec<Vec<usize>> = order.chunk_by(|&a, &b| score[a] == score[b]).map(<[usize]>::to_vec).collect();
    equal.into_iter().scan([0.0; 2], |sums, equal| {
        sums[0] += equal.len() as f64;
        sums[1] += equal.iter().filter(|&&i| is_positive[i]).count() as f64;
        Some(*sums)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_threshold_marks_all_of_equal_scores() {
        let positive = [true, true, false, true, false];
        assert_eq!(recall_at(0.9, &[5.0, 4.0, 3.0, 2.0, 1.0], &positive), 2.0 / 3.0);
        assert_eq!(recall_at(0.7, &[5.0, 4.0, 3.0, 2.0, 1.0], &positive), 1.0);
        // The second and third are marked together.
        assert_eq!(recall_at(0.9, &[5.0, 3.0, 3.0, 2.0, 1.0], &positive), 1.0 / 3.0);
        assert_eq!(recall_at(0.9, &[1.0; 5], &positive), 0.0);
        let precision = |recall| precision_of(recall, &[5.0, 3.0, 3.0, 2.0, 1.0], &positive);
        assert_eq!([0.3, 0.5, 1.0].map(precision), [1.0, 2.0 / 3.0, 0.75]);
    }
}
