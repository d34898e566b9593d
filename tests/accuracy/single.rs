//! Single scenes: what is special about each.

use glam::{DMat3, DVec3, Vec3};
use octobayes::field::closed_form::{Primitive, Shape, Texture};
use octobayes::field::{Radiance, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Camera, Domain, Ray};
use octobayes::posterior::{Covariance, DensePosterior, Posterior, VertexSums, trace};
use octobayes::render::{Differences, Differentiation, JacobianBuffers, Marcher, RayBatch, Stencil, Tracer};

use crate::compare::{Case, Run, cameras, error, lambda, nothing_left_out};
use crate::oracle::Derivatives;
use crate::scenes::{self, CELL, HardScene, LEVEL, surfaces};

fn scene(name: &str) -> HardScene {
    scenes::by_name(name)
}

fn information(run: &Run) -> f64 {
    run.field.sums().unwrap().iter().map(|e| trace(&e.information)).sum()
}

/// A field that does not reveal its density bounds, as most models do not.
struct BlackBox<'a>(&'a dyn TrainedField);

impl RadianceField for BlackBox<'_> {
    fn bounds(&self) -> Aabb {
        self.0.bounds()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        self.0.evaluate(positions, directions, out);
    }

    fn suggested_step(&self) -> f64 {
        self.0.suggested_step()
    }
}

impl TrainedField for BlackBox<'_> {}

/// An early version lost 39 % of the information here, from rays that pass a step within h with all samples in
/// empty space.
#[test]
#[ignore = "slow: several seconds"]
fn rays_that_pass_a_step_by_are_found_if_the_field_bounds_its_density() {
    let scene = scene("opaque-step");
    let cameras = scene.cameras();
    let case = Case { field: &scene.field, cameras: &cameras, level: LEVEL, rays: 40_000 };
    let (rays, grid) = case.defaults();
    let whole = information(&case.run(nothing_left_out(rays, grid)).unwrap());
    let default = information(&case.run((rays, grid)).unwrap());
    // Left out: ‖G‖ below the cutoff, `1e-6 / 2h = 1e-3`, of G up to 80.
    assert!((default / whole - 1.0).abs() < 1e-6, "{default} of {whole}");
    let hidden = information(&case.run_through(&BlackBox(&scene.field), (rays, grid)).unwrap());
    // The README states this limit. If the ratio rises to 1, that sentence can go.
    assert!((0.3..0.95).contains(&(hidden / whole)), "{hidden} of {whole}");
}

/// The derivative of a step is a spike that few samples meet. Differences blur it over 2h, and give another result
/// for every h.
#[test]
fn an_opaque_step_depends_on_the_step_of_differences() {
    let scene = scene("opaque-step");
    let cameras = scene.cameras();
    let case = Case { field: &scene.field, cameras: &cameras, level: LEVEL, rays: 40_000 };
    let (rays, grid) = case.defaults();
    let at = |step: f64| {
        let run = case.run((rays.step(Some(step)), grid)).unwrap();
        information(&run)
    };
    // Head on, a share 2h / δ of the rays meets the blurred spike, with (1 / 2h)² each: 1 / h. At grazing
    // incidence on a ball, √h samples in a row meet it on a share h of the rays. They add up before they are
    // squared: h⁰.
    let ratio = at(1.0 / 128.0) / at(1.0 / 32.0);
    assert!((1.3..4.0).contains(&ratio), "{ratio}");
}

#[test]
fn noise_of_half_precision_fades_with_a_larger_step() {
    let scene = scene("half-precision");
    let cameras = scene.cameras();
    let case = Case { field: &scene.field, cameras: &cameras, level: LEVEL, rays: 512 };
    let (rays, grid) = case.defaults();
    let off = |step: f64| {
        let run = case.run((rays.step(Some(step)), grid)).unwrap();
        error(&case, &run, &case.oracle(&run, Derivatives::Exact))
    };
    let (fine, coarse) = (off(1.0 / 128.0), off(1.0 / 16.0));
    assert!(fine.mean[2] > 3.0 * coarse.mean[2], "{fine:?} {coarse:?}");
    // Noise adds up as squares, so it can only pass for information, most of all where a surface's texture says
    // least (`block`).
    assert!(fine.bias[2] < 0.0, "{fine:?}");
}

#[test]
fn matter_in_one_cell_moves_the_cells_eight_corners() {
    let scene = scene("one-cell");
    let cameras = scene.cameras();
    let case = Case { field: &scene.field, cameras: &cameras, level: LEVEL, rays: 512 };
    let run = case.run(case.defaults()).unwrap();
    let n = 33;
    let moved: Vec<usize> = (0..n * n * n).filter(|&i| run.field.sums().unwrap()[i].rays > 0).collect();
    let corners = (0..8).map(|c| ((16 + (c >> 2)) * n + 16 + (c >> 1 & 1)) * n + 16 + (c & 1));
    assert_eq!(moved, corners.collect::<Vec<usize>>());
}

/// The coarsest lattice has 2³ cells. A lattice of a single cell is refused.
#[test]
fn a_lattice_of_eight_cells_agrees_with_the_oracle_and_one_of_one_is_refused() {
    let scene = scene("camera-inside");
    let cameras = scene.cameras();
    let case = Case { field: &scene.field, cameras: &cameras, level: 1, rays: 256 };
    let (rays, grid) = case.defaults();
    let run = case.run(nothing_left_out(rays, grid)).unwrap();
    assert_eq!(run.field.sums().unwrap().len(), 27);
    let e = error(&case, &run, &case.oracle(&run, Derivatives::Differences(run.h)));
    assert!(e.hessian < 2e-3 && e.moved == 27, "{e:?}");
    let none = Case { level: 0, ..case };
    assert!(none.run(none.defaults()).is_err());
}

/// Median of `of` over well-seen vertices: those whose information is above `floor`.
fn median(run: &Run, floor: f64, of: impl Fn(&VertexSums) -> f64) -> f64 {
    let values: Vec<f64> = run.field.sums().unwrap().iter().filter(|e| trace(&e.information) > floor).map(of).collect();
    assert!(values.len() > 100);
    octobayes::metrics::median(values)
}

/// One picture, or two from almost the same place, pin what is across the line of sight better than what is along
/// it. The method counts the second as another picture of the same, and reports no depth from it.
#[test]
fn two_cameras_alike_are_taken_for_one() {
    let runs = ["one-camera", "two-cameras"].map(|name| {
        let scene = scene(name);
        let cameras = scene.cameras();
        let case = Case { field: &scene.field, cameras: &cameras, level: LEVEL, rays: 40_000 };
        (case.run(case.defaults()).unwrap(), lambda(&scene.field, LEVEL))
    });
    let sight = DVec3::new(2.6, 0.4, 0.7).normalize();
    let ratio = |(run, lambda): &(Run, f64)| {
        let floor = 1e3 * lambda * 40_000.0;
        median(run, floor, |e| {
            let [xx, xy, xz, yy, yz, zz] = e.information;
            let h = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
                + DMat3::from_diagonal(DVec3::splat(lambda * 40_000.0));
            let along = sight.dot(h * sight);
            let across = 0.5 * (h.x_axis.x + h.y_axis.y + h.z_axis.z - along);
            along / across
        })
    };
    let [one, two] = [ratio(&runs[0]), ratio(&runs[1])];
    assert!((one / two).log10().abs() < 0.05, "{one} {two}");
    assert!(one < 0.4, "information along the line of sight over across: {one}");
    let spread = |(run, lambda): &(Run, f64)| {
        median(run, 1e3 * lambda * 40_000.0, |e| Covariance::Block.deviation(e, 40_000, *lambda).log10())
    };
    // The same number of rays gives the same information.
    assert!((spread(&runs[0]) - spread(&runs[1])).abs() < 0.05, "{} {}", spread(&runs[0]), spread(&runs[1]));
}

/// For a plain colour c before a background b, `∂C/∂σ = T_end (c − b) δ` all along the ray. A hat function φ along
/// it gets `J = T_end (c − b) ∫ φ σ' dt = −T_end (c − b) ∫ φ' σ dt`. With matter in one cell that is
/// `± T_end (c − b) τ / edge`, however steep its sides are. Squaring before summing would give the slopes
/// themselves.
#[test]
fn both_sides_of_a_thin_sheet_cancel_within_a_ray() {
    let color = Vec3::new(0.8, 0.3, 0.2);
    let shape = Shape::Slab { center: 0.5 * CELL * Vec3::X, normal: Vec3::X, half: CELL / 16.0 };
    let sheet = Primitive { shape, peak: 150.0, softness: CELL / 32.0, texture: Texture::Plain(color) };
    let field = surfaces::specimen(sheet);
    let edge = f64::from(CELL);
    // On a lattice line there are two vertices, with weights 1 across.
    let ray = Ray::new(DVec3::new(2.0, 2.0 * edge, -3.0 * edge), -DVec3::X);
    let marcher = Marcher { step: edge / 256.0, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
    let tracer = Tracer { field: &field, marcher, background: Vec3::ONE };
    let differences = Differences {
        step: DVec3::splat(edge / 512.0),
        domain: Domain::Box(field.bounds()),
        stencil: Stencil::Central,
    };
    let how = Differentiation { differences, analytic: None };
    let samples = tracer.jacobians(
        &RayBatch { rays: vec![ray], jitter: vec![0.4], first: 0 },
        &how,
        &mut JacobianBuffers::default(),
    );
    let lattice = octobayes::geometry::Lattice::new(field.bounds(), 5).unwrap();
    let mut posterior = DensePosterior::new(lattice);
    posterior.add(&[samples]);
    let tau = 150.0 * 2.0 * edge / 16.0;
    let contrast = (color.as_dvec3() - 1.0) * (-tau).exp();
    let expected = contrast.length_squared() * (tau / edge).powi(2);
    let at = |x: usize, y: usize, z: usize| posterior.sums()[(x * 33 + y) * 33 + z].information;
    for x in [16, 17] {
        let [xx, xy, xz, yy, yz, zz] = at(x, 18, 13);
        // The quadrature of a ramp of 16 samples, twice, and differences over an eighth of it.
        assert!((xx / expected - 1.0).abs() < 0.01, "{xx} instead of {expected}");
        assert!([xy, xz, yy, yz, zz].iter().all(|s| s.abs() < 1e-6 * xx));
    }
    // The line of vertices beside it has weight 0.
    assert_eq!(at(16, 19, 13), [0.0; 6]);
}

/// A ray 1e-9 outside the box is outside; a ray on its edge is inside.
#[test]
fn grazing_rays_count_if_they_touch_the_box_along_a_line() {
    let scene = scene("ray-grazing");
    let all = scene.cameras();
    let seen = |camera: &Camera| {
        let one = [*camera];
        let case = Case { field: &scene.field, cameras: &one, level: LEVEL, rays: 16 };
        case.run(case.defaults()).unwrap().progress.samples > 0
    };
    let found: Vec<bool> = all.iter().map(seen).collect();
    // Two edges; a hair outside; an edge and a corner in one point; an edge cut by a thousandth of a cell, in
    // empty space; past everything.
    assert_eq!(found, [true, true, false, false, false, false, false]);
    assert_eq!(cameras(&scene.field).len(), found.len());
}
