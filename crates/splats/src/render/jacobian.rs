//! How a pixel's colour changes when its splats move.
//!
//! With b = ∂C/∂α = T c − S/(1 − α) and g = ∂α/∂μ, the Jacobian is G = b gᵀ + w ∂c/∂μ: 3×3, row = colour channel,
//! column = axis. Its three parts are the motion on the image, the change of the ellipse, both in g, and the change of
//! colour with the direction of view.
//!
//! The displacement moves centres only: that it would also stretch a splat, Σ → (I + ∇D) Σ (I + ∇D)ᵀ, is left out.

use glam::DVec3;
use multiversion::multiversion;

use super::project::{Footprint, Slope};
use super::{Hit, Hits, SplatView};
use octobayes::geometry::Ray;
use octobayes::render::{RaySamples, VisibleSegment};

/// A pixel shows a splat if its share of the colour is more than this.
const SHOWN: f64 = 0.05;

impl Slope {
    /// g = ∂α/∂μ, 1 / scene unit.
    #[inline(always)]
    fn of(&self, hit: &Hit) -> [f64; 4] {
        if hit.is_limited {
            return [0.0; 4];
        }
        let v = hit.v;
        let n = [v.x, v.y, v.x * v.x, v.x * v.y, v.y * v.y, 1.0];
        let mut sum = [0.0; 4];
        for (column, n) in self.of_alpha.iter().zip(n) {
            (0..4).for_each(|axis| sum[axis] += n * f64::from(column[axis]));
        }
        sum.map(|sum| hit.alpha * sum)
    }
}

/// G of every hit, from what is behind the last of them.
#[multiversion(targets("x86_64+avx2+fma"))]
fn jacobians(hits: &[Hit], footprints: &[Footprint], slopes: &[Slope], mut behind: DVec3, out: &mut [[f32; 9]]) {
    for (hit, out) in hits.iter().zip(out).rev() {
        let (footprint, slope) = (&footprints[hit.footprint as usize], &slopes[hit.footprint as usize]);
        let (color, weight) = (footprint.color, hit.weight());
        let b = hit.before * color - behind / (1.0 - hit.alpha);
        let g = slope.of(hit);
        for channel in 0..3 {
            let of_color = &slope.of_color[channel];
            let row: [f64; 4] = std::array::from_fn(|axis| b[channel] * g[axis] + weight * f64::from(of_color[axis]));
            (0..3).for_each(|axis| out[3 * channel + axis] = row[axis] as f32);
        }
        behind += weight * color;
    }
}

impl SplatView<'_> {
    /// Appends what is shown at an image point to `out` as samples of ray `index`: centres, Jacobians and weights.
    ///
    /// A ray with a number that is not finite is dropped, and counted as such.
    pub(crate) fn push_samples(&self, at: [f64; 2], index: u64, hits: &mut Hits, out: &mut RaySamples) {
        self.hits(at, hits);
        let ray = self.camera.ray(at[0], at[1]);
        out.sight.push(self.segment(hits, ray));
        let Hits { list, passed, jacobians: found } = hits;
        if list.is_empty() {
            return;
        }
        let centre = |hit: &Hit| self.renderer.splats().mean(self.splat(hit));
        let line = out.sight.len() - 1;
        let in_front = list.iter().take_while(|hit| hit.before > 0.5).filter(|hit| hit.weight() > SHOWN);
        out.reached.extend(in_front.map(|hit| (line, centre(hit))));
        found.resize(list.len(), [0.0; 9]);
        let behind = *passed * self.renderer.background().as_dvec3();
        jacobians(list, &self.footprints, &self.slopes, behind, found);
        if let Some(bad) = found.iter().position(|jacobian| !jacobian.iter().all(|v| v.is_finite())) {
            out.dropped += 1;
            out.first_invalid = out.first_invalid.or(Some(centre(&list[bad])));
            return;
        }
        out.rays.push(index);
        out.positions.extend(list.iter().map(centre));
        out.jacobians.extend_from_slice(found);
        out.weights.extend(list.iter().map(|hit| hit.weight() as f32));
        out.offsets.push(out.positions.len());
    }

    /// How far the ray of an image point sees.
    pub(crate) fn sight(&self, at: [f64; 2], hits: &mut Hits) -> VisibleSegment {
        self.hits(at, hits);
        self.segment(hits, self.camera.ray(at[0], at[1]))
    }

    /// The ray of these hits, until T falls to ½; without an end if it does not.
    fn segment(&self, hits: &Hits, ray: Ray) -> VisibleSegment {
        let ends = |hit: &&Hit| hit.before - hit.weight() <= 0.5;
        let last = hits.list.iter().find(ends);
        VisibleSegment { ray, until: last.map_or(f64::INFINITY, |hit| self.distance(hit, &ray)) }
    }

    /// Distance of a splat along the ray of a pixel that shows it, scene units: where its depth lies on the ray.
    pub(super) fn distance(&self, hit: &Hit, ray: &Ray) -> f64 {
        self.footprints[hit.footprint as usize].depth / ray.direction.dot(self.forward())
    }
}
