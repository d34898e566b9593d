use super::*;
use crate::field::{ClosedForm, RadianceField};
use crate::geometry::Domain;
use crate::monitor::Silent;
use crate::render::trace::TracedRays;
use crate::render::{Differences, Marcher, Occupancy, Stencil};
use proptest::prelude::*;

/// Jacobians by central differences over ±h.
fn by_differences(tracer: &Tracer, rays: &[Ray], jitter: &[f64], first: u64, h: f64) -> RaySamples {
    let differences =
        Differences { step: DVec3::splat(h), domain: Domain::Box(tracer.field.bounds()), stencil: Stencil::Central };
    let differentiation = Differentiation { differences, analytic: None };
    let batch = RayBatch { rays: rays.to_vec(), jitter: jitter.to_vec(), first };
    tracer.jacobians(&batch, &differentiation, &mut JacobianBuffers::default())
}

fn alone(ray: Ray, jitter: f64) -> RayBatch {
    RayBatch { rays: vec![ray], jitter: vec![jitter], first: 0 }
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

/// A black bump in front of white fog of this density, against black. With 1e-5, each sample of the fog weighs 1e-7,
/// and all of them 1e-5.
struct BumpBeforeFog(f32);

impl RadianceField for BumpBeforeFog {
    fn bounds(&self) -> crate::geometry::Aabb {
        crate::geometry::Aabb::centered_cube(1.0)
    }
    fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
        for (x, out) in positions.iter().zip(out) {
            let bump = f32::max(0.0, 1.0 - ((x.x + 0.5) / 0.05).powi(2)).powi(2);
            let fog = if x.x > 0.0 { self.0 } else { 0.0 };
            *out = Radiance { density: 20.0 * bump + fog, color: if x.x > 0.0 { Vec3::ONE } else { Vec3::ZERO } };
        }
    }
    fn suggested_step(&self) -> f64 {
        0.01
    }
    fn memory(&self) -> usize {
        0
    }
}

/// A slab of uniform density and colour between ramps, within 0.5 of the middle along x.
struct Slab;

impl RadianceField for Slab {
    fn bounds(&self) -> crate::geometry::Aabb {
        crate::geometry::Aabb::centered_cube(1.0)
    }
    fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
        for (x, out) in positions.iter().zip(out) {
            let density = 2.0 * ((0.5 - x.x.abs()) / 0.1).clamp(0.0, 1.0);
            *out = Radiance { density, color: Vec3::splat(0.5) };
        }
    }
    fn suggested_step(&self) -> f64 {
        0.01
    }
    fn memory(&self) -> usize {
        0
    }
}

/// What files of samples hold: `docs/src/formats.md` lists which are missing, and that weights do not add up.
#[test]
fn samples_without_a_jacobian_are_left_out() {
    let marcher = Marcher { step: 0.01, bounds: Slab.bounds(), occupancy: None, cutoff: 1e-6 };
    let tracer = Tracer { field: &Slab, marcher, background: Vec3::ZERO };
    let ray = Ray::new(DVec3::new(-2.0, 0.1, 0.2), DVec3::X);
    let differences =
        Differences { step: DVec3::splat(1e-3), domain: Domain::Box(Slab.bounds()), stencil: Stencil::Central };
    let differentiation = Differentiation { differences, analytic: None };
    let found = tracer.jacobians(&alone(ray, 0.5), &differentiation, &mut JacobianBuffers::default());
    assert!(found.jacobians.iter().all(|jacobian| jacobian.iter().any(|entry| *entry != 0.0)));
    // Of the 80 samples of the slab between the ramps none, to within the step of the differences; of the two ramps'
    // 20 nearly all.
    assert!(found.positions.iter().all(|x| (0.399..0.502).contains(&x.x.abs())), "{:?}", found.positions);
    assert!((18..=24).contains(&found.positions.len()), "{}", found.positions.len());
    // Optical depth 0.1 in each ramp and 1.6 between: the ramps' weights, and the ray's opacity.
    let weights: f64 = found.weights.iter().map(|w| f64::from(*w)).sum();
    let ramps = (1.0 - f64::exp(-0.1)) * (1.0 + f64::exp(-1.7));
    assert!((weights - ramps).abs() < 0.01, "{weights} and {ramps}");
    assert!(weights < 1.0 - f64::exp(-1.8) - 0.5, "less than the opacity");
}

/// With and without an occupancy grid, whose bound of the density is one more reason to leave the fog's samples
/// out.
#[test]
fn what_is_not_differentiated_is_composited() {
    let field = BumpBeforeFog(1e-5);
    let grid = Occupancy::build(&field, 32, 1e-3, &Silent).unwrap();
    for occupancy in [None, Some(grid)] {
        composites_what_is_not_differentiated(&field, occupancy);
    }
}

/// Jacobians with cutoff 0, and with the default.
fn of_bump_before_fog(field: &BumpBeforeFog, occupancy: Option<Occupancy>) -> [RaySamples; 2] {
    let marcher = Marcher { step: 0.01, bounds: field.bounds(), occupancy, cutoff: 1e-6 };
    let tracer = Tracer { field, marcher, background: Vec3::ZERO };
    let ray = Ray::new(DVec3::new(-2.0, 0.1, 0.2), DVec3::X);
    let differences =
        Differences { step: DVec3::splat(1e-3), domain: Domain::Box(field.bounds()), stencil: Stencil::Central };
    let differentiation = Differentiation { differences, analytic: None };
    let exact = Tracer { marcher: Marcher { cutoff: 0.0, ..tracer.marcher.clone() }, ..tracer.clone() };
    [exact, tracer].map(|t| t.jacobians(&alone(ray, 0.5), &differentiation, &mut JacobianBuffers::default()))
}

/// The fog's 100 samples together weigh 1e-7, less than the cutoff: the field does not evaluate their colours, so that
/// nothing is seen behind the bump. Its derivatives are then at most δ · cutoff · |∇σ|.
#[test]
fn colours_that_are_left_out_weigh_less_than_the_cutoff() {
    let [exact, found] = of_bump_before_fog(&BumpBeforeFog(1e-7), None);
    let steepest = exact.jacobians.iter().map(|j| j[0].abs()).fold(0.0, f32::max);
    // A hundredth of the test below, where the fog is a hundred times as dense; |∇σ| is 600 at most.
    assert!((1e-7..4e-7).contains(&steepest) && f64::from(steepest) < 0.01 * 1e-6 * 600.0, "{steepest}");
    assert!(found.positions.iter().all(|x| x.x > 0.0), "{:?}", found.positions);
}

fn composites_what_is_not_differentiated(field: &BumpBeforeFog, occupancy: Option<Occupancy>) {
    let [exact, found] = of_bump_before_fog(field, occupancy);
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
