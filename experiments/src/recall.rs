//! How many of what is looked for a score finds.

/// The largest share of what `is_positive` that a threshold of the score finds, of all thresholds above which at least
/// `precision` of them are; 0 if there is none.
#[must_use]
pub fn recall_at(precision: f64, score: &[f64], is_positive: &[bool]) -> f64 {
    let all = is_positive.iter().filter(|is| **is).count().max(1) as f64;
    let mut order: Vec<usize> = (0..score.len()).collect();
    order.sort_by(|&a, &b| score[b].total_cmp(&score[a]));
    let (mut marked, mut hits, mut most) = (0.0, 0.0, 0.0);
    for equal in order.chunk_by(|&a, &b| score[a] == score[b]) {
        marked += equal.len() as f64;
        hits += equal.iter().filter(|&&i| is_positive[i]).count() as f64;
        if hits >= precision * marked {
            most = hits / all;
        }
    }
    most
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
    }
}
