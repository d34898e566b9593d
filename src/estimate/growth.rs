//! How what a run takes grows with its rays, by its first ones.
//!
//! Letters: V vertices have sums after n rays, f₁ of them touched by a single ray. The next ray meets a new vertex as
//! often as f₁ of n rays did (Good 1953, Turing), so that e = d log V / d log n = f₁ / V. This slope falls while rays
//! meet what others met. If 1 / e goes on to grow with log n as it did between two marks, by c for every factor of
//! Euler's number,
//!
//! ```text
//! V(n) = V (1 + e c log(n / n₀))^(1 / c),
//! ```
//!
//! which bounds what follows where that growth quickens. It does if rates are alike. If they spread evenly over many
//! orders of magnitude, it is even, and V(n) exact. (Many vertices of a high rate and more of a low one, with none
//! between, would exceed it. The only bound that holds then is a straight line, at several times what scenes were found
//! to have.) The vertices of a field are those and their neighbours: the two marks show by which part of log V the
//! logarithm of their number grows.

use std::time::Duration;

/// Rays of a low-discrepancy sequence are farther apart than random ones, and meet more new vertices: of random ones,
/// the sums on disk of one run would have been foreseen as 1 % too few.
const EVEN: f64 = 1.05;

/// What the first rays of a run, or of one set of its rays, have taken.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Mark {
    /// Number of these rays.
    pub rays: f64,
    /// Number of vertices that have sums.
    pub sums: f64,
    /// Number of these that a single ray touched.
    pub once: f64,
    /// Size of the sums in memory, bytes.
    pub memory: f64,
    /// Number of vertices that a field of these rays has.
    pub vertices: f64,
    /// Time that the rays took, and that finding the vertices of a field took.
    pub drawing: Duration,
    pub refining: Duration,
}

/// The last two marks of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Growth {
    before: Option<Mark>,
    last: Mark,
}

impl Growth {
    pub fn new(before: Option<Mark>, last: Mark) -> Self {
        Self { before, last }
    }

    pub fn last(&self) -> &Mark {
        &self.last
    }

    /// The logarithm of the ratio of a count now and at the mark before, per that of rays.
    fn slope(&self, count: impl Fn(&Mark) -> f64) -> Option<f64> {
        let before = self.before.filter(|before| count(before) > 0.0 && before.rays < self.last.rays)?;
        Some(((count(&self.last) / count(&before)).ln() / (self.last.rays / before.rays).ln()).max(0.0))
    }

    /// e of the last mark, and c.
    fn of_sums(&self) -> [f64; 2] {
        let e = |mark: &Mark| (EVEN * mark.once / mark.sums.max(1.0)).clamp(1e-6, 1.0);
        let c = self.before.filter(|before| before.sums > 0.0 && before.rays < self.last.rays).map_or(0.0, |before| {
            (1.0 / e(&self.last) - 1.0 / e(&before)).max(0.0) / (self.last.rays / before.rays).ln()
        });
        [e(&self.last), c]
    }

    /// Upper bound on a count after so many rays.
    pub fn at(&self, rays: f64, count: impl Fn(&Mark) -> f64) -> f64 {
        let ([e, c], more) = (self.of_sums(), (rays / self.last.rays).ln());
        // Fewer rays: the tangent.
        let log = if c * more > 1e-9 { (e * c * more).ln_1p() / c } else { e * more };
        let part = match (self.slope(&count), self.slope(|mark| mark.sums)) {
            (Some(slope), Some(of_sums)) if of_sums > 0.0 => slope / of_sums,
            // A dense grid has all its vertices from the first ray on.
            (Some(_), _) => 0.0,
            (None, _) => 1.0,
        };
        count(&self.last) * (part * log).exp()
    }

    /// Number of rays after which so many vertices have sums, or fewer.
    pub fn rays_with(&self, sums: f64) -> f64 {
        let ([e, c], log) = (self.of_sums(), (sums / self.last.sums.max(1.0)).ln());
        let more = if c * log > 1e-9 { (c * log).exp_m1() / (e * c) } else { log / e };
        self.last.rays * more.min(100.0).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mark(rays: f64, sums: f64, once: f64) -> Mark {
        Mark { rays, sums, once, ..Mark::default() }
    }

    proptest! {
        /// Vertices whose rates are alike, or fall off evenly by up to 2^12, are never more than foreseen.
        #[test]
        fn what_saturates_is_bounded(most in 10.0..1e6_f64, fall in 0.0..1.0_f64, rays in 100.0..1e5_f64) {
            // As many vertices of each rate: 1, 2^-fall, 4^-fall, …
            let found = |rays: f64| -> f64 {
                (0..12).map(|k| most * -(-rays / most * (-fall * f64::from(k)).exp2()).exp_m1()).sum()
            };
            let once = |rays: f64| -> f64 {
                (0..12).map(|k| rays / most * (-fall * f64::from(k)).exp2()).map(|r| most * r * (-r).exp()).sum()
            };
            let mark = |rays| mark(rays, found(rays), once(rays));
            let growth = Growth::new(Some(mark(rays)), mark(2.0 * rays));
            for scale in [2.0, 4.0, 16.0, 64.0] {
                let (bound, truth) = (growth.at(scale * rays, |mark| mark.sums), found(scale * rays));
                prop_assert!(bound >= truth * (1.0 - 1e-3), "{} foreseen, {} found", bound, truth);
                prop_assert!(bound <= found(2.0 * rays) * scale / 2.0 * (1.0 + 1e-9), "no more than a line");
            }
            let sums = found(5.0 * rays);
            prop_assert!(growth.rays_with(sums) <= 5.0 * rays * (1.0 + 1e-2));
        }
    }

    #[test]
    fn without_a_mark_before_every_ray_is_new() {
        let growth = Growth::new(None, mark(100.0, 30.0, 30.0));
        let is_near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-12;
        assert!(is_near(growth.at(1600.0, |mark| mark.sums), 480.0) && is_near(growth.rays_with(60.0), 200.0));
        assert_eq!(growth.at(100.0, |mark| mark.sums), 30.0, "of all rays, nothing is left to foresee");
    }
}
