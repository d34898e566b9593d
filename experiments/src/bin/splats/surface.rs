//! The true surface: how far points are from it, and whether cameras see them.

use glam::DVec3;
use octobayes::geometry::Camera;
use octobayes_synth::{GROUND_RADIUS, HALF_HEIGHT, MeshScene};
use rayon::prelude::*;

use common::visibility::is_seen;

/// Distance of each point from the mesh or the ground under it, scene units.
pub fn distances(scene: &MeshScene, points: &[DVec3]) -> Vec<f64> {
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
pub fn sightings(scene: &MeshScene, cameras: &[Camera], points: &[DVec3], slack: f64) -> Vec<usize> {
    points.par_iter().map(|&x| cameras.iter().filter(|camera| is_seen(scene, camera, x, slack)).count()).collect()
}
