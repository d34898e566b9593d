//! What more precision at one vertex is worth.
//!
//! Letters: `P` = precision of a displacement before, `Δ` = what is added to it, both symmetric 3×3 and given as xx,
//! xy, xz, yy, yz, zz, in 1 / scene unit²; P = L Lᵀ; M = L⁻¹ Δ L⁻ᵀ, without a unit.

use octobayes::posterior::Information;

/// M, xx to zz.
fn whitened(p: &Information, delta: &Information) -> Information {
    let [xx, xy, xz, yy, yz, zz] = *p;
    let l00 = xx.sqrt();
    let (l10, l20) = (xy / l00, xz / l00);
    // P is at least the prior's, so that pivots are positive but for rounding.
    let l11 = (yy - l10 * l10).max(yy * f64::EPSILON).sqrt();
    let l21 = (yz - l20 * l10) / l11;
    let l22 = (zz - l20 * l20 - l21 * l21).max(zz * f64::EPSILON).sqrt();
    let solved = |[a, b, c]: [f64; 3]| {
        let a = a / l00;
        let b = (b - l10 * a) / l11;
        [a, b, (c - l20 * a - l21 * b) / l22]
    };
    let [dxx, dxy, dxz, dyy, dyz, dzz] = *delta;
    let columns = [solved([dxx, dxy, dxz]), solved([dxy, dyy, dyz]), solved([dxz, dyz, dzz])];
    let row = |k: usize| solved([columns[0][k], columns[1][k], columns[2][k]]);
    let [first, second, third] = [row(0), row(1), row(2)];
    [first[0], first[1], first[2], second[1], second[2], third[2]]
}

/// ½ log det(I + P⁻¹ Δ) in nats: by how much the posterior of this displacement loses entropy, or what a Gaussian
/// observation of precision Δ has about it (D-optimality).
#[must_use]
pub fn log_det(p: &Information, delta: &Information) -> f64 {
    let [xx, xy, xz, yy, yz, zz] = whitened(p, delta);
    // The pivots of I + M less 1, which are not negative, as M is a sum of squares.
    let first = xx.max(0.0);
    let second = (yy - xy * xy / (1.0 + first)).max(0.0);
    let below = yz - xy * xz / (1.0 + first);
    let third = (zz - xz * xz / (1.0 + first) - below * below / (1.0 + second)).max(0.0);
    0.5 * (first.ln_1p() + second.ln_1p() + third.ln_1p())
}

/// ½ tr(P⁻¹ Δ), the first-order term of [`log_det`] (T-optimality).
#[must_use]
pub fn first_order(p: &Information, delta: &Information) -> f64 {
    let [xx, _, _, yy, _, zz] = whitened(p, delta);
    0.5 * (xx.max(0.0) + yy.max(0.0) + zz.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use proptest::prelude::*;

    fn matrix([xx, xy, xz, yy, yz, zz]: Information) -> DMat3 {
        DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
    }

    /// Sums of squares of up to three rows, times a power of ten.
    fn squares() -> impl Strategy<Value = Information> {
        let row = proptest::array::uniform3(-1.0..1.0_f64);
        (proptest::collection::vec(row, 1..4), -3.0..3.0_f64).prop_map(|(rows, decade)| {
            let mut sum = [0.0; 6];
            for [x, y, z] in rows {
                let products = [x * x, x * y, x * z, y * y, y * z, z * z];
                sum.iter_mut().zip(products).for_each(|(s, p)| *s += 10_f64.powf(decade) * p);
            }
            sum
        })
    }

    fn with_prior(s: Information) -> Information {
        let [xx, xy, xz, yy, yz, zz] = s;
        [xx + 1.0, xy, xz, yy + 1.0, yz, zz + 1.0]
    }

    #[test]
    fn three_separate_axes_add_up() {
        // ½ (ln (1 + 3/1) + ln (1 + 8/2) + ln 1).
        let (p, delta) = ([1.0, 0.0, 0.0, 2.0, 0.0, 5.0], [3.0, 0.0, 0.0, 8.0, 0.0, 0.0]);
        assert!((log_det(&p, &delta) - 0.5 * 20_f64.ln()).abs() < 1e-15);
        assert!((first_order(&p, &delta) - 0.5 * 7.0).abs() < 1e-15);
    }

    proptest! {
        /// Both against their definition, by an inverse and a determinant of their own.
        #[test]
        fn gains_follow_their_definition(s in squares(), delta in squares()) {
            let p = with_prior(s);
            let (before, change) = (matrix(p), matrix(delta));
            let by_inverse = before.inverse() * change;
            let expected = 0.5 * (DMat3::IDENTITY + by_inverse).determinant().ln();
            let found = log_det(&p, &delta);
            // P has a condition of at most 1e4, the determinant of 1e9 relative to its least term.
            prop_assert!((found - expected).abs() < 1e-7 * (1.0 + expected.abs()), "{} {}", found, expected);
            let trace = 0.5 * (0..3).map(|k| by_inverse.col(k)[k]).sum::<f64>();
            prop_assert!((first_order(&p, &delta) / trace - 1.0).abs() < 1e-9);
            prop_assert!(found <= first_order(&p, &delta) * (1.0 + 1e-12), "log (1 + x) is at most x");
        }

        /// ½ Σ ln(1 + μ) = ½ Σ μ − ¼ Σ μ² + …, and Σ μ² is at most (Σ μ)².
        #[test]
        fn the_trace_is_the_first_order_of_the_log_det(s in squares(), delta in squares(), decade in -12.0..-4.0_f64) {
            let p = with_prior(s);
            let small = delta.map(|d| d * 10_f64.powf(decade) / (delta[0] + delta[3] + delta[5]));
            let (exact, first) = (log_det(&p, &small), first_order(&p, &small));
            // In any direction: ΔP, and P of at least 1.
            prop_assert!(exact <= first * (1.0 + 1e-9) && first - exact <= first * first + 1e-9 * first,
                "{} {}", exact, first);
        }

        /// What is added later is worth no more: the gain is submodular.
        #[test]
        fn later_is_worth_no_more(s in squares(), before in squares(), delta in squares()) {
            let p = with_prior(s);
            let more: Information = std::array::from_fn(|k| p[k] + before[k]);
            prop_assert!(log_det(&more, &delta) <= log_det(&p, &delta) * (1.0 + 1e-9) + 1e-12);
            prop_assert!(first_order(&more, &delta) <= first_order(&p, &delta) * (1.0 + 1e-9) + 1e-12);
            // One after the other is both at once.
            let both: Information = std::array::from_fn(|k| before[k] + delta[k]);
            let (apart, together) = (log_det(&p, &before) + log_det(&more, &delta), log_det(&p, &both));
            prop_assert!((apart - together).abs() < 1e-9 * (1.0 + together), "{} {}", apart, together);
        }
    }
}
