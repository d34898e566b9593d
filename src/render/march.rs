//! Sample positions along a ray.
//!
//! Samples sit at t = entry + (k + jitter) · step, k = 0, 1, …, up to the exit from the box. Each stands for an
//! interval of length `step`. Blocks of cells where no sample could matter are skipped. The other samples keep
//! their places, so skipping moves none of them.

use super::Occupancy;
use super::occupancy::{Crossings, SkipBlock, Space};
use crate::geometry::{Aabb, Ray};

/// Places samples along rays.
#[derive(Debug, Clone)]
pub struct Marcher {
    /// Distance between samples, scene units.
    pub step: f64,
    /// The box that is sampled.
    pub bounds: Aabb,
    /// Upper bound of the density; `None` samples everything.
    pub occupancy: Option<Occupancy>,
    /// Smallest optical depth and transmittance that matter. Cells are skipped if, by their density bound, all of
    /// them along a ray together stay below this optical depth. A ray ends when its transmittance falls below it.
    pub cutoff: f64,
}

impl Marcher {
    /// Appends the distances of the ray's samples to `t`; `jitter` in `[0, 1)` shifts all
    /// of them by that share of a step.
    pub fn distances(&self, ray: &Ray, jitter: f64, t: &mut Vec<f64>) {
        t.extend(self.walk(ray, jitter));
    }

    /// Walks along the distances of the ray's samples. They are found on demand, because rays
    /// often end long before the box.
    #[must_use]
    pub fn walk(&self, ray: &Ray, jitter: f64) -> SampleDistances<'_> {
        let (entry, exit) = self.bounds.clip(ray).unwrap_or_default();
        let steps = ((exit - entry) / self.step).ceil() as u64;
        // Thin fog adds up. No ray through the box is longer than its diagonal.
        let least = (self.cutoff / self.bounds.size().length()) as f32;
        let known = if self.occupancy.is_none() { steps } else { 0 };
        let crossings = self.occupancy.as_ref().map(|occupancy| occupancy.crossings(ray)).unwrap_or_default();
        let per_step = 1.0 / self.step;
        SampleDistances {
            marcher: self,
            ray: *ray,
            jitter,
            entry,
            exit,
            steps,
            least,
            k: 0,
            known,
            crossings,
            per_step,
        }
    }

    /// Density bound at a point; ∞ without an occupancy grid.
    #[must_use]
    pub fn majorant(&self, x: glam::DVec3) -> f64 {
        self.occupancy.as_ref().map_or(f64::INFINITY, |o| f64::from(o.majorant(x)))
    }
}

/// Iterator over the sample distances along a ray, in increasing order.
#[derive(Debug, Clone)]
pub struct SampleDistances<'a> {
    marcher: &'a Marcher,
    ray: Ray,
    jitter: f64,
    entry: f64,
    exit: f64,
    steps: u64,
    /// Largest density that cannot matter.
    least: f32,
    /// Next candidate.
    k: u64,
    /// All candidates before this one are samples.
    known: u64,
    crossings: Crossings,
    /// Steps per scene unit.
    per_step: f64,
}

impl SampleDistances<'_> {
    fn place(&self, k: u64) -> f64 {
        self.entry + (k as f64 + self.jitter) * self.marcher.step
    }

    /// Returns a candidate after the current one such that all between them are in the
    /// block; usually the first outside it.
    fn behind(&self, block: SkipBlock, occupancy: &Occupancy) -> u64 {
        // Cell indices are monotone along a ray: if a later candidate is in the block, so are those between.
        // Division finds the last one. Rounding may put it just behind the block's face; then it is the one before.
        let last = ((self.crossings.exit(block) - self.entry) * self.per_step - self.jitter) as u64;
        let mut lasts = [last, last.saturating_sub(1)].into_iter().map(|last| last.min(self.steps - 1));
        let inside = |k: u64| k > self.k && occupancy.is_in(self.ray.at(self.place(k)), block);
        lasts.find(|&k| inside(k)).unwrap_or(self.k) + 1
    }
}

impl Iterator for SampleDistances<'_> {
    type Item = f64;

    fn next(&mut self) -> Option<f64> {
        while self.k < self.steps {
            let t = self.place(self.k);
            if t >= self.exit {
                break;
            }
            if let (Some(occupancy), true) = (&self.marcher.occupancy, self.k >= self.known) {
                match occupancy.space(self.ray.at(t), self.least) {
                    Space::Matter(block) => self.known = self.behind(block, occupancy),
                    Space::Low(block) => {
                        self.k = self.behind(block, occupancy);
                        continue;
                    }
                    Space::Outside => {
                        self.k += 1;
                        continue;
                    }
                }
            }
            self.k += 1;
            return Some(t);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use super::*;
    use crate::field::{ClosedForm, RadianceField};
    use crate::monitor::Silent;
    use glam::DVec3;
    use proptest::prelude::*;

    /// The same as [`Marcher::distances`], step by step instead of by leaps.
    fn distances_slowly(marcher: &Marcher, ray: &Ray, jitter: f64) -> Vec<f64> {
        let Some((entry, exit)) = marcher.bounds.clip(ray) else { return Vec::new() };
        let steps = ((exit - entry) / marcher.step).ceil() as u64;
        let least = marcher.cutoff / marcher.bounds.size().length();
        let candidates = (0..steps).map(|k| entry + (k as f64 + jitter) * marcher.step).take_while(|&t| t < exit);
        candidates.filter(|&t| marcher.majorant(ray.at(t)) > f64::from(least as f32)).collect()
    }

    /// Scenes with grids of a single brick, of several bricks, of bricks that stick out, and of a single value.
    static MARCHERS: LazyLock<Vec<Marcher>> = LazyLock::new(|| {
        let scenes =
            [("courtyard", 8), ("courtyard", 19), ("courtyard", 64), ("slab", 12), ("floater", 33), ("city", 96)];
        let marcher = |(name, resolution)| {
            let field = ClosedForm::named(name).unwrap();
            let occupancy = Some(Occupancy::build(&field, resolution, 0.0, &Silent).unwrap());
            Marcher { step: 0.0, bounds: field.bounds(), occupancy, cutoff: 1e-4 }
        };
        scenes.map(marcher).to_vec()
    });

    /// A coordinate in units of the box, often on or an ulp beside the face of a cell,
    /// of a brick or of the box itself.
    fn coordinate() -> impl Strategy<Value = f64> {
        let face = (0u32..97, -1i32..2).prop_map(|(i, side)| {
            let face = f64::from(i) / 96.0;
            if side < 0 {
                face.next_down()
            } else if side > 0 {
                face.next_up()
            } else {
                face
            }
        });
        prop_oneof![-0.5..1.5_f64, 0.0..1.0_f64, face]
    }

    /// A component of a direction: zero, almost zero, or any.
    fn component() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-1.0), Just(1e-14), Just(-1e-9), -1.0..1.0_f64]
    }

    proptest! {
        #[test]
        fn leaps_keep_the_samples_that_single_steps_keep(
            scene in 0..MARCHERS.len(),
            origin in [coordinate(), coordinate(), coordinate()],
            direction in [component(), component(), component()],
            // From a thirtieth of the smallest cell to several bricks.
            step in prop_oneof![3e-4..3e-3_f64, 3e-3..0.3_f64, Just(1.0 / 96.0), Just(1.0 / 64.0)],
            jitter in prop_oneof![Just(0.0), Just(0.5), 0.0..1.0_f64],
        ) {
            let direction = DVec3::from_array(direction);
            prop_assume!(direction.length() > 0.0);
            let bounds = MARCHERS[scene].bounds;
            let marcher = Marcher { step: step * bounds.longest_edge(), ..MARCHERS[scene].clone() };
            let ray = Ray::new(bounds.min() + DVec3::from_array(origin) * bounds.size(), direction);
            let mut t = vec![-1.0];
            marcher.distances(&ray, jitter, &mut t);
            prop_assert_eq!(&t[1..], distances_slowly(&marcher, &ray, jitter));
        }
    }

    #[test]
    fn occupancy_removes_samples_but_moves_none() {
        let field = ClosedForm::ball();
        let all = Marcher { step: 0.01, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
        let occupancy = Occupancy::build(&field, 32, 0.0, &Silent).unwrap();
        let some = Marcher { occupancy: Some(occupancy), cutoff: 1e-4, ..all.clone() };
        let ray = Ray::new(DVec3::new(-3.0, 0.1, 0.2), DVec3::new(1.0, 0.05, -0.02));
        let (mut a, mut b) = (Vec::new(), Vec::new());
        all.distances(&ray, 0.3, &mut a);
        some.distances(&ray, 0.3, &mut b);
        // The chord through the ball and its ramp is 0.916 long. Each end may add a cell, with a diagonal of 0.108.
        assert!((198..=202).contains(&a.len()) && (91..=114).contains(&b.len()), "{} of {}", b.len(), a.len());
        assert!(b.iter().all(|t| a.contains(t)));
    }
}
