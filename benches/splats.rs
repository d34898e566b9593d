//! Splats: preparing a view, compositing its pixels, and a whole run, for a surface of 100,000 splats that covers four
//! tenths of images of 400 × 400.
//!
//! Pixels per second and core: `RAYON_NUM_THREADS=1`.

use std::hint::black_box;

use criterion::{Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::glam::{DVec3, Quat, Vec3};
use octobayes::monitor::Silent;
use octobayes::render::Renderer;
use octobayes::splats::{RenderMode, SplatRenderer, Splats, Use};

const SPLATS: usize = 100_000;

/// Flat splats on a wavy ball of radius 1, each as wide as its neighbours are apart, with colours of degree 3.
fn ball() -> Splats {
    let spacing = (4.0 * std::f32::consts::PI / SPLATS as f32).sqrt();
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / SPLATS as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    let wave = |x: Vec3| 1.0 + 0.05 * (9.0 * x.x).sin() * (7.0 * x.y).sin() * (8.0 * x.z).sin();
    let each = || (0..SPLATS).map(normal);
    let number = |i: usize, k: usize| ((i.wrapping_mul(2_654_435_761) >> 7) ^ (k * 40_503)) % 1024;
    let coefficient = |(i, k): (usize, usize)| (number(i, k) as f32 / 512.0 - 1.0) * if k < 3 { 1.0 } else { 0.1 };
    Splats::new(
        each().map(|x| wave(x) * x).collect(),
        vec![Vec3::new(spacing, 0.7 * spacing, 0.2 * spacing).map(f32::ln); SPLATS],
        each().map(|x| Quat::from_rotation_arc(Vec3::Z, x)).collect(),
        (0..SPLATS).map(|i| number(i, 99) as f32 / 256.0 - 2.0).collect(),
        (0..SPLATS).flat_map(|i| (0..48).map(move |k| (i, k))).map(coefficient).collect(),
        3,
        RenderMode::Classic,
    )
    .unwrap()
}

fn cameras(count: u32) -> Vec<Camera> {
    let camera = |i: u32| {
        let (angle, height) = (f64::from(i) * 2.4, 2.0 * (f64::from(i) + 0.5) / f64::from(count) - 1.0);
        let level = (1.0 - height * height).sqrt();
        let eye = 4.0 * DVec3::new(level * angle.cos(), level * angle.sin(), height);
        Camera::look_at(eye, DVec3::ZERO, DVec3::new(0.1, 0.2, 1.0), 0.691, [400, 400])
    };
    (0..count).map(camera).collect()
}

fn splats(c: &mut Criterion) {
    let (ball, cameras) = (ball(), cameras(100));
    let renderer = SplatRenderer::new(&ball, Vec3::ONE);
    let mut group = c.benchmark_group("splats");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    group.bench_function("prepare", |b| b.iter(|| black_box(renderer.prepare(&cameras[3], Use::Colors))));
    group.bench_function("prepare with derivatives", |b| {
        b.iter(|| black_box(renderer.prepare(&cameras[3], Use::Derivatives)));
    });
    group.throughput(Throughput::Elements(cameras[3].pixels()));
    group.bench_function("image", |b| b.iter(|| renderer.image(&cameras[3], 0.5, &[], &[], &Silent).unwrap()));
    let rays = 1_000_000;
    group.throughput(Throughput::Elements(rays));
    group.bench_function("run of a million rays", |b| {
        b.iter(|| {
            let run = Estimation::of_splats(&ball, &cameras).domain(Domain::Box(Aabb::centered_cube(1.1)));
            let grid = GridSettings::default().level(7);
            run.rays(RaySettings::default().rays(rays)).grid(grid).run().unwrap().progress.samples
        });
    });
    group.finish();
}

criterion_group!(benches, splats);
criterion_main!(benches);
