//! Which samples of a ray need derivatives, which only their colour, and which nothing.
//!
//! What is evaluated depends on how much a sample can change its pixel:
//!
//! | | density | ∇σ | colour | ∇c |
//! |---|---|---|---|---|
//! | *visible*: w > cutoff | x | x | x | x |
//! | *lurking*: w ≤ cutoff, but visible matter may lie within h: √3 δ T σ̂ > cutoff | x | x | if ∇σ ≠ 0 | |
//! | *faint*: 0 < w ≤ cutoff, no visible matter near | x | | x | |
//! | all others, behind surfaces or in empty space | x | | | |
//!
//! Faint samples have no derivatives but are composited: they are part of the colour behind others, which enters
//! ∂C/∂σ.
//!
//! The two criteria bound what differences leave out. w > cutoff bounds the contribution of ∇c (|∇c| ≤ 1/2h), the
//! criterion for lurking samples that of ∇σ (|∇σ| ≤ σ̂/2h). Here |∂C/∂σ| ≤ √3 δ T because colours lie in [0, 1], and
//! σ̂ is the density bound of the occupancy grid. A sample in the empty space before a surface has w = 0 but may see
//! the surface within h: it is lurking. Cutoff 0 leaves out only exact zeros.
//!
//! A field's own derivatives are taken at the same samples, so that h has a say in which they are.
//!
//! σ̂ is also taken to be at most a hundred times the density at the sample and its neighbours on the ray, if these
//! are at least eight h away: sampling a field at that distance presumes that it is resolved. A sudden step in
//! density is not resolved. Rays that pass it within h are found if the field bounds its density everywhere
//! ([`RadianceField::density_bound`](crate::field::RadianceField::density_bound)), and lost if it does not
//! (`experiments/hard_cases.md`).

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::jacobian::JacobianBuffers;
use super::{Differentiation, Occupancy, Tracer};
use crate::geometry::Ray;

/// Assumed bound of the density within h of a sample, as a multiple of the density at the
/// sample and its two neighbours.
const STEEPEST: f64 = 100.0;
/// Smallest distance between samples, in multiples of h, at which that bound is assumed.
const FAR_APART: f64 = 8.0;

/// Largest density at sample `i` of a ray and at its neighbours.
pub(super) fn around(densities: &[f32], ray: &Range<usize>, i: usize) -> f32 {
    let near = i.saturating_sub(1).max(ray.start)..(i + 2).min(ray.end);
    densities[near].iter().copied().fold(0.0, f32::max)
}

/// Samples that need the same evaluation.
#[derive(Default, Clone)]
pub(super) struct Chosen {
    /// `[n]`: index of the sample; increasing where derivatives are needed.
    pub samples: Vec<u32>,
    /// `[n]`: index of its ray.
    pub rays: Vec<u32>,
    pub positions: Vec<Vec3>,
    pub directions: Vec<Vec3>,
}

impl Chosen {
    pub fn clear(&mut self) {
        self.samples.clear();
        self.rays.clear();
        self.positions.clear();
        self.directions.clear();
    }

    pub fn append(&mut self, other: &Self) {
        self.samples.extend(&other.samples);
        self.rays.extend(&other.rays);
        self.positions.extend(&other.positions);
        self.directions.extend(&other.directions);
    }

    pub fn truncate(&mut self, length: usize) {
        self.samples.truncate(length);
        self.rays.truncate(length);
        self.positions.truncate(length);
        self.directions.truncate(length);
    }

    pub fn push(&mut self, sample: usize, ray: usize, position: Vec3, direction: Vec3) {
        self.samples.push(sample as u32);
        self.rays.push(ray as u32);
        self.positions.push(position);
        self.directions.push(direction);
    }
}

impl Tracer<'_> {
    /// Upper bound of |∂C/∂σ| at transmittance T.
    pub(super) fn influence(&self, transmittance: f64) -> f64 {
        3_f64.sqrt() * self.marcher.step * transmittance
    }

    /// Finds the visible, the lurking and the faint samples.
    pub(super) fn choose(&self, rays: &[Ray], differentiation: &Differentiation, buffers: &mut JacobianBuffers) {
        let JacobianBuffers { trace, quadrature, visible, lurking, faint, .. } = buffers;
        let traced = &trace.traced;
        [&mut *visible, lurking, faint].into_iter().for_each(Chosen::clear);
        for (r, ray) in rays.iter().enumerate() {
            let direction = ray.direction.as_vec3();
            let samples = traced.samples(r);
            for i in samples.clone() {
                let x = traced.positions[i];
                if quadrature.weights[i] > self.marcher.cutoff {
                    visible.push(i, r, x, direction);
                    continue;
                }
                let influence = self.influence(quadrature.behind[i]);
                let h = differentiation.differences.reach(x);
                let is_resolved = FAR_APART * h.max_element() <= self.marcher.step;
                let near = if is_resolved { around(&traced.densities, &samples, i) } else { f32::INFINITY };
                if self.may_matter(influence, x, h, near) {
                    lurking.push(i, r, x, direction);
                } else if quadrature.weights[i] > 0.0 {
                    faint.push(i, r, x, direction);
                }
            }
        }
    }

    /// Returns true if matter within `h` of a sample at `x` could change its pixel.
    ///
    /// `near` is the largest density that the ray meets at the sample, the one before and the one behind it.
    fn may_matter(&self, influence: f64, x: Vec3, h: DVec3, near: f32) -> bool {
        let cutoff = self.marcher.cutoff;
        // ∞ · 0 would be NaN: the bound is infinite without an occupancy grid, and the
        // influence is 0 behind opaque matter.
        if influence == 0.0 || cutoff == 0.0 {
            return influence > 0.0;
        }
        if influence * self.marcher.majorant(x.as_dvec3()) <= cutoff {
            return false;
        }
        if influence * STEEPEST * f64::from(near) > cutoff {
            return true;
        }
        // The corners are rounded like the points that differences evaluate.
        let within = |x: DVec3| self.field.density_bound((x - h).as_vec3(), (x + h).as_vec3());
        // A field that bounds only part of its density is not asked at every sample: it would mostly be in vain.
        self.marcher.occupancy.as_ref().is_some_and(Occupancy::is_certain)
            && within(x.as_dvec3()).is_some_and(|bound| influence * f64::from(bound) > cutoff)
    }
}
