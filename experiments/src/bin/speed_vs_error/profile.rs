//! Where the time of a run goes, against what it could be at least.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use glam::Vec3;
use ndarray::Array2;
use octobayes::Result;
use octobayes::estimate::{Estimation, FieldBuilder, GridKind};
use octobayes::field::{Differentiable, Radiance, RadianceField, RadianceJet, TrainedField};
use octobayes::geometry::{Aabb, Domain, Ray};
use octobayes::metrics::median;
use octobayes::monitor::Silent;
use octobayes::rays::{RunProgress, Shard};
use octobayes::render::{CompositingWeights, GradientMethod, TraceBuffers};
use rayon::prelude::*;

use super::measure::{alternating, grid, ratio};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::Table;
use common::work::Work;

/// Kinds of evaluation.
const KINDS: [&str; 4] = ["σ", "σ, c", "σ, ∇σ", "σ, c, ∇σ, ∇c"];

/// A field that counts its evaluations and the time that all threads spend in them.
struct Counted<'a> {
    field: &'a dyn TrainedField,
    points: [AtomicU64; 4],
    nanoseconds: AtomicU64,
}

impl Counted<'_> {
    fn count(&self, kind: usize, points: usize, work: impl FnOnce()) {
        let start = Instant::now();
        work();
        self.nanoseconds.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        self.points[kind].fetch_add(points as u64, Ordering::Relaxed);
    }

    fn own(&self) -> &dyn Differentiable {
        self.field.differentiable().expect("the field differentiates itself")
    }
}

impl RadianceField for Counted<'_> {
    fn bounds(&self) -> Aabb {
        self.field.bounds()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        self.count(1, positions.len(), || self.field.evaluate(positions, directions, out));
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        self.count(0, positions.len(), || self.field.densities(positions, out));
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        self.field.density_bound(min, max)
    }

    fn suggested_step(&self) -> f64 {
        self.field.suggested_step()
    }

    fn memory(&self) -> usize {
        self.field.memory()
    }
}

impl TrainedField for Counted<'_> {
    fn describe(&self) -> String {
        self.field.describe()
    }
}

impl Differentiable for Counted<'_> {
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        self.count(3, positions.len(), || self.own().jets(positions, directions, out));
    }

    fn density_jets(&self, positions: &[Vec3], densities: &mut [f32], gradients: &mut [Vec3]) {
        self.count(2, positions.len(), || self.own().density_jets(positions, densities, gradients));
    }
}

/// Points per ray by kind, then µs of one core per ray: in all, in the field, in accumulation.
type Measured = ([f64; 4], [f64; 3]);

const WAYS: [(&str, Option<GradientMethod>); 4] = [
    ("plain colour rendering", None),
    ("differences", Some(GradientMethod::FiniteDifference)),
    ("forward differences", Some(GradientMethod::ForwardDifference)),
    ("own derivatives", Some(GradientMethod::Analytic)),
];

/// Evaluations per ray, and shares of the time; beside them a plain colour rendering of the same rays.
pub fn profile(work: &Work, lego: &Scene, mlp: &Scene) -> Result<(String, String)> {
    let head = ["in the field", "accumulation", "all", "share of accumulation", "times plain rendering"];
    let mut table = Table::new(&[&[""][..], &KINDS, &head].concat());
    let measured = alternating(&WAYS, &[0, 1, 2, 3, 4], |&(name, gradient), round| {
        work.row(("profile", name, round), || measure(lego, gradient)).map(Some)
    })?;
    let all = |way: &[Measured]| -> Vec<f64> { way.iter().map(|(_, [all, ..])| *all).collect() };
    for ((name, _), mut way) in WAYS.iter().zip(measured.clone()) {
        let ratio = ratio(&all(&way), &all(&measured[0]));
        way.sort_by(|(_, [a, ..]), (_, [b, ..])| a.total_cmp(b));
        let (points, [all, field, adding]) = way[way.len() / 2];
        let points = points.map(|n| format!("{n:.2}"));
        let times = [field, adding, all].map(|t| format!("{t:.2}"));
        let shares = [format!("{:.0} %", 100.0 * adding / all), ratio];
        table.row(&[&[(*name).to_string()][..], &points, &times, &shares].concat());
    }
    let costs: [f64; 4] = work.row("costs", || Ok(costs(lego)))?;
    let costs: Vec<String> = KINDS.iter().zip(costs).map(|(kind, ns)| format!("{kind}: {ns:.0} ns")).collect();
    let [network, product]: [f64; 2] = work.row("network", || Ok(network(mlp)))?;
    let words = format!(
        "{}. {} {} Evaluations per ray by what is asked for, then µs of one core per ray; medians of five.",
        lego.name,
        describe(&lego.settings.rays(RAYS), &grid(GridKind::Octree, 8), &["gradient"]),
        seeds(&[0])
    );
    let body = format!(
        "{}\nOne evaluation on one core, median of 9, where the field is not empty: {}.\n\nMLP on one core: {:.1} \
         Gflop/s with encoding and activations, a 512³ product alone {:.1}: {:.0} %.",
        table.text(),
        costs.join("; "),
        network * 1e-9,
        product * 1e-9,
        100.0 * network / product
    );
    Ok((words, body))
}

const RAYS: u64 = 409_600;

fn measure(lego: &Scene, gradient: Option<GradientMethod>) -> Result<Measured> {
    let threads = rayon::current_num_threads() as f64;
    let counted = Counted { field: &*lego.field, points: Default::default(), nanoseconds: AtomicU64::new(0) };
    let settings = lego.settings.rays(RAYS).gradient(gradient.unwrap_or_default());
    let octree = grid(GridKind::Octree, 8);
    let run = Estimation::new(&counted, &lego.cameras).rays(settings).grid(octree).prepare()?;
    counted.nanoseconds.store(0, Ordering::Relaxed);
    counted.points.iter().for_each(|n| n.store(0, Ordering::Relaxed));
    let mut builder = FieldBuilder::new(octree, Domain::Box(counted.bounds()))?;
    let stream = run.stream();
    let (start, mut adding) = (Instant::now(), 0.0);
    if gradient.is_some() {
        // Without what comes after the last ray: reading the field off the sums.
        stream.run(Shard::whole(RAYS), RunProgress::default(), &Silent, |batches, _| {
            let start = Instant::now();
            builder.add(batches);
            adding += start.elapsed().as_secs_f64();
            Ok(())
        })?;
    } else {
        let tracer = &stream.source.marched().expect("a volume is profiled").tracer;
        (0..RAYS / 512).into_par_iter().for_each(|batch| {
            let picks = stream.pixels.picks(batch * 512, 512);
            let offset = stream.pixel_offset;
            let rays: Vec<Ray> = picks
                .iter()
                .map(|p| lego.cameras[p.camera].ray(f64::from(p.pixel[0]) + offset, f64::from(p.pixel[1]) + offset))
                .collect();
            let jitter: Vec<f64> = picks.iter().map(|p| p.jitter).collect();
            let (mut buffers, mut quadrature) = (TraceBuffers::default(), CompositingWeights::default());
            tracer.trace(&rays, &jitter, &mut buffers);
            let traced = &buffers.traced;
            quadrature.set(traced, tracer.marcher.step);
            let colors = tracer.visible_colors(&rays, traced, &quadrature);
            let background = tracer.background();
            let pixel = |r| quadrature.pixel(&traced.samples(r), &colors, &traced.t, background).color;
            std::hint::black_box((0..rays.len()).map(pixel).collect::<Vec<_>>());
        });
    }
    let per_ray = 1e6 * threads / RAYS as f64;
    let all = start.elapsed().as_secs_f64() * per_ray;
    let field = counted.nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9 * 1e6 / RAYS as f64;
    let points = counted.points.each_ref().map(|n| n.load(Ordering::Relaxed) as f64 / RAYS as f64);
    Ok((points, [all, field, adding * per_ray]))
}

/// Nanoseconds of one evaluation of each kind on one core, at points along rays that the field is not empty at.
fn costs(lego: &Scene) -> [f64; 4] {
    let bounds = lego.field.bounds();
    let golden = [0.819_172_5_f64, 0.671_043_6, 0.549_700_5];
    let positions: Vec<Vec3> = (0..)
        .map(|i| {
            let u = glam::DVec3::from(golden.map(|g| (f64::from(i / 16) * g).fract()));
            (bounds.min() + u * bounds.size()).as_vec3() + 0.005 * Vec3::X * (i % 16) as f32
        })
        .filter(|&x| bounds.contains(x) && lego.field.density_bound(x, x) != Some(0.0))
        .take(65_536)
        .collect();
    let directions = vec![Vec3::Z; positions.len()];
    let own = lego.field.differentiable().expect("the field differentiates itself");
    let n = positions.len();
    let (mut radiance, mut densities) = (vec![Radiance::default(); n], vec![0.0; n]);
    let (mut gradients, mut jets) = (vec![Vec3::ZERO; n], vec![RadianceJet::default(); n]);
    let mut time = |kind: usize| {
        let start = Instant::now();
        match kind {
            0 => lego.field.densities(&positions, &mut densities),
            1 => lego.field.evaluate(&positions, &directions, &mut radiance),
            2 => own.density_jets(&positions, &mut densities, &mut gradients),
            _ => own.jets(&positions, &directions, &mut jets),
        }
        start.elapsed().as_secs_f64() * 1e9 / n as f64
    };
    [0, 1, 2, 3].map(|kind| median((0..9).map(|_| time(kind))))
}

/// Operations per second inside the MLP's network, and in a product of matrices alone.
fn network(mlp: &Scene) -> [f64; 2] {
    // Multiplications and additions of one point: layers of 63, 4 × 128 and 155 inputs, two heads.
    const FLOP: f64 = 2.0 * (63.0 * 128.0 + 4.0 * 128.0 * 128.0 + 155.0 * 64.0 + 128.0 + 3.0 * 64.0);
    let positions: Vec<Vec3> = (0..16_384).map(|i| Vec3::splat(0.5) * (i as f32 * 0.37).sin()).collect();
    let directions = vec![Vec3::Z; positions.len()];
    let mut out = vec![Radiance::default(); positions.len()];
    let (a, b) = (Array2::<f32>::from_elem((512, 512), 0.5), Array2::<f32>::from_elem((512, 512), 0.25));
    let mut c = Array2::<f32>::zeros((512, 512));
    let (mut network, mut product) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let start = Instant::now();
        mlp.field.evaluate(&positions, &directions, &mut out);
        network.push(FLOP * positions.len() as f64 / start.elapsed().as_secs_f64());
        let start = Instant::now();
        for _ in 0..20 {
            ndarray::linalg::general_mat_mul(1.0, &a, &b, 0.0, &mut c);
        }
        product.push(20.0 * 2.0 * 512_f64.powi(3) / start.elapsed().as_secs_f64());
    }
    [median(network), median(product)]
}
