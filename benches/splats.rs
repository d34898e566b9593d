//! Splats: preparing a view, compositing its pixels, and a whole run, for a surface of 100,000 splats that covers four
//! tenths of images of 400 × 400.
//!
//! Pixels per second and core: `RAYON_NUM_THREADS=1`.

use std::hint::black_box;

use criterion::{Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Domain};
use octobayes::glam::Vec3;
use octobayes::monitor::Silent;
use octobayes::render::{Outputs, Renderer};
use octobayes_splats::SplatRenderer;

const SPLATS: usize = 100_000;

fn splats(c: &mut Criterion) {
    let (ball, cameras) = (common::ball::ball(SPLATS), common::ball::cameras(100));
    let renderer = SplatRenderer::new(&ball, Vec3::ONE);
    let mut group = c.benchmark_group("splats");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    group.bench_function("prepare", |b| b.iter(|| black_box(renderer.prepare(&cameras[3], Outputs::Colors))));
    group.bench_function("prepare with derivatives", |b| {
        b.iter(|| black_box(renderer.prepare(&cameras[3], Outputs::Derivatives)));
    });
    group.throughput(Throughput::Elements(cameras[3].pixels()));
    group.bench_function("image", |b| b.iter(|| renderer.image(&cameras[3], 0.5, &[], &Silent).unwrap()));
    let rays = 1_000_000;
    group.throughput(Throughput::Elements(rays));
    group.bench_function("run of a million rays", |b| {
        b.iter(|| {
            let run = Estimation::new(&ball, &cameras).domain(Domain::Box(Aabb::centered_cube(1.1)));
            let grid = GridSettings::default().level(7);
            run.rays(RaySettings::default().rays(rays)).grid(grid).run().unwrap().progress.samples
        });
    });
    group.finish();
}

criterion_group!(benches, splats);
criterion_main!(benches);
