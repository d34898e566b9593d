//! Greedy selection: the best view, then the best beside it, and so on.
//!
//! All gains here are submodular: what a view adds only falls as others are taken. The greedy choice is then worth at
//! least 1 − 1/e of the best set of the same size (Nemhauser, Wolsey, Fisher 1978). A gain found earlier bounds what it
//! is now from above, so that only those at the head of the list are found anew (Minoux 1978).

use super::Rescoring;

/// Gains are rounded, so that a bound holds to within this share.
const ROUNDING: f64 = 1e-9;

/// The list of candidates that remain, each with its latest gain.
pub struct Candidates {
    /// Number of the candidate, its latest gain, and how many had been taken when it was found.
    remaining: Vec<(usize, f64, usize)>,
    taken: usize,
    /// Number of gains found after the first ones.
    pub rescored: usize,
}

impl Candidates {
    /// All of them, with their gains before any is taken.
    pub fn new(gains: &[f64]) -> Self {
        let remaining = gains.iter().copied().enumerate().map(|(candidate, gain)| (candidate, gain, 0)).collect();
        Self { remaining, taken: 0, rescored: 0 }
    }

    /// Takes the candidate of the largest gain, the first of several; `None` if none is left. `gain` finds the gain of
    /// a candidate now.
    ///
    /// # Errors
    /// What `gain` returns.
    pub fn take<E>(
        &mut self,
        rescoring: Rescoring,
        mut gain: impl FnMut(usize) -> Result<f64, E>,
    ) -> Result<Option<(usize, f64)>, E> {
        // From the largest bound; equal ones in their order.
        self.remaining.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let mut best: Option<(usize, f64)> = None;
        for (candidate, latest, when) in &mut self.remaining {
            let is_beaten = best.is_some_and(|(_, found)| *latest * (1.0 + ROUNDING) < found);
            if is_beaten && rescoring == Rescoring::Lazy {
                break;
            }
            if *when < self.taken {
                (*latest, *when) = (gain(*candidate)?, self.taken);
                self.rescored += 1;
            }
            let is_better = |(other, found): (usize, f64)| *latest > found || (*latest == found && *candidate < other);
            if best.is_none_or(is_better) {
                best = Some((*candidate, *latest));
            }
        }
        if let Some((taken, _)) = best {
            self.remaining.retain(|(candidate, ..)| *candidate != taken);
            self.taken += 1;
        }
        Ok(best)
    }
}
