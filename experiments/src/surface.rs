//! The true scene: where points are in it, and whether cameras see them.

use glam::DVec3;
use octobayes::geometry::Camera;
use octobayes_synth::{GROUND_RADIUS, HALF_HEIGHT, MeshScene};
use rayon::prelude::*;

use crate::visibility::is_seen;

/// Where a point is in the true scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// At the surface of the mesh.
    Surface,
    /// In the air, as floaters are.
    Air,
    /// Inside the mesh.
    Inside,
    /// At the ground, under it, or outside the scene's box: the model is not judged there.
    Elsewhere,
}

/// Where points are. What is nearer to a surface than `slack` is at it.
#[must_use]
pub fn places(scene: &MeshScene, points: &[DVec3], slack: f64) -> Vec<Place> {
    let distances = distances(scene, points);
    let place = |(x, distance): (&DVec3, f64)| match () {
        () if x.z < slack - HALF_HEIGHT || !MeshScene::bounds().contains(x.as_vec3()) => Place::Elsewhere,
        () if distance <= slack => Place::Surface,
        () if turns(scene, *x) > 0.5 => Place::Inside,
        () => Place::Air,
    };
    points.par_iter().zip(distances).map(place).collect()
}

/// How often the mesh winds around a point: 1 inside a closed one, 0 outside; the solid angles of its faces (van
/// Oosterom, Strackee 1983) over 4π (Jacobson, Kavan, Sorkine-Hornung 2013).
fn turns(scene: &MeshScene, x: DVec3) -> f64 {
    let mesh = scene.mesh();
    let angle = |face: u32| {
        let [a, b, c] = mesh.corners(face).map(|corner| corner - x);
        let [la, lb, lc] = [a, b, c].map(DVec3::length);
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.dot(b.cross(c)).atan2(below)
    };
    (0..mesh.faces().len() as u32).map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// Distance of each point from the mesh or the ground under it, scene units.
fn distances(scene: &MeshScene, points: &[DVec3]) -> Vec<f64> {
    let mesh = scene.mesh();
    let faces: Vec<Face> = (0..mesh.faces().len() as u32).map(|face| Face::new(mesh.corners(face))).collect();
    let of = |x: &DVec3| {
        let mut least = ground(*x);
        for face in &faces {
            let reach = least + face.radius;
            if x.distance_squared(face.middle) < reach * reach {
                least = least.min(face.nearest(*x).distance(*x));
            }
        }
        least
    };
    points.par_iter().map(of).collect()
}

fn ground(x: DVec3) -> f64 {
    let beside = (x.truncate().length() - GROUND_RADIUS).max(0.0);
    beside.hypot(x.z + HALF_HEIGHT)
}

/// A triangle with a ball around it.
struct Face {
    corners: [DVec3; 3],
    middle: DVec3,
    radius: f64,
}

impl Face {
    fn new(corners: [DVec3; 3]) -> Self {
        let middle = corners.iter().sum::<DVec3>() / 3.0;
        Self { corners, middle, radius: corners.iter().map(|c| c.distance(middle)).fold(0.0, f64::max) }
    }

    /// The nearest point of the triangle (Ericson, "Real-Time Collision Detection", 5.1.5).
    fn nearest(&self, x: DVec3) -> DVec3 {
        let [a, b, c] = self.corners;
        let (ab, ac) = (b - a, c - a);
        let [to_a, to_b, to_c] = self.corners.map(|corner| x - corner);
        let [d1, d2] = [ab.dot(to_a), ac.dot(to_a)];
        if d1 <= 0.0 && d2 <= 0.0 {
            return a;
        }
        let [d3, d4] = [ab.dot(to_b), ac.dot(to_b)];
        if d3 >= 0.0 && d4 <= d3 {
            return b;
        }
        let [d5, d6] = [ab.dot(to_c), ac.dot(to_c)];
        if d6 >= 0.0 && d5 <= d6 {
            return c;
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return a + d1 / (d1 - d3) * ab;
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return a + d2 / (d2 - d6) * ac;
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            return b + (d4 - d3) / (d4 - d3 + d5 - d6) * (c - b);
        }
        a + (vb * ab + vc * ac) / (va + vb + vc)
    }
}

/// Number of cameras that see each point: nothing stands more than `slack` in front of it.
#[must_use]
pub fn sightings(scene: &MeshScene, cameras: &[Camera], points: &[DVec3], slack: f64) -> Vec<usize> {
    points.par_iter().map(|&x| cameras.iter().filter(|camera| is_seen(scene, camera, x, slack)).count()).collect()
}

#[cfg(test)]
mod tests {
    use octobayes_synth::Mesh;

    use super::*;

    #[test]
    fn points_are_inside_outside_and_at_the_surface() {
        let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].into_iter().map(|x| 0.5 * x - 0.1).collect();
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let scene = MeshScene::new(Mesh::new(corners, faces).unwrap());
        let points = [DVec3::ZERO, DVec3::splat(0.4), DVec3::splat(-0.1), DVec3::Z * -0.9, DVec3::X * 1.5];
        let expected = [Place::Inside, Place::Air, Place::Surface, Place::Elsewhere, Place::Elsewhere];
        assert_eq!(places(&scene, &points, 0.01), expected);
    }
}
