//! Question: on a real pre-trained NeRF, does the octree give the dense grid's answer, in how much memory?
//!
//! The MLP lego model, its 100 training cameras (400 × 400), level 8, 409,600 rays, seed 0. One stream of ray samples feeds
//! the dense reference, an octree at the default tolerance, and an octree that leaves nothing out. Reads the model from
//! `$OCTOBAYES_DATA/nerf-mlp-pretrained`; writes the three fields to `target/experiments/` for `octobayes evaluate`, and the
//! tables of `experiments/lego.md` to stdout.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use octobayes::Result;
use octobayes::dataset::Views;
use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::NerfMlp;
use octobayes::monitor::Silent;
use octobayes::posterior::trace;
use octobayes::uncertainty::{Difference, Support, UncertaintyField, compare};

const LEVEL: u8 = 8;
const RAYS: u64 = 409_600;
const POINTS: usize = 1_000_000;

fn main() -> Result<()> {
    let data = PathBuf::from(std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA names the data folder"));
    let folder = data.join("nerf-mlp-pretrained");
    let model = NerfMlp::read(&folder.join("lego.safetensors"))?;
    let cameras = Views::read(&folder.join("cameras/lego_train.json"), Some([400, 400]))?.cameras();

    let settings = |grid, tolerance| GridSettings::default().grid(grid).tolerance(tolerance).level(LEVEL);
    let names = ["octree, tolerance 0.01", "octree, nothing left out", "dense"];
    let grids = [settings(GridKind::Octree, 0.01), settings(GridKind::Octree, 0.0), settings(GridKind::Dense, 0.0)];
    let rays = RaySettings::default().rays(RAYS);
    let start = Instant::now();
    let run = Estimation::new(&model, &cameras)
        .rays(rays)
        .grid(grids[2])
        .source("lego.safetensors, lego_train.json")
        .prepare()?;
    let occupancy = start.elapsed();
    let start = Instant::now();
    let outcomes = run.finish_on(&grids)?;
    let evaluating = start.elapsed() - outcomes.iter().map(|outcome| outcome.summing).sum::<Duration>();
    let progress = outcomes[0].progress;
    let (sums, spent): (Vec<usize>, Vec<Duration>) = outcomes.iter().map(|o| (o.sums_bytes, o.summing)).unzip();
    let fields: Vec<UncertaintyField> = outcomes.into_iter().map(|outcome| outcome.field).collect();

    // As many surface points as box points; the run's own rays do not give a million.
    let other = rays.seed(rays.seed + 1);
    let other = Estimation::new(&model, &cameras).rays(other).prepare()?;
    let surface = other.stream().surface_points(POINTS, 10 * RAYS, &Silent)?;
    let fields: Vec<_> = fields.into_iter().map(|f| f.with_surface(surface.clone())).collect();

    println!("{RAYS} rays, level {LEVEL}, seed {}, {} samples with a Jacobian", rays.seed, progress.samples);
    println!(
        "occupancy {:.1} s, field and Jacobians {:.1} s, {} threads\n",
        occupancy.as_secs_f64(),
        evaluating.as_secs_f64(),
        rayon::current_num_threads()
    );
    println!(
        "| grid | vertices | structure, bytes | values f32, bytes | all, bytes | dense : this | sums while running, MB | time to sum, s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let dense_bytes = fields[2].query_memory() as f64;
    for ((name, field), (sums, spent)) in names.iter().zip(&fields).zip(sums.iter().zip(spent)) {
        let s = field.summary();
        println!(
            "| {name} | {} | {} | {} | {} | {:.1} | {:.1} | {:.2} |",
            s.vertices,
            s.structure_bytes,
            s.query_bytes - s.structure_bytes,
            s.query_bytes,
            dense_bytes / s.query_bytes as f64,
            *sums as f64 / 1e6,
            spent.as_secs_f64()
        );
    }
    println!("\n| octree | vertices surrounded by finest leaves | largest relative difference of H |");
    println!("|---|---|---|");
    for (name, field) in names.iter().zip(&fields).take(2) {
        let (vertices, worst) = information_difference(field, &fields[2]);
        println!("| {name} | {vertices} | {worst:.2e} |");
    }
    println!("\n| octree against dense | points | mean | 95 % | 99 % | max |");
    println!("|---|---|---|---|---|---|");
    for (name, field) in names.iter().zip(&fields).take(2) {
        let result = compare(field, &fields[2], POINTS, 1)?;
        let row = |place: &str, d: &Difference| {
            println!(
                "| {name}, {place} | {} | {:.2e} | {:.2e} | {:.2e} | {:.6} |",
                d.points, d.mean, d.percentile_95, d.percentile_99, d.max
            );
        };
        result.in_box.iter().for_each(|d| row("box", d));
        result.on_surfaces.iter().for_each(|d| row("surfaces", d));
    }
    let out = Path::new("target/experiments");
    std::fs::create_dir_all(out).map_err(octobayes::Error::io(out, "cannot create the folder"))?;
    for (name, field) in ["octree", "octree_all", "dense"].iter().zip(&fields) {
        field.clone().with_surface(Vec::new()).write(&out.join(format!("lego_{name}.oct")))?;
    }
    Ok(())
}

/// Vertices of the octree whose eight cells are finest leaves, and the largest |ΔH| / |H| over them, H = 2S/R + 2λI in the
/// trace norm.
fn information_difference(octree: &UncertaintyField, dense: &UncertaintyField) -> (usize, f64) {
    let Support::Octree(tree) = octree.support() else { return (0, f64::NAN) };
    let (a, b) = (octree.sums().expect("kept"), dense.sums().expect("kept"));
    let protocol = octree.protocol();
    let prior = 3.0 * protocol.lambda * protocol.rays as f64;
    let (mut vertices, mut worst) = (0, 0.0_f64);
    for (s, [x, y, z]) in a.iter().map(|e| &e.information).zip(tree.vertex_positions()) {
        if tree.is_surrounded_by_finest([x, y, z]) {
            let t = &b[octree.lattice().dense_index([x, y, z])].information;
            let difference = s.iter().zip(t).map(|(s, t)| (s - t).abs()).fold(0.0, f64::max);
            worst = worst.max(difference / (trace(t) + prior));
            vertices += 1;
        }
    }
    (vertices, worst)
}
