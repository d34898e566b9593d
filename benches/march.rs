//! Placing samples along rays through empty space, from the courtyard to a city, and what the occupancy grid for it
//! costs: with its pyramid (what the program does), with every candidate looked up, and with a bounding volume
//! hierarchy of the occupied cells (obvhs).

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, Intrinsics, TrainedField};
use octobayes::geometry::Ray;
use octobayes::monitor::Silent;
use octobayes::render::{Marcher, Occupancy};

const RAYS: usize = 4_096;

/// Pixels of a scene's own cameras in no particular order.
fn rays(scene: &ClosedForm) -> Vec<Ray> {
    let cameras = scene.cameras(&Intrinsics::default()).unwrap().unwrap();
    let pixel = |i: usize, size: u32| f64::from((i as u32).wrapping_mul(2_654_435_761) % size) + 0.5;
    let camera = |i: usize| &cameras[i * 7919 % cameras.len()];
    (0..RAYS).map(|i| camera(i).ray(pixel(i, camera(i).resolution[0]), pixel(i / 3, camera(i).resolution[1]))).collect()
}

/// The occupied cells as boxes in a hierarchy.
struct Boxes {
    bvh: Bvh2,
    boxes: Vec<Aabb>,
}

impl Boxes {
    fn of(marcher: &Marcher) -> Self {
        let occupancy = marcher.occupancy.as_ref().unwrap();
        let least = (marcher.cutoff / marcher.bounds.size().length()) as f32;
        let half = (marcher.bounds.size() / (2.0 * occupancy.resolution() as f64)).as_vec3().to_array();
        let cell = |center: glam::DVec3| {
            let center = center.as_vec3().to_array();
            let corner = |sign: f32| std::array::from_fn(|axis| center[axis] + sign * half[axis]);
            let [min, max]: [[f32; 3]; 2] = [corner(-1.0), corner(1.0)];
            Aabb::new(min.into(), max.into())
        };
        let boxes: Vec<Aabb> = occupancy.cells_above(least).map(cell).collect();
        let mut time = std::time::Duration::ZERO;
        Self { bvh: build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut time), boxes }
    }

    /// The candidates in occupied cells: intervals in the order of the hierarchy, then sorted.
    fn distances(&self, marcher: &Marcher, ray: &Ray, jitter: f64, intervals: &mut Vec<[f32; 2]>, t: &mut Vec<f64>) {
        let (entry, exit) = marcher.bounds.clip(ray).unwrap_or_default();
        intervals.clear();
        let (origin, direction) = (ray.origin.as_vec3().to_array(), ray.direction.as_vec3().to_array());
        let narrow = obvhs::ray::Ray::new(origin.into(), direction.into(), entry as f32, exit as f32);
        self.bvh.ray_traverse_anyhit(narrow, |ray, slot| {
            let cell = self.boxes[self.bvh.primitive_indices[slot] as usize];
            let (a, b) = ((cell.min - ray.origin) * ray.inv_direction, (cell.max - ray.origin) * ray.inv_direction);
            let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
            if near < far {
                intervals.push([near, far]);
            }
        });
        intervals.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let mut k = 0;
        for &[near, far] in &*intervals {
            let first = ((f64::from(near) - entry) / marcher.step - jitter).ceil().max(0.0) as u64;
            k = k.max(first);
            loop {
                let at = entry + (k as f64 + jitter) * marcher.step;
                if at >= f64::from(far) || at >= exit {
                    break;
                }
                t.push(at);
                k += 1;
            }
        }
    }
}

/// The candidates in occupied cells, each looked up.
fn one_by_one(marcher: &Marcher, ray: &Ray, jitter: f64, t: &mut Vec<f64>) {
    let (entry, exit) = marcher.bounds.clip(ray).unwrap_or_default();
    let least = marcher.cutoff / marcher.bounds.size().length();
    let candidates =
        (0..((exit - entry) / marcher.step).ceil() as u64).map(|k| entry + (k as f64 + jitter) * marcher.step);
    t.extend(candidates.filter(|&at| at < exit && marcher.majorant(ray.at(at)) > least));
}

fn distances(c: &mut Criterion) {
    let mut group = c.benchmark_group("distances");
    group.throughput(Throughput::Elements(RAYS as u64));
    for (name, resolution) in [("courtyard", 128), ("city", 128), ("city", 512)] {
        let scene = ClosedForm::named(name).unwrap();
        let rays = rays(&scene);
        let settings = RaySettings::default().occupancy(resolution);
        let marcher = settings.tracer(&scene, 1e-3, &Silent).unwrap().marcher;
        let (mut t, mut intervals) = (Vec::new(), Vec::new());
        let boxes = Boxes::of(&marcher);
        let counted = |all: &dyn Fn(&Ray, &mut Vec<f64>)| {
            let mut t = Vec::new();
            rays.iter().for_each(|ray| all(ray, &mut t));
            t.len() as f64
        };
        // All three find the same samples, up to roundings at the cells' faces.
        let pyramid = counted(&|ray, t| marcher.distances(ray, 0.5, t));
        let hierarchy = counted(&|ray, t| boxes.distances(&marcher, ray, 0.5, &mut Vec::new(), t));
        let plain = counted(&|ray, t| one_by_one(&marcher, ray, 0.5, t));
        assert!((hierarchy / plain - 1.0).abs() < 1e-3 && pyramid >= plain, "{pyramid} {hierarchy} {plain}");
        println!(
            "{name}, {resolution}: {:.1} samples a ray; {:.1} in occupied cells",
            pyramid / RAYS as f64,
            plain / RAYS as f64
        );
        group.bench_function(format!("{name}, {resolution} cells per axis, every candidate"), |b| {
            b.iter(|| {
                for ray in black_box(&rays) {
                    t.clear();
                    one_by_one(&marcher, ray, 0.5, &mut t);
                }
            });
        });
        group.bench_function(format!("{name}, {resolution} cells per axis, obvhs"), |b| {
            b.iter(|| {
                for ray in black_box(&rays) {
                    t.clear();
                    boxes.distances(&marcher, ray, 0.5, &mut intervals, &mut t);
                }
            });
        });
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
