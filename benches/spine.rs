//! One bench per job a user would name, on the built-in courtyard at level 7; the dense grid beside the octree where
//! both do the job, so that ratios come from one run.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{DMat3, Vec3};
use octobayes::estimate::{Estimation, FieldBuilder, FieldSource, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField};
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::rays::{RunProgress, Shard};
use octobayes::render::{RaySamples, render_view};
use octobayes::uncertainty::UncertaintyField;

const RAYS: u64 = 8_192;

fn grid(grid: GridKind) -> GridSettings {
    GridSettings::default().grid(grid).level(7)
}

fn rays() -> RaySettings {
    RaySettings::default().rays(RAYS).occupancy(64)
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
    // The degenerate case: one point at a time.
    group.throughput(Throughput::Elements(1));
    group.bench_function("courtyard, one point", |b| {
        b.iter(|| scene.evaluate(black_box(&positions[..1]), &positions[..1], &mut out[..1]));
    });
    group.finish();
}

fn accumulate(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(40, [200, 200]);
    let run = Estimation::new(&scene, &cameras).rays(rays()).grid(grid(GridKind::Octree)).prepare().unwrap();
    let mut batches: Vec<RaySamples> = Vec::new();
    run.stream()
        .run(Shard::whole(RAYS), RunProgress::default(), &Silent, |samples, _| {
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
            run.stream()
                .run(Shard::whole(RAYS), RunProgress::default(), &Silent, |samples, _| {
                    black_box(samples);
                    Ok(())
                })
                .unwrap()
        });
    });
    group.finish();
}

fn render(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let tracer = rays().tracer(&scene, 0.0, &Silent).unwrap();
    let camera = ClosedForm::half_circle(40, [100, 75])[20];
    // The degenerate case: looking away from the scene.
    let away = Camera { axes: camera.axes * DMat3::from_rotation_y(std::f64::consts::PI), ..camera };
    let mut group = c.benchmark_group("render");
    group.sample_size(20).throughput(Throughput::Elements(7_500));
    for (name, camera) in [("courtyard", &camera), ("nothing", &away)] {
        group.bench_function(name, |b| {
            b.iter(|| render_view(&tracer, black_box(camera), 0.5, &[], &Silent).unwrap());
        });
    }
    group.finish();
}

fn build(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(40, [200, 200]);
    let mut group = c.benchmark_group("build");
    group.sample_size(10);
    // The degenerate case: no ray at all.
    for (name, share) in [("an octree of 8,192 rays", Shard::whole(RAYS)), ("an octree of no ray", Shard::whole(0))] {
        let octree = grid(GridKind::Octree);
        let make = || {
            let mut builder = FieldBuilder::new(octree, Domain::Box(scene.bounds())).unwrap();
            let run = Estimation::new(&scene, &cameras).rays(rays()).grid(octree).prepare().unwrap();
            run.stream()
                .run(share, RunProgress::default(), &Silent, |samples, _| {
                    builder.add(samples);
                    Ok(())
                })
                .unwrap();
            builder
        };
        let finish = |builder: FieldBuilder| {
            let progress = RunProgress { rays: RAYS, ..RunProgress::default() };
            builder.finish(&FieldSource { source: name.into(), progress, ..FieldSource::default() }).unwrap()
        };
        group.bench_function(name, |b| b.iter_batched(make, finish, criterion::BatchSize::PerIteration));
    }
    group.finish();
}

fn query_and_file(c: &mut Criterion) {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(40, [200, 200]);
    let folder = tempfile::tempdir().unwrap();
    let positions = points(200_000);
    for kind in [GridKind::Octree, GridKind::Dense] {
        let settings = rays().rays(100_000);
        let field =
            Estimation::new(&scene, &cameras).rays(settings).grid(grid(kind)).run().unwrap().field.without_sums();
        let mut group = c.benchmark_group("query");
        group.throughput(Throughput::Elements(positions.len() as u64));
        group
            .bench_function(format!("{kind:?}, 200,000 points"), |b| b.iter(|| field.query_all(black_box(&positions))));
        // The degenerate case: all in one cell.
        let near: Vec<Vec3> = positions.iter().map(|x| Vec3::splat(0.501) + 1e-3 * *x).collect();
        group.bench_function(format!("{kind:?}, 200,000 points of one cell"), |b| {
            b.iter(|| field.query_all(black_box(&near)));
        });
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

criterion_group!(benches, field_evaluation, render, accumulate, build, query_and_file);
criterion_main!(benches);
