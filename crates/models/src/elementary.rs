//! Branch-free polynomials for sin, cos and exp of f32 numbers, so that loops over them become vector code.
//!
//! Coefficients are Chebyshev interpolants. All operations are IEEE (`mul_add` rounds once on every machine),
//! so results do not depend on the instructions that the compiler chooses.

use std::f32::consts::{FRAC_1_PI, LOG2_E, PI};

/// Coefficients of P in sin πf = f P(f²), |f| ≤ ½, lowest power first.
const SIN: [f32; 6] = [PI, -5.167_712_8, 2.550_163_3, -0.599_252_2, 0.082_050_35, -0.007_028_304];
/// Coefficients of P in cos πf = P(f²), |f| ≤ ½.
const COS: [f32; 6] = [1.0, -4.934_802, 4.058_709, -1.335_212, 0.234_937_07, -0.024_395_932];
/// Coefficients of exp r, |r| ≤ ½ ln 2.
const EXP: [f32; 7] = [1.0, 1.0, 0.5, 0.166_664_15, 0.041_666_35, 0.008_375_133, 0.001_394_111_6];
/// π in two parts. The first has 8 significant bits, so n · `PI_PARTS[0]` is exact for n up to 2¹⁶.
const PI_PARTS: [f32; 2] = [3.140_625, 9.676_536e-4];
/// ln 2 in two parts. The first has so few bits that n · `LN_2[0]` is exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];

/// Σ cᵢ xⁱ.
#[inline(always)]
fn horner<const N: usize>(coefficients: &[f32; N], x: f32) -> f32 {
    let mut sum = coefficients[N - 1];
    for i in (0..N - 1).rev() {
        sum = sum.mul_add(x, coefficients[i]);
    }
    sum
}

/// (sin πy, cos πy), each to within an absolute 2e-7.
#[inline(always)]
#[must_use]
pub fn sin_cos_pi(y: f32) -> (f32, f32) {
    // Half turns make the reduction exact: y − n is not rounded.
    let n = y.round_ties_even();
    let f = y - n;
    let sign = (n as i32 as u32) << 31;
    let (sin, cos) = (f * horner(&SIN, f * f), horner(&COS, f * f));
    (f32::from_bits(sin.to_bits() ^ sign), f32::from_bits(cos.to_bits() ^ sign))
}

/// (sin x, cos x) of x in radians, each to within an absolute 3e-7, for |x| up to 1e4.
#[inline(always)]
#[must_use]
pub fn sin_cos(x: f32) -> (f32, f32) {
    let n = (x * FRAC_1_PI).round_ties_even();
    // n · PI_PARTS[0] is exact, and so is the remainder of x. The second part is what the first leaves of π.
    let r = n.mul_add(-PI_PARTS[1], n.mul_add(-PI_PARTS[0], x));
    let f = r * FRAC_1_PI;
    let sign = (n as i32 as u32) << 31;
    let (sin, cos) = (f * horner(&SIN, f * f), horner(&COS, f * f));
    (f32::from_bits(sin.to_bits() ^ sign), f32::from_bits(cos.to_bits() ^ sign))
}

/// exp x to within a relative 3e-7. x is clamped to [−87, 88], where results are normal f32 numbers; NaN stays NaN.
#[inline(always)]
#[must_use]
pub fn exp(x: f32) -> f32 {
    let x = x.clamp(-87.0, 88.0);
    let n = (x * LOG2_E).round_ties_even();
    let r = n.mul_add(-LN_2[1], n.mul_add(-LN_2[0], x));
    f32::from_bits(((n as i32 + 127) as u32) << 23) * horner(&EXP, r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_keep_their_promise() {
        let mut largest = 0.0_f64;
        for i in -400_000..=400_000 {
            let y = i as f32 * 2.0e-5;
            let (sin, cos) = sin_cos_pi(y);
            let (s, c) = (f64::from(y) * std::f64::consts::PI).sin_cos();
            largest = largest.max((f64::from(sin) - s).abs()).max((f64::from(cos) - c).abs());
        }
        // Six fused steps on numbers below π, the last ones below 1, give one to three ulps of 1 (6e-8).
        assert!(largest < 2e-7, "{largest:e}");
        assert_eq!(sin_cos_pi(0.0), (0.0, 1.0));
    }

    #[test]
    fn sine_and_cosine_of_radians_keep_theirs() {
        let mut largest = 0.0_f64;
        for i in -500_000..=500_000 {
            let x = i as f32 * 2.0e-2;
            let (sin, cos) = sin_cos(x);
            let (s, c) = f64::from(x).sin_cos();
            largest = largest.max((f64::from(sin) - s).abs()).max((f64::from(cos) - c).abs());
        }
        // As above, plus n times what the two parts leave of π: 3183 · 5e-12.
        assert!(largest < 3e-7, "{largest:e}");
    }

    #[test]
    fn exponential_keeps_its_promise() {
        let mut largest = 0.0_f64;
        for i in -870_000..=880_000 {
            let x = i as f32 * 1e-4;
            largest = largest.max((f64::from(exp(x)) / f64::from(x).exp() - 1.0).abs());
        }
        assert!(largest < 3e-7, "{largest:e}");
        assert!(exp(f32::NAN).is_nan() && exp(1e9).is_finite() && exp(-1e9) < 2e-38 && exp(0.0) == 1.0);
    }
}
