//! One training step, and what it is made of: its cost per sample.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::Vec3;
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, Differentiable, Radiance, RadianceField, RadianceJet};
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes::render::render_view;
use octobayes_data::PosedImage;
use octobayes_models::HashGridConfig;
use octobayes_train::{Shot, TrainSettings, Trainer};

fn shots(scene: &ClosedForm) -> Vec<Shot> {
    let tracer = RaySettings::default().occupancy(32).cutoff(1e-4);
    let tracer = tracer.tracer(scene, 0.0, &Silent).unwrap();
    let shot = |camera| {
        let view = render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap();
        let byte = |v: f64| (255.0 * v).round() as u8;
        let pixel = |p: &octobayes::render::Pixel| {
            let [r, g, b] = p.color.to_array().map(byte);
            [r, g, b, 255]
        };
        let image = PosedImage::new(camera.resolution, view.pixels.iter().map(pixel).collect());
        Shot { name: String::new(), camera, image, mask: None }
    };
    ClosedForm::half_circle(8, [64; 2]).into_iter().map(shot).collect()
}

/// A step once the scene is known, per sample of the budget, for several sizes of table.
fn step(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let shots = shots(&scene);
    let mut group = c.benchmark_group("train");
    group.sample_size(20);
    for log2_hashmap_size in [14, 16, 18] {
        let config = HashGridConfig::default().log2_hashmap_size(log2_hashmap_size);
        let settings = TrainSettings::default().config(config);
        let mut trainer = Trainer::new(settings, Domain::Box(scene.bounds()), &shots).unwrap();
        for _ in 0..200 {
            trainer.step(0.5);
        }
        group.throughput(Throughput::Elements(settings.samples_per_step));
        group.bench_function(BenchmarkId::new("step", log2_hashmap_size), |b| b.iter(|| trainer.step(0.5)));

        let field = trainer.field(serde_json::Value::Null);
        let positions: Vec<Vec3> =
            (0..4096).map(|i| 0.4 * Vec3::new((i as f32).sin(), (i as f32).cos(), 0.1)).collect();
        let directions = vec![Vec3::X; 4096];
        let mut values = vec![Radiance::default(); 4096];
        let mut jets = vec![RadianceJet::default(); 4096];
        group.throughput(Throughput::Elements(4096));
        group.bench_function(BenchmarkId::new("evaluate", log2_hashmap_size), |b| {
            b.iter(|| field.evaluate(black_box(&positions), &directions, &mut values));
        });
        group.bench_function(BenchmarkId::new("evaluate with gradients", log2_hashmap_size), |b| {
            b.iter(|| field.jets(black_box(&positions), &directions, &mut jets));
        });
    }
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);
