//! The Jacobian of a pixel's colour with respect to the positions of its samples.
//!
//! G_i = dC/dx_i = (∂C/∂σ_i) ∇σ(x_i)ᵀ + w_i ∇c(x_i), 3×3, row = colour channel, column = axis (Bayes' Rays,
//! Sec. 4.3, by the chain rule through compositing). ∂C/∂σ_i and ∂C/∂c_i = w_i are analytic; ∇σ and ∇c come from a
//! [`Differentiation`].
//!
//! Which samples need which of these is decided in [`choose`](super::choose).

use glam::{DVec3, Vec3};
use itertools::{Itertools, izip};

use super::choose::Chosen;
use super::gradient::{GradientBuffers, Jet};
use super::{
    CompositingWeights, Differentiation, Question, RaySample, RaySamples, TraceBuffers, Tracer, VisibleSegment,
};
use crate::field::Radiance;
use crate::geometry::Ray;

/// How far a group of rays has come, and with it what it asks of the field next.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Stage {
    /// σ at the next samples.
    Tracing,
    /// Jets of the visible samples.
    Jets,
    /// ∇σ of the lurking samples.
    DensityGradients,
    /// Colours of the samples that need no more.
    Colors,
    /// Nothing.
    #[default]
    Done,
}

/// Buffers that a thread reuses from batch to batch, or rays on the way to their Jacobians.
#[derive(Default)]
pub struct JacobianBuffers<'a> {
    stage: Stage,
    pub(super) trace: TraceBuffers<'a>,
    pub(super) quadrature: CompositingWeights,
    pub(super) visible: Chosen,
    pub(super) lurking: Chosen,
    gradient: GradientBuffers,
    jets: Vec<Option<Jet>>,
    density_gradients: Vec<Option<DVec3>>,
    /// Faint samples; in the end, all that need only their colour.
    pub(super) faint: Chosen,
    radiance: Vec<Radiance>,
    /// `[samples]`: colours; black where nothing can be seen.
    colors: Vec<Vec3>,
    /// `[samples]`: ∂C/∂σ.
    density_derivatives: Vec<DVec3>,
    /// `[rays]`: a sample at which the field is not finite, if any.
    invalid: Vec<Option<u32>>,
}

impl JacobianBuffers<'_> {
    /// What the rays ask of the field; `None` once they need nothing more.
    pub(super) fn question(&mut self, how: &Differentiation) -> Option<Question<'_>> {
        let Self { trace, visible, lurking, faint, gradient, radiance, .. } = self;
        match self.stage {
            Stage::Tracing => Some(trace.question()),
            Stage::Jets => Some(how.jets_question(&visible.positions, &visible.directions, gradient)),
            Stage::DensityGradients => Some(how.density_gradients_question(&lurking.positions, gradient)),
            Stage::Colors => {
                let (positions, directions) = (&faint.positions, &faint.directions);
                Some(Question::Radiance { positions, directions, out: radiance })
            }
            Stage::Done => None,
        }
    }
}

impl Tracer<'_> {
    /// Traces `rays`, numbered from `first_ray`, and differentiates their pixels.
    #[must_use]
    pub fn jacobians<'b>(
        &'b self,
        rays: &[Ray],
        jitter: &[f64],
        first_ray: u64,
        differentiation: &Differentiation,
        buffers: &mut JacobianBuffers<'b>,
    ) -> RaySamples {
        self.begin(rays, jitter, differentiation, buffers);
        while let Some(question) = buffers.question(differentiation) {
            question.answer(self.field, differentiation.analytic);
            self.advance(rays, differentiation, buffers);
        }
        self.assemble(rays, first_ray, buffers)
    }

    /// Takes rays to their first question.
    pub(super) fn begin<'b>(
        &'b self,
        rays: &[Ray],
        jitter: &[f64],
        differentiation: &Differentiation,
        buffers: &mut JacobianBuffers<'b>,
    ) {
        self.start(rays, jitter, &mut buffers.trace);
        self.trace_on(rays, differentiation, buffers);
    }

    /// Takes rays whose question is answered to the next one that asks for anything.
    pub(super) fn advance(&self, rays: &[Ray], differentiation: &Differentiation, buffers: &mut JacobianBuffers) {
        match buffers.stage {
            Stage::Tracing => {
                self.absorb(&mut buffers.trace);
                self.trace_on(rays, differentiation, buffers);
            }
            Stage::Jets => self.read_jets(differentiation, buffers),
            Stage::DensityGradients => {
                differentiation.read_density_gradients(&buffers.gradient, &mut buffers.density_gradients);
                self.weigh_lurking(buffers);
            }
            Stage::Colors => Self::read_colors(buffers),
            Stage::Done => {}
        }
    }

    /// Takes the next samples along the rays, or, where these have ended, those that matter.
    fn trace_on(&self, rays: &[Ray], differentiation: &Differentiation, buffers: &mut JacobianBuffers) {
        buffers.stage = Stage::Tracing;
        if self.next_round(rays, &mut buffers.trace) {
            return;
        }
        buffers.trace.gather();
        buffers.quadrature.set(&buffers.trace.traced, self.marcher.step);
        self.choose(rays, differentiation, buffers);
        let JacobianBuffers { trace, visible, gradient, colors, invalid, stage, .. } = &mut *buffers;
        invalid.clear();
        invalid.resize(rays.len(), None);
        colors.clear();
        colors.resize(trace.traced.positions.len(), Vec3::ZERO);
        differentiation.ask_jets(&self.field.bounds(), &visible.positions, &visible.directions, gradient);
        *stage = Stage::Jets;
        if visible.positions.is_empty() {
            self.read_jets(differentiation, buffers);
        }
    }

    /// Takes in the jets of the visible samples, and prepares for ∇σ of the lurking ones.
    fn read_jets(&self, differentiation: &Differentiation, buffers: &mut JacobianBuffers) {
        let JacobianBuffers { visible, lurking, gradient, jets, density_gradients, colors, invalid, stage, .. } =
            &mut *buffers;
        differentiation.read_jets(gradient, jets);
        for (i, jet) in jets.iter().enumerate() {
            match jet {
                Some(jet) => colors[visible.samples[i] as usize] = jet.color,
                None => {
                    invalid[visible.rays[i] as usize].get_or_insert(visible.samples[i]);
                }
            }
        }
        if lurking.positions.is_empty() {
            density_gradients.clear();
            self.weigh_lurking(buffers);
        } else {
            differentiation.ask_density_gradients(&self.field.bounds(), &lurking.positions, gradient);
            *stage = Stage::DensityGradients;
        }
    }

    /// Keeps the lurking samples that can change their pixel, and prepares for the colours of all that need no more.
    fn weigh_lurking(&self, buffers: &mut JacobianBuffers) {
        let JacobianBuffers { quadrature, lurking, faint, density_gradients, invalid, radiance, stage, .. } =
            &mut *buffers;
        // The few that can change their pixel move to the front; of the others, some are faint.
        let mut kept = 0;
        for i in 0..lurking.samples.len() {
            let (sample, ray) = (lurking.samples[i], lurking.rays[i]);
            let Some(gradient) = density_gradients[i] else {
                invalid[ray as usize].get_or_insert(sample);
                continue;
            };
            if self.influence(quadrature.behind[sample as usize]) * gradient.length() > 0.0 {
                (lurking.samples[kept], lurking.rays[kept]) = (sample, ray);
                (lurking.positions[kept], lurking.directions[kept]) = (lurking.positions[i], lurking.directions[i]);
                density_gradients[kept] = Some(gradient);
                kept += 1;
            } else if quadrature.weights[sample as usize] > 0.0 {
                faint.push(sample as usize, ray as usize, lurking.positions[i], lurking.directions[i]);
            }
        }
        lurking.truncate(kept);
        density_gradients.truncate(kept);
        faint.append(lurking);
        radiance.clear();
        radiance.resize(faint.samples.len(), Radiance::default());
        *stage = if faint.samples.is_empty() { Stage::Done } else { Stage::Colors };
    }

    /// Takes in the colours of samples that need no more.
    fn read_colors(buffers: &mut JacobianBuffers) {
        let JacobianBuffers { faint, radiance, colors, invalid, stage, .. } = buffers;
        for (i, radiance) in radiance.iter().enumerate() {
            colors[faint.samples[i] as usize] = radiance.color;
            if !radiance.is_valid() {
                invalid[faint.rays[i] as usize].get_or_insert(faint.samples[i]);
            }
        }
        *stage = Stage::Done;
    }

    /// Assembles the Jacobians of the chosen samples. A ray with an invalid evaluation is dropped as a whole, like
    /// a ray with an invalid density.
    pub(super) fn assemble(&self, rays: &[Ray], first_ray: u64, buffers: &mut JacobianBuffers) -> RaySamples {
        let JacobianBuffers { trace, quadrature, visible, lurking, jets, density_gradients, colors, invalid, .. } =
            buffers;
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
                    let dark = samples.clone().find(|&i| quadrature.behind[i] < 0.5);
                    let until = dark.map_or(f64::INFINITY, |i| traced.t[i] + 0.5 * self.marcher.step);
                    out.sight.push(VisibleSegment { ray: rays[r], until });
                }
            }
        }
        let of_visible = izip!(&visible.samples, &visible.rays, jets.iter().copied());
        let of_density = |gradient: &Option<DVec3>| gradient.map(|g| Jet { density_gradient: g, ..Jet::default() });
        let of_lurking = izip!(&lurking.samples, &lurking.rays, density_gradients.iter().map(of_density));
        for (&sample, &ray, jet) in of_visible.merge_by(of_lurking, |a, b| a.0 < b.0) {
            let (sample, ray) = (sample as usize, ray as usize);
            let Some(jet) = jet.filter(|_| invalid[ray].is_none()) else { continue };
            let (weight, derivative) = (quadrature.weights[sample], derivatives[sample]);
            // [∂C/∂x, ∂C/∂y, ∂C/∂z], each red, green, blue.
            let columns =
                [0, 1, 2].map(|axis| derivative * jet.density_gradient[axis] + weight * jet.color_gradients[axis]);
            if columns.iter().any(|column| column.length_squared() > 0.0) {
                let jacobian = std::array::from_fn(|i| columns[i % 3][i / 3] as f32);
                let position = traced.positions[sample];
                out.push(first_ray + ray as u64, RaySample { position, jacobian, weight: weight as f32 });
            }
        }
        out
    }
}

#[cfg(test)]
mod tests;
