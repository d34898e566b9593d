//! The object that counts, given as a mesh: what is near to its surface.

use glam::{DVec3, Vec3};
use octobayes::geometry::Lattice;
use rustc_hash::FxHashSet;

/// The finest level of cells around a mesh: at most so many are on its surface as can be listed quickly.
const LEVEL: u8 = 7;

/// The cells of a lattice that triangles cross, and those around them.
#[derive(Debug, Clone)]
pub struct NearMesh {
    lattice: Lattice,
    cells: FxHashSet<[u32; 3]>,
}

impl NearMesh {
    /// What is near to triangles, whose corners are scene points, in cells of `lattice` or coarser ones; `None` if none
    /// of it lies in the lattice's domain.
    #[must_use]
    pub fn new(triangles: impl Iterator<Item = [DVec3; 3]>, lattice: &Lattice) -> Option<Self> {
        let lattice = lattice.coarsened(lattice.level().min(LEVEL));
        let mut cells = FxHashSet::default();
        for corners in triangles {
            let known = corners.map(|x| lattice.coordinates(x.as_vec3()));
            let [Some(a), Some(b), Some(c)] = known else { continue };
            let longest = [a - b, b - c, c - a].map(|edge| edge.abs().max_element()).into_iter().fold(0.0, f64::max);
            // Points half a cell apart; in contracted space sides are bent by less than the cells around.
            let steps = (2.0 * longest).ceil().max(1.0) as u32;
            let [p, q, r] = corners;
            for i in 0..=steps {
                for j in 0..=steps - i {
                    let [s, t] = [i, j].map(|n| f64::from(n) / f64::from(steps));
                    let x = p + s * (q - p) + t * (r - p);
                    cells.extend(lattice.coordinates(x.as_vec3()).map(|u| lattice.cell(u).0));
                }
            }
        }
        (!cells.is_empty()).then_some(Self { lattice, cells })
    }

    /// Whether a scene point is in one of these cells, or in one beside them.
    #[must_use]
    pub fn contains(&self, x: DVec3) -> bool {
        let Some(u) = self.lattice.coordinates(Vec3::new(x.x as f32, x.y as f32, x.z as f32)) else { return false };
        let cell = self.lattice.cell(u).0;
        let around = (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [i, j, k])));
        around
            .filter_map(|step: [i32; 3]| {
                let mut other = cell;
                for (n, step) in other.iter_mut().zip(step) {
                    *n = n.checked_add_signed(step)?;
                }
                Some(other)
            })
            .any(|cell| self.cells.contains(&cell))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use octobayes::geometry::Aabb;

    #[test]
    fn a_triangle_has_what_is_within_a_cell_of_it() {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 5).unwrap();
        let edge = 2.0 / 32.0;
        let corners = [DVec3::new(-0.5, -0.5, 0.1), DVec3::new(0.5, -0.5, 0.1), DVec3::new(-0.5, 0.5, 0.1)];
        let near = NearMesh::new(std::iter::once(corners), &lattice).unwrap();
        for (s, t) in [(0.0, 0.0), (0.5, 0.5), (0.31, 0.17), (0.9, 0.05)] {
            let x = corners[0] + s * (corners[1] - corners[0]) + t * (corners[2] - corners[0]);
            assert!(near.contains(x) && near.contains(x + 0.9 * edge * DVec3::Z), "{x}");
            assert!(!near.contains(x + 2.1 * edge * DVec3::Z) && !near.contains(x - 2.1 * edge * DVec3::Z), "{x}");
        }
        assert!(!near.contains(DVec3::new(0.45, 0.45, 0.1)), "beyond the slanted side");
        assert!(!near.contains(DVec3::splat(3.0)) && NearMesh::new(std::iter::empty(), &lattice).is_none());
    }
}
