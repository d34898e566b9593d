//! Root mean square errors of log10 U relative to the limit of infinitely many rays, by the delete-one-group jackknife.
//!
//! Letters: `G` groups of rays with independent pixels; `m_g` rays of group g, R = Σ m_g, h_g = R / m_g;
//! `θ` = log10 σ_v by all rays, `θ_g` by all but those of group g. With pseudo-values
//! p_g = h_g θ − (h_g − 1) θ_g and their weighted mean p̄,
//!
//! ```text
//! p̄ = G θ − Σ_g (1 − 1/h_g) θ_g        SE² = 1/G Σ_g (p_g − p̄)² / (h_g − 1)
//! bias = θ − p̄                         E² = SE² + bias²
//! ```
//!
//! (Quenouille 1956, Tukey 1958; for groups of unequal size Busing, Meijer, van der Leeden 1999. For two equal
//! groups, SE is half their difference, as with `--target-error`.) The bias is due to the small number of rays. Most
//! of H comes from the few rays that happen to see the edge of a texture, so U is more often too large than too
//! small. `experiments/hard_cases.md` has the cost of ignoring the bias. Each θ_g is computed like the field
//! itself, with the same pooling and refinement limits.
//!
//! **Pooling.** What surfaces smear into the space beside them is the same in all groups, so that they cannot show it.
//! The vertex's own sums do: they are noisy, but not smeared. With `τ` and τ_g the same as θ and θ_g, without pooling,
//! and p̄ of τ, θ − p̄ is the bias and what noise SE_δ leaves in it, that of δ = θ − τ:
//!
//! ```text
//! E² = SE² + max(0, (θ − p̄)² − SE_δ²)
//! ```
//!
//! **Few rays.** The jackknife compares groups. Where fewer than two groups, or fewer than four rays, saw a vertex,
//! there is too little to compare, and the error is *unknown*: `None`, not 0. In space that no ray reached, U is the
//! prior's, and no number states how much a first ray would change it.

use half::f16;

use serde_json::Value;

use super::super::file::Source;
use super::{Change, Layer, Sections};
use crate::Result;
use crate::io::container::Section;
use crate::posterior::{Posterior, Reading, Sums, VertexSums};
use crate::uncertainty::{StandardDeviations, UncertaintyField};

/// Root mean square errors of log10 σ_v, decades.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorBars {
    groups: u16,
    /// `[vertices]`: bits of f16, which has three digits; `UNKNOWN` where too few rays saw the vertex.
    errors: Vec<u16>,
}

/// Marks an unknown error: the bits of NaN.
pub(super) const UNKNOWN: u16 = 0x7e00;
/// Fewest groups that must have seen a vertex, and fewest rays. With two or three rays the jackknife underrates the
/// mean error by half: what rare rays would add cannot be known from so few (`experiments/hard_cases.md`).
const MIN_GROUPS_AND_RAYS: (usize, u64) = (2, 4);
/// Numbers of groups that are valid in a file.
const GROUPS: std::ops::RangeInclusive<u16> = 2..=1024;

/// A statistic of all rays, θ, and of all but each group's, θ_g.
#[derive(Debug, Clone)]
pub struct Replicates {
    pub value: f64,
    pub deleted: Vec<f64>,
}

/// Standard error and bias of a statistic by the jackknife.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jackknife {
    pub standard_error: f64,
    /// Expected value minus limit.
    pub bias: f64,
}

impl Jackknife {
    /// Of groups with these `rays`, m_g.
    pub fn new(of: &Replicates, rays: &[u64]) -> Self {
        let Replicates { value: theta, deleted } = of;
        assert!(deleted.len() == rays.len() && rays.len() >= 2, "one value for each of two groups or more");
        let all: u64 = rays.iter().sum();
        let (groups, h) = (rays.len() as f64, |m: u64| all as f64 / m as f64);
        let pairs = || deleted.iter().zip(rays);
        // Uses differences from θ instead of θ itself, because they are small where errors are.
        let mean: f64 = pairs().map(|(t, &m)| (1.0 - 1.0 / h(m)) * (theta - t)).sum();
        let pseudo = |t: f64, m: u64| (h(m) - 1.0) * (theta - t);
        let sum: f64 = pairs().map(|(&t, &m)| (pseudo(t, m) - mean).powi(2) / (h(m) - 1.0)).sum();
        Self { standard_error: (sum / groups).sqrt(), bias: -mean }
    }

    /// Root mean square error.
    pub fn error(&self) -> f64 {
        self.standard_error.hypot(self.bias)
    }
}

/// Root mean square error of a pooled statistic, beside the `own` one, which is not pooled.
fn error_of_pooled(pooled: &Replicates, own: &Replicates, rays: &[u64]) -> f64 {
    let deleted = pooled.deleted.iter().zip(&own.deleted).map(|(p, o)| p - o).collect();
    let apart = Replicates { value: pooled.value - own.value, deleted };
    let bias = apart.value + Jackknife::new(own, rays).bias;
    let noise = Jackknife::new(&apart, rays).standard_error;
    let square = (bias * bias - noise * noise).max(0.0);
    (Jackknife::new(pooled, rays).standard_error.powi(2) + square).sqrt()
}

impl ErrorBars {
    /// Number of groups of rays that were compared.
    #[must_use]
    pub fn groups(&self) -> u16 {
        self.groups
    }

    /// Root mean square error of log10 σ at vertex `v`, decades; `None` where too few rays saw it.
    #[must_use]
    pub fn get(&self, v: usize) -> Option<f64> {
        let bits = self.errors[v];
        (bits != UNKNOWN).then(|| f16::from_bits(bits).to_f64())
    }

    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.errors.len()
    }

    /// Whether there are no vertices.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.errors.is_empty()
    }

    /// Restores the number of groups and the bits of every error behind it, which may come from an untrusted file.
    ///
    /// # Errors
    /// What was expected and what was found instead.
    fn from_words(words: &[u16], vertices: u64) -> std::result::Result<Self, (String, String)> {
        let Some((&groups, bits)) = words.split_first() else {
            return Err(("a number of groups and an error per vertex".into(), "nothing".into()));
        };
        if !GROUPS.contains(&groups) {
            return Err((format!("{} to {} groups", GROUPS.start(), GROUPS.end()), groups.to_string()));
        }
        if bits.len() as u64 != vertices {
            return Err((format!("{vertices} errors, one per vertex"), bits.len().to_string()));
        }
        let possible = |bits: u16| {
            let error = f16::from_bits(bits);
            bits == UNKNOWN || (error.is_finite() && !error.is_sign_negative())
        };
        match bits.iter().position(|&bits| !possible(bits)) {
            None => Ok(Self { groups, errors: bits.to_vec() }),
            Some(v) => {
                let found = format!("{} at vertex {v}", f16::from_bits(bits[v]));
                Err(("errors that are finite and not negative, or unknown".into(), found))
            }
        }
    }
}

impl Section for &ErrorBars {
    /// The number of groups, then the bits of every error.
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        [self.groups].as_slice().visit(visit)?;
        self.errors.as_slice().visit(visit)
    }
}

impl Layer for ErrorBars {
    const NAME: &'static str = "error bars";
    const DEPENDS_ON: &'static [Change] = &[Change::Covariance, Change::Prior, Change::Vertices];
    const WITHOUT: &'static str = "uncertainty --error-bars makes them";

    fn sections(&self, _to_be_merged: bool) -> Sections<'_> {
        vec![("errors", Box::new(self))]
    }

    fn read(_head: Value, file: &mut Source) -> Result<Self> {
        let words: Vec<u16> = file.section("errors")?;
        Self::from_words(&words, file.vertices)
            .map_err(|(expected, found)| file.malformed("section `errors`", expected, found))
    }

    // A merge drops them: the sums of the groups are no longer there.

    fn memory(&self) -> usize {
        self.errors.capacity() * size_of::<u16>()
    }

    fn info(&self) -> String {
        format!("of log10 U, by {} groups of rays", self.groups)
    }
}

/// The sums of all `groups` but `deleted`, at one vertex.
///
/// They are summed anew, because subtracting from the total would leave rounding where the result is 0.
fn summed<S: Sums>(groups: &[S], deleted: Option<usize>) -> VertexSums {
    let others = groups.iter().enumerate().filter(|(g, _)| Some(*g) != deleted);
    let sum = others.fold(S::default(), |mut sum, (_, group)| {
        sum += group;
        sum
    });
    sum.widened()
}

/// Whether groups with these sums at a vertex show its error.
fn is_known<S: Sums>(groups: &[S]) -> bool {
    let seen = groups.iter().filter(|sums| sums.rays() > 0).count();
    let rays: u64 = groups.iter().map(|sums| u64::from(sums.rays())).sum();
    seen >= MIN_GROUPS_AND_RAYS.0 && rays >= MIN_GROUPS_AND_RAYS.1
}

impl UncertaintyField {
    /// Adds the error of every log10 σ_v to the field. It is computed from the sums of independent `groups`; group g
    /// has `rays[g]` rays.
    ///
    /// # Errors
    /// If sums that left memory cannot be read.
    ///
    /// # Panics
    /// If there are fewer than two groups, a group has no rays, or they are on another kind of grid.
    pub fn with_error_bars<P: Posterior>(mut self, groups: &[P], rays: &[u64]) -> Result<Self> {
        assert!(groups.len() == rays.len() && rays.len() >= 2 && rays.iter().all(|&m| m > 0), "groups with rays");
        let pooled = self.record.pooling.is_on();
        let errors = if pooled { self.errors_of_pooled(groups, rays) } else { self.errors_of_own(groups, rays) }?;
        self.layers.error_bars = Some(ErrorBars { groups: groups.len() as u16, errors });
        Ok(self)
    }

    /// How sums are read without each group's rays.
    fn deleted_readings(&self, rays: &[u64]) -> Vec<Reading> {
        let (all, reading) = (rays.iter().sum::<u64>(), self.record.reading());
        rays.iter().map(|m| Reading { rays: all - m, ..reading }).collect()
    }

    /// `[vertices]`: errors, vertex by vertex.
    fn errors_of_own<P: Posterior>(&self, groups: &[P], rays: &[u64]) -> Result<Vec<u16>> {
        let (deleted, limits) = (self.deleted_readings(rays), self.limits());
        P::read_groups(groups, &self.support, |v, point, sums| {
            if !is_known(sums) {
                return UNKNOWN;
            }
            let without = |g: usize| deleted[g].deviation_at(&limits, point, summed(sums, Some(g)));
            let deleted = (0..groups.len()).map(|g| f64::from(without(g)).log10()).collect();
            let theta = Replicates { value: self.deviations.get(v).log10(), deleted };
            f16::from_f64(Jackknife::new(&theta, rays).error()).to_bits()
        })
    }

    /// `[vertices]`: errors of pooled deviations, which depend on all sums around a vertex.
    fn errors_of_pooled<P: Posterior>(&self, groups: &[P], rays: &[u64]) -> Result<Vec<u16>> {
        let sums = |deleted| P::read_groups(groups, &self.support, |_, _, sums| summed(sums, deleted));
        let (mut deleted, mut own_deleted) = (Vec::new(), Vec::new());
        for (g, reading) in self.deleted_readings(rays).iter().enumerate() {
            let others = sums(Some(g))?;
            deleted.push(self.deviations_of(reading, &others));
            own_deleted.push(self.deviations_of(&reading.unpooled(), &others));
        }
        let own = self.deviations_of(&self.record.reading().unpooled(), &sums(None)?);
        let log10 = |of: &StandardDeviations, v: usize| of.get(v).log10();
        let replicates = |v: usize, whole, parts: &[StandardDeviations]| Replicates {
            value: log10(whole, v),
            deleted: parts.iter().map(|part| log10(part, v)).collect(),
        };
        P::read_groups(groups, &self.support, |v, _, sums| {
            if !is_known(sums) {
                return UNKNOWN;
            }
            let (theta, tau) = (replicates(v, &self.deviations, &deleted), replicates(v, &own, &own_deleted));
            f16::from_f64(error_of_pooled(&theta, &tau, rays)).to_bits()
        })
    }

    /// `[vertices]`: errors of log10 σ_v, if the field has them.
    #[must_use]
    pub fn error_bars(&self) -> Option<&ErrorBars> {
        self.layers.error_bars.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::container::Item;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn of_a_mean_it_is_the_standard_error_of_the_mean(
            groups in proptest::collection::vec((-3.0..3.0_f64, 1..1000_u64), 2..20), shift in -1e3..1e3_f64,
        ) {
            let (values, rays): (Vec<f64>, Vec<u64>) = groups.iter().map(|g| (g.0 + shift, g.1)).unzip();
            let all: u64 = rays.iter().sum();
            // A mean of n values of variance s² per ray has variance s²/R, where s² is estimated from each
            // group's deviation. With p_g = x_g the formula is 1/G Σ (x_g − mean)² m_g / (R − m_g).
            let mean = |skip: Option<usize>| {
                let kept = || (0..values.len()).filter(|g| Some(*g) != skip);
                kept().map(|g| values[g] * rays[g] as f64).sum::<f64>() / kept().map(|g| rays[g] as f64).sum::<f64>()
            };
            let theta = mean(None);
            let deleted: Vec<f64> = (0..values.len()).map(|g| mean(Some(g))).collect();
            let terms = values.iter().zip(&rays).map(|(x, &m)| (x - theta).powi(2) * m as f64 / (all - m) as f64);
            let expected = (terms.sum::<f64>() / values.len() as f64).sqrt();
            let found = Jackknife::new(&Replicates { value: theta, deleted }, &rays);
            // θ and θ_g are rounded to 1e3 · 2⁻⁵³; pseudo-values magnify that by h ≤ 2e4.
            let error = (found.standard_error - expected).abs();
            prop_assert!(error <= 1e-8 * expected.max(1.0), "{:?} instead of {}", found, expected);
            prop_assert!(found.bias.abs() <= 1e-8, "a mean has no bias: {:?}", found);
        }

        #[test]
        fn two_groups_are_split_half(a in -5.0..5.0_f64, b in -5.0..5.0_f64) {
            let halves = Replicates { value: 0.5 * (a + b), deleted: vec![b, a] };
            let found = Jackknife::new(&halves, &[7, 7]).error();
            prop_assert!((found - 0.5 * (a - b).abs()).abs() < 1e-14);
        }

        #[test]
        fn of_a_squared_mean_the_bias_is_the_means_variance(values in proptest::collection::vec(-3.0..3.0_f64, 2..20)) {
            let n = values.len() as f64;
            let sum: f64 = values.iter().sum();
            let deleted: Vec<f64> = values.iter().map(|x| ((sum - x) / (n - 1.0)).powi(2)).collect();
            let squared = Replicates { value: (sum / n).powi(2), deleted };
            let found = Jackknife::new(&squared, &vec![5; values.len()]);
            // Known (Efron 1982, Sec. 2.1): exactly s²/n.
            let expected = values.iter().map(|x| (x - sum / n).powi(2)).sum::<f64>() / (n - 1.0) / n;
            prop_assert!((found.bias - expected).abs() < 1e-12 * n * n, "{:?} instead of {}", found, expected);
        }

        #[test]
        fn words_come_back(
            errors in proptest::collection::vec(proptest::option::of(0.0..6.0_f64), 0..50),
            groups in 2..=64_u16,
        ) {
            let bits = |e: &Option<f64>| e.map_or(UNKNOWN, |e| f16::from_f64(e).to_bits());
            let bars = ErrorBars { groups, errors: errors.iter().map(bits).collect() };
            let mut bytes = Vec::new();
            let mut put = |piece: &[u8]| {
                bytes.extend(piece);
                Ok(())
            };
            (&bars).visit(&mut put).unwrap();
            let words: Vec<u16> = bytes.chunks_exact(u16::SIZE).map(u16::take).collect();
            let read = ErrorBars::from_words(&words, errors.len() as u64).unwrap();
            prop_assert_eq!(&read, &bars);
            for (v, error) in errors.iter().enumerate() {
                // 11 significant bits, or the smallest step of f16.
                let close = |(a, b): (f64, f64)| (a - b).abs() <= b * 2.0_f64.powi(-11) + 2.0_f64.powi(-25);
                prop_assert!(read.get(v).is_some() == error.is_some() && read.get(v).zip(*error).is_none_or(close));
            }
        }
    }

    #[test]
    fn words_of_no_run_are_refused() {
        let one = f16::ONE.to_bits();
        for (words, named) in [
            (vec![], "number of groups"),
            (vec![1, one, one], "2 to 1024"),
            (vec![2000, one, one], "2 to 1024"),
            (vec![8, one], "2 errors"),
            (vec![8, one, one, one], "2 errors"),
            (vec![8, one, f16::NEG_ONE.to_bits()], "not negative"),
            (vec![8, one, f16::NEG_ZERO.to_bits()], "not negative"),
            (vec![8, f16::INFINITY.to_bits(), one], "finite"),
            // A NaN with bits other than those that are written.
            (vec![8, UNKNOWN | 1, one], "unknown"),
        ] {
            let (expected, found) = ErrorBars::from_words(&words, 2).unwrap_err();
            assert!(expected.contains(named), "{words:?}: {expected}, {found}");
        }
    }
}
