//! Errors of depth: the posterior of the displacements, pushed through to the expected depth of rays.

use glam::{DVec3, Vec3};
use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField};
use octobayes::geometry::{Aabb, Camera, Lattice};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Information};
use octobayes::render::{
    DepthProbe, Differences, Differentiation, Marcher, RenderedView, Tracer, render_view, render_view_with_depth,
};
use octobayes::uncertainty::UncertaintyField;

/// A field whose matter is moved along an axis by a hat function around a lattice point.
struct Deformed<'a> {
    field: &'a dyn RadianceField,
    lattice: Lattice,
    vertex: [u32; 3],
    by: DVec3,
}

impl Deformed<'_> {
    fn moved(&self, x: Vec3) -> Vec3 {
        let Some(u) = self.lattice.coordinates(x) else { return x };
        let hat = |axis: usize| (1.0 - (u[axis] - f64::from(self.vertex[axis])).abs()).max(0.0);
        (x.as_dvec3() + self.by * hat(0) * hat(1) * hat(2)).as_vec3()
    }
}

impl RadianceField for Deformed<'_> {
    fn bounds(&self) -> Aabb {
        self.field.bounds()
    }

    fn suggested_step(&self) -> f64 {
        self.field.suggested_step()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let positions: Vec<Vec3> = positions.iter().map(|&x| self.moved(x)).collect();
        self.field.evaluate(&positions, directions, out);
    }
}

fn tracer(field: &dyn RadianceField, step: f64) -> Tracer<'_> {
    let marcher = Marcher { step, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
    Tracer { field, marcher, background: Vec3::ONE }
}

/// A field of `scene` in the scale of its data, with its sums.
fn uncertainty(scene: &ClosedForm, grid: GridSettings, covariance: Covariance) -> UncertaintyField {
    let cameras = ClosedForm::half_circle(5, [48; 2]);
    let data = DataScale::from_cameras(&cameras, 0.03, &octobayes::geometry::Domain::Box(scene.bounds())).unwrap();
    let grid = grid.covariance(covariance).surface_points(100).scale(octobayes::posterior::Scale::Data(data));
    let rays = RaySettings::default().rays(20_000).occupancy(32);
    Estimation::new(scene, &cameras).rays(rays).grid(grid).run().unwrap().field
}

fn view_with_depth(tracer: &Tracer, camera: &Camera, field: &UncertaintyField) -> RenderedView {
    let posterior = field.depth_posterior().unwrap();
    let step = 0.02 * field.lattice().edge();
    let differences = Differences { step, domain: *field.lattice().domain() };
    let differentiation = Differentiation { differences, analytic: None };
    let probe = DepthProbe { differentiation, variances: &[&posterior] };
    render_view_with_depth(tracer, camera, 0.5, &[], &probe, &Silent).unwrap()
}

/// Every vertex is moved along every axis, the ray rendered again, and gᵀ C g added up.
#[test]
fn the_variance_is_that_of_rendering_moved_matter_again() {
    let ball = ClosedForm::ball();
    let grid = GridSettings::default().grid(GridKind::Dense).level(3);
    let camera = Camera::look_at(DVec3::new(2.1, -1.7, 0.9), DVec3::new(0.1, 0.1, -0.1), DVec3::Z, 0.5, [3, 3]);
    let step = 0.01;
    for covariance in [Covariance::Block, Covariance::Diagonal] {
        let field = uncertainty(&ball, grid, covariance);
        let view = view_with_depth(&tracer(&ball, step), &camera, &field);
        let lattice = *field.lattice();
        let last = lattice.cells_per_axis();
        let points = (0..=last).flat_map(|x| (0..=last).flat_map(move |y| (0..=last).map(move |z| [x, y, z])));
        // A hundredth of the length over which the ball's density rises; both sides, so errors are of second order.
        let h = 1e-3;
        let mut sums = vec![0.0; view.pixels.len()];
        for point in points {
            let depths = |by: DVec3| {
                let deformed = Deformed { field: &ball, lattice, vertex: point, by };
                let view = render_view(&tracer(&deformed, step), &camera, 0.5, &[], &Silent).unwrap();
                view.pixels.iter().map(|pixel| pixel.expected_depth).collect::<Vec<f64>>()
            };
            let gradients = DVec3::AXES.map(|axis| {
                let (up, down) = (depths(h * axis), depths(-h * axis));
                up.iter().zip(&down).map(|(up, down)| (up - down) / (2.0 * h)).collect::<Vec<f64>>()
            });
            let at = lattice.position(DVec3::from(point.map(f64::from))).as_vec3();
            let [xx, xy, xz, yy, yz, zz]: Information = field.covariances(&[at], covariance).unwrap()[0];
            let matrix = glam::DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
            for (i, sum) in sums.iter_mut().enumerate() {
                let g = DVec3::from(gradients.each_ref().map(|gradient| gradient[i]));
                *sum += g.dot(matrix * g);
            }
        }
        let hit = (0..sums.len()).filter(|&i| view.pixels[i].opacity > 0.0);
        for (i, found, expected) in hit.map(|i| (i, view.posterior_variance[0][i], sums[i])) {
            // Second-order errors of both differences, and f32 positions.
            assert!((found / expected - 1.0).abs() < 0.02, "{covariance:?}, pixel {i}: {found} against {expected}");
        }
        assert!(sums.iter().any(|&sum| sum > 1e-6), "{sums:?}");
    }
}

/// The octree has no vertices where nothing is known; its variances are the dense grid's all the same.
#[test]
fn octree_and_dense_grid_give_the_same_errors() {
    let courtyard = ClosedForm::courtyard();
    let camera = ClosedForm::half_circle(3, [40; 2])[1];
    let tracer = tracer(&courtyard, 0.01);
    let views = [GridKind::Dense, GridKind::Octree].map(|grid| {
        let settings = GridSettings::default().grid(grid).level(5).keep_sums(true);
        view_with_depth(&tracer, &camera, &uncertainty(&courtyard, settings, Covariance::Block))
            .posterior_variance
            .remove(0)
    });
    let mut compared = 0;
    for (dense, octree) in views[0].iter().zip(&views[1]) {
        assert_eq!(dense.is_nan(), octree.is_nan());
        if *dense > 0.0 {
            // A deviation may be off by the tolerance of the octree, 0.01 decades, a variance by twice that.
            assert!((octree / dense).log10().abs() <= 0.02, "{octree} against {dense}");
            compared += 1;
        }
    }
    assert!(compared > 500, "{compared} pixels have a depth");
}

#[test]
fn a_field_without_sums_takes_its_covariances_for_the_same_in_all_directions() {
    let ball = ClosedForm::ball();
    let field = uncertainty(&ball, GridSettings::default().level(4), Covariance::Trace);
    let camera = ClosedForm::half_circle(3, [24; 2])[0];
    let tracer = tracer(&ball, 0.01);
    let [with, without] = [field.clone(), field.without_sums()]
        .map(|field| view_with_depth(&tracer, &camera, &field).posterior_variance.remove(0));
    let mut compared = 0;
    for (with, without) in with.iter().zip(&without).filter(|(with, _)| **with > 0.0) {
        // `trace` knows no directions anyway. Deviations are stored in f32, relative error 6e-8.
        assert!((without / with - 1.0).abs() < 1e-6, "{without} against {with}");
        compared += 1;
    }
    assert!(compared > 50, "{compared} pixels have a depth");
}

#[test]
fn the_papers_scale_has_no_errors_of_depth() {
    let ball = ClosedForm::ball();
    let cameras = ClosedForm::half_circle(3, [16; 2]);
    let settings = RaySettings::default().rays(100).occupancy(16);
    let outcome = Estimation::new(&ball, &cameras).rays(settings).grid(GridSettings::default().level(3)).run().unwrap();
    let error = outcome.field.depth_posterior().err().expect("a refusal").to_string();
    assert!(error.contains("scale of its data"), "{error}");
}
