//! A surface of splats that covers four tenths of images of 400 × 400, for measurements of time.

use octobayes::geometry::Camera;
use octobayes::glam::{DVec3, Quat, Vec3};
use octobayes_splats::{RenderMode, Splats};

/// Flat splats on a wavy ball of radius 1, each as wide as its neighbours are apart, with colours of degree 3.
pub fn ball(count: usize) -> Splats {
    let spacing = (4.0 * std::f32::consts::PI / count as f32).sqrt();
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    let wave = |x: Vec3| 1.0 + 0.05 * (9.0 * x.x).sin() * (7.0 * x.y).sin() * (8.0 * x.z).sin();
    let each = || (0..count).map(normal);
    let number = |i: usize, k: usize| ((i.wrapping_mul(2_654_435_761) >> 7) ^ (k * 40_503)) % 1024;
    let coefficient = |(i, k): (usize, usize)| (number(i, k) as f32 / 512.0 - 1.0) * if k < 3 { 1.0 } else { 0.1 };
    Splats::new(
        each().map(|x| wave(x) * x).collect(),
        vec![Vec3::new(spacing, 0.7 * spacing, 0.2 * spacing).map(f32::ln); count],
        each().map(|x| Quat::from_rotation_arc(Vec3::Z, x)).collect(),
        (0..count).map(|i| number(i, 99) as f32 / 256.0 - 2.0).collect(),
        (0..count).flat_map(|i| (0..48).map(move |k| (i, k))).map(coefficient).collect(),
        3,
        RenderMode::Classic,
    )
    .unwrap()
}

/// Cameras around it, of 400 × 400 pixels.
#[must_use]
pub fn cameras(count: u32) -> Vec<Camera> {
    let camera = |i: u32| {
        let (angle, height) = (f64::from(i) * 2.4, 2.0 * (f64::from(i) + 0.5) / f64::from(count) - 1.0);
        let level = (1.0 - height * height).sqrt();
        let eye = 4.0 * DVec3::new(level * angle.cos(), level * angle.sin(), height);
        Camera::look_at(eye, DVec3::ZERO, DVec3::new(0.1, 0.2, 1.0), 0.691, [400, 400])
    };
    (0..count).map(camera).collect()
}
