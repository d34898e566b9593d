//! The Jacobian of a pixel's colour with respect to the positions of its samples.
//!
//! G_i = dC/dx_i = (∂C/∂σ_i) ∇σ(x_i)ᵀ + w_i ∇c(x_i), 3×3, row = colour channel, column = axis (Bayes' Rays,
//! Sec. 4.3, by the chain rule through compositing). ∂C/∂σ_i and ∂C/∂c_i = w_i are analytic; ∇σ and ∇c come from a
//! [`Differentiation`].
//!
//! What is evaluated depends on how much a sample can change its pixel:
//!
//! | | density | ∇σ | colour | ∇c |
//! |---|---|---|---|---|
//! | *visible*: w > cutoff | x | x | x | x |
//! | *near-surface*: w ≤ cutoff, but visible matter may lie within h: √3 δ T σ̂ > cutoff | x | x | if ∇σ ≠ 0 | |
//! | *low-weight*: cutoff / n < w ≤ cutoff of the n samples of a ray, no visible matter near | x | | x | |
//! | all others, behind surfaces or in empty space | x | | | |
//!
//! Low-weight samples have no derivatives but are composited: they are part of the colour behind others, which enters
//! ∂C/∂σ. Only the faintest have not even a colour: all of a ray together weigh at most the cutoff.
//!
//! The two criteria bound what differences leave out. w > cutoff bounds the contribution of ∇c (|∇c| ≤ 1/2h), the
//! criterion for near-surface samples that of ∇σ (|∇σ| ≤ σ̂/2h). Here |∂C/∂σ| ≤ √3 δ T because colours lie in [0, 1],
//! and σ̂ is the density bound of the occupancy grid. A sample in the empty space before a surface has w = 0 but may
//! see the surface within h: it is near-surface. Cutoff 0 leaves out only exact zeros.
//!
//! A field's own derivatives are taken at the same samples, so the set of samples depends on h.
//!
//! σ̂ is also taken to be at most a hundred times the density at the sample and its neighbours on the ray, if these
//! are at least eight h away: sampling a field at that distance presumes that it is resolved. A sudden step in
//! density is not resolved. Rays that pass it within h are found if the field bounds its density everywhere
//! ([`RadianceField::density_bound`](crate::field::RadianceField::density_bound)), and lost if it does not
//! (`experiments/hard_cases.md`).

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::gradient::{GradientBuffers, Jet};
use super::trace::{Points, ask_together};
use super::{
    CompositingWeights, Differentiation, Occupancy, RaySample, RaySamples, TraceBuffers, Tracer, VisibleSegment,
};
use crate::Result;
use crate::field::Radiance;
use crate::geometry::Ray;
use crate::monitor::{Monitor, Silent, check};

/// Buffers that a thread reuses from batch to batch.
#[derive(Default)]
pub struct JacobianBuffers<'a> {
    pub(super) trace: TraceBuffers<'a>,
    pub(super) quadrature: CompositingWeights,
    pub(super) visible: Chosen,
    pub(super) near_surface: Chosen,
    gradient: GradientBuffers,
    jets: Vec<Option<Jet>>,
    density_gradients: Vec<Option<DVec3>>,
    /// Faint samples; in the end, all that need only their colour.
    pub(super) low_weight: Chosen,
    radiance: Vec<Radiance>,
    /// `[samples]`: colours; black where nothing can be seen.
    colors: Vec<Vec3>,
    /// `[samples]`: ∂C/∂σ.
    density_derivatives: Vec<DVec3>,
    /// `[rays]`: a sample at which the field is not finite, if any.
    invalid: Vec<Option<u32>>,
}

/// Rays that are differentiated together, numbered from `first`.
#[derive(Debug, Clone, Default)]
pub struct RayBatch {
    /// The rays.
    pub rays: Vec<Ray>,
    /// `[rays]`: jitter of their samples, in `[0, 1)` steps.
    pub jitter: Vec<f64>,
    /// Index of the first ray in the run.
    pub first: u64,
}

impl RayBatch {
    /// The same rays in batches of at most `most`.
    pub(crate) fn portions(&self, most: usize) -> impl Iterator<Item = Self> {
        let rays = self.rays.chunks(most).zip(self.jitter.chunks(most));
        let first = (0..).step_by(most);
        rays.zip(first).map(|((rays, jitter), offset)| Self {
            rays: rays.to_vec(),
            jitter: jitter.to_vec(),
            first: self.first + offset,
        })
    }
}

/// A batch and what was computed of it so far.
struct Member<'m, 'b> {
    batch: &'m RayBatch,
    buffers: &'m mut JacobianBuffers<'b>,
}

/// Calls `step` for all members, in parallel.
fn each<'m, 'b>(members: &mut [Member<'m, 'b>], step: impl Fn(&RayBatch, &mut JacobianBuffers<'b>) + Sync) {
    members.par_iter_mut().for_each(|member| step(member.batch, member.buffers));
}

/// Splits members into runs of at least `wanted` points each, except for the last.
fn split<'s, 'm, 'b>(
    members: &'s mut [Member<'m, 'b>],
    wanted: usize,
    points: impl Fn(&JacobianBuffers) -> usize,
) -> Vec<&'s mut [Member<'m, 'b>]> {
    let (mut runs, mut rest) = (Vec::new(), members);
    while !rest.is_empty() {
        let mut sum = 0;
        let reached = rest.iter().position(|member| {
            sum += points(member.buffers);
            sum >= wanted
        });
        let (run, others) = rest.split_at_mut(reached.map_or(rest.len(), |last| last + 1));
        runs.push(run);
        rest = others;
    }
    runs
}

impl Tracer<'_> {
    /// Traces the rays of a batch and differentiates their pixels.
    #[must_use]
    #[doc(hidden)]
    pub fn jacobians<'b>(
        &'b self,
        batch: &RayBatch,
        differentiation: &Differentiation,
        buffers: &mut JacobianBuffers<'b>,
    ) -> RaySamples {
        let mut alone = [Member { batch, buffers }];
        // Only the monitor can end the work early.
        let _ = self.differentiate(&mut alone, differentiation, &Silent);
        self.assemble(batch, buffers)
    }

    /// The same for several batches, which evaluate the field together, from this thread: for a field with a high cost
    /// per call ([`RadianceField::batch`](crate::field::RadianceField::batch)).
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    #[doc(hidden)]
    pub fn jacobians_together(
        &self,
        batches: &[RayBatch],
        differentiation: &Differentiation,
        monitor: &dyn Monitor,
    ) -> Result<Vec<RaySamples>> {
        let mut buffers: Vec<JacobianBuffers> = batches.iter().map(|_| JacobianBuffers::default()).collect();
        let members = batches.iter().zip(&mut buffers).map(|(batch, buffers)| Member { batch, buffers });
        self.differentiate(&mut members.collect::<Vec<_>>(), differentiation, monitor)?;
        Ok(batches.par_iter().zip(&mut buffers).map(|(batch, buffers)| self.assemble(batch, buffers)).collect())
    }

    /// Evaluates and differentiates the field wherever the rays need it. All members take each step together, so that
    /// the field answers for all of them in one call.
    fn differentiate<'b>(
        &'b self,
        members: &mut [Member<'_, 'b>],
        how: &Differentiation,
        monitor: &dyn Monitor,
    ) -> Result<()> {
        let (field, bounds) = (self.field, self.field.bounds());
        each(members, |batch, buffers| self.start(&batch.rays, &batch.jitter, &mut buffers.trace));
        loop {
            check(monitor)?;
            each(members, |batch, buffers| self.next_round(&batch.rays, &mut buffers.trace));
            let rounds: Vec<_> = members.iter_mut().map(|member| member.buffers.trace.round()).collect();
            if !ask_together(rounds, |positions, _, out| field.densities(positions, out)) {
                break;
            }
            each(members, |_, buffers| self.absorb(&mut buffers.trace));
        }
        each(members, |batch, buffers| self.choose_samples(&batch.rays, how, buffers));
        for run in split(members, field.batch(), |buffers| how.jet_points(buffers.visible.positions.len())) {
            check(monitor)?;
            each(run, |_, JacobianBuffers { visible, gradient, .. }| how.place_jets(&bounds, visible, gradient));
            how.ask_jets(field, run.iter_mut().map(|member| member.buffers.jet_points()));
            each(run, |_, buffers| buffers.take_jets(how));
        }
        for run in split(members, field.batch(), |buffers| how.gradient_points(buffers.near_surface.positions.len())) {
            check(monitor)?;
            each(run, |_, JacobianBuffers { near_surface, gradient, .. }| {
                how.place_density_gradients(&bounds, &near_surface.positions, gradient);
            });
            how.ask_density_gradients(field, run.iter_mut().map(|member| member.buffers.gradient_points()));
            each(run, |_, buffers| {
                how.take_density_gradients(&buffers.gradient, &mut buffers.density_gradients);
                self.weigh_near_surface(buffers);
            });
        }
        check(monitor)?;
        let low_weight = members.iter_mut().map(|member| member.buffers.color_points()).collect();
        ask_together(low_weight, |positions, directions, out| field.evaluate(positions, directions, out));
        each(members, |_, buffers| buffers.take_colors());
        Ok(())
    }

    /// Finds the samples whose derivatives or colours are needed.
    fn choose_samples(&self, rays: &[Ray], how: &Differentiation, buffers: &mut JacobianBuffers) {
        buffers.trace.gather();
        buffers.quadrature.set(&buffers.trace.traced, self.marcher.step);
        self.choose(rays, how, buffers);
        let JacobianBuffers { trace, colors, invalid, .. } = buffers;
        invalid.clear();
        invalid.resize(rays.len(), None);
        colors.clear();
        colors.resize(trace.traced.positions.len(), Vec3::ZERO);
    }

    /// Keeps the near-surface samples that can change their pixel, and prepares the colours of all that need no more.
    fn weigh_near_surface(&self, buffers: &mut JacobianBuffers) {
        let JacobianBuffers { quadrature, near_surface, low_weight, density_gradients, invalid, radiance, .. } =
            buffers;
        // The few that can change their pixel move to the front; of the others, some are low-weight.
        let mut kept = 0;
        for i in 0..near_surface.samples.len() {
            let (sample, ray) = (near_surface.samples[i], near_surface.rays[i]);
            let Some(gradient) = density_gradients[i] else {
                invalid[ray as usize].get_or_insert(sample);
                continue;
            };
            if self.influence(quadrature.transmittance_after[sample as usize]) * gradient.length() > 0.0 {
                (near_surface.samples[kept], near_surface.rays[kept]) = (sample, ray);
                (near_surface.positions[kept], near_surface.directions[kept]) =
                    (near_surface.positions[i], near_surface.directions[i]);
                density_gradients[kept] = Some(gradient);
                kept += 1;
            } else if quadrature.weights[sample as usize] > 0.0 {
                low_weight.push(sample as usize, ray as usize, near_surface.positions[i], near_surface.directions[i]);
            }
        }
        near_surface.truncate(kept);
        density_gradients.truncate(kept);
        low_weight.append(near_surface);
        radiance.clear();
        radiance.resize(low_weight.samples.len(), Radiance::default());
    }

    /// Assembles the Jacobians of the chosen samples. A ray with an invalid evaluation is dropped as a whole, like
    /// a ray with an invalid density.
    fn assemble(&self, batch: &RayBatch, buffers: &mut JacobianBuffers) -> RaySamples {
        let JacobianBuffers {
            trace, quadrature, visible, near_surface, jets, density_gradients, colors, invalid, ..
        } = buffers;
        let traced = &trace.traced;
        let derivatives = &mut buffers.density_derivatives;
        derivatives.clear();
        derivatives.resize(traced.positions.len(), DVec3::ZERO);
        let mut out =
            RaySamples { dropped: traced.dropped, first_invalid: traced.first_invalid, ..RaySamples::default() };
        for (r, &invalid) in invalid.iter().enumerate() {
            let samples = traced.samples(r);
            if let Some(sample) = invalid {
                out.dropped += 1;
                out.first_invalid.get_or_insert(traced.positions[sample as usize]);
            } else {
                quadrature.density_derivative(&samples, colors, self.marcher.step, self.background(), derivatives);
                if !traced.is_dropped[r] {
                    let dark = samples.clone().find(|&i| quadrature.transmittance_after[i] < 0.5);
                    let until = dark.map_or(f64::INFINITY, |i| traced.t[i] + 0.5 * self.marcher.step);
                    out.sight.push(VisibleSegment { ray: batch.rays[r], until });
                }
            }
        }
        out.reserve(visible.samples.len() + near_surface.samples.len());
        let of_density = |gradient: &Option<DVec3>| gradient.map(|g| Jet { density_gradient: g, ..Jet::default() });
        let of_visible = visible.samples.iter().zip(&visible.rays).zip(jets.iter().copied());
        let of_near_surface =
            near_surface.samples.iter().zip(&near_surface.rays).zip(density_gradients.iter().map(of_density));
        let (mut of_visible, mut of_near_surface) = (of_visible.peekable(), of_near_surface.peekable());
        // In the order of the samples.
        let next = || match (of_visible.peek(), of_near_surface.peek()) {
            (Some(((visible, _), _)), Some(((near_surface, _), _))) if visible >= near_surface => {
                of_near_surface.next()
            }
            (None, _) => of_near_surface.next(),
            _ => of_visible.next(),
        };
        for ((&sample, &ray), jet) in std::iter::from_fn(next) {
            let (sample, ray) = (sample as usize, ray as usize);
            let Some(jet) = jet.filter(|_| invalid[ray].is_none()) else { continue };
            let (weight, derivative) = (quadrature.weights[sample], derivatives[sample]);
            // [∂C/∂x, ∂C/∂y, ∂C/∂z], each red, green, blue.
            let columns =
                [0, 1, 2].map(|axis| derivative * jet.density_gradient[axis] + weight * jet.color_gradients[axis]);
            if columns.iter().any(|column| column.length_squared() > 0.0) {
                let jacobian = std::array::from_fn(|i| columns[i % 3][i / 3] as f32);
                let position = traced.positions[sample];
                out.push(batch.first + ray as u64, RaySample { position, jacobian, weight: weight as f32 });
            }
        }
        out
    }
}

impl JacobianBuffers<'_> {
    /// The visible samples, where the field's jets are needed, and room for these.
    fn jet_points(&mut self) -> (&Chosen, &mut GradientBuffers) {
        (&self.visible, &mut self.gradient)
    }

    /// The near-surface samples, where ∇σ is needed, and room for it.
    fn gradient_points(&mut self) -> (&[Vec3], &mut GradientBuffers) {
        (&self.near_surface.positions, &mut self.gradient)
    }

    /// Samples whose colour alone is needed, and room for it.
    fn color_points(&mut self) -> Points<'_, Radiance> {
        Points {
            positions: &self.low_weight.positions,
            directions: &self.low_weight.directions,
            out: &mut self.radiance,
        }
    }

    /// Takes in the jets of the visible samples.
    fn take_jets(&mut self, how: &Differentiation) {
        let Self { visible, gradient, jets, colors, invalid, .. } = self;
        how.take_jets(gradient, jets);
        for (i, jet) in jets.iter().enumerate() {
            match jet {
                Some(jet) => colors[visible.samples[i] as usize] = jet.color,
                None => {
                    invalid[visible.rays[i] as usize].get_or_insert(visible.samples[i]);
                }
            }
        }
    }

    /// Takes in the colours of samples that need no more.
    fn take_colors(&mut self) {
        let Self { low_weight, radiance, colors, invalid, .. } = self;
        for (i, radiance) in radiance.iter().enumerate() {
            colors[low_weight.samples[i] as usize] = radiance.color;
            if !radiance.is_valid() {
                invalid[low_weight.rays[i] as usize].get_or_insert(low_weight.samples[i]);
            }
        }
    }
}

/// Assumed bound of the density within h of a sample, as a multiple of the density at the
/// sample and its two neighbours.
const STEEPEST: f64 = 100.0;
/// Smallest distance between samples, in multiples of h, at which that bound is assumed.
const MIN_SPACING_STEPS: f64 = 8.0;

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

    /// Finds the visible, the near-surface and the low-weight samples.
    pub(super) fn choose(&self, rays: &[Ray], differentiation: &Differentiation, buffers: &mut JacobianBuffers) {
        let JacobianBuffers { trace, quadrature, visible, near_surface, low_weight, .. } = buffers;
        let traced = &trace.traced;
        [&mut *visible, near_surface, low_weight].into_iter().for_each(Chosen::clear);
        for (r, ray) in rays.iter().enumerate() {
            let direction = ray.direction.as_vec3();
            let samples = traced.samples(r);
            for i in samples.clone() {
                let x = traced.positions[i];
                if quadrature.weights[i] > self.marcher.cutoff {
                    visible.push(i, r, x, direction);
                    continue;
                }
                let influence = self.influence(quadrature.transmittance_after[i]);
                let h = differentiation.differences.reach(x);
                let is_resolved = MIN_SPACING_STEPS * h.max_element() <= self.marcher.step;
                let near = if is_resolved { around(&traced.densities, &samples, i) } else { f32::INFINITY };
                if self.may_matter(influence, x, h, near) {
                    near_surface.push(i, r, x, direction);
                } else if quadrature.weights[i] * samples.len() as f64 > self.marcher.cutoff {
                    low_weight.push(i, r, x, direction);
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
        // A field that bounds only part of its density is not queried at every sample, because most queries would fail.
        self.marcher.occupancy.as_ref().is_some_and(Occupancy::is_certain)
            && within(x.as_dvec3()).is_some_and(|bound| influence * f64::from(bound) > cutoff)
    }
}

#[cfg(test)]
mod tests;
