//! One bench per job a user would name, on the built-in courtyard at level 7; the dense grid beside the octree where both do
//! the job, so that ratios come from one run.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::Vec3;
use octobayes::estimate::{FieldBuilder, GridKind, GridSettings, RaySettings, estimate};
use octobayes::field::{ClosedForm, Radiance, RadianceField};
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes::posterior::{Share, Tally};
use octobayes::render::RaySamples;
use octobayes::uncertainty::UncertaintyField;

const RAYS: u64 = 8_192;

fn grid(grid: GridKind) -> GridSettings {
    GridSettings { grid, level: 7, ..GridSettings::default() }
}

fn rays() -> RaySettings {
    RaySettings { rays: RAYS, occupancy: 64, ..RaySettings::default() }
}

/// Points of the box in no particular order.
fn points(n: usize) -> Vec<Vec3> {
    let golden = [0.819_172_5_f32, 0.671_043_6, 0.549_700_5];
    (0..n).map(|i| Vec3::from_array(golden.map(|g| 2.0 * (i as f32 * g).fract() - 1.0))).collect()
}

fn field_evaluation(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let positions = points(4096);
    let mut out = vec![Radiance::default(); positions.len()];
    let mut group = c.benchmark_group("evaluate");
    group.throughput(Throughput::Elements(positions.len() as u64));
    group.bench_function("courtyard", |b| b.iter(|| scene.evaluate(black_box(&positions), &positions, &mut out)));
    group.finish();
}

fn accumulate(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(40, [200, 200]);
    let empty = FieldBuilder::new(grid(GridKind::Octree), Domain::Box(scene.bounds())).unwrap();
    let stream = rays().stream(&scene, &cameras, &grid(GridKind::Octree), empty.lattice(), &Silent).unwrap();
    let mut batches: Vec<RaySamples> = Vec::new();
    stream
        .run(Share::whole(RAYS), Tally::default(), &Silent, |samples, _| {
            batches.extend_from_slice(samples);
            Ok(())
        })
        .unwrap();
    let mut group = c.benchmark_group("accumulate");
    group.sample_size(20).throughput(Throughput::Elements(RAYS));
    for kind in [GridKind::Octree, GridKind::Dense] {
        group.bench_function(format!("{kind:?}"), |b| {
            b.iter_batched_ref(
                || FieldBuilder::new(grid(kind), Domain::Box(scene.bounds())).unwrap(),
                |builder| builder.add(black_box(&batches)),
                criterion::BatchSize::PerIteration,
            );
        });
    }
    group.bench_function("rays, samples and Jacobians alone", |b| {
        b.iter(|| {
            stream
                .run(Share::whole(RAYS), Tally::default(), &Silent, |samples, _| {
                    black_box(samples);
                    Ok(())
                })
                .unwrap()
        });
    });
    group.finish();
}

fn query_and_file(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(40, [200, 200]);
    let folder = tempfile::tempdir().unwrap();
    let positions = points(200_000);
    for kind in [GridKind::Octree, GridKind::Dense] {
        let settings = RaySettings { rays: 100_000, ..rays() };
        let field = estimate(&scene, &cameras, &settings, &grid(kind), &Silent).unwrap().0.without_evidence();
        let mut group = c.benchmark_group("query");
        group.throughput(Throughput::Elements(positions.len() as u64));
        group
            .bench_function(format!("{kind:?}, 200,000 points"), |b| b.iter(|| field.query_all(black_box(&positions))));
        group.throughput(Throughput::Elements(1));
        group.bench_function(format!("{kind:?}, one point"), |b| b.iter(|| field.query(black_box(positions[77]))));
        group.finish();
        let path = folder.path().join("field.oct");
        let mut group = c.benchmark_group("file");
        group.sample_size(10);
        group.bench_function(format!("{kind:?}, write"), |b| b.iter(|| field.write(&path).unwrap()));
        group.bench_function(format!("{kind:?}, read"), |b| b.iter(|| UncertaintyField::read(&path).unwrap()));
        group.finish();
    }
}

criterion_group!(benches, field_evaluation, accumulate, query_and_file);
criterion_main!(benches);
