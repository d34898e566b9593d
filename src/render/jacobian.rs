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
mod tests {
    use super::*;
    use crate::field::{ClosedForm, RadianceField};
    use crate::geometry::Domain;
    use crate::monitor::Silent;
    use crate::render::{Differences, Marcher, Occupancy, Stencil, TracedRays};
    use proptest::prelude::*;

    /// Jacobians by central differences over ±h.
    fn by_differences(tracer: &Tracer, rays: &[Ray], jitter: &[f64], first: u64, h: f64) -> RaySamples {
        let differences = Differences {
            step: DVec3::splat(h),
            domain: Domain::Box(tracer.field.bounds()),
            stencil: Stencil::Central,
        };
        let differentiation = Differentiation { differences, analytic: None };
        tracer.jacobians(rays, jitter, first, &differentiation, &mut JacobianBuffers::default())
    }

    /// Renders the ray's pixel with the position of sample `moved` displaced.
    fn pixel_with_moved_sample(tracer: &Tracer, ray: &Ray, traced: &TracedRays, moved: usize, by: DVec3) -> DVec3 {
        let positions: Vec<Vec3> = traced
            .positions
            .iter()
            .enumerate()
            .map(|(i, x)| if i == moved { (x.as_dvec3() + by).as_vec3() } else { *x })
            .collect();
        let mut radiance = vec![Radiance::default(); positions.len()];
        tracer.field.evaluate(&positions, &vec![ray.direction.as_vec3(); positions.len()], &mut radiance);
        let (densities, colors): (Vec<f32>, Vec<Vec3>) = radiance.iter().map(|r| (r.density, r.color)).unzip();
        let mut quadrature = CompositingWeights::default();
        quadrature.set(&TracedRays { densities, ..traced.clone() }, tracer.marcher.step);
        quadrature.pixel(&traced.samples(0), &colors, &traced.t, tracer.background()).color
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn jacobian_is_the_whole_rays_response_to_moving_one_sample(
            y in -0.3..0.3_f64,
            z in -0.3..0.3_f64,
            jitter in 0.0..1.0_f64,
        ) {
            let field = ClosedForm::ball();
            let marcher = Marcher { step: 0.01, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
            let tracer = Tracer { field: &field, marcher, background: Vec3::ONE };
            let ray = Ray::new(DVec3::new(-3.0, y, z), DVec3::new(1.0, -0.1 * z, 0.1 * y));
            let h = 2.5e-4;
            let mut traced = TraceBuffers::default();
            tracer.trace(&[ray], &[jitter], &mut traced);
            let traced = traced.traced;
            let samples = by_differences(&tracer, &[ray], &[jitter], 7, h);
            prop_assert!(samples.rays == [7] && samples.offsets == [0, samples.positions.len()]);
            let scale = samples.jacobians.iter().flatten().fold(0.0_f32, |m, g| m.max(g.abs()));
            for (x, jacobian) in samples.positions.iter().zip(&samples.jacobians).step_by(7) {
                let moved = traced.positions.iter().position(|y| y == x).unwrap();
                for axis in 0..3 {
                    let by = DVec3::AXES[axis] * h;
                    let up = pixel_with_moved_sample(&tracer, &ray, &traced, moved, by);
                    let down = pixel_with_moved_sample(&tracer, &ray, &traced, moved, -by);
                    for channel in 0..3 {
                        let brute = (up - down)[channel] / (2.0 * h);
                        let found = f64::from(jacobian[3 * channel + axis]);
                        // Both difference the same field values, so the field's rounding cancels. Widths differ
                        // by an ulp of the positions, 2e-4 relative. What remains is that brute force squares
                        // and multiplies increments: with |σ'| = 80 · 23, |σ''| = 80 · 901 (the ramp's
                        // largest), |∇c| = 2.25 and δ = 0.01, C'' σ' σ'' h² / 2 = δ² · 1.3e8 · h² / 2 = 4e-4
                        // and δ σ'' |∇c| h² / 2 = 5e-5.
                        let limit = 0.001 * f64::from(scale) + 6e-4;
                        prop_assert!(
                            (brute - found).abs() <= limit,
                            "axis {} channel {}: {} against {}",
                            axis,
                            channel,
                            found,
                            brute
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn differences_at_the_box_border_are_one_sided() {
        // Density exactly on the face: the box cuts the wall's flat side at x = 1.
        let field = ClosedForm::courtyard();
        let marcher = Marcher { step: 0.004, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &field, marcher, background: Vec3::ONE };
        // Down through the floor, a hair inside the face.
        let ray = Ray::new(DVec3::new(0.999_999, 0.1, 1.0), -DVec3::Z);
        let samples = by_differences(&tracer, &[ray], &[0.5], 0, 0.01);
        // Along x only the floor's texture changes there. A two-sided difference across the face would see the
        // density fall from 120 to 0 and give entries of several hundred.
        let along_x = samples.jacobians.iter().map(|j| j[0].abs()).fold(0.0, f32::max);
        assert!(along_x > 0.0 && along_x < 5.0, "{along_x}");
    }

    #[test]
    fn not_a_number_drops_the_ray_and_is_reported() {
        struct Holed;
        impl RadianceField for Holed {
            fn bounds(&self) -> crate::geometry::Aabb {
                crate::geometry::Aabb::centered_cube(1.0)
            }
            fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
                for (x, out) in positions.iter().zip(out) {
                    *out = Radiance { density: if x.y > 0.5 { f32::NAN } else { 1.0 }, color: Vec3::splat(x.z.abs()) };
                }
            }
            fn suggested_step(&self) -> f64 {
                0.1
            }
            fn memory(&self) -> usize {
                0
            }
            fn describe(&self) -> String {
                "not finite for y > 0.5".into()
            }
        }
        let marcher = Marcher { step: 0.1, bounds: Holed.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &Holed, marcher, background: Vec3::ONE };
        let ray = |y| Ray::new(DVec3::new(-2.0, y, 0.2), DVec3::X);
        // The second ray runs through the hole. The third is finite itself, but its differences are not.
        let rays = [ray(0.0), ray(0.7), ray(0.499)];
        let samples = by_differences(&tracer, &rays, &[0.5; 3], 10, 0.01);
        assert_eq!((samples.rays, samples.dropped), (vec![10], 2));
        assert!(samples.first_invalid.unwrap().y > 0.49);
    }

    /// A black bump in front of white fog, against black. Each sample of the fog weighs 1e-7, all of them 1e-5.
    struct BumpBeforeFog;

    impl RadianceField for BumpBeforeFog {
        fn bounds(&self) -> crate::geometry::Aabb {
            crate::geometry::Aabb::centered_cube(1.0)
        }
        fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
            for (x, out) in positions.iter().zip(out) {
                let bump = f32::max(0.0, 1.0 - ((x.x + 0.5) / 0.05).powi(2)).powi(2);
                let fog = if x.x > 0.0 { 1e-5 } else { 0.0 };
                *out = Radiance { density: 20.0 * bump + fog, color: if x.x > 0.0 { Vec3::ONE } else { Vec3::ZERO } };
            }
        }
        fn suggested_step(&self) -> f64 {
            0.01
        }
        fn memory(&self) -> usize {
            0
        }
        fn describe(&self) -> String {
            "a bump before fog".into()
        }
    }

    /// With and without an occupancy grid, whose bound of the density is one more reason to leave the fog's samples
    /// out.
    #[test]
    fn what_is_not_differentiated_is_composited() {
        let grid = Occupancy::build(&BumpBeforeFog, 32, 1e-3, &Silent).unwrap();
        for occupancy in [None, Some(grid)] {
            let marcher = Marcher { step: 0.01, bounds: BumpBeforeFog.bounds(), occupancy, cutoff: 1e-6 };
            composites_what_is_not_differentiated(marcher);
        }
    }

    fn composites_what_is_not_differentiated(marcher: Marcher) {
        let tracer = Tracer { field: &BumpBeforeFog, marcher, background: Vec3::ZERO };
        let ray = Ray::new(DVec3::new(-2.0, 0.1, 0.2), DVec3::X);
        let differences = Differences {
            step: DVec3::splat(1e-3),
            domain: Domain::Box(BumpBeforeFog.bounds()),
            stencil: Stencil::Central,
        };
        let differentiation = Differentiation { differences, analytic: None };
        let jacobians =
            |tracer: &Tracer| tracer.jacobians(&[ray], &[0.5], 0, &differentiation, &mut JacobianBuffers::default());
        let exact = Tracer { marcher: Marcher { cutoff: 0.0, ..tracer.marcher.clone() }, ..tracer.clone() };
        let (exact, found) = (jacobians(&exact), jacobians(&tracer));
        // Behind the bump, T S = exp(-20 · 0.05 · 16/15) · 1.05e-5 = 3.6e-6; times δ |∇σ| of about 600 that is 2e-5.
        let steepest = exact.jacobians.iter().map(|j| j[0].abs()).fold(0.0, f32::max);
        assert!((1e-5..4e-5).contains(&steepest), "{steepest}");
        // The fog is even and white, and its 100 samples weigh less than the cutoff: they have no derivatives. All
        // derivatives are of the bump, but for the fog's rim.
        assert!(found.positions.iter().all(|x| x.x < 0.02));
        // All of the bump is there: were the fog left out, too, there would be nothing to see behind it, and no
        // derivative.
        let of_bump =
            exact.positions.iter().zip(&exact.jacobians).filter(|(x, j)| x.x < 0.0 && j[0].abs() > 1e-3 * steepest);
        assert!(of_bump.clone().count() > 5 && of_bump.clone().all(|(x, _)| found.positions.contains(x)));
        // What is differentiated sees all of it: equal, but for the rounding to f32.
        for (position, jacobian) in found.positions.iter().zip(&found.jacobians) {
            let i = exact.positions.iter().position(|x| x == position).unwrap();
            let off = jacobian.iter().zip(exact.jacobians[i]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off <= 1e-6 * steepest, "at {position}: {off}");
        }
    }
}
