//! Question: what do low-discrepancy pixels and pooling by evidence gain, and what does pooling spoil?
//!
//! Dense grids of the same rays, read with every vertex by itself, pooled by this crate's rule (`--min-rays`), and pooled as block
//! means (the smallest aligned block of 1, 2³, 4³ or 8³ vertices with at least 4 rays, counted at the vertices themselves), against
//! a dense grid of 4,096,000 random rays of another seed. |Δ log10 U|, mean / rms, over two sets of vertices: those that the truth moved by
//! more than 0.5 from the prior, and those that the truth or the estimate moved so far. The second set is the one that sees
//! surfaces smeared into empty space.
//!
//! Scenes: the courtyard (level 7, 40 cameras of 400 × 400 on a half circle) and, with `OCTOBAYES_DATA`, the pre-trained Plenoptic PNG
//! lego of type 1 (level 7, its 100 training cameras of 400 × 400). Prints the tables of `experiments/pooling.md`.

use std::path::PathBuf;

use octobayes::Result;
use octobayes::dataset::Views;
use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Coordinates, RadianceField};
use octobayes::geometry::Camera;
use octobayes::open::open_in;
use octobayes::posterior::{Covariance, VertexSums};
use octobayes::rays::Pixels;
use octobayes::uncertainty::UncertaintyField;

const LEVEL: u8 = 7;
const RAYS: [u64; 6] = [20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000];
const TRUTH: u64 = 4_096_000;
const TOLERANCE: f64 = 0.01;

fn main() -> Result<()> {
    study("courtyard", &ClosedForm::courtyard(), &ClosedForm::half_circle(40, [400, 400]))?;
    if let Some(data) = std::env::var_os("OCTOBAYES_DATA").map(PathBuf::from) {
        let model = data.join("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng");
        let lego = open_in(&model.to_string_lossy(), Some(Coordinates::Blender))?;
        let file = data.join("nerf-mlp-pretrained/cameras/lego_train.json");
        study("lego, Plenoptic PNG type 1", &*lego, &Views::read(&file, Some([400, 400]))?.cameras())?;
    }
    Ok(())
}

fn study(name: &str, field: &dyn RadianceField, cameras: &[Camera]) -> Result<()> {
    let run = |rays, seed, pixels| {
        let grid = GridSettings::default().grid(GridKind::Dense).level(LEVEL).surface_points(0);
        let rays = RaySettings::default().rays(rays).seed(seed).pixels(pixels);
        Estimation::new(field, cameras).rays(rays).grid(grid).run().map(|outcome| outcome.field)
    };
    let truth = run(TRUTH, 99, Pixels::Random)?.without_sums();
    let prior = truth.prior().log10();
    let truth: Vec<f64> = truth.deviations().iter().map(f64::log10).collect();
    let moved = truth.iter().filter(|&&t| prior - t > 0.5).count();
    println!("\n### {name}: {moved} of {} vertices moved by more than 0.5\n", truth.len());
    println!(
        "| rays | set | random, by itself | Sobol, by itself | Sobol, --min-rays 4 | Sobol, --min-rays 8 | Sobol, block means |"
    );
    println!("|---|---|---|---|---|---|---|");
    for rays in RAYS {
        let random = run(rays, 1, Pixels::Random)?;
        let sobol = run(rays, 1, Pixels::Sobol)?;
        let blocks = by_blocks(&sobol);
        let read = |field: &UncertaintyField| -> Vec<f64> { field.deviations().iter().map(f64::log10).collect() };
        let plain = [read(&random.without_sums()), read(&sobol)];
        let four = sobol.with_pooling(4.0, TOLERANCE)?;
        let pooled = [read(&four), read(&four.with_pooling(8.0, TOLERANCE)?)];
        for (set, either) in [("moved in truth", false), ("moved in either", true)] {
            let cells: Vec<String> = plain
                .iter()
                .chain(&pooled)
                .chain([&blocks])
                .map(|estimate| {
                    let pairs = truth.iter().zip(estimate);
                    let of_set = pairs.filter(|&(t, e)| prior - t > 0.5 || either && prior - e > 0.5);
                    let (n, sum, squares) =
                        of_set.fold((0.0, 0.0, 0.0), |(n, sum, squares): (f64, f64, f64), (t, e)| {
                            (n + 1.0, sum + (t - e).abs(), squares + (t - e).powi(2))
                        });
                    format!("{:.3} / {:.3}", sum / n, (squares / n).sqrt())
                })
                .collect();
            println!("| {rays} | {set} | {} |", cells.join(" | "));
        }
    }
    Ok(())
}

/// log10 σ_v from the mean evidence of the smallest aligned block around v with at least 4 rays.
fn by_blocks(field: &UncertaintyField) -> Vec<f64> {
    let kept = field.sums().expect("kept");
    let n = (1_usize << LEVEL) + 1;
    let protocol = field.protocol();
    let mut settled: Vec<Option<VertexSums>> = kept.iter().map(|e| (e.rays >= 4).then_some(*e)).collect();
    for edge in [2, 4, 8] {
        let blocks = n.div_ceil(edge);
        let mut sums = vec![VertexSums::default(); blocks.pow(3)];
        let block = |i: usize| ((i / (n * n) / edge) * blocks + i / n % n / edge) * blocks + i % n / edge;
        kept.iter().enumerate().for_each(|(i, e)| sums[block(i)].add(e));
        let volume = (edge * edge * edge) as f64;
        for (i, settled) in settled.iter_mut().enumerate().filter(|(_, settled)| settled.is_none()) {
            let sum = sums[block(i)];
            *settled = (sum.rays >= 4).then(|| VertexSums { information: sum.information.map(|s| s / volume), ..sum });
        }
    }
    let read = |e: VertexSums| Covariance::Diagonal.deviation(&e, protocol.rays, protocol.lambda).log10();
    settled.into_iter().zip(kept).map(|(pooled, own)| read(pooled.unwrap_or(*own))).collect()
}
