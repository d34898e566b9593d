//! Errors of depth: the posterior of the displacements, pushed through to the expected depth of rays.

use glam::{DVec3, Vec3};
use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Camera, Lattice};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Information};
use octobayes::render::{
    DepthProbe, Differences, Differentiation, Marcher, RenderedView, Stencil, Tracer, render_view,
    render_view_with_depth,
};
use octobayes::uncertainty::UncertaintyField;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// A field whose matter is moved by displacements of all lattice points.
struct Moved<'a> {
    field: &'a dyn TrainedField,
    lattice: Lattice,
    /// x slowest.
    moves: Vec<DVec3>,
}

impl RadianceField for Moved<'_> {
    fn bounds(&self) -> Aabb {
        self.field.bounds()
    }

    fn suggested_step(&self) -> f64 {
        self.field.suggested_step()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let moved = |x: &Vec3| {
            let Some(u) = self.lattice.coordinates(*x) else { return *x };
            let (cell, offset) = self.lattice.cell(u);
            let corner = |c: u32| {
                let weight: f64 =
                    (0..3).map(|axis| if c >> axis & 1 == 1 { offset[axis] } else { 1.0 - offset[axis] }).product();
                let point = std::array::from_fn(|axis| cell[axis] + (c >> axis & 1));
                weight * self.moves[self.lattice.dense_index(point)]
            };
            (x.as_dvec3() + (0..8).map(corner).sum::<DVec3>()).as_vec3()
        };
        let positions: Vec<Vec3> = positions.iter().map(moved).collect();
        self.field.evaluate(&positions, directions, out);
    }
}

impl TrainedField for Moved<'_> {}

fn tracer(field: &dyn TrainedField, step: f64) -> Tracer<'_> {
    let marcher = Marcher { step, bounds: field.bounds(), occupancy: None, cutoff: 0.0 };
    Tracer { field, marcher, background: Vec3::ONE }
}

/// A field of `scene` in the scale of its data, with its sums.
fn uncertainty(scene: &ClosedForm, grid: GridSettings, covariance: Covariance) -> UncertaintyField {
    let cameras = ClosedForm::half_circle(5, [48; 2]);
    let data = DataScale::from_cameras(&cameras, 0.03, &octobayes::geometry::Domain::Box(scene.bounds())).unwrap();
    let grid = grid.covariance(covariance).scale(octobayes::posterior::Scale::Data(data));
    let rays = RaySettings::default().rays(20_000).occupancy(32);
    Estimation::new(scene, &cameras).rays(rays).grid(grid).run().unwrap().field
}

fn view_with_depth(tracer: &Tracer, camera: &Camera, field: &UncertaintyField) -> RenderedView {
    view_with_step(tracer, camera, field, 0.02)
}

/// With differences over this part of a cell.
fn view_with_step(tracer: &Tracer, camera: &Camera, field: &UncertaintyField, step: f64) -> RenderedView {
    let posterior = field.depth_posterior().unwrap();
    let step = step * field.lattice().edge();
    let differences = Differences { step, domain: *field.lattice().domain(), stencil: Stencil::Central };
    let differentiation = Differentiation { differences, analytic: None };
    let probe = DepthProbe { differentiation, variances: &[&posterior] };
    render_view_with_depth(tracer, camera, 0.5, &[], &probe, &Silent).unwrap()
}

/// Every vertex is moved along every axis, the ray rendered again, and gᵀ C g added up.
#[test]
#[ignore = "slow: several seconds"]
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
                let mut moves = vec![DVec3::ZERO; lattice.dense_vertices() as usize];
                moves[lattice.dense_index(point)] = by;
                let moved = Moved { field: &ball, lattice, moves };
                let view = render_view(&tracer(&moved, step), &camera, 0.5, &[], &Silent).unwrap();
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
            // Differences of second order on either side: measured below 0.01, and half of that with half the step.
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

/// Matter behind the plane x = `at`: hardly any before it, hardly anything passes behind it.
struct Wall {
    at: f32,
}

impl RadianceField for Wall {
    fn bounds(&self) -> Aabb {
        Aabb::centered_cube(1.0)
    }

    fn suggested_step(&self) -> f64 {
        5e-4
    }

    fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
        for (x, out) in positions.iter().zip(out) {
            // Light is gone within a hundredth, a twelfth of a cell of level 4.
            let depth = (x.x - self.at).clamp(0.0, 0.02);
            *out = Radiance { density: 1e5 * depth, color: Vec3::splat(0.5) };
        }
    }
}

impl TrainedField for Wall {}

/// By hand: a wall far thinner than a cell, at the fraction a between two planes of vertices; a ray through the middle
/// of the cell's other two edges moves with the eight corners in proportion to (1 − a) / 4 and a / 4, four of each. If
/// nothing is known, all have the prior's variance τ², and Var(d) = τ² ((1 − a)² + a²) / 4.
#[test]
fn the_variance_before_a_wall_is_that_by_hand() {
    let prior = 1e-4;
    for a in [0.5, 0.25] {
        // Level 4: sixteen cells of an eighth.
        let wall = Wall { at: 0.125 * a };
        let cameras = ClosedForm::half_circle(3, [8; 2]);
        // One pixel of the largest noise: no information to speak of.
        let data = DataScale::new(1, 0.5, prior).unwrap();
        let grid = GridSettings::default().grid(GridKind::Dense).level(4).keep_sums(true);
        let grid = grid.covariance(Covariance::Block).scale(octobayes::posterior::Scale::Data(data));
        let rays = RaySettings::default().rays(200).occupancy(16);
        let field = Estimation::new(&wall, &cameras).rays(rays).grid(grid).run().unwrap().field;
        // The camera's only ray runs along x, through the middle of a cell along y and z.
        let eye = DVec3::new(-3.0, 0.0625, 0.0625);
        let camera = Camera::look_at(eye, eye + DVec3::X, DVec3::Z, 0.5, [1, 1]);
        // The wall's density rises over 0.004: samples are forty times as dense, and differences closer still.
        let view = view_with_step(&tracer(&wall, 1e-4), &camera, &field, 0.0004);
        let depth = view.pixels[0].expected_depth - 3.0;
        let a = f64::from(a);
        // Light ends a little behind the plane: after about √(π / (2 · 1e5)) = 0.004.
        let inside = depth / 0.125;
        assert!((0.03..0.04).contains(&(inside - a)), "{inside} instead of a little more than {a}");
        // With T = exp(−s y²/2) at y behind the plane and d = ∫ T dy, moving matter at y moves d by m = s ∫_y^∞ T, and
        // the mean of y over m is half of that over the depth: ∫ y m dy = ½ √(π / 2s) = ½ d.
        let place = a + 0.5 * (inside - a);
        let expected = prior * prior * ((1.0 - place).powi(2) + place * place) / 4.0;
        let found = view.posterior_variance[0][0];
        // Samples are a fortieth of the reach of light apart; errors of their sums are of second order.
        assert!((found / expected - 1.0).abs() < 2e-3, "{found} against {expected}");
    }
}

/// Errors that are drawn from the posterior lie within their deviations as often as they should: before the half that
/// cameras saw, and before the half that none did.
#[test]
fn errors_of_the_posterior_lie_within_its_deviations() {
    let ball = ClosedForm::ball();
    let grid = GridSettings::default().grid(GridKind::Dense).level(3).keep_sums(true);
    let cameras = ClosedForm::half_circle(5, [48; 2]);
    // A prior of a fiftieth of a cell, so that depth answers linearly.
    let data = DataScale::new(5 * 48 * 48, 0.03, 0.005).unwrap();
    let grid = grid.covariance(Covariance::Block).scale(octobayes::posterior::Scale::Data(data));
    let rays = RaySettings::default().rays(20_000).occupancy(32);
    let field = Estimation::new(&ball, &cameras).rays(rays).grid(grid).run().unwrap().field;
    let lattice = *field.lattice();
    let n = lattice.cells_per_axis() + 1;
    let all = (0..n).flat_map(|x| (0..n).flat_map(move |y| (0..n).map(move |z| [x, y, z])));
    let at: Vec<Vec3> = all.map(|p| lattice.position(DVec3::from(p.map(f64::from))).as_vec3()).collect();
    let roots: Vec<glam::DMat3> =
        field.covariances(&at, Covariance::Block).unwrap().into_iter().map(cholesky).collect();
    let [seen, unseen] =
        [cameras[2].position, -cameras[2].position].map(|eye| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.5, [9; 2]));
    for (name, camera) in [("seen", seen), ("unseen", unseen)] {
        let view = view_with_depth(&tracer(&ball, 0.01), &camera, &field);
        let mut random = ChaCha8Rng::seed_from_u64(3);
        // Twelve uniform numbers less six: normal to what a test of shares can tell.
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let (mut within, mut pairs) = ([0_usize; 2], 0);
        for _ in 0..60 {
            let moves = roots.iter().map(|root| *root * DVec3::new(normal(), normal(), normal())).collect();
            let moved = Moved { field: &ball, lattice, moves };
            let drawn = render_view(&tracer(&moved, 0.01), &camera, 0.5, &[], &Silent).unwrap();
            for (i, pixel) in drawn.pixels.iter().enumerate().filter(|(i, _)| view.pixels[*i].opacity > 0.9) {
                let ratio =
                    (pixel.expected_depth - view.pixels[i].expected_depth).abs() / view.posterior_variance[0][i].sqrt();
                pairs += 1;
                within[0] += usize::from(ratio <= 1.0);
                within[1] += usize::from(ratio <= 1.96);
            }
        }
        let [one, two] = within.map(|count| count as f64 / f64::from(pairs));
        // About 30 pixels of 60 draws, of which neighbours move together: perhaps 600 independent ones, whose shares of
        // 0.68 and 0.95 have standard errors of 0.019 and 0.009. Three of them.
        assert!(pairs > 1500 && (one - 0.683).abs() < 0.06 && (two - 0.95).abs() < 0.03, "{name}: {one}, {two}");
    }
}

/// L with L Lᵀ = C.
fn cholesky([xx, xy, xz, yy, yz, zz]: Information) -> glam::DMat3 {
    let a = xx.sqrt();
    let (b, c) = (xy / a, xz / a);
    let d = (yy - b * b).sqrt();
    let e = (yz - b * c) / d;
    let f = (zz - c * c - e * e).max(0.0).sqrt();
    glam::DMat3::from_cols(DVec3::new(a, b, c), DVec3::new(0.0, d, e), DVec3::new(0.0, 0.0, f))
}

#[test]
fn the_papers_scale_has_no_errors_of_depth() {
    let ball = ClosedForm::ball();
    let cameras = ClosedForm::half_circle(3, [16; 2]);
    let settings = RaySettings::default().rays(100).occupancy(16);
    let outcome = Estimation::new(&ball, &cameras).rays(settings).grid(GridSettings::default().level(3)).run().unwrap();
    let error = outcome.field.depth_posterior().err().expect("a refusal").to_string();
    assert!(error.contains("computed with it"), "{error}");
}
