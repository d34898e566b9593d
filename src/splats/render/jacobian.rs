//! How a pixel's colour and its depth change when its splats move.
//!
//! With b = ∂C/∂α = T c − S/(1 − α) and g = ∂α/∂μ, the Jacobian is G = b gᵀ + w ∂c/∂μ: 3×3, row = colour channel,
//! column = axis. Its three parts are the motion on the image, the change of the ellipse, both in g, and the change of
//! colour with the direction of view. The expected depth D = Σ w z / Σ w moves by
//!
//! ∂D/∂μ = [(T (z − D) − S'/(1 − α)) g + w r₃] / Σ w, with S' = Σ_{j>i} w_j (z_j − D) and r₃ the view axis.
//!
//! The displacement moves centres only: that it would also stretch a splat, Σ → (I + ∇D) Σ (I + ∇D)ᵀ, is left out.

use glam::{DVec3, Vec3};

use super::project::Slope;
use super::{Hit, Hits, SplatView};
use crate::geometry::Ray;
use crate::render::{DepthSample, RaySample, RaySamples, VisibleSegment};

impl Slope {
    /// g = ∂α/∂μ, 1 / scene unit.
    fn of(&self, hit: &Hit) -> DVec3 {
        if hit.is_limited {
            return DVec3::ZERO;
        }
        let v = hit.v;
        let n = [v.x, v.y, v.x * v.x, v.x * v.y, v.y * v.y, 1.0];
        let sum: DVec3 = self.of_alpha.iter().zip(n).map(|(column, n)| n * Vec3::from(*column).as_dvec3()).sum();
        hit.alpha * sum
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
        let first = out.positions.len();
        let mut behind = hits.passed * self.renderer.background().as_dvec3();
        let mut samples = Vec::with_capacity(hits.list.len());
        for hit in hits.list.iter().rev() {
            let (footprint, slope) = (&self.footprints[hit.footprint as usize], &self.slopes[hit.footprint as usize]);
            let (color, weight) = (footprint.color, hit.weight());
            let b = hit.before * color - behind / (1.0 - hit.alpha);
            let g = slope.of(hit);
            let entry =
                |channel: usize, axis: usize| b[channel] * g[axis] + weight * f64::from(slope.of_color[channel][axis]);
            let jacobian = std::array::from_fn(|k| entry(k / 3, k % 3) as f32);
            let position = self.renderer.splats().mean(footprint.splat as usize);
            samples.push(RaySample { position, jacobian, weight: weight as f32 });
            behind += weight * color;
        }
        if let Some(bad) = samples.iter().find(|sample| !sample.jacobian.iter().all(|v| v.is_finite())) {
            out.dropped += 1;
            out.first_invalid = out.first_invalid.or(Some(bad.position));
            return;
        }
        samples.into_iter().rev().for_each(|sample| out.push(index, sample));
        debug_assert!(out.positions.len() == first + hits.list.len());
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

    /// ∂d/∂μ of the expected distance d along `ray`, for all hits, front to back. None without hits.
    pub(super) fn depth_samples(&self, hits: &Hits, ray: &Ray) -> Vec<DepthSample> {
        let depth = |hit: &Hit| self.footprints[hit.footprint as usize].depth;
        let total: f64 = hits.list.iter().map(Hit::weight).sum();
        let mean = hits.list.iter().map(|hit| hit.weight() * depth(hit)).sum::<f64>() / total;
        let (forward, mut behind) = (self.forward(), 0.0);
        let scale = 1.0 / (total * ray.direction.dot(forward));
        let mut samples: Vec<DepthSample> = Vec::with_capacity(hits.list.len());
        for hit in hits.list.iter().rev() {
            let offset = depth(hit) - mean;
            let by_alpha = hit.before * offset - behind / (1.0 - hit.alpha);
            let slope = &self.slopes[hit.footprint as usize];
            let gradient = scale * (by_alpha * slope.of(hit) + hit.weight() * forward);
            samples.push(DepthSample { position: self.renderer.splats().mean(self.splat(hit)), gradient });
            behind += hit.weight() * offset;
        }
        samples.reverse();
        samples
    }
}
