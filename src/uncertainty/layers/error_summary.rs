//! What the error bars of a field come to, over the vertices that moved.

use half::f16;

use super::error_bars::UNKNOWN;
use crate::uncertainty::{MOVED, UncertaintyField};

/// Summary of the error bars of the vertices that moved by more than half a decade from the prior.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct ErrorSummary {
    /// Number of groups of rays that were compared.
    pub groups: u16,
    /// Number of vertices that moved.
    pub moved: usize,
    /// Number of those that enough rays saw for their error to be known.
    pub known: usize,
    /// Root mean square of their errors, decades.
    pub root_mean_square: f64,
    /// Median, decades.
    pub median: f64,
}

impl UncertaintyField {
    /// Summary of the error bars of the moved vertices, if the field has error bars.
    #[must_use]
    pub fn error_summary(&self) -> Option<ErrorSummary> {
        let groups = self.error_bars()?.groups();
        // Errors have few values, and bits of f16 their order: so there is no list of them.
        let (mut moved, mut known, mut squares, mut counts) = (0, 0, 0.0, vec![0; usize::from(UNKNOWN)]);
        for error in self.errors_of_moved() {
            moved += 1;
            if let Some(error) = error {
                known += 1;
                squares += error * error;
                counts[usize::from(f16::from_f64(error).to_bits())] += 1;
            }
        }
        let root_mean_square = (squares / known.max(1) as f64).sqrt();
        Some(ErrorSummary { groups, moved, known, root_mean_square, median: median(&counts, known) })
    }

    /// `[moved vertices]`: the error of each, decades, `None` where it is unknown. Empty without error bars.
    pub(crate) fn errors_of_moved(&self) -> impl Iterator<Item = Option<f64>> {
        let limit = self.prior() * 10_f64.powf(-MOVED);
        let bars = self.error_bars().into_iter().flat_map(|bars| (0..bars.len()).map(|v| (v, bars.get(v))));
        bars.filter(move |(v, _)| self.deviations.get(*v) < limit).map(|(_, error)| error)
    }
}

/// The median of so many numbers, given how often each f16 is among them, by its bits; 0 if there are none.
fn median(counts: &[usize], all: usize) -> f64 {
    let nth = |n: usize| {
        let mut before = 0;
        let bits = counts.iter().position(|count| {
            before += count;
            before > n
        });
        bits.map_or(0.0, |bits| f16::from_bits(bits as u16).to_f64())
    };
    let half = all / 2;
    0.5 * (nth(half.saturating_sub(1 - all % 2)) + nth(half))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn medians_of_counts_are_those_of_lists(bits in proptest::collection::vec(0..0x7c00_u16, 0..30)) {
            let mut counts = vec![0; usize::from(UNKNOWN)];
            bits.iter().for_each(|bits| counts[usize::from(*bits)] += 1);
            let list = crate::metrics::median(bits.iter().map(|bits| f16::from_bits(*bits).to_f64()));
            prop_assert_eq!(median(&counts, bits.len()), if bits.is_empty() { 0.0 } else { list });
        }
    }
}
