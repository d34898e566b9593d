//! The Jacobian of a pixel's colour with respect to the positions of its samples.
//!
//! G_i = dC/dx_i = (∂C/∂σ_i) ∇σ(x_i)ᵀ + w_i ∇c(x_i), 3×3, row = colour channel, column = axis (Bayes' Rays, Sec. 4.3, by the
//! chain rule through compositing). ∂C/∂σ_i and ∂C/∂c_i = w_i are analytic; ∇σ and ∇c are central differences of the field.

use glam::{DVec3, Vec3};

use super::{Quadrature, TracedRays, Tracer};
use crate::field::Radiance;
use crate::geometry::{Domain, Ray};

/// How the field is differentiated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differences {
    /// Distance h to both sides along each axis where space is not contracted, scene units.
    pub step: DVec3,
    /// Where it is, h grows with the lattice's cells.
    pub domain: Domain,
}

impl Differences {
    /// h along each axis at x.
    #[must_use]
    pub fn at(&self, x: Vec3) -> DVec3 {
        self.step * self.domain.stretch(x)
    }
}

/// Ray samples with their Jacobians: what a posterior is made of, wherever it came from. Rays in increasing order; rays
/// without samples are absent. Ray r of the list owns `offsets[r]..offsets[r + 1]`.
#[derive(Debug, Clone, PartialEq)]
pub struct RaySamples {
    /// `[rays]`, increasing: index of each ray in the whole run.
    pub rays: Vec<u64>,
    /// `[rays + 1]`.
    pub offsets: Vec<usize>,
    /// `[n]`, scene units.
    pub positions: Vec<Vec3>,
    /// `[n]`: ∂C_c/∂x_k at 3·c + k.
    pub jacobians: Vec<[f32; 9]>,
    /// `[n]`: w, share of the pixel's colour; 0 where unknown.
    pub weights: Vec<f32>,
    /// `[n]`: ‖∂C/∂σ‖ ∇σ, the density's part of the Jacobian by size and direction; 0 where unknown.
    pub gradients: Vec<[f32; 3]>,
    /// Rays dropped because the field was not finite.
    pub dropped: u64,
    /// Position of the first sample that was not.
    pub first_invalid: Option<Vec3>,
}

impl Default for RaySamples {
    fn default() -> Self {
        Self {
            rays: Vec::new(),
            offsets: vec![0],
            positions: Vec::new(),
            jacobians: Vec::new(),
            weights: Vec::new(),
            gradients: Vec::new(),
            dropped: 0,
            first_invalid: None,
        }
    }
}

/// One sample of a ray; see [`RaySamples`] for units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RaySample {
    /// Position.
    pub position: Vec3,
    /// ∂C_c/∂x_k at 3·c + k.
    pub jacobian: [f32; 9],
    /// w.
    pub weight: f32,
    /// ‖∂C/∂σ‖ ∇σ.
    pub gradient: [f32; 3],
}

impl RaySamples {
    /// Appends one sample to the ray with index `ray`, which must not be below the last one.
    pub fn push(&mut self, ray: u64, sample: RaySample) {
        if self.rays.last() != Some(&ray) {
            self.rays.push(ray);
            self.offsets.push(self.positions.len());
        }
        self.positions.push(sample.position);
        self.jacobians.push(sample.jacobian);
        self.weights.push(sample.weight);
        self.gradients.push(sample.gradient);
        if let Some(end) = self.offsets.last_mut() {
            *end = self.positions.len();
        }
    }

    /// Sample `i` of the list.
    #[must_use]
    pub fn sample(&self, i: usize) -> RaySample {
        RaySample {
            position: self.positions[i],
            jacobian: self.jacobians[i],
            weight: self.weights[i],
            gradient: self.gradients[i],
        }
    }

    /// Each ray's index and its samples' range.
    pub fn iter(&self) -> impl Iterator<Item = (u64, std::ops::Range<usize>)> + '_ {
        self.rays.iter().zip(self.offsets.windows(2)).map(|(&ray, pair)| (ray, pair[0]..pair[1]))
    }
}

/// A sample whose gradient is wanted.
struct Wanted {
    ray: usize,
    sample: usize,
    weight: f64,
    density_derivative: DVec3,
}

impl Tracer<'_> {
    /// Traces `rays` and differentiates their pixels; the rays are numbered from `first_ray`.
    ///
    /// Left out are samples that are certain to matter little, max(w, σ̂ ‖∂C/∂σ‖) ≤ cutoff with σ̂ the density bound around the
    /// sample: the first bounds the share of ∇c (|∇c| ≤ 1/2h), the second that of ∇σ (|∇σ| ≤ σ̂/2h). A sample in the empty
    /// space before a surface has w = 0 but may see the surface within h: it is kept. Cutoff 0 leaves out only exact zeros.
    #[must_use]
    pub fn jacobians(&self, rays: &[Ray], jitter: &[f64], first_ray: u64, differences: Differences) -> RaySamples {
        let traced = self.trace(rays, jitter);
        let wanted = self.wanted(&traced);
        let gradients = self.gradients(&traced, rays, &wanted, differences);
        let mut out =
            RaySamples { dropped: traced.dropped, first_invalid: traced.first_invalid, ..RaySamples::default() };
        // A ray with an invalid neighbour evaluation is dropped as a whole, like one with an invalid sample.
        let mut invalid = vec![false; rays.len()];
        for (w, gradient) in wanted.iter().zip(&gradients) {
            if gradient.is_none() && !invalid[w.ray] {
                invalid[w.ray] = true;
                out.dropped += 1;
                out.first_invalid.get_or_insert(traced.positions[w.sample]);
            }
        }
        for (w, gradient) in wanted.iter().zip(gradients) {
            let Some((density_gradient, color_gradient)) = gradient.filter(|_| !invalid[w.ray]) else { continue };
            let mut jacobian = [0.0; 9];
            for channel in 0..3 {
                for axis in 0..3 {
                    let g = w.density_derivative[channel] * density_gradient[axis]
                        + w.weight * color_gradient[axis][channel];
                    jacobian[3 * channel + axis] = g as f32;
                }
            }
            if jacobian.iter().any(|&g| g != 0.0) {
                let gradient = (w.density_derivative.length() * density_gradient).as_vec3().to_array();
                let sample =
                    RaySample { position: traced.positions[w.sample], jacobian, weight: w.weight as f32, gradient };
                out.push(first_ray + w.ray as u64, sample);
            }
        }
        out
    }

    /// The samples whose Jacobian may matter.
    fn wanted(&self, traced: &TracedRays) -> Vec<Wanted> {
        let mut quadrature = Quadrature::default();
        let mut derivative = Vec::new();
        let mut wanted = Vec::new();
        for ray in 0..traced.rays() {
            let samples = traced.samples(ray);
            let radiance = &traced.radiance[samples.clone()];
            quadrature.set(radiance, self.marcher.step);
            quadrature.density_derivative(radiance, self.marcher.step, self.background(), &mut derivative);
            for (i, sample) in samples.enumerate() {
                let weight = quadrature.weights[i];
                let length = derivative[i].length();
                // ∞ · 0 would be NaN: without occupancy the bound is infinite, and behind opaque matter the length is 0.
                let reach = if length > 0.0 {
                    length * self.marcher.majorant(traced.positions[sample].as_dvec3())
                } else {
                    0.0
                };
                if weight.max(reach) > self.marcher.cutoff {
                    wanted.push(Wanted { ray, sample, weight, density_derivative: derivative[i] });
                }
            }
        }
        wanted
    }

    /// (∇σ, [∂c/∂x, ∂c/∂y, ∂c/∂z]) of every wanted sample; `None` where the field is not finite nearby.
    ///
    /// Points are clipped to the box, so that the difference is one-sided at its border, and divided by the distance that
    /// f32 positions really have.
    fn gradients(
        &self,
        traced: &TracedRays,
        rays: &[Ray],
        wanted: &[Wanted],
        differences: Differences,
    ) -> Vec<Option<(DVec3, [DVec3; 3])>> {
        let mut positions = Vec::with_capacity(6 * wanted.len());
        let mut directions = Vec::with_capacity(6 * wanted.len());
        for w in wanted {
            let x = traced.positions[w.sample];
            let step = differences.at(x);
            for axis in 0..3 {
                for side in [1.0, -1.0] {
                    let mut y = x.as_dvec3();
                    y[axis] += side * step[axis];
                    let mut y = y.as_vec3();
                    y[axis] = self.marcher.bounds.clamp(y)[axis];
                    positions.push(y);
                    directions.push(rays[w.ray].direction.as_vec3());
                }
            }
        }
        let mut radiance = vec![Radiance::default(); positions.len()];
        self.field.evaluate(&positions, &directions, &mut radiance);

        let around = positions.as_chunks::<6>().0.iter().zip(radiance.as_chunks::<6>().0);
        around
            .map(|(x, r)| {
                if r.iter().any(|r| !r.is_valid()) {
                    return None;
                }
                let mut density = DVec3::ZERO;
                let mut color = [DVec3::ZERO; 3];
                for axis in 0..3 {
                    let (up, down) = (2 * axis, 2 * axis + 1);
                    let width = f64::from(x[up][axis]) - f64::from(x[down][axis]);
                    if width > 0.0 {
                        density[axis] = (f64::from(r[up].density) - f64::from(r[down].density)) / width;
                        color[axis] = (r[up].color.as_dvec3() - r[down].color.as_dvec3()) / width;
                    }
                }
                Some((density, color))
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{ClosedForm, RadianceField};
    use crate::render::Marcher;
    use proptest::prelude::*;

    /// A scene whose sample `moved` sits elsewhere: renders the ray's pixel with that one position displaced.
    fn pixel_with_moved_sample(tracer: &Tracer, ray: &Ray, traced: &TracedRays, moved: usize, by: DVec3) -> DVec3 {
        let positions: Vec<Vec3> = traced
            .positions
            .iter()
            .enumerate()
            .map(|(i, x)| if i == moved { (x.as_dvec3() + by).as_vec3() } else { *x })
            .collect();
        let mut radiance = vec![Radiance::default(); positions.len()];
        tracer.field.evaluate(&positions, &vec![ray.direction.as_vec3(); positions.len()], &mut radiance);
        let mut quadrature = Quadrature::default();
        quadrature.set(&radiance, tracer.marcher.step);
        quadrature.pixel(&radiance, &traced.t, tracer.background()).color
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn jacobian_is_the_whole_rays_response_to_moving_one_sample(y in -0.3..0.3_f64, z in -0.3..0.3_f64, jitter in 0.0..1.0_f64) {
            let field = ClosedForm::ball();
            let marcher = Marcher { step: 0.01, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
            let tracer = Tracer { field: &field, marcher, background: Vec3::ONE };
            let ray = Ray::new(DVec3::new(-3.0, y, z), DVec3::new(1.0, -0.1 * z, 0.1 * y));
            let h = 2.5e-4;
            let traced = tracer.trace(&[ray], &[jitter]);
            let samples = tracer.jacobians(&[ray], &[jitter], 7, Differences { step: DVec3::splat(h), domain: Domain::Box(field.bounds()) });
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
                        // Both difference the same field values, so its rounding cancels; widths differ by an ulp of
                        // the positions, 2e-4 relative. What is left is that brute force squares and multiplies
                        // increments: with |σ'| = 80 · 23, |σ''| = 80 · 901 (the ramp's largest), |∇c| = 2.25 and
                        // δ = 0.01, C'' σ' σ'' h² / 2 = δ² · 1.3e8 · h² / 2 = 4e-4 and δ σ'' |∇c| h² / 2 = 5e-5.
                        let limit = 0.001 * f64::from(scale) + 6e-4;
                        prop_assert!((brute - found).abs() <= limit, "axis {} channel {}: {} against {}", axis, channel, found, brute);
                    }
                }
            }
        }
    }

    #[test]
    fn differences_at_the_box_border_are_one_sided() {
        // Density exactly on the face: the wall's flat side is cut by the box at x = 1.
        let field = ClosedForm::courtyard();
        let marcher = Marcher { step: 0.004, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &field, marcher, background: Vec3::ONE };
        // Down through the floor a hair inside the face.
        let ray = Ray::new(DVec3::new(0.999_999, 0.1, 1.0), -DVec3::Z);
        let samples = tracer.jacobians(
            &[ray],
            &[0.5],
            0,
            Differences { step: DVec3::splat(0.01), domain: Domain::Box(field.bounds()) },
        );
        // The floor does not change along x there except in texture; a two-sided difference across the face would see the
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
        // The second ray runs through the hole, the third is finite itself but its differences are not.
        let rays = [ray(0.0), ray(0.7), ray(0.499)];
        let samples = tracer.jacobians(
            &rays,
            &[0.5; 3],
            10,
            Differences { step: DVec3::splat(0.01), domain: Domain::Box(Holed.bounds()) },
        );
        assert_eq!((samples.rays, samples.dropped), (vec![10], 2));
        assert!(samples.first_invalid.unwrap().y > 0.49);
    }
}
