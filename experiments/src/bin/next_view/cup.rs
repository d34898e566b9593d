//! A mesh with a deep cavity, which only cameras high above it look into.

use std::f64::consts::TAU;

use glam::DVec3;
use octobayes_synth::Mesh;

/// Points around the axis.
const AROUND: usize = 64;
/// Radius and height of the profile, from the outer bottom over the rim to the inner bottom.
const PROFILE: [[f64; 2]; 10] = [
    [0.0, 0.0],
    [0.36, 0.0],
    [0.4, 0.05],
    [0.5, 0.7],
    [0.52, 1.3],
    [0.47, 1.3],
    [0.45, 0.7],
    [0.35, 0.08],
    [0.3, 0.06],
    [0.0, 0.06],
];
/// Rings between two points of the profile.
const RINGS: usize = 12;

/// The cup.
pub fn cup() -> Mesh {
    let mut profile: Vec<[f64; 2]> = Vec::new();
    for pair in PROFILE.windows(2) {
        let between =
            |k: usize| [0, 1].map(|axis| pair[0][axis] + (pair[1][axis] - pair[0][axis]) * k as f64 / RINGS as f64);
        profile.extend((0..RINGS).map(between));
    }
    profile.push(PROFILE[PROFILE.len() - 1]);
    let point = |[radius, height]: [f64; 2], k: usize| {
        let angle = TAU * k as f64 / AROUND as f64;
        DVec3::new(radius * angle.cos(), radius * angle.sin(), height)
    };
    let vertices = profile.iter().flat_map(|&ring| (0..AROUND).map(move |k| point(ring, k))).collect();
    let vertex = |ring: usize, k: usize| (ring * AROUND + k % AROUND) as u32;
    let quad = |ring: usize, k: usize| {
        let [a, b, c, d] = [vertex(ring, k), vertex(ring, k + 1), vertex(ring + 1, k + 1), vertex(ring + 1, k)];
        [[a, b, c], [a, c, d]]
    };
    let faces = (0..profile.len() - 1).flat_map(|ring| (0..AROUND).flat_map(move |k| quad(ring, k))).collect();
    Mesh::new(vertices, faces).expect("triangles of finite corners")
}
