//! How the expected depth of a ray answers when the matter along it is moved.
//!
//! Moving the matter at sample i by u changes σ_i by ∇σ(x_i) · u, and the expected depth d by (∂d/∂σ_i) ∇σ(x_i) · u.
//! ∂d/∂σ_i is analytic ([`CompositingWeights::depth_derivative`]), ∇σ comes from a [`Differentiation`].

use glam::{DVec3, Vec3};

use super::gradient::GradientBuffers;
use super::jacobian::{Chosen, around};
use super::trace::TracedRays;
use super::{CompositingWeights, Differentiation, Tracer};
use crate::geometry::Ray;

/// A sample that can move the expected depth of its ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthSample {
    /// x_i, scene units.
    pub position: Vec3,
    /// ∂d/∂x_i: scene units of depth for each scene unit that the matter at x_i moves.
    pub gradient: DVec3,
}

/// Variances of depth, from a posterior of displacements.
pub trait DepthVariance: Sync {
    /// Variance of a ray's expected depth from the samples that move it, squared scene units.
    fn variance(&self, samples: &[DepthSample]) -> f64;

    /// Variance of the depth of matter at a scene point that moving matter does not explain, squared scene units.
    fn unexplained(&self, _x: Vec3) -> f64 {
        0.0
    }
}

/// Asks for variances of the expected depth of every pixel, beside its image.
#[derive(Clone, Copy)]
pub struct DepthProbe<'a> {
    /// Source of ∇σ.
    pub differentiation: Differentiation<'a>,
    /// Each gives one number per pixel.
    pub variances: &'a [&'a dyn DepthVariance],
}

impl DepthProbe<'_> {
    /// `[variances][rays]`: those of each ray's expected depth; NaN where it has none, or where ∇σ is not finite.
    pub(super) fn ask(
        &self,
        tracer: &Tracer,
        rays: &[Ray],
        traced: &TracedRays,
        quadrature: &CompositingWeights,
    ) -> Vec<Vec<f64>> {
        let mut derivatives = vec![0.0; traced.positions.len()];
        let mut chosen = Chosen::default();
        for (r, ray) in rays.iter().enumerate() {
            let samples = traced.samples(r);
            quadrature.depth_derivative(&samples, &traced.t, tracer.marcher.step, &mut derivatives);
            for i in samples.clone() {
                // A sample without matter beside it cannot move any. What is left out, moved by the length over which σ
                // falls off, moves the depth by less than this part of a step.
                let movable = derivatives[i].abs() * f64::from(around(&traced.densities, &samples, i));
                if movable > tracer.marcher.cutoff * tracer.marcher.step {
                    chosen.push(i, r, traced.positions[i], ray.direction.as_vec3());
                }
            }
        }
        let gradients = self.density_gradients(tracer, &chosen.positions);
        let mut found = chosen.samples.iter().zip(&chosen.rays).zip(&chosen.positions).zip(gradients).peekable();
        let mut moving = Vec::new();
        let mut variances = vec![Vec::with_capacity(rays.len()); self.variances.len()];
        for r in 0..rays.len() {
            moving.clear();
            let mut is_finite = true;
            while let Some((((&i, _), &position), gradient)) = found.next_if(|(((_, ray), _), _)| **ray as usize == r) {
                let gradient = gradient.map(|gradient| derivatives[i as usize] * gradient);
                is_finite &= gradient.is_some();
                moving.extend(gradient.map(|gradient| DepthSample { position, gradient }));
            }
            let has_depth = traced.samples(r).any(|i| quadrature.weights[i] > 0.0);
            for (variance, out) in self.variances.iter().zip(&mut variances) {
                out.push(if has_depth && is_finite { variance.variance(&moving) } else { f64::NAN });
            }
        }
        variances
    }

    /// ∇σ at some points; `None` where it is not finite.
    fn density_gradients(&self, tracer: &Tracer, positions: &[Vec3]) -> Vec<Option<DVec3>> {
        let (mut buffers, mut gradients) = (GradientBuffers::default(), Vec::new());
        let how = &self.differentiation;
        how.place_density_gradients(&tracer.field.bounds(), positions, &mut buffers);
        how.ask_density_gradients(tracer.field, std::iter::once((positions, &mut buffers)));
        how.take_density_gradients(&buffers, &mut gradients);
        gradients
    }
}
