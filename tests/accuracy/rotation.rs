//! What turning a scene by 45° does to each scalar read off the Hessian.

use glam::{DMat3, DVec3, Mat3, Vec3};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Camera};
use octobayes::posterior::Covariance;
use octobayes::uncertainty::UncertaintyField;

/// A scene within the unit ball, turned about z by `angle` and then shifted, in a larger box.
struct Moved {
    scene: ClosedForm,
    angle: f64,
    shift: DVec3,
}

impl Moved {
    fn forth(&self, x: DVec3) -> DVec3 {
        DMat3::from_rotation_z(self.angle) * x + self.shift
    }
}

impl RadianceField for Moved {
    fn bounds(&self) -> Aabb {
        Aabb::centered_cube(1.25)
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let back = Mat3::from_rotation_z(-self.angle as f32);
        let there: Vec<Vec3> = positions.iter().map(|x| back * (*x - self.shift.as_vec3())).collect();
        self.scene.evaluate(&there, directions, out);
    }

    fn suggested_step(&self) -> f64 {
        self.scene.suggested_step()
    }
}

impl TrainedField for Moved {}

/// The field of a moved scene. Its cameras moved with it, so the same rays hit the same places.
fn field(scene: &ClosedForm, angle: f64, shift: DVec3) -> (UncertaintyField, Moved) {
    let moved = Moved { scene: scene.clone(), angle, shift };
    let cameras: Vec<Camera> = (0..12)
        .map(|i| {
            let azimuth = 0.52 * f64::from(i);
            let eye = DVec3::new(2.6 * azimuth.cos(), 2.6 * azimuth.sin(), [0.6, -0.5, 1.6][i as usize % 3]);
            let up = DMat3::from_rotation_z(angle) * DVec3::Z;
            Camera::look_at(moved.forth(eye), moved.forth(DVec3::ZERO), up, 0.6, [64, 64])
        })
        .collect();
    let grid = GridSettings::default().level(5).tolerance(0.0);
    let rays = RaySettings::default().rays(60_000).occupancy(32);
    (Estimation::new(&moved, &cameras).rays(rays).grid(grid).run().unwrap().field, moved)
}

/// Mean |Δ log10 U| between two copies of a scene, over points on the ball's surface, each moved with its copy.
fn change(a: &(UncertaintyField, Moved), b: &(UncertaintyField, Moved), points: &[DVec3]) -> f64 {
    let log10 = |(field, moved): &(UncertaintyField, Moved), x: DVec3| field.log10(moved.forth(x).as_vec3());
    points.iter().map(|&x| (log10(a, x) - log10(b, x)).abs()).sum::<f64>() / points.len() as f64
}

/// Points spread along a spiral over a sphere of the given radius.
fn sphere(radius: f64) -> Vec<DVec3> {
    (0..2000)
        .map(|i| {
            let z = 1.0 - (f64::from(i) + 0.5) / 1000.0;
            let (s, c) = (2.399_963 * f64::from(i)).sin_cos();
            radius * DVec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z)
        })
        .collect()
}

#[test]
fn trace_and_block_change_no_more_than_discretisation_does() {
    let scene = ClosedForm::ball();
    let turned = 45_f64.to_radians();
    // Shifts by fractions of the lattice edge, 2.5 / 32, show what discretisation alone does.
    let edge = 2.5 / 32.0;
    let still = field(&scene, 0.0, DVec3::ZERO);
    let shifted = field(&scene, 0.0, edge * DVec3::new(0.5, 0.31, 0.43));
    let rotated = field(&scene, turned, edge * DVec3::new(0.5, 0.31, 0.43));
    let points = sphere(0.5);
    for covariance in [Covariance::Trace, Covariance::Block] {
        let read = |f: &(UncertaintyField, Moved)| {
            (f.0.clone().with_covariance(covariance).unwrap(), Moved { scene: f.1.scene.clone(), ..f.1 })
        };
        let [still, shifted, rotated] = [&still, &shifted, &rotated].map(read);
        // The rays know these points: anywhere else nothing would change, whatever the method.
        let known = points.iter().map(|x| still.0.prior().log10() - still.0.log10(still.1.forth(*x).as_vec3()));
        let known = known.sum::<f64>() / points.len() as f64;
        assert!(known > 1.0, "{covariance:?}: U lies {known} decades below the prior's");
        let discretisation = change(&still, &shifted, &points);
        let rotation = change(&still, &rotated, &points);
        // To a scalar that does not depend on the axes a turned lattice is one more place of the lattice, so both
        // changes have one expectation. They are means over the ball's 500 cells (area π over edge²). Neighbours share
        // vertices, so that about a quarter of the cells are independent; |Δ| of a normal Δ has a deviation of ¾ of its
        // mean. Each mean has a standard error of ¾ / √125 = 7 %, their ratio 10 %: five of these are allowed. A method
        // with less discretisation has to have less of both.
        assert!(
            rotation <= 1.5 * discretisation,
            "{covariance:?}: turning changes {rotation}, shifting {discretisation}"
        );
    }
}
