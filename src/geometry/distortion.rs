//! OpenCV's lens distortion, as COLMAP, nerfstudio and instant-ngp write it.
//!
//! Letters: (x, y) ideal image coordinates on the plane at depth 1, y downwards; r² = x² + y²;
//! s = k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸. The lens moves them by dx = s x + 2 p1 xy + p2 (r² + 2x²) and
//! dy = s y + 2 p2 xy + p1 (r² + 2y²). k4 is nerfstudio's; OpenCV's own k4 divides.

/// Radial (k) and tangential (p) coefficients; all zero is a perfect pinhole.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distortion {
    /// Radial coefficients of r², r⁴, r⁶ and r⁸.
    pub k: [f64; 4],
    /// Tangential coefficients.
    pub p: [f64; 2],
}

/// The coefficients that are not 0 by their names; those of every lens always.
impl std::fmt::Display for Distortion {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        // A number of 300 digits is harder to read than its exponent.
        let short = |v: f64| if v.abs() < 1e9 { v.to_string() } else { format!("{v:e}") };
        let ([k1, k2, k3, k4], [p1, p2]) = (self.k.map(short), self.p.map(short));
        write!(f, "k1 {k1}, k2 {k2}")?;
        for (name, value, text) in [("k3", self.k[2], k3), ("k4", self.k[3], k4)] {
            if value != 0.0 {
                write!(f, ", {name} {text}")?;
            }
        }
        write!(f, ", p1 {p1}, p2 {p2}")
    }
}

impl Distortion {
    /// Maps an ideal point to where the lens puts it.
    #[must_use]
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let ([k1, k2, k3, k4], [p1, p2]) = (self.k, self.p);
        let radial = r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let dx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let dy = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y);
        [x + dx, y + dy]
    }

    /// Derivatives of [`Distortion::distort`]: ∂x'/∂x, ∂y'/∂y, and ∂x'/∂y, which is ∂y'/∂x.
    fn derivatives(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let r2 = x * x + y * y;
        let ([k1, k2, k3, k4], [p1, p2]) = (self.k, self.p);
        let radial = r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        // d(radial)/dx = 2x · slope.
        let slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4));
        let xx = 1.0 + radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
        let yy = 1.0 + radial + 2.0 * y * y * slope + 2.0 * p2 * x + 6.0 * p1 * y;
        [xx, yy, 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y]
    }

    /// The ideal point that the lens puts at `seen`.
    ///
    /// If the coefficients fold the image over there, this is the nearest point found.
    #[must_use]
    pub fn undistort(&self, seen: [f64; 2]) -> [f64; 2] {
        if *self == Self::default() {
            return seen;
        }
        let at_once = self.newton(seen, seen);
        if self.keeps_its_side(at_once, seen) {
            return at_once;
        }
        // Where `seen`, taken for an ideal point, lies beyond a fold, Newton's method cannot begin there. From the
        // centre outwards every step begins next to its solution.
        const STEPS: u32 = 16;
        let shares = (1..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
        let outwards = shares.fold([0.0; 2], |ideal, share| self.newton(seen.map(|v| share * v), ideal));
        if self.keeps_its_side(outwards, seen) { outwards } else { at_once }
    }

    /// The ideal point that the lens puts at `seen`, by Newton's method from `ideal` on.
    fn newton(&self, seen: [f64; 2], ideal: [f64; 2]) -> [f64; 2] {
        let [mut x, mut y] = ideal;
        for _ in 0..20 {
            let at = self.distort([x, y]);
            let (ex, ey) = (at[0] - seen[0], at[1] - seen[1]);
            let [xx, yy, xy] = self.derivatives([x, y]);
            let determinant = xx * yy - xy * xy;
            let (nx, ny) = (x - (yy * ex - xy * ey) / determinant, y - (xx * ey - xy * ex) / determinant);
            // Absurd coefficients must not turn a ray into NaN: keep the last finite point.
            if ex.abs().max(ey.abs()) < 1e-15 || determinant <= 0.0 || !(nx.is_finite() && ny.is_finite()) {
                break;
            }
            (x, y) = (nx, ny);
        }
        [x, y]
    }

    /// Returns true if the lens puts an ideal point at `seen`, and does not fold the image over on the way to it from
    /// the centre.
    #[must_use]
    pub fn is_invertible(&self, seen: [f64; 2]) -> bool {
        self.keeps_its_side(self.undistort(seen), seen)
    }

    /// Whether the lens puts the point `ideal` at `seen`, and folds nothing over between the centre and it.
    pub(super) fn keeps_its_side(&self, ideal: [f64; 2], seen: [f64; 2]) -> bool {
        const STEPS: u32 = 16;
        let back = self.distort(ideal);
        let scale = 1.0 + seen[0].abs().max(seen[1].abs());
        let is_reached = (0..2).all(|k| (back[k] - seen[k]).abs() < 1e-9 * scale);
        is_reached
            && (1..=STEPS).all(|step| {
                let [xx, yy, xy] = self.derivatives(ideal.map(|v| v * f64::from(step) / f64::from(STEPS)));
                xx > 0.0 && xx * yy - xy * xy > 0.0
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The lenses of COLMAP's and nerfstudio's perspective cameras, by how many of their radial coefficients, and
    /// whether their tangential ones, may differ from 0: simple radial, radial, OpenCV's, with k3, with k4.
    const KINDS: [(usize, bool); 5] = [(1, false), (2, false), (2, true), (3, true), (4, true)];

    proptest! {
        #[test]
        fn undistort_is_the_inverse_wherever_nothing_folds(
            x in -0.8..0.8_f64,
            y in -0.8..0.8_f64,
            kind in proptest::sample::select(KINDS.as_slice()),
            size in proptest::sample::select([0.1, 0.3, 0.6].as_slice()),
            k in proptest::array::uniform4(-1.0..1.0_f64),
            p in [-1e-2..1e-2_f64, -1e-2..1e-2],
        ) {
            let (radial, is_tangential) = kind;
            let k = std::array::from_fn(|i| if i < radial { size * k[i] } else { 0.0 });
            let lens = Distortion { k, p: if is_tangential { p } else { [0.0; 2] } };
            // Beyond a fold a point nearer to the centre has the same image.
            let is_flat = |step: u32| {
                let [xx, yy, xy] = lens.derivatives([x, y].map(|v| v * f64::from(step) / 64.0));
                xx > 0.05 && xx * yy - xy * xy > 0.05
            };
            prop_assume!((0..=64).all(is_flat));
            let seen = lens.distort([x, y]);
            let found = lens.undistort(seen);
            prop_assert!((found[0] - x).abs().max((found[1] - y).abs()) < 1e-12, "{:?} for {:?}", found, [x, y]);
            prop_assert!(lens.is_invertible(seen));
        }

        #[test]
        fn derivatives_are_those_of_differences(
            x in -0.8..0.8_f64, y in -0.8..0.8_f64, k in proptest::array::uniform4(-0.6..0.6_f64),
            p in [-1e-2..1e-2_f64, -1e-2..1e-2],
        ) {
            let lens = Distortion { k, p };
            let h = 1e-5;
            let along = |dx: f64, dy: f64| {
                let [a, b] = [1.0, -1.0].map(|sign| lens.distort([x + sign * dx * h, y + sign * dy * h]));
                [0, 1].map(|i| (a[i] - b[i]) / (2.0 * h))
            };
            let ([xx, yx], [xy, yy]) = (along(1.0, 0.0), along(0.0, 1.0));
            let expected = lens.derivatives([x, y]);
            // Differences are off by h² times third derivatives, which stay below 1e3 here, and by rounding.
            for (found, expected) in [xx, yy, xy, yx].into_iter().zip([0, 1, 2, 2].map(|i| expected[i])) {
                prop_assert!((found - expected).abs() < 2e-7, "{} for {}", found, expected);
            }
        }
    }

    /// By hand, in whole numbers: x = 1/2, y = 1/4, so r² = 5/16; k1 = 1/10, k2 = -1/5, k3 = 2/5, k4 = 4/5, p1 = 1/100,
    /// p2 = -1/50.
    #[test]
    fn every_coefficient_has_its_power() {
        let lens = |k| Distortion { k, p: [0.0; 2] }.distort([0.5, 0.25]);
        for (i, power) in [5.0 / 16.0, 25.0 / 256.0, 125.0 / 4096.0, 625.0 / 65536.0].into_iter().enumerate() {
            let k = std::array::from_fn(|n| if n == i { 1.0 } else { 0.0 });
            assert_eq!(lens(k), [0.5 * (1.0 + power), 0.25 * (1.0 + power)]);
        }
        let all = Distortion { k: [0.1, -0.2, 0.4, 0.8], p: [0.01, -0.02] }.distort([0.5, 0.25]);
        // s = 1/32 - 5/256 + 25/2048 + 125/16384 = 517/16384; x (1 + s) = 16901/32768, y (1 + s) = 16901/65536;
        // tangential: dx = 1/400 - 13/800 = -11/800 and dy = -1/200 + 7/1600 = -1/1600.
        let expected = [16901.0 / 32768.0 - 11.0 / 800.0, 16901.0 / 65536.0 - 1.0 / 1600.0];
        assert!((0..2).all(|i| (all[i] - expected[i]).abs() < 1e-15), "{all:?} for {expected:?}");
    }

    #[test]
    fn beyond_the_fold_the_inner_point_is_found() {
        let lens = Distortion { k: [-0.085, -0.092, 0.0, 0.0], p: [0.0, 0.0066] };
        let outer = [-0.7654, 0.7882];
        let inner = lens.undistort(lens.distort(outer));
        let [there, here] = [lens.distort(outer), lens.distort(inner)];
        assert!((there[0] - here[0]).abs().max((there[1] - here[1]).abs()) < 1e-12, "{there:?} and {here:?}");
        assert!(inner[0].hypot(inner[1]) < outer[0].hypot(outer[1]) - 1e-3, "{inner:?}");
    }
}
