//! Points per second of a trained grid field, alone and on all cores, on points near surfaces: what rendering asks for.
//!
//! `OCTOBAYES_DATA=… cargo measure field`; without the data there is nothing to measure.

use std::hint::black_box;
use std::path::PathBuf;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::Vec3;
use octobayes::field::{Differentiable, Radiance, RadianceField, RadianceJet};
use octobayes_models::{Coordinates, Ppng};
use rayon::prelude::*;

/// Points of a batch, as the tracer's groups of rays make them.
const POINTS: usize = 4096;
/// Batches of the parallel measurement.
const BATCHES: usize = 64;

/// Neighbouring samples along rays through the middle of the box, where there is density.
fn points(model: &Ppng) -> Vec<Vec3> {
    let bounds = model.bounds();
    let golden = [0.819_172_5_f32, 0.671_043_6, 0.549_700_5];
    let mut found = Vec::new();
    for ray in 0.. {
        let start = Vec3::from_array(golden.map(|g| (ray as f32 * g).fract()));
        for sample in 0..64 {
            let x = 0.5 + 0.3 * (start - 0.5) + Vec3::new(0.002 * sample as f32, 0.0, 0.0);
            if model.density_bound(x, x) != Some(0.0) && bounds.contains(x) {
                found.push(x);
            }
            if found.len() == POINTS {
                return found;
            }
        }
    }
    unreachable!("the loop ends when enough points are found")
}

fn field(c: &mut Criterion) {
    let Some(root) = std::env::var_os("OCTOBAYES_DATA") else {
        eprintln!("OCTOBAYES_DATA is not set: nothing to measure");
        return;
    };
    for (name, file) in [("type 1", "NeRFSynthetic/ppng_1/lego.ppng"), ("type 2", "NeRFSynthetic/ppng_2/lego.ppng")] {
        let path = PathBuf::from(&root).join("ppng-pretrained").join(file);
        let model = Ppng::read(&path, Coordinates::Ngp).unwrap();
        let positions = points(&model);
        let directions: Vec<Vec3> = positions.iter().map(|x| (*x + 0.1).normalize()).collect();
        let mut group = c.benchmark_group(format!("ppng {name}"));
        group.throughput(Throughput::Elements(POINTS as u64));
        let mut out = vec![Radiance::default(); POINTS];
        group.bench_function("evaluate", |b| b.iter(|| model.evaluate(black_box(&positions), &directions, &mut out)));
        let mut jets = vec![RadianceJet::default(); POINTS];
        group.bench_function("jets", |b| b.iter(|| model.jets(black_box(&positions), &directions, &mut jets)));
        let mut densities = vec![0.0; POINTS];
        let mut gradients = vec![Vec3::ZERO; POINTS];
        group.bench_function("density jets", |b| {
            b.iter(|| model.density_jets(black_box(&positions), &mut densities, &mut gradients));
        });
        group.bench_function("densities", |b| b.iter(|| model.densities(black_box(&positions), &mut densities)));
        group.throughput(Throughput::Elements((BATCHES * POINTS) as u64));
        let mut outs = vec![vec![Radiance::default(); POINTS]; BATCHES];
        group.bench_function("evaluate, all cores", |b| {
            b.iter(|| outs.par_iter_mut().for_each(|out| model.evaluate(black_box(&positions), &directions, out)));
        });
        group.finish();
    }
}

criterion_group!(benches, field);
criterion_main!(benches);
