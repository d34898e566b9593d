//! Clean-up: removes the density that is too uncertain from a field (the paper, Sec. 5.2).

use glam::Vec3;

use super::{Answer, BakedField, Observability};
use crate::field::{Radiance, RadianceField, TrainedField};
use crate::geometry::Aabb;

/// Largest share of the visible surfaces that a clean-up removes without a warning.
pub const NEARLY_ALL: f64 = 0.9;
/// The share of visible surfaces that a threshold of 1 may have meant, and any other that removes nearly all.
const USUAL: f64 = 0.99;

/// A warning for a threshold of log10 U that nearly all points on visible surfaces exceed: it may have been meant as a
/// share of them. `None` if they do not exceed it, or if the field has no such points.
#[must_use]
pub fn threshold_warning(field: &BakedField, log10: f64) -> Option<String> {
    let share = if log10 > 0.0 && log10 < 1.0 { log10 } else { USUAL };
    let [usual] = field.surface_quantiles([share])?;
    let points: Vec<Vec3> = field.field().surface().iter().copied().map(Vec3::from_array).collect();
    let above = field.query_all(&points).iter().filter(|found| found.uncertainty.log10() > log10).count();
    let removed = above as f64 / points.len() as f64;
    (removed >= NEARLY_ALL).then(|| {
        let percents = [100.0 * removed, 100.0 * share].map(|percent| (100.0 * percent).round() / 100.0);
        let [removed, share] = percents;
        format!(
            "log10 U is above {log10} on {removed} % of the visible surfaces, where density is removed; as a share, \
             {share}%, the threshold is log10 U = {usual:.3}"
        )
    })
}

/// `[n]`: which parts with these `centers` (`[n]`, such as those of splats) a clean-up keeps: those at whose centre
/// log10 U is at most `threshold`, but none that was never seen, whose U is not that of a look at it. From the prior
/// on, all are kept.
#[must_use]
pub fn is_certain(centers: &[Vec3], field: &BakedField, threshold: f64) -> Vec<bool> {
    let is_all = threshold >= field.field().record().reading().prior().log10();
    let is_kept = |at: Answer| {
        at.estimate.uncertainty.log10() <= threshold && (is_all || at.observability != Some(Observability::Unseen))
    };
    field.answers(centers).into_iter().map(is_kept).collect()
}

/// A radiance field whose density is zero wherever log10 U exceeds a threshold.
pub struct ThresholdedField<'a> {
    field: &'a dyn RadianceField,
    uncertainty: &'a BakedField<'a>,
    threshold: f64,
}

impl<'a> ThresholdedField<'a> {
    /// `field` with the density where log10 U is at most `threshold`.
    #[must_use]
    pub fn new(field: &'a dyn RadianceField, uncertainty: &'a BakedField<'a>, threshold: f64) -> Self {
        Self { field, uncertainty, threshold }
    }

    /// The field before the clean-up.
    #[must_use]
    pub fn uncleaned(&self) -> &'a dyn RadianceField {
        self.field
    }

    /// Its uncertainty.
    #[must_use]
    pub fn uncertainty(&self) -> &'a BakedField<'a> {
        self.uncertainty
    }

    /// Largest log10 U that is kept.
    #[must_use]
    pub fn threshold(&self) -> f64 {
        self.threshold
    }

    /// Calls `remove` for the index of every point at which nothing is kept.
    fn for_each_removed(&self, positions: &[Vec3], has_density: impl Fn(usize) -> bool, mut remove: impl FnMut(usize)) {
        let dense: Vec<usize> = (0..positions.len()).filter(|&i| has_density(i)).collect();
        let points: Vec<Vec3> = dense.iter().map(|&i| positions[i]).collect();
        let is_kept = |uncertainty: f64| uncertainty.log10() <= self.threshold;
        let found = dense.into_iter().zip(self.uncertainty.query_all(&points));
        found.filter(|(_, found)| !is_kept(found.uncertainty)).for_each(|(i, _)| remove(i));
    }
}

impl RadianceField for ThresholdedField<'_> {
    fn bounds(&self) -> Aabb {
        self.field.bounds()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        self.field.evaluate(positions, directions, out);
        let densities: Vec<f32> = out.iter().map(|out| out.density).collect();
        self.for_each_removed(positions, |i| densities[i] > 0.0, |i| out[i].density = 0.0);
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        self.field.densities(positions, out);
        let dense: Vec<bool> = out.iter().map(|density| *density > 0.0).collect();
        self.for_each_removed(positions, |i| dense[i], |i| out[i] = 0.0);
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        self.field.density_bound(min, max)
    }

    fn suggested_step(&self) -> f64 {
        self.field.suggested_step()
    }

    fn batch(&self) -> usize {
        self.field.batch()
    }

    fn memory(&self) -> usize {
        self.field.memory()
    }
}

impl TrainedField for ThresholdedField<'_> {
    fn describe(&self) -> String {
        format!("a field, cleaned at log10 U <= {}", self.threshold)
    }
}
