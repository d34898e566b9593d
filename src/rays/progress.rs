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
