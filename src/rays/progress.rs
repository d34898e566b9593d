//! The progress of a run.

use std::iter::Sum;
use std::ops::Add;

/// Counts of a run so far, without the samples themselves. A run can be resumed from here.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct RunProgress {
    /// Completed batches of the shard.
    pub batches: u64,
    /// R, the number of rays drawn.
    pub rays: u64,
    /// Number of samples with a Jacobian.
    pub samples: u64,
    /// Number of rays dropped because the field was not finite.
    pub dropped: u64,
    /// Position of the first sample where the field was not finite.
    pub first_invalid: Option<[f32; 3]>,
}

impl Add for RunProgress {
    type Output = Self;

    /// The progress of both runs together.
    fn add(self, other: Self) -> Self {
        Self {
            batches: self.batches + other.batches,
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
            dropped: self.dropped + other.dropped,
            first_invalid: self.first_invalid.or(other.first_invalid),
        }
    }
}

impl Sum for RunProgress {
    fn sum<I: Iterator<Item = Self>>(runs: I) -> Self {
        runs.fold(Self::default(), Self::add)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_counts_add_up_and_the_first_invalid_sample_stays_the_first() {
        let run = |n: u64, first_invalid| RunProgress {
            batches: n,
            rays: 10 * n,
            samples: 100 * n,
            dropped: 1000 * n,
            first_invalid,
        };
        let runs = [run(1, None), run(2, Some([1.0; 3])), run(4, Some([2.0; 3]))];
        assert_eq!(runs.into_iter().sum::<RunProgress>(), run(7, Some([1.0; 3])));
        assert_eq!(runs[2] + runs[0], run(5, Some([2.0; 3])));
    }
}
