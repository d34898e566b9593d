//! Measures without a Hessian that `evaluate` does not list, because none of them ranks errors as well as those that it
//! lists.

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::geometry::Ray;
use octobayes::monitor::Silent;
use octobayes::render::{CompositingWeights, RenderedView, Renderer, TraceBuffers, Tracer};
use octobayes::uncertainty::UncertaintyField;
use octobayes_depth::TrainingViews;
use octobayes_evaluation::{EvaluatedView, TrueView};
use rayon::prelude::*;

/// Rays that are traced together.
const TOGETHER: usize = 256;

/// What the measures are computed from.
pub struct Baselines<'a> {
    pub tracer: &'a Tracer<'a>,
    /// Whose rays are counted.
    pub field: &'a UncertaintyField,
    pub training: &'a TrainingViews,
}

impl Baselines<'_> {
    /// Entropy of where the ray ends, nats; 1 - opacity; minus the numbers of training rays behind what the ray hits,
    /// of those that reached the expected depth, and of training cameras that see the point there; angle to the nearest
    /// of these cameras, radians, π without any.
    pub const NAMES: [&'static str; 6] = [
        "ray entropy",
        "1 - opacity",
        "ray count",
        "ray coverage",
        "training views that see it",
        "angle to a training view",
    ];

    /// The measures of the pixels of a view.
    pub fn of(&self, truth: &TrueView, view: &EvaluatedView) -> [Vec<f64>; 6] {
        let chunks = view.pixels.par_chunks(TOGETHER).map(|pixels| self.of_some(truth, view, pixels));
        let rows: Vec<Vec<[f64; 6]>> = chunks.collect();
        std::array::from_fn(|m| rows.iter().flatten().map(|row| row[m]).collect())
    }

    fn of_some(&self, truth: &TrueView, view: &EvaluatedView, pixels: &[usize]) -> Vec<[f64; 6]> {
        let width = truth.camera.resolution[0] as usize;
        let ray = |i: &usize| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + truth.pixel_offset);
            truth.camera.ray(x, y)
        };
        let rays: Vec<Ray> = pixels.iter().map(ray).collect();
        let mut buffers = TraceBuffers::default();
        self.tracer.trace(&rays, &vec![0.5; rays.len()], &mut buffers);
        let mut compositing = CompositingWeights::default();
        compositing.set(&buffers.traced, self.tracer.marcher.step);
        let row = |(r, ray): (usize, &Ray)| {
            let pixel = &view.rendered.pixels[pixels[r]];
            let samples = buffers.traced.samples(r);
            let weights = &compositing.weights[samples.clone()];
            let counted = |(w, x): (&f64, &Vec3)| if *w > 0.0 { w * self.field.support_at(*x) } else { 0.0 };
            let rays: f64 = weights.iter().zip(&buffers.traced.positions[samples.clone()]).map(counted).sum();
            let x = self.tracer.marcher.bounds.clamp(ray.at(pixel.expected_depth).as_vec3());
            let reached = self.field.ray_coverage().and_then(|coverage| coverage.at(x)).unwrap_or(0);
            let (x, eye) = (x.as_dvec3(), truth.camera.position);
            let angles =
                self.training.seeing(x).map(|(i, _)| (eye - x).angle_between(self.training.camera(i).position - x));
            [
                entropy(weights, compositing.end_transmittance(&samples)),
                1.0 - pixel.opacity,
                -rays / weights.iter().sum::<f64>(),
                -f64::from(reached),
                -(self.training.sighting(x).views as f64),
                angles.fold(std::f64::consts::PI, f64::min),
            ]
        };
        rays.iter().enumerate().map(row).collect()
    }
}

/// Shannon entropy, nats: −Σ w ln w − T ln T. Passing through is one of the outcomes.
fn entropy(weights: &[f64], end_transmittance: f64) -> f64 {
    let of = |p: f64| if p > 0.0 { -p * p.ln() } else { 0.0 };
    weights.iter().map(|&w| of(w)).sum::<f64>() + of(end_transmittance)
}

/// ψ² of density-aware ensembles (Sünderhauf, Abou-Chakra, Miller 2023) for the pixels of a view: the variance of the
/// colour over the members, averaged over channels, plus (1 − q̄)², where q̄ is the members' mean opacity.
pub fn density_aware(members: &[&dyn Renderer], truth: &TrueView, pixels: &[usize]) -> Result<Vec<f64>> {
    let render =
        |member: &&dyn Renderer| member.strided_image(&truth.whole, truth.stride, truth.pixel_offset, &[], &Silent);
    let views: Vec<RenderedView> = members.iter().map(render).collect::<Result<_>>()?;
    let n = views.len() as f64;
    let of = |&i: &usize| {
        let mean = views.iter().map(|view| view.pixels[i].color).sum::<DVec3>() / n;
        let variance = views.iter().map(|view| (view.pixels[i].color - mean).length_squared()).sum::<f64>() / n;
        let unseen = 1.0 - views.iter().map(|view| view.pixels[i].opacity).sum::<f64>() / n;
        variance / 3.0 + unseen * unseen
    };
    Ok(pixels.iter().map(of).collect())
}

#[cfg(test)]
mod tests {
    use super::entropy;

    #[test]
    fn two_walls_alike_have_one_bit_of_entropy() {
        assert!((entropy(&[0.5, 0.0, 0.5], 0.0) - std::f64::consts::LN_2).abs() < 1e-15);
        assert!((entropy(&[0.25, 0.25], 0.5) - 1.5 * std::f64::consts::LN_2).abs() < 1e-15);
        assert_eq!([entropy(&[], 1.0), entropy(&[1.0], 0.0)], [0.0, 0.0]);
    }
}
