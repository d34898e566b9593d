//! Directional coverage: from which sides surfaces were seen, whatever the model is sensitive to.
//!
//! Chen et al. (COVER, CVPR 2026, arXiv 2604.05259) show that information gain of colour comes down to this, and rank
//! views by geometry that past cameras covered worst. Here every cell of a coarse grid that a ray ends in has a colour
//! that depends linearly on the direction of view: spherical harmonics up to degree 1, with four coefficients of prior
//! variance 1. A view of the cell from the unit direction d observes w = (1, d)/√2 times them, with noise of variance
//! [`NOISE`]. With G = ε I + Σ w wᵀ over the views so far, another is worth ½ log(1 + wᵀ G⁻¹ w). It is largest where no
//! view was, smaller where views from opposite sides were, and smallest where one from the same side was. Every cell
//! counts once, however many pixels show it. Past views are taken as those of training cameras: traced through the
//! model, so that what lies behind matter is not covered.

use glam::{DMat4, DVec3, DVec4};
use rustc_hash::FxHashMap;

/// ε: variance of a view's noise relative to the prior's. Smaller, a first view of a cell is worth ever more than a
/// second from elsewhere; at 1, a second view from the same side is worth half a first one.
const NOISE: f64 = 0.1;

/// A cell that a view shows, and from where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facet {
    /// Number of the cell.
    pub cell: usize,
    /// Unit vector from the cell to the camera.
    pub towards: DVec3,
}

impl Facet {
    fn observed(&self) -> DVec4 {
        self.towards.extend(1.0) / 2_f64.sqrt()
    }
}

/// G⁻¹ of every cell that was seen.
#[derive(Debug, Clone, Default)]
pub struct Coverage(FxHashMap<usize, DMat4>);

impl Coverage {
    fn of(&self, cell: usize) -> DMat4 {
        self.0.get(&cell).copied().unwrap_or(DMat4::IDENTITY * (1.0 / NOISE))
    }

    /// What the view of these cells is worth.
    #[must_use]
    pub fn gain(&self, facets: &[Facet]) -> f64 {
        let worth = |facet: &Facet| {
            let w = facet.observed();
            0.5 * w.dot(self.of(facet.cell) * w).ln_1p()
        };
        // The sum of no numbers is -0.0.
        0.0 + facets.iter().map(worth).sum::<f64>()
    }

    /// Adds a view (Sherman & Morrison 1950).
    pub fn add(&mut self, facets: &[Facet]) {
        for facet in facets {
            let (inverse, w) = (self.of(facet.cell), facet.observed());
            let v = inverse * w;
            let scaled = v / (1.0 + w.dot(v));
            let change = DMat4::from_cols(v * scaled.x, v * scaled.y, v * scaled.z, v * scaled.w);
            self.0.insert(facet.cell, inverse - change);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facet(cell: usize, towards: DVec3) -> Facet {
        Facet { cell, towards }
    }

    #[test]
    fn what_was_seen_from_elsewhere_or_never_is_worth_more() {
        let mut coverage = Coverage::default();
        let never = coverage.gain(&[facet(3, DVec3::X)]);
        // w is a unit vector: ½ ln(1 + 1/ε).
        assert!((never - 0.5 * 11_f64.ln()).abs() < 1e-12, "{never}");
        coverage.add(&[facet(3, DVec3::X)]);
        let [same, aside, opposite] = [DVec3::X, DVec3::Y, DVec3::NEG_X].map(|d| coverage.gain(&[facet(3, d)]));
        assert!(same < aside && aside < opposite, "{same} {aside} {opposite}");
        // ½ ln(1 + 1 / (1 + ε)), and what is orthogonal to (1, d) is as new as ever.
        assert!((same - 0.5 * (1.0 + 1.0 / 1.1_f64).ln()).abs() < 1e-12, "{same}");
        assert!((opposite - never).abs() < 1e-12, "{opposite}");
        assert!((coverage.gain(&[facet(4, DVec3::X)]) - never).abs() < 1e-12, "another cell");
        assert!(coverage.gain(&[]).is_sign_positive(), "nothing is 0, and not -0");
    }

    /// By the matrix determinant lemma gains add up to ½ log det(G / ε), whatever the order.
    #[test]
    fn the_order_of_views_does_not_count() {
        let views = [DVec3::X, DVec3::new(0.6, 0.8, 0.0), DVec3::NEG_Z, DVec3::X];
        let total = |order: [usize; 4]| {
            let mut coverage = Coverage::default();
            order.map(|k| {
                let gain = coverage.gain(&[facet(0, views[k])]);
                coverage.add(&[facet(0, views[k])]);
                gain
            })
        };
        let [a, b] = [[0, 1, 2, 3], [3, 2, 0, 1]].map(|order| total(order).iter().sum::<f64>());
        let mut g = DMat4::IDENTITY * NOISE;
        for view in views {
            let w = facet(0, view).observed();
            g += DMat4::from_cols(w * w.x, w * w.y, w * w.z, w * w.w);
        }
        let expected = 0.5 * (g.determinant() / NOISE.powi(4)).ln();
        assert!((a - expected).abs() < 1e-12 && (b - expected).abs() < 1e-12, "{a} {b} {expected}");
    }
}
