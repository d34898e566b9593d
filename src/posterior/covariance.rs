//! Standard deviations computed from a vertex's information.

use super::double_double::DoubleDouble;
use super::{Entries, Information, VertexSums, trace};

choices! {
    /// The definition of the standard deviation σ_v, computed from H_v = (2/R) S_v + 2λ I.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
    #[non_exhaustive]
    pub enum Covariance {
        /// σ² = Σ_k 1 / H_kk (the paper, Sec. 4.4). Depends on the orientation of the axes.
        #[default]
        Diagonal = "diagonal", "sum of 1/H_kk: the paper's; depends on how the axes are turned";
        /// σ² = 1 / (tr S / R + λ) (the official code: no factor 2; interpolates variance with normalised squared
        /// weights).
        Trace = "trace", "1/(tr S/R + lambda): the official code's";
        /// σ² = tr(H⁻¹) of the full 3×3 block. Does not depend on the axes; counts sliding along a surface as
        /// uncertainty.
        Block = "block", "trace of the inverse 3x3 block: does not depend on the axes";
    }
}

impl Covariance {
    /// The entries of S that σ_v depends on.
    pub(crate) fn entries(self) -> Entries {
        match self {
            Self::Diagonal | Self::Trace => Entries::Diagonal,
            Self::Block => Entries::All,
        }
    }

    /// σ_v in scene units, from the `sums` of a run of `rays` rays and the prior precision λ (1 / scene unit²).
    #[must_use]
    pub fn deviation(self, sums: &VertexSums, rays: u64, lambda: f64) -> f64 {
        let s = &sums.information;
        let hessian = |per_ray: f64| s.map(|s| 2.0 * per_ray * s);
        let per_ray = 1.0 / (rays.max(1) as f64);
        let variance = match self {
            Self::Diagonal => [s[0], s[3], s[5]].iter().map(|s| 1.0 / (2.0 * per_ray * s + 2.0 * lambda)).sum(),
            Self::Trace => 1.0 / (per_ray * trace(s) + lambda),
            Self::Block => InverseFactor::new(hessian(per_ray), 2.0 * lambda).trace(),
        };
        f64::sqrt(variance)
    }

    /// The covariance matrix (xx, xy, xz, yy, yz, zz) whose trace is σ_v², squared scene units.
    ///
    /// `block` has all of H⁻¹, `diagonal` 1 / H_kk on its diagonal, and `trace`, which has no directions, a third of
    /// σ_v² in each.
    #[must_use]
    pub fn matrix(self, sums: &VertexSums, rays: u64, lambda: f64) -> Information {
        let per_ray = 1.0 / (rays.max(1) as f64);
        let hessian = sums.information.map(|s| 2.0 * per_ray * s);
        match self {
            Self::Diagonal => {
                let [xx, yy, zz] = [0, 3, 5].map(|k| 1.0 / (hessian[k] + 2.0 * lambda));
                [xx, 0.0, 0.0, yy, 0.0, zz]
            }
            Self::Trace => {
                let third = self.deviation(sums, rays, lambda).powi(2) / 3.0;
                [third, 0.0, 0.0, third, 0.0, third]
            }
            Self::Block => InverseFactor::new(hessian, 2.0 * lambda).matrix(),
        }
    }

    /// σ_v in scene units at a vertex that no ray touched.
    #[must_use]
    pub fn prior(self, lambda: f64) -> f64 {
        self.deviation(&VertexSums::default(), 1, lambda)
    }

    /// Interpolates U from the deviations at the eight corners of a cell, with their trilinear weights.
    ///
    /// The paper's U is trilinear in σ_v; the official code's is √(Σ w² σ² / Σ w²).
    #[must_use]
    pub fn interpolate(self, deviations: &[f64; 8], weights: &[f64; 8]) -> f64 {
        let pairs = || deviations.iter().zip(weights);
        match self {
            Self::Diagonal | Self::Block => pairs().map(|(s, w)| s * w).sum(),
            Self::Trace => {
                let squares: f64 = weights.iter().map(|w| w * w).sum();
                (pairs().map(|(s, w)| w * w * s * s).sum::<f64>() / squares).sqrt()
            }
        }
    }

    /// Bounds the error of log10 U from the errors of log10 σ_v at the corners, to first order.
    ///
    /// The bound assumes that all errors have the same sign. That is nearly true for corners passed by the same
    /// rays. `None` if the error of a corner is unknown.
    #[must_use]
    pub fn interpolate_errors(
        self,
        errors: &[Option<f64>; 8],
        deviations: &[f64; 8],
        weights: &[f64; 8],
    ) -> Option<f64> {
        self.joined_error((0..8).map(|c| (errors[c], deviations[c], weights[c])))
    }

    /// Same as [`Covariance::interpolate_errors`], but takes (error, deviation, weight) per corner.
    ///
    /// d log U = Σ p d log σ_v with fractions p = w σ_v / Σ w σ_v, or w² σ² / Σ w² σ² for `trace`.
    #[must_use]
    pub fn joined_error(self, corners: impl Iterator<Item = (Option<f64>, f64, f64)>) -> Option<f64> {
        let (mut sum, mut total) = (0.0, 0.0);
        for (error, deviation, weight) in corners.filter(|corner| corner.2 > 0.0) {
            let share = match self {
                Self::Diagonal | Self::Block => weight * deviation,
                Self::Trace => (weight * deviation).powi(2),
            };
            sum += share * error?;
            total += share;
        }
        Some(sum / total)
    }

    /// The mean of the deviations at the ends of a hanging corner's edge or face, taken in the
    /// quantity that is interpolated.
    #[must_use]
    pub fn mean(self, deviations: impl ExactSizeIterator<Item = f64>) -> f64 {
        let n = deviations.len() as f64;
        match self {
            Self::Diagonal | Self::Block => deviations.sum::<f64>() / n,
            Self::Trace => (deviations.map(|s| s * s).sum::<f64>() / n).sqrt(),
        }
    }
}

/// The largest tr S that changes log10 U by at most `tolerance` for every covariance, given `rays`
/// rays and the prior precision λ.
///
/// tr S ≤ ε λ R keeps every eigenvalue and every diagonal entry of S below ε λ R. H then lies between 2λ and 2λ
/// (1 + ε), so no σ_v falls by more than the factor √(1 + ε). Hence ε = 10^(2 · tolerance) − 1.
#[must_use]
pub fn negligible_information(tolerance: f64, rays: u64, lambda: f64) -> f64 {
    (2.0 * tolerance * std::f64::consts::LN_10).exp_m1() * lambda * rays as f64
}

/// M = L⁻¹ and D⁻¹ of H = A + floor · I = L D Lᵀ (L unit lower triangular), so that H⁻¹ = Mᵀ D⁻¹ M.
///
/// A is positive semidefinite (xx, xy, xz, yy, yz, zz). It may have rank 1 and be 10¹⁸ times larger than `floor`.
/// In f64 the floor would be lost, and with it everything known about the other directions. The pivots are
/// therefore computed in double-double arithmetic, with 104 bits. Each pivot is a Schur complement of H and hence
/// at least `floor`. Sums that were already rounded can push it below, so `floor` is enforced: results are
/// finite, positive and at most what `floor` alone gives.
struct InverseFactor {
    /// M below its unit diagonal: entries 10, 20, 21.
    rows: [f64; 3],
    /// D⁻¹.
    inverse_pivots: [f64; 3],
    floor: f64,
}

impl InverseFactor {
    fn new(a: [f64; 6], floor: f64) -> Self {
        if trace(&a) == 0.0 {
            return Self { rows: [0.0; 3], inverse_pivots: [1.0 / floor; 3], floor };
        }
        let [xx, xy, xz, yy, yz, zz] = a;
        let least = DoubleDouble::from(floor);
        let [off_xy, off_xz, off_yz] = [xy, xz, yz].map(DoubleDouble::from);
        let d0 = DoubleDouble::sum(xx, floor).max(least);
        let (l10, l20) = (off_xy / d0, off_xz / d0);
        let d1 = (DoubleDouble::sum(yy, floor) - l10 * off_xy).max(least);
        let t = off_yz - l20 * off_xy;
        let l21 = t / d1;
        let d2 = (DoubleDouble::sum(zz, floor) - l20 * off_xz - l21 * t).max(least);
        let rows = [-l10, l10 * l21 - l20, -l21].map(f64::from);
        Self { rows, inverse_pivots: [d0, d1, d2].map(|d| 1.0 / f64::from(d)), floor }
    }

    /// H⁻¹ = Mᵀ D⁻¹ M.
    fn matrix(&self) -> Information {
        let ([m10, m20, m21], [p0, p1, p2]) = (self.rows, self.inverse_pivots);
        let rows = [(p0, [1.0, 0.0, 0.0]), (p1, [m10, 1.0, 0.0]), (p2, [m20, m21, 1.0])];
        [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
            .map(|(i, j)| rows.iter().map(|(pivot, row)| pivot * row[i] * row[j]).sum())
    }

    /// tr(H⁻¹) = Σ_i ‖M_i‖² / d_i.
    fn trace(&self) -> f64 {
        let ([m10, m20, m21], [p0, p1, p2]) = (self.rows, self.inverse_pivots);
        let sum = p0 + (1.0 + m10 * m10) * p1 + (1.0 + m20 * m20 + m21 * m21) * p2;
        sum.min(3.0 / self.floor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dashu_ratio::RBig;
    use proptest::prelude::*;

    fn seen(information: Information) -> VertexSums {
        VertexSums::new(information, 1)
    }

    fn information() -> impl Strategy<Value = Information> {
        // Sums of a few outer products over many decades; a single product has rank 1.
        let row = ([-1.0..1.0_f64, -1.0..1.0, -1.0..1.0], -8.0..2.0_f64);
        proptest::collection::vec(row, 0..5).prop_map(|rows| {
            let mut s = [0.0; 6];
            for (g, decade) in rows {
                let k = 10_f64.powf(decade);
                let products = [g[0] * g[0], g[0] * g[1], g[0] * g[2], g[1] * g[1], g[1] * g[2], g[2] * g[2]];
                for (s, p) in s.iter_mut().zip(products) {
                    *s += k * p;
                }
            }
            s
        })
    }

    #[test]
    fn matrices_are_the_inverses_whose_trace_is_the_variance() {
        // H = 2 S / R + 2 λ with S / R = [[2, 1, 0], [1, 2, 0], [0, 0, 5]] and λ = ½
        // is [[5, 2, 0], [2, 5, 0], [0, 0, 11]].
        let sums = seen([20.0, 10.0, 0.0, 20.0, 0.0, 50.0]);
        let matrix = |covariance: Covariance| covariance.matrix(&sums, 10, 0.5);
        let expected = [5.0 / 21.0, -2.0 / 21.0, 0.0, 5.0 / 21.0, 0.0, 1.0 / 11.0];
        assert!(matrix(Covariance::Block).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15));
        assert_eq!(matrix(Covariance::Diagonal), [0.2, 0.0, 0.0, 0.2, 0.0, 1.0 / 11.0]);
        for covariance in Covariance::ALL {
            let variance = covariance.deviation(&sums, 10, 0.5).powi(2);
            // A few roundings of f64.
            assert!((trace(&matrix(covariance)) / variance - 1.0).abs() < 1e-14, "{covariance:?}");
        }
    }

    #[test]
    fn prior_values() {
        // Paper: ½ log10(3 / 2λ); official code: ½ log10(1 / λ).
        let lambda = 1e-4 / 256_f64.powi(3);
        assert!((Covariance::Diagonal.prior(lambda).log10() - 0.5 * (3.0 / (2.0 * lambda)).log10()).abs() < 1e-14);
        assert!((Covariance::Block.prior(lambda) / Covariance::Diagonal.prior(lambda) - 1.0).abs() < 1e-14);
        assert!((Covariance::Trace.prior(lambda).log10() - 0.5 * (1.0 / lambda).log10()).abs() < 1e-14);
    }

    #[test]
    fn diagonal_depends_on_the_axes_and_block_does_not() {
        // A textureless wall: all information lies along its normal. If the normal is an axis, `diagonal` is
        // near the prior. If it is (1,1,1)/√3, `diagonal` is decades lower, a known property of the formula.
        // `block` gives the same for both.
        let (lambda, rays, strength) = (1e-10, 1000, 1e3);
        let axis = [strength, 0.0, 0.0, 0.0, 0.0, 0.0];
        let turned = [strength / 3.0; 6];
        let log10 = |c: Covariance, s: &Information| c.deviation(&seen(*s), rays, lambda).log10();
        assert!(log10(Covariance::Diagonal, &axis) - log10(Covariance::Diagonal, &turned) > 4.0);
        // Rounding 1/3 leaves a second eigenvalue of 1e-16 · strength = 1e-13, or 1e-16 per ray, compared with
        // λ = 1e-10.
        assert!((log10(Covariance::Block, &axis) - log10(Covariance::Block, &turned)).abs() < 1e-5);
    }

    proptest! {
        #[test]
        fn negligible_information_bounds_every_scalar(s in information(), tolerance in 1e-4..0.1_f64) {
            let (lambda, rays) = (1e-6, 100);
            let limit = negligible_information(tolerance, rays, lambda);
            let t = trace(&s);
            if t > 0.0 {
                let scaled = s.map(|v| v * limit / t);
                for covariance in Covariance::ALL {
                    let change = (covariance.prior(lambda) / covariance.deviation(&seen(scaled), rays, lambda)).log10();
                    prop_assert!(
                        (-1e-12..=tolerance * (1.0 + 1e-9)).contains(&change),
                        "{:?} moves by {}",
                        covariance,
                        change
                    );
                }
                // Two-sided: `trace` reaches the bound.
                let deviation = Covariance::Trace.deviation(&seen(scaled), rays, lambda);
                let change = (Covariance::Trace.prior(lambda) / deviation).log10();
                prop_assert!((change - tolerance).abs() < 1e-9);
            }
        }

        #[test]
        fn trace_of_the_inverse_is_the_sum_over_eigenvalues(s in information(), decade in -9.0..0.0_f64) {
            // tr(H⁻¹) = (sum of principal 2×2 minors) / det. In f64 its accuracy is 1e-16 · (largest / floor)²,
            // so the comparison is limited to cases where that is small.
            let floor = 10_f64.powf(decade);
            let found = InverseFactor::new(s, floor).trace();
            let [xx, xy, xz, yy, yz, zz] = [s[0] + floor, s[1], s[2], s[3] + floor, s[4], s[5] + floor];
            let minors = (yy * zz - yz * yz) + (xx * zz - xz * xz) + (xx * yy - xy * xy);
            let det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
            let condition = (trace(&s) + floor) / floor;
            if condition < 1e5 {
                let limit = (1e-14 * condition * condition).max(1e-12);
                prop_assert!((found * det / minors - 1.0).abs() < limit, "{} against {}", found, minors / det);
            }
            prop_assert!(found > 0.0 && found <= 3.0 / floor * (1.0 + 1e-12));
        }

        /// Compares with exact rational arithmetic, down to a floor 10¹⁸ times below the largest eigenvalue.
        #[test]
        fn inverses_are_exact_down_to_the_floor(
            vectors in proptest::collection::vec((proptest::array::uniform3(-40..=40_i32), 0..=30_i32), 0..4),
            exponent in -60..=60_i32,
        ) {
            // Sums of outer products of small integer vectors times powers of four: eigenvalues from 1 to
            // 4³⁰ · 4800 floors, in any direction.
            let floor = f64::from(exponent).exp2();
            let mut a = [0.0; 6];
            for (v, k) in &vectors {
                let [x, y, z] = v.map(f64::from);
                let scale = 4.0_f64.powi(*k) * floor;
                for (a, product) in a.iter_mut().zip([x * x, x * y, x * z, y * y, y * z, z * z]) {
                    *a += product * scale;
                }
            }
            let exact = |v: f64| RBig::try_from(v).unwrap();
            // Principal minors and determinant of A + shift · I.
            let minors_of = |shift: f64| {
                let [xx, yy, zz] = [0, 3, 5].map(|i| exact(a[i]) + exact(shift));
                let [xy, xz, yz] = [1, 2, 4].map(|i| exact(a[i]));
                let minors = [&yy * &zz - &yz * &yz, &xx * &zz - &xz * &xz, &xx * &yy - &xy * &xy];
                let cofactors = [&xz * &yz - &xy * &zz, &xy * &yz - &xz * &yy, &xy * &xz - &xx * &yz];
                let det = &xx * &minors[0] + &xy * &cofactors[0] + &xz * &cofactors[1];
                (minors, cofactors, det)
            };
            let inverse = InverseFactor::new(a, floor);
            let found = inverse.trace();
            prop_assert!(found > 0.0 && found <= 3.0 / floor, "{}", found);
            // Rounded f64 sums may no longer be positive semidefinite. Then no answer is right,
            // and only the bounds are checked.
            let (minors, _, det) = minors_of(0.0);
            let zero = exact(0.0);
            if minors.iter().all(|m| *m >= zero) && det >= zero {
                let (minors, _, det) = minors_of(floor);
                let expected = ((&minors[0] + &minors[1] + &minors[2]) / &det).to_f64().value();
                // The rounding is 2⁻¹⁰⁰ of the largest entry, which is at most 10²² floors.
                prop_assert!((found / expected - 1.0).abs() < 1e-8, "{} instead of {}", found, expected);
            }
        }

        #[test]
        fn more_information_never_raises_the_deviation(s in information(), more in information()) {
            let sum: Information = std::array::from_fn(|k| s[k] + more[k]);
            for covariance in Covariance::ALL {
                let [before, after] = [s, sum].map(|s| covariance.deviation(&seen(s), 10, 1e-6));
                // `block` uses a triangular factorisation: relative rounding of 1e-16 · 1e2 / 2e-6.
                prop_assert!(after <= before * (1.0 + 1e-7), "{:?}: {} after {}", covariance, after, before);
            }
        }
    }
}
