//! The surface in a lattice of values, by naive surface nets (Gibson, MICCAI 1998): a vertex in every cube that the
//! surface crosses, in the middle of the crossings on the cube's edges, and a quadrilateral around every edge that
//! it crosses.

use std::array;

use glam::{Vec3, Vec3Swizzles};

/// A closed mesh, in coordinates of the lattice.
#[derive(Debug, Default)]
pub struct SurfaceNet {
    /// One vertex per cube, in the order of the cubes.
    pub positions: Vec<Vec3>,
    /// The gradient of the values at every vertex, which points outwards.
    pub gradients: Vec<Vec3>,
    /// Vertices of every triangle, counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Edges of a cube by the numbers of their corners, whose bits are x, y and z.
const EDGES: [[usize; 2]; 12] =
    [[0, 1], [0, 2], [0, 4], [1, 3], [1, 5], [2, 3], [2, 6], [3, 7], [4, 5], [4, 6], [5, 7], [6, 7]];

impl SurfaceNet {
    /// The surface between negative values, which are inside, and others. In `values` x runs fastest, and those at the
    /// faces of the lattice are outside.
    pub fn new(values: &[f32], points: [usize; 3]) -> Self {
        let steps = [1, points[0], points[0] * points[1]];
        let [nx, ny, nz] = points.map(|n| n - 1);
        let mut net = Self::default();
        // Every cube by its lowest point; and the number of its vertex, if it has one.
        let mut crossed = Vec::new();
        let mut vertices = vec![u32::MAX; values.len()];
        for [x, y, z] in (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z]))) {
            let at = x + y * steps[1] + z * steps[2];
            let corners = array::from_fn(|c| values[at + (c & 1) + (c >> 1 & 1) * steps[1] + (c >> 2) * steps[2]]);
            if let Some(middle) = middle_of_crossings(&corners) {
                vertices[at] = net.positions.len() as u32;
                crossed.push(at);
                net.positions.push(Vec3::new(x as f32, y as f32, z as f32) + middle);
                net.gradients.push(gradient(&corners, middle));
            }
        }
        for at in crossed {
            for axis in 0..3 {
                let is_inside = [at, at + steps[axis]].map(|point| values[point] < 0.0);
                if is_inside[0] != is_inside[1] {
                    let [b, c] = [steps[(axis + 1) % 3], steps[(axis + 2) % 3]];
                    net.quadrilateral([at, at - b, at - c, at - b - c].map(|cube| vertices[cube]), is_inside[0]);
                }
            }
        }
        net
    }

    /// Two triangles between the vertices of the four cubes around an edge, divided along the shorter diagonal.
    fn quadrilateral(&mut self, [own, b, c, bc]: [u32; 4], ends_outside: bool) {
        let squared = |from: u32, to: u32| self.positions[from as usize].distance_squared(self.positions[to as usize]);
        let triangles =
            if squared(own, bc) < squared(b, c) { [[own, b, bc], [own, bc, c]] } else { [[b, bc, c], [b, c, own]] };
        let turned = |[first, second, third]: [u32; 3]| [first, third, second];
        self.triangles.extend(if ends_outside { triangles } else { triangles.map(turned) });
    }
}

/// The mean of the points where the surface crosses a cube's edges, relative to its corner 0; `None` if there are none.
fn middle_of_crossings(corners: &[f32; 8]) -> Option<Vec3> {
    let corner = |c: usize| Vec3::new((c & 1) as f32, (c >> 1 & 1) as f32, (c >> 2) as f32);
    let (mut sum, mut count) = (Vec3::ZERO, 0.0);
    for [from, to] in EDGES {
        if (corners[from] < 0.0) != (corners[to] < 0.0) {
            let share = corners[from] / (corners[from] - corners[to]);
            sum += (1.0 - share) * corner(from) + share * corner(to);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum / count)
}

/// The gradient at a point of a cube: along each axis, the differences along the four edges, interpolated bilinearly.
fn gradient(corners: &[f32; 8], at: Vec3) -> Vec3 {
    // On the edges along x, y and z from one corner each.
    let differences = |start: [usize; 3]| {
        Vec3::from_array(array::from_fn(|axis| corners[start[axis] | 1 << axis] - corners[start[axis]]))
    };
    let rest = Vec3::ONE - at;
    rest.yzx() * rest.zxy() * differences([0, 0, 0])
        + rest.yzx() * at.zxy() * differences([4, 1, 2])
        + at.yzx() * rest.zxy() * differences([2, 4, 1])
        + at.yzx() * at.zxy() * differences([6, 5, 3])
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn a_sphere_is_closed_and_its_normals_point_outwards() {
        let (middle, radius, points) = (Vec3::new(9.3, 8.1, 7.7), 6.4, [19, 18, 16]);
        let at = |i: usize| Vec3::new((i % 19) as f32, (i / 19 % 18) as f32, (i / (19 * 18)) as f32);
        let values: Vec<f32> = (0..19 * 18 * 16).map(|i| at(i).distance(middle) - radius).collect();
        let net = SurfaceNet::new(&values, points);
        for (position, gradient) in net.positions.iter().zip(&net.gradients) {
            let outwards = *position - middle;
            assert!((outwards.length() - radius).abs() < 0.1, "{position}");
            assert!(gradient.normalize().dot(outwards.normalize()) > 0.99, "{position}");
        }
        for triangle in &net.triangles {
            let [a, b, c] = triangle.map(|v| net.positions[v as usize]);
            assert!((b - a).cross(c - a).dot(a - middle) > 0.0, "{triangle:?}");
        }
        let edges = edges_of_closed(&net);
        assert_eq!(net.positions.len() + net.triangles.len(), edges + 2, "Euler's formula");
        assert!(net.positions.len() > 500);
    }

    #[test]
    fn matter_is_closed_up_to_the_last_points_but_one() {
        let is_inside =
            |i: usize| [i % 7, i / 7 % 6, i / 42].into_iter().zip([7, 6, 5]).all(|(x, n)| (1..n - 1).contains(&x));
        let values: Vec<f32> = (0..7 * 6 * 5).map(|i| if is_inside(i) { -0.5 } else { 0.5 }).collect();
        let net = SurfaceNet::new(&values, [7, 6, 5]);
        // The squares around a block of 5 × 4 × 3 points.
        assert_eq!(net.triangles.len(), 2 * 2 * (5 * 4 + 4 * 3 + 3 * 5));
        edges_of_closed(&net);
    }

    /// The number of edges. Each has two triangles, which pass it in opposite directions.
    fn edges_of_closed(net: &SurfaceNet) -> usize {
        let mut edges = HashSet::new();
        for triangle in &net.triangles {
            assert!((0..3).all(|k| edges.insert([triangle[k], triangle[(k + 1) % 3]])), "{triangle:?}");
        }
        assert!(edges.iter().all(|&[a, b]| edges.contains(&[b, a])));
        edges.len() / 2
    }
}
