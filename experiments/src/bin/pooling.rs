//! Question: what do low-discrepancy pixels and pooling gain, and what does pooling spoil?
//!
//! Dense grids of the same rays, read with every vertex by itself, pooled (`--pooling auto`), and pooled
//! as block means (the smallest aligned block of 1, 2³, 4³ or 8³ vertices with at least 4 rays, counted at the
//! vertices themselves), against a dense grid of 4,096,000 random rays of another seed. |Δ log10 U|, mean / rms, over
//! two sets of vertices: those that the truth moved by more than half a decade, and those that the truth or the
//! estimate moved so far. The second set is the one that sees surfaces smeared into empty space. Writes the blocks of
//! `experiments/pooling.md`.

use octobayes::Result;
use octobayes::estimate::{GridKind, GridSettings, RaySettings};
use octobayes::posterior::{Covariance, Pooling, VertexSums};
use octobayes::rays::Pixels;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{MOVED, UncertaintyField};

use common::program::{Needs, Program};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, spread, whole};
use common::work::Work;

const LEVEL: u8 = 7;
const RAYS: [u64; 4] = [20_000, 50_000, 200_000, 500_000];
const SEEDS: [u64; 3] = [0, 1, 2];
const TRUTH: u64 = 4_096_000;
const TRUTH_SEED: u64 = 99;
const TOLERANCE: f64 = 0.01;

/// How a field is estimated.
const METHODS: [&str; 4] = ["random, by itself", "Sobol, by itself", "Sobol, pooled", "Sobol, block means"];
/// Which vertices are judged.
const SETS: [&str; 2] = ["moved in truth", "moved in either"];

fn main() -> Result<()> {
    let program = Program::start("pooling", &[("courtyard", Needs::Nothing), ("lego", Needs::Data)])?;
    program.part("courtyard", |work| study(work, &Scene::courtyard()))?;
    program.part("lego", |work| study(work, &Scene::lego(&Program::data()?)?))
}

fn grid(scene: &Scene) -> GridSettings {
    scene.grid.grid(GridKind::Dense).level(LEVEL)
}

fn run(scene: &Scene, rays: RaySettings) -> Result<UncertaintyField> {
    Ok(scene.estimation(rays, grid(scene)).run()?.field)
}

fn log10(field: &UncertaintyField) -> Vec<f64> {
    field.deviations().iter().map(f64::log10).collect()
}

/// Mean and rms of |Δ log10 U| by method and set, of one number of rays and one seed.
type Row = Vec<[[f64; 2]; 2]>;

fn row(scene: &Scene, rays: RaySettings, truth: &[f64], prior: f64) -> Result<Row> {
    let random = run(scene, rays.pixels(Pixels::Random))?;
    let grids = [Pooling::Off, Pooling::Auto].map(|pooling| grid(scene).pooling(pooling).tolerance(TOLERANCE));
    let sobol = scene.estimation(rays.pixels(Pixels::Sobol), grids[0]).prepare()?.finish_on(&grids)?;
    let mut estimates = vec![log10(&random)];
    estimates.extend(sobol.iter().map(|outcome| log10(&outcome.field)));
    estimates.push(by_blocks(&sobol[0].field));
    let judge = |estimate: &Vec<f64>| {
        [false, true].map(|either| {
            let pairs = truth.iter().zip(estimate);
            let of_set = pairs.filter(|&(t, e)| prior - t > MOVED || either && prior - e > MOVED);
            let errors: Vec<f64> = of_set.map(|(t, e)| (t - e).abs()).collect();
            let n = errors.len() as f64;
            [errors.iter().sum::<f64>() / n, (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt()]
        })
    };
    Ok(estimates.iter().map(judge).collect())
}

fn study(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let settings = scene.settings.gradient(GradientMethod::Auto);
    let truth = settings.rays(TRUTH).seed(TRUTH_SEED).pixels(Pixels::Random);
    let truth = work.field(("truth", scene.name, LEVEL, TRUTH), || Ok(run(scene, truth)?.without_sums()))?;
    let (prior, truth) = (truth.prior().log10(), log10(&truth));
    let moved = truth.iter().filter(|&&t| prior - t > MOVED).count();

    let mut table = Table::new(&[&["rays", "set"][..], &METHODS[..]].concat());
    for rays in RAYS {
        let of = |seed| {
            work.row((scene.name, LEVEL, rays, seed), || row(scene, settings.rays(rays).seed(seed), &truth, prior))
        };
        let rows = SEEDS.into_iter().map(of).collect::<Result<Vec<Row>>>()?;
        for (s, set) in SETS.iter().enumerate() {
            let of =
                |method: usize, k: usize| spread(&rows.iter().map(|row| row[method][s][k]).collect::<Vec<f64>>(), 3);
            let cells = (0..METHODS.len()).map(|method| format!("{} / {}", of(method, 0), of(method, 1)));
            table.row(&[whole(rays as f64), (*set).to_string()].into_iter().chain(cells).collect::<Vec<_>>());
        }
    }
    let grid = scene.grid.grid(GridKind::Dense).level(LEVEL);
    let words = format!(
        "{}. Mean / rms of |Δ log10 U|. {} {} The truth: {} random rays of seed {TRUTH_SEED}; it moved {} of {} \
        vertices.",
        scene.name,
        describe(&settings, &grid, &["rays", "pixels", "pooling", "tolerance"]),
        seeds(&SEEDS),
        whole(TRUTH as f64),
        whole(moved as f64),
        whole(truth.len() as f64),
    );
    Ok((words, table.text().into()))
}

/// log10 σ_v from the mean sums of the smallest aligned block around v with at least 4 rays.
fn by_blocks(field: &UncertaintyField) -> Vec<f64> {
    let kept = field.sums().expect("kept");
    let n = (1_usize << LEVEL) + 1;
    let record = field.record();
    let mut settled: Vec<Option<VertexSums>> = kept.iter().map(|sums| (sums.rays >= 4).then_some(*sums)).collect();
    for edge in [2, 4, 8] {
        let blocks = n.div_ceil(edge);
        let mut sums = vec![VertexSums::default(); blocks.pow(3)];
        let block = |i: usize| ((i / (n * n) / edge) * blocks + i / n % n / edge) * blocks + i % n / edge;
        kept.iter().enumerate().for_each(|(i, own)| sums[block(i)] += own);
        let volume = (edge * edge * edge) as f64;
        for (i, settled) in settled.iter_mut().enumerate().filter(|(_, settled)| settled.is_none()) {
            let sum = sums[block(i)];
            *settled = (sum.rays >= 4).then(|| VertexSums::new(sum.information.map(|s| s / volume), sum.rays));
        }
    }
    let read = |sums: VertexSums| Covariance::Diagonal.deviation(&sums, record.rays, record.lambda).log10();
    settled.into_iter().zip(kept).map(|(pooled, own)| read(pooled.unwrap_or(*own))).collect()
}
