//! How far a run has come.

use std::iter::Sum;
use std::ops::Add;

/// What came out of a run so far, apart from the samples themselves: also the place where it can be taken up again.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct RunProgress {
    /// Batches of the share that are done.
    pub batches: u64,
    /// Rays drawn: R.
    pub rays: u64,
    /// Samples with a Jacobian.
    pub samples: u64,
    /// Rays dropped because the field was not finite.
    pub dropped: u64,
    /// Position of the first sample that was not.
    pub first_invalid: Option<[f32; 3]>,
}

impl Add for RunProgress {
    type Output = Self;

    /// Both runs together.
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
