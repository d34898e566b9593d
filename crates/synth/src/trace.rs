//! Intersection of rays with the scene: a mesh in a bounding volume hierarchy, and the ground disc.
//!
//! The hierarchy (obvhs) works in f32 and only proposes triangles; hits are computed in f64. Too many proposals are
//! slow, too few are wrong, so boxes exceed their content by [`MARGIN`].

use glam::DVec3;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb as Aabb32;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ray::{Ray as Ray32, RayHit};

use super::mesh::{HALF_HEIGHT, Mesh};
use super::triangle::{Crossing, ShearedRay};
use octobayes::geometry::{Aabb, Ray};

/// Radius of the ground disc around the z axis.
pub const GROUND_RADIUS: f64 = 0.95;

/// Margin of boxes around their content, in scene units.
///
/// In f32 the error of a slab test (b − o)/d acts like a shift of the slab b. It comes from the rounding of o, of
/// the subtraction, and of d, 1/d and the product, relative 2⁻²⁴ each. With |o| ≤ 8 and |b − o| ≤ 9 that is below
/// 2.7e-6. obvhs takes 2²³ for larger 1/d. A ray inside the slab then stays inside for 1e-5 · 2²³ = 84 units,
/// longer than any ray here. Less than 4e-6 would miss edges; 1e-4 begins to cost time on fine meshes.
const MARGIN: f64 = 1e-5;
/// Maximal distance of a ray's origin from the scene's origin, as assumed by [`MARGIN`].
const REACH: f64 = 8.0;

/// The first point that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the ray, in scene units.
    pub t: f64,
    /// Surface that is hit.
    pub surface: Surface,
}

/// A place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// The ground disc.
    Ground,
    /// A triangle of the mesh.
    Face {
        /// Index of the face.
        face: u32,
        /// Weights of its corners.
        barycentric: [f64; 3],
    },
}

impl Hit {
    fn on_face(face: u32, Crossing { t, barycentric }: Crossing) -> Self {
        Self { t, surface: Surface::Face { face, barycentric } }
    }

    /// Sort key of hits: by distance, then (at shared edges) by index, with the ground first.
    fn key(&self) -> (f64, Option<u32>) {
        let face = match self.surface {
            Surface::Ground => None,
            Surface::Face { face, .. } => Some(face),
        };
        (self.t, face)
    }

    fn nearest(a: Option<Self>, b: Option<Self>) -> Option<Self> {
        [a, b].into_iter().flatten().reduce(|a, b| if b.key() < a.key() { b } else { a })
    }
}

/// A mesh and the ground disc z = −[`HALF_HEIGHT`] under it.
pub struct MeshScene {
    mesh: Mesh,
    bvh: Bvh2,
}

impl MeshScene {
    /// Builds the hierarchy, deterministically.
    ///
    /// # Panics
    /// If the mesh extends beyond the scene box: it must have been [`Mesh::placed`].
    #[must_use]
    pub fn new(mesh: Mesh) -> Self {
        let bounds = Self::bounds();
        let boxes: Vec<Aabb32> = (0..mesh.faces().len() as u32)
            .map(|face| {
                let [a, b, c] = mesh.corners(face);
                let (low, high) = (a.min(b).min(c), a.max(b).max(c));
                assert!(
                    bounds.contains(low.as_vec3()) && bounds.contains(high.as_vec3()),
                    "{low} to {high} is outside"
                );
                Aabb32::new((low - MARGIN).as_vec3().into(), (high + MARGIN).as_vec3().into())
            })
            .collect();
        let bvh = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut std::time::Duration::default());
        Self { mesh, bvh }
    }

    /// The box around everything, [−1, 1]³.
    #[must_use]
    pub fn bounds() -> Aabb {
        Aabb::centered_cube(1.0)
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Returns the first hit of the ray.
    ///
    /// # Panics
    /// If the ray starts more than 8 units from the scene's origin.
    #[must_use]
    pub fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best = ground(ray);
        let sheared = ShearedRay::new(ray);
        // Rounded up, because a face at the same distance as the best so far must still be proposed.
        let limit = |hit: &Hit| (hit.t as f32).next_up();
        let start = narrow(ray, best.as_ref().map_or(f32::INFINITY, limit));
        self.bvh.ray_traverse(start, &mut RayHit::none(), |_, slot| {
            let face = self.bvh.primitive_indices[slot];
            let found = sheared.cross(&self.mesh.corners(face)).map(|crossing| Hit::on_face(face, crossing));
            best = Hit::nearest(best, found);
            best.as_ref().map_or(f32::INFINITY, limit)
        });
        best
    }

    /// Returns true if the ray meets anything.
    ///
    /// # Panics
    /// As for [`MeshScene::nearest`].
    #[must_use]
    pub fn is_blocked(&self, ray: &Ray) -> bool {
        let sheared = ShearedRay::new(ray);
        ground(ray).is_some()
            || !self.bvh.ray_traverse_miss(narrow(ray, f32::INFINITY), |_, slot| {
                let corners = self.mesh.corners(self.bvh.primitive_indices[slot]);
                sheared.cross(&corners).map_or(f32::INFINITY, |crossing| crossing.t as f32)
            })
    }

    /// Like [`MeshScene::nearest`], but tests every face: the slow reference.
    #[must_use]
    pub fn nearest_of_all(&self, ray: &Ray) -> Option<Hit> {
        let sheared = ShearedRay::new(ray);
        (0..self.mesh.faces().len() as u32)
            .map(|face| sheared.cross(&self.mesh.corners(face)).map(|crossing| Hit::on_face(face, crossing)))
            .fold(ground(ray), Hit::nearest)
    }
}

/// The ray in f32, for the hierarchy.
fn narrow(ray: &Ray, limit: f32) -> Ray32 {
    assert!(ray.origin.length() <= REACH, "rays start within {REACH} of the scene's origin, not at {}", ray.origin);
    Ray32::new(ray.origin.as_vec3a(), ray.direction.as_vec3a(), 0.0, limit)
}

/// Hit of the ray on the ground disc.
fn ground(ray: &Ray) -> Option<Hit> {
    let t = (-HALF_HEIGHT - ray.origin.z) / ray.direction.z;
    let at: DVec3 = ray.at(t);
    // For a ray along the ground, t is infinite or NaN, and no point lies on the disc.
    (t >= 0.0 && at.truncate().length() <= GROUND_RADIUS).then_some(Hit { t, surface: Surface::Ground })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{icosphere, soup};
    use proptest::prelude::*;

    fn vector(reach: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-reach..reach).prop_map(DVec3::from)
    }

    proptest! {
        /// The hierarchy finds the same hit as the scan, to the last bit: the same face with the same weights. Rays
        /// aim anywhere, at a vertex, at the middle of an edge, or along an axis through a vertex. The meshes are
        /// a closed one, and a soup with slivers and with triangles without area.
        #[test]
        fn the_hierarchy_finds_what_the_scan_finds(
            origin in vector(4.0),
            target in vector(1.0),
            seed in 0_u64..20,
            face in 0_u32..80,
            aim in 0..4,
        ) {
            for mesh in [soup(80, seed), icosphere(0.7, 1)] {
                let scene = MeshScene::new(mesh);
                let corners = scene.mesh().corners(face);
                let (origin, target) = match aim {
                    0 => (origin, target),
                    1 => (origin, corners[0]),
                    2 => (origin, corners[0].midpoint(corners[1])),
                    _ => (corners[0] + 3.0 * DVec3::X, corners[0]),
                };
                prop_assume!((target - origin).length() > 1e-6);
                let ray = Ray::new(origin, target - origin);
                let expected = scene.nearest_of_all(&ray);
                prop_assert_eq!(scene.nearest(&ray), expected);
                prop_assert_eq!(scene.is_blocked(&ray), expected.is_some());
            }
        }
    }

    #[test]
    fn a_closed_mesh_has_no_gap_at_its_vertices_and_edges() {
        let scene = MeshScene::new(icosphere(0.7, 2));
        let inside = DVec3::new(0.011, -0.007, 0.013);
        for face in 0..scene.mesh().faces().len() as u32 {
            let [a, b, _] = scene.mesh().corners(face);
            for target in [a, a.midpoint(b), a.lerp(b, 1e-16), a.lerp(b, 1.0 / 3.0)] {
                assert!(scene.nearest(&Ray::new(inside, target - inside)).is_some(), "gap at {target}");
                assert!(scene.is_blocked(&Ray::new(inside, target - inside)), "gap at {target}");
            }
        }
    }

    #[test]
    fn one_triangle_is_a_scene_and_the_ground_ends() {
        let corner = DVec3::new(0.0, 0.0, 0.5);
        let scene = MeshScene::new(
            Mesh::new(vec![corner, corner + 0.1 * DVec3::X, corner + 0.1 * DVec3::Y], vec![[0, 1, 2]]).unwrap(),
        );
        let down = |x, y| scene.nearest(&Ray::new(DVec3::new(x, y, 3.0), -DVec3::Z));
        assert_eq!(down(0.02, 0.02).map(|h| h.t), Some(2.5));
        assert_eq!(down(0.94, 0.0), Some(Hit { t: 3.75, surface: Surface::Ground }));
        assert_eq!(down(0.96, 0.0), None);
        let along = Ray::new(DVec3::new(-2.0, 0.0, -HALF_HEIGHT), DVec3::X);
        assert_eq!(scene.nearest(&along), None, "the disc has no thickness");
    }
}
