//! σ_v of every vertex, in four bytes or in two.

use std::sync::LazyLock;

use half::f16;

/// The storage of deviations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Store {
    /// σ in four bytes; rounding changes log10 U by 3e-8
    #[default]
    F32,
    /// log10 of σ over the prior in two bytes; rounding changes log10 U by at most |log10 (U / prior)| / 2048
    F16,
}

/// Deviations by vertex, scene units.
///
/// Sixteen bits cannot hold σ itself, which spans ten decades or more. They hold v = log10(σ / unit) instead, and
/// σ is looked up in a table of all 65,536 powers.
#[derive(Debug, Clone, PartialEq)]
pub enum StandardDeviations {
    /// σ.
    F32(Vec<f32>),
    /// σ = unit · 10^v.
    F16 {
        /// The prior's deviation, so that unseen vertices are exact.
        unit: f32,
        /// v.
        logs: Vec<f16>,
    },
}

/// 10^v for every f16 v, indexed by its bits.
static POWERS: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=u16::MAX).map(|bits| 10_f64.powf(f16::from_bits(bits).to_f64()) as f32).collect());

impl StandardDeviations {
    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::F16 { logs, .. } => logs.len(),
        }
    }

    /// Whether there are no vertices.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// σ of vertex `v`.
    #[must_use]
    pub fn get(&self, v: usize) -> f64 {
        match self {
            Self::F32(values) => f64::from(values[v]),
            Self::F16 { unit, logs } => f64::from(*unit) * f64::from(POWERS[usize::from(logs[v].to_bits())]),
        }
    }

    /// σ of all vertices.
    pub fn iter(&self) -> impl Iterator<Item = f64> + '_ {
        (0..self.len()).map(|v| self.get(v))
    }

    /// The storage of the deviations.
    #[must_use]
    pub fn store(&self) -> Store {
        match self {
            Self::F32(_) => Store::F32,
            Self::F16 { .. } => Store::F16,
        }
    }

    /// The same deviations in two bytes each, relative to the prior's deviation `unit`.
    #[must_use]
    pub fn to_f16(&self, unit: f64) -> Self {
        let unit = unit as f32;
        let logs = self.iter().map(|sigma| f16::from_f64((sigma / f64::from(unit)).log10())).collect();
        Self::F16 { unit, logs }
    }

    /// The largest change of log10 σ by [`StandardDeviations::to_f16`] over all vertices.
    ///
    /// f16 has 11 significant bits and no exponent below −14. The powers in the table are f32.
    #[must_use]
    pub fn f16_rounding(&self, unit: f64) -> f64 {
        let largest = self.iter().map(|sigma| (sigma / unit).log10().abs()).fold(0.0, f64::max);
        largest * 2.0_f64.powi(-11) + 2.0_f64.powi(-25) + 1e-7
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn memory(&self) -> usize {
        match self {
            Self::F32(values) => values.capacity() * size_of::<f32>(),
            Self::F16 { logs, .. } => logs.capacity() * size_of::<f16>(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sixteen_bits_keep_the_promised_digits(logs in proptest::collection::vec(-12.0..0.5_f64, 1..50), unit in -6..6_i32) {
            let unit = 10_f64.powi(unit);
            let full = StandardDeviations::F32(logs.iter().map(|v| (unit * 10_f64.powf(*v)) as f32).collect());
            let half = full.to_f16(unit);
            let bound = full.f16_rounding(unit);
            prop_assert!(bound <= 0.006);
            for (a, b) in full.iter().zip(half.iter()) {
                prop_assert!((a / b).log10().abs() <= bound, "{} became {}", a, b);
            }
        }
    }

    #[test]
    fn the_prior_is_exact_and_the_bound_is_not_idle() {
        let full = StandardDeviations::F32((0..1000).map(|i| 10_f32.powf(-7.0 - 0.001 * i as f32)).collect());
        let half = full.to_f16(1.0);
        let worst = full.iter().zip(half.iter()).map(|(a, b)| (a / b).log10().abs()).fold(0.0, f64::max);
        assert!(worst > 0.4 * full.f16_rounding(1.0), "{worst}");
        assert_eq!(StandardDeviations::F32(vec![0.1]).to_f16(f64::from(0.1_f32)).get(0), f64::from(0.1_f32));
        assert_eq!((half.memory(), half.len(), half.store()), (2000, 1000, Store::F16));
    }
}
