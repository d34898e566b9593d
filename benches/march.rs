//! Placing samples along rays through empty space, from the courtyard to a city, and what the occupancy grid for it costs.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, Intrinsics, RadianceField};
use octobayes::geometry::Ray;
use octobayes::monitor::Silent;
use octobayes::render::Occupancy;

const RAYS: usize = 4_096;

/// Pixels of a scene's own cameras in no particular order.
fn rays(scene: &ClosedForm) -> Vec<Ray> {
    let cameras = scene.cameras(&Intrinsics::default()).unwrap().unwrap();
    let pixel = |i: usize, size: u32| f64::from((i as u32).wrapping_mul(2_654_435_761) % size) + 0.5;
    let camera = |i: usize| &cameras[i * 7919 % cameras.len()];
    (0..RAYS).map(|i| camera(i).ray(pixel(i, camera(i).resolution[0]), pixel(i / 3, camera(i).resolution[1]))).collect()
}

fn distances(c: &mut Criterion) {
    let mut group = c.benchmark_group("distances");
    group.throughput(Throughput::Elements(RAYS as u64));
    for (name, resolution) in [("courtyard", 128), ("city", 128), ("city", 512)] {
        let scene = ClosedForm::named(name).unwrap();
        let rays = rays(&scene);
        let settings = RaySettings { occupancy: resolution, ..RaySettings::default() };
        let marcher = settings.tracer(&scene, 1e-3, &Silent).unwrap().marcher;
        let mut t = Vec::new();
        group.bench_function(format!("{name}, {resolution} cells per axis"), |b| {
            b.iter(|| {
                for ray in black_box(&rays) {
                    t.clear();
                    marcher.distances(ray, 0.5, &mut t);
                }
            });
        });
    }
    group.finish();
}

fn build(c: &mut Criterion) {
    let scene = ClosedForm::named("city").unwrap();
    let mut group = c.benchmark_group("occupancy of the city");
    group.sample_size(10);
    for resolution in [128, 256, 512] {
        group.bench_function(format!("{resolution} cells per axis"), |b| {
            b.iter(|| Occupancy::build(black_box(&scene), resolution, 1e-3, &Silent).unwrap());
        });
    }
    group.finish();
}

criterion_group!(benches, distances, build);
criterion_main!(benches);
