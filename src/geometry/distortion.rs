//! OpenCV's lens distortion, as COLMAP, nerfstudio and instant-ngp write it.
//!
//! Letters: (x, y) ideal image coordinates on the plane at depth 1, y downwards; r² = x² + y². The lens moves
//! them by dx = x (k1 r² + k2 r⁴) + 2 p1 xy + p2 (r² + 2x²) and dy = y (k1 r² + k2 r⁴) + 2 p2 xy + p1 (r² + 2y²).

/// Radial (k) and tangential (p) coefficients; all zero is a perfect pinhole.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distortion {
    /// Radial coefficients of r² and r⁴.
    pub k: [f64; 2],
    /// Tangential coefficients.
    pub p: [f64; 2],
}

impl Distortion {
    /// Maps an ideal point to where the lens puts it.
    #[must_use]
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let radial = r2 * (self.k[0] + self.k[1] * r2);
        let [p1, p2] = self.p;
        let dx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let dy = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y);
        [x + dx, y + dy]
    }

    /// Derivatives of [`Distortion::distort`]: ∂x'/∂x, ∂y'/∂y, and ∂x'/∂y, which is ∂y'/∂x.
    fn derivatives(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let r2 = x * x + y * y;
        let ([k1, k2], [p1, p2]) = (self.k, self.p);
        let radial = r2 * (k1 + k2 * r2);
        // d(radial)/dx = 2x · slope.
        let slope = k1 + 2.0 * k2 * r2;
        let xx = 1.0 + radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
        let yy = 1.0 + radial + 2.0 * y * y * slope + 2.0 * p2 * x + 6.0 * p1 * y;
        [xx, yy, 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y]
    }

    /// The ideal point that the lens puts at `seen`, by Newton's method.
    ///
    /// If the coefficients fold the image over there, this is the nearest point found.
    #[must_use]
    pub fn undistort(&self, seen: [f64; 2]) -> [f64; 2] {
        if *self == Self::default() {
            return seen;
        }
        let [mut x, mut y] = seen;
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
        const STEPS: u32 = 16;
        let ideal = self.undistort(seen);
        let back = self.distort(ideal);
        let scale = 1.0 + seen[0].abs().max(seen[1].abs());
        let is_reached = (0..2).all(|k| (back[k] - seen[k]).abs() < 1e-9 * scale);
        let keeps_its_side = (1..=STEPS).all(|step| {
            let [xx, yy, xy] = self.derivatives(ideal.map(|v| v * f64::from(step) / f64::from(STEPS)));
            xx > 0.0 && xx * yy - xy * xy > 0.0
        });
        is_reached && keeps_its_side
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn undistort_is_the_inverse(
            x in -0.8..0.8_f64,
            y in -0.8..0.8_f64,
            k in [-0.1..0.1_f64, -0.1..0.1],
            p in [-1e-2..1e-2_f64, -1e-2..1e-2],
        ) {
            let lens = Distortion { k, p };
            // Beyond the fold a point nearer to the centre has the same image.
            let [xx, yy, xy] = lens.derivatives([x, y]);
            prop_assume!(xx * yy - xy * xy > 0.05);
            let found = lens.undistort(lens.distort([x, y]));
            prop_assert!((found[0] - x).abs().max((found[1] - y).abs()) < 1e-12, "{:?} for {:?}", found, [x, y]);
        }
    }

    #[test]
    fn beyond_the_fold_the_inner_point_is_found() {
        let lens = Distortion { k: [-0.085, -0.092], p: [0.0, 0.0066] };
        let outer = [-0.7654, 0.7882];
        let inner = lens.undistort(lens.distort(outer));
        let [there, here] = [lens.distort(outer), lens.distort(inner)];
        assert!((there[0] - here[0]).abs().max((there[1] - here[1]).abs()) < 1e-12, "{there:?} and {here:?}");
        assert!(inner[0].hypot(inner[1]) < outer[0].hypot(outer[1]) - 1e-3, "{inner:?}");
    }
}
