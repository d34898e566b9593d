//! A vertex's sums in 28 bytes.
//!
//! S has entries that differ by ten decades and more. In f32 its small eigenvalues would drown, and `block` is made
//! of them. Its Cholesky factor spans half as many decades and keeps both: if every entry of L is off by a relative
//! δ, so are the diagonal entries of S = L Lᵀ (by 2 δ), and, as long as each column's diagonal entry is its
//! largest, every quadratic form vᵀSv by about 6 δ. Pivoting makes it so.
//!
//! Letters: S the information, P a permutation of the axes, L lower triangular, PᵀSP = L Lᵀ.

use super::double_double::DoubleDouble;
use super::{Information, VertexSums};
use crate::io::container::Item;

/// The six orders of the axes, by number.
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// The Cholesky factor of a vertex's information in f32, and its ray count.
///
/// Entries 00, 10, 11, 20, 21, 22 of L. The signs of the diagonal, which is not negative, hold the number of the
/// order of pivots, 0 to 5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FactoredSums {
    entries: [f32; 6],
    rays: u32,
}

/// Index of entry (i, k) of a symmetric matrix given as xx, xy, xz, yy, yz, zz.
fn index(i: usize, k: usize) -> usize {
    let (i, k) = (i.min(k), i.max(k));
    [0, 3, 5][i] + (k - i)
}

impl From<&VertexSums> for FactoredSums {
    fn from(sums: &VertexSums) -> Self {
        let s = &sums.information;
        let zero = DoubleDouble::from(0.0);
        let root = |pivot: DoubleDouble| f64::from(pivot.max(zero)).sqrt();
        // An entry of L beside the `root` of its column's pivot; at most the root of its row's, up to rounding. A
        // column is empty if the pivots before it explain everything.
        let entry = |value: DoubleDouble, root: f64, most: f64| match root > 0.0 {
            true => (f64::from(value) / root).clamp(-most, most),
            false => 0.0,
        };

        let first = (0..3).fold(0, |best, i| if s[index(i, i)] > s[index(best, best)] { i } else { best });
        let others = [0, 1, 2].map(|k| (first + k) % 3);
        let (a, b) = (others[1], others[2]);
        let pivot = s[index(first, first)];
        let schur = |i: usize, k: usize| {
            let own = DoubleDouble::from(s[index(i, k)]);
            if pivot > 0.0 {
                let product = DoubleDouble::from(s[index(first, i)]) * DoubleDouble::from(s[index(first, k)]);
                own - product / DoubleDouble::from(pivot)
            } else {
                own
            }
        };
        let (second, third) = if f64::from(schur(b, b)) > f64::from(schur(a, a)) { (b, a) } else { (a, b) };
        let l00 = pivot.max(0.0).sqrt();
        let [l10, l20] =
            [second, third].map(|i| entry(DoubleDouble::from(s[index(first, i)]), l00, s[index(i, i)].max(0.0).sqrt()));
        let [c11, c21, c22] = [[second, second], [third, second], [third, third]].map(|[i, k]| schur(i, k));
        let l11 = root(c11);
        let l21 = entry(c21, l11, root(c22));
        let rest = if l11 > 0.0 { c22 - c21 / c11 * c21 } else { c22 };
        let entries = [l00, l10, l11, l20, l21, root(rest)];
        let order = ORDERS.iter().position(|order| *order == [first, second, third]).unwrap_or(0);
        // Sums of other programs may exceed f32; the largest f32 is 10³⁸, and no ray moves anything by that much.
        let mut entries = entries.map(|v| (v as f32).clamp(f32::MIN, f32::MAX));
        for (bit, diagonal) in [0, 2, 5].into_iter().enumerate() {
            entries[diagonal] = entries[diagonal].abs().copysign(if order >> bit & 1 == 1 { -1.0 } else { 1.0 });
        }
        Self { entries, rays: sums.rays }
    }
}

impl FactoredSums {
    /// Checks whether sums can have this factor.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.entries.iter().all(|v| v.is_finite()) && self.order() < ORDERS.len()
    }

    fn order(&self) -> usize {
        [0, 2, 5].into_iter().enumerate().map(|(bit, i)| usize::from(self.entries[i].is_sign_negative()) << bit).sum()
    }

    /// The order of the axes, and entries 00, 10, 11, 20, 21, 22 of L: those of a column are at most its first.
    #[must_use]
    pub fn factor(&self) -> Option<([usize; 3], [f32; 6])> {
        let [l00, l10, l11, l20, l21, l22] = self.entries;
        Some((*ORDERS.get(self.order())?, [l00.abs(), l10, l11.abs(), l20, l21, l22.abs()]))
    }

    /// The sums, with f32 precision; zero if the factor is not [valid](FactoredSums::is_valid).
    #[must_use]
    pub fn sums(&self) -> VertexSums {
        let Some((order, entries)) = self.factor() else { return VertexSums::default() };
        let [l00, l10, l11, l20, l21, l22] = entries.map(f64::from);
        let rows = [[l00, 0.0, 0.0], [l10, l11, 0.0], [l20, l21, l22]];
        let mut information: Information = [0.0; 6];
        for (i, a) in rows.iter().enumerate() {
            for (k, b) in rows.iter().enumerate().take(i + 1) {
                information[index(order[i], order[k])] = a.iter().zip(b).map(|(a, b)| a * b).sum();
            }
        }
        VertexSums::new(information, self.rays)
    }
}

impl Item for FactoredSums {
    const SIZE: usize = <[f32; 6]>::SIZE + u32::SIZE;

    fn put(self, out: &mut Vec<u8>) {
        self.entries.put(out);
        self.rays.put(out);
    }

    fn take(bytes: &[u8]) -> Self {
        let (entries, rays) = bytes.split_at(<[f32; 6]>::SIZE);
        Self { entries: Item::take(entries), rays: Item::take(rays) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::posterior::Covariance;
    use proptest::prelude::*;

    proptest! {
        /// Sums of up to four rays' squares over 20 decades, which may nearly be of rank 1 or 2.
        #[test]
        fn every_covariance_survives(
            rows in proptest::collection::vec((proptest::array::uniform3(-1.0..1.0_f64), -14..6_i32), 0..5),
            turned in proptest::bool::ANY, rays in 1_u32..,
        ) {
            let mut sums = VertexSums::new([0.0; 6], rays);
            for (row, decade) in &rows {
                // Rows along an axis but for a little, so that pivots differ by decades.
                let g = if turned { *row } else { [row[0], 1e-3 * row[1], 1e-7 * row[2]] };
                let g = g.map(|v| v * 10_f64.powf(0.5 * f64::from(*decade)));
                let squares = [g[0] * g[0], g[0] * g[1], g[0] * g[2], g[1] * g[1], g[1] * g[2], g[2] * g[2]];
                sums.information.iter_mut().zip(squares).for_each(|(s, v)| *s += v);
            }
            let factor = FactoredSums::from(&sums);
            prop_assert!(factor.is_valid());
            let mut bytes = Vec::new();
            factor.put(&mut bytes);
            prop_assert_eq!((bytes.len(), FactoredSums::take(&bytes)), (28, factor));
            let kept = factor.sums();
            prop_assert!(kept.is_valid() && kept.rays == rays, "{:?} became {:?}", sums, kept);
            for i in [0, 3, 5] {
                let off = (kept.information[i] - sums.information[i]).abs();
                prop_assert!(off <= 2e-7 * sums.information[i] + f64::MIN_POSITIVE, "{:?} became {:?}", sums, kept);
            }
            // 6 δ with δ = 6e-8 is 3.6e-7 of σ², 8e-8 decades of σ. In addition both S are rounded to f64: their
            // smallest eigenvalues are known to 1e-16 of the largest entry.
            let lambda = 1e-7;
            let noise = 1e-14 * crate::posterior::trace(&sums.information) / lambda;
            for covariance in Covariance::ALL {
                let [kept, exact] = [&kept, &sums].map(|sums| covariance.deviation(sums, 1, lambda));
                let allowed = 3e-7 + if covariance == Covariance::Block { noise } else { 0.0 };
                prop_assert!((kept / exact).log10().abs() <= allowed, "{:?}: {} for {}", covariance, kept, exact);
            }
        }
    }

    #[test]
    fn pivots_may_come_in_any_order() {
        for order in ORDERS {
            let mut sums = VertexSums::new([0.0; 6], 3);
            for (k, axis) in order.into_iter().enumerate() {
                sums.information[index(axis, axis)] = 4.0_f64.powi(-(k as i32));
            }
            let factor = FactoredSums::from(&sums);
            assert_eq!(ORDERS[factor.order()], order);
            assert_eq!(factor.sums(), sums);
        }
        assert_eq!(FactoredSums::from(&VertexSums::default()).sums(), VertexSums::default());
        let negative = |entries| FactoredSums { entries, rays: 0 }.is_valid();
        assert!(!negative([-1.0, 0.0, -1.0, 0.0, 0.0, -1.0]) && !negative([f32::NAN, 0.0, 1.0, 0.0, 0.0, 1.0]));
    }
}
