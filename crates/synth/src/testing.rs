//! Meshes for tests.

use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rustc_hash::FxHashMap;

use super::Mesh;

/// An icosahedron around the origin, with each face cut into four `rounds` times.
///
/// Vertices lie on the sphere of this radius, normals point outwards.
pub fn icosphere(radius: f64, rounds: u32) -> Mesh {
    let g = 0.5 * (1.0 + 5.0_f64.sqrt());
    let mut vertices: Vec<DVec3> = Vec::new();
    for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
        vertices.extend([DVec3::new(a, b, 0.0), DVec3::new(0.0, a, b), DVec3::new(b, 0.0, a)]);
    }
    // The faces are the triples of vertices at mutual distance 2, the shortest.
    let near = |a: DVec3, b: DVec3| ((a - b).length() - 2.0).abs() < 1e-9;
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for (i, &a) in vertices.iter().enumerate() {
        for (j, &b) in vertices.iter().enumerate().skip(i + 1) {
            for (k, &c) in vertices.iter().enumerate().skip(j + 1) {
                if near(a, b) && near(b, c) && near(c, a) {
                    let outwards = (b - a).cross(c - a).dot(a) > 0.0;
                    faces.push((if outwards { [i, j, k] } else { [i, k, j] }).map(|v| v as u32));
                }
            }
        }
    }
    for _ in 0..rounds {
        let mut middles: FxHashMap<[u32; 2], u32> = FxHashMap::default();
        let mut cut = Vec::new();
        for [a, b, c] in faces {
            let [d, e, f] = [[a, b], [b, c], [c, a]].map(|[i, j]| {
                *middles.entry([i.min(j), i.max(j)]).or_insert_with(|| {
                    vertices.push(vertices[i as usize].midpoint(vertices[j as usize]));
                    vertices.len() as u32 - 1
                })
            });
            cut.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        faces = cut;
    }
    let vertices = vertices.iter().map(|v| radius * v.normalize()).collect();
    Mesh::new(vertices, faces).expect("an icosphere is a mesh")
}

/// Random triangles inside the box, with shared vertices. Every eighth has no area, and every eighth is a sliver.
pub fn soup(faces: u32, seed: u64) -> Mesh {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut vertices: Vec<DVec3> =
        (0..faces).map(|_| DVec3::from(std::array::from_fn(|_| rng.random_range(-0.9..0.9)))).collect();
    let faces = (0..faces)
        .map(|i| {
            let [a, b, c] = std::array::from_fn(|_| rng.random_range(0..faces));
            match i % 8 {
                0 => [a, b, b],
                4 => {
                    vertices.push(vertices[a as usize].lerp(vertices[b as usize], 0.3) + 1e-12);
                    [a, b, vertices.len() as u32 - 1]
                }
                _ => [a, b, c],
            }
        })
        .collect();
    Mesh::new(vertices, faces).expect("a soup is a mesh")
}
