//! Question: on a real pre-trained NeRF, does the octree give the dense grid's answer, in how much memory?
//!
//! The MLP lego model, level 8. One stream of ray samples feeds the dense reference, an octree at the default
//! tolerance, and an octree that leaves nothing out. Writes the blocks of `experiments/lego.md` and its plot.

use octobayes::Result;
use octobayes::estimate::{GridKind, GridSettings};
use octobayes::monitor::Silent;
use octobayes::posterior::trace;
use octobayes::render::RayAverage;
use octobayes::uncertainty::{Difference, Support, UncertaintyField, compare};
use octobayes_evaluation::Reading;
use octobayes_show::picture::{Curve, write_plot};
use serde::{Deserialize, Serialize};

use common::clock::Clock;
use common::program::{Needs, Program, folder};
use common::ranking::{Ranking, Truth};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread, spread_e, whole, whole_spread};
use common::work::Work;

const POINTS: usize = 1_000_000;
const SEEDS: [u64; 3] = [0, 1, 2];
const NAMES: [&str; 3] = ["octree, tolerance 0.01", "octree, tolerance 0", "dense"];
/// Of the pixels of test views, one in so many along x and y.
const STRIDE: u32 = 4;

fn main() -> Result<()> {
    let parts = [("agreement", Needs::Data), ("times", Needs::Data), ("ranking", Needs::Data)];
    let program = Program::start("lego", &parts)?;
    let scene = || Scene::lego_mlp(&Program::data()?);
    program.part("agreement", |work| agreement(work, &scene()?))?;
    program.part("times", |work| times(work, &scene()?))?;
    program.part("ranking", |work| ranking(work, &scene()?))
}

/// Octree, octree that leaves nothing out, dense grid.
fn grids(scene: &Scene) -> [GridSettings; 3] {
    let octree = scene.grid;
    [octree.tolerance(0.01), octree.tolerance(0.0), octree.tolerance(0.0).grid(GridKind::Dense)]
}

fn words(scene: &Scene, used: &[u64]) -> String {
    let cameras = scene.cameras.len();
    let described = describe(&scene.settings, &scene.grid, &["grid", "tolerance"]);
    format!("{}, {cameras} cameras of 400 × 400. {described} {}", scene.name, seeds(used))
}

/// Sizes of a grid, and how far an octree is from the dense grid.
#[derive(Serialize, Deserialize)]
struct Row {
    vertices: f64,
    structure: f64,
    bytes: f64,
    sums: f64,
    /// Vertices surrounded by finest leaves, and the largest relative difference of H over them; 0 for the dense grid.
    finest: [f64; 2],
    /// |Δ log10 U| in the box and on surfaces: mean, 99 %, maximum.
    space: [f64; 3],
    surfaces: [f64; 3],
}

fn of_seed(scene: &Scene, seed: u64) -> Result<Vec<Row>> {
    let grids = grids(scene);
    let rays = scene.settings.seed(seed);
    let outcomes = scene.estimation(rays, grids[2]).prepare()?.finish_on(&grids)?;
    let sums: Vec<f64> = outcomes.iter().map(|outcome| outcome.sums_bytes as f64).collect();
    // As many surface points as box points; the run's own rays do not give a million.
    let other = scene.estimation(rays.seed(seed + 1000), grids[2]).prepare()?;
    let surface = other.stream().surface_points(POINTS, 10 * rays.rays, &Silent)?;
    let fields: Vec<UncertaintyField> =
        outcomes.into_iter().map(|outcome| outcome.field.with_surface(surface.clone())).collect();
    let dense = &fields[2];
    let row = |(field, sums): (&UncertaintyField, f64)| {
        let compared = compare(field, dense, POINTS, 1)?;
        let of = |d: &Option<Difference>| d.as_ref().map_or([f64::NAN; 3], |d| [d.mean, d.percentile_99, d.max]);
        let summary = field.summary();
        Ok(Row {
            vertices: summary.vertices as f64,
            structure: summary.structure_bytes as f64,
            bytes: summary.query_bytes as f64,
            sums,
            finest: information_difference(field, dense),
            space: of(&compared.in_box),
            surfaces: of(&compared.on_surfaces),
        })
    };
    fields.iter().zip(sums).map(row).collect()
}

/// Vertices of the octree whose eight cells are finest leaves, and the largest |ΔH| / |H| over them, H = 2S/R + 2λI in
/// the trace norm.
fn information_difference(octree: &UncertaintyField, dense: &UncertaintyField) -> [f64; 2] {
    let Support::Octree(tree) = octree.support() else { return [0.0; 2] };
    let (a, b) = (octree.sums().expect("kept"), dense.sums().expect("kept"));
    let record = octree.record();
    let prior = 3.0 * record.lambda * record.rays as f64;
    let (mut vertices, mut worst) = (0.0, 0.0_f64);
    for (s, [x, y, z]) in a.iter().map(|sums| &sums.information).zip(tree.vertex_positions()) {
        if tree.is_surrounded_by_finest([x, y, z]) {
            let t = &b[octree.lattice().dense_index([x, y, z])].information;
            let difference = s.iter().zip(t).map(|(s, t)| (s - t).abs()).fold(0.0, f64::max);
            worst = worst.max(difference / (trace(t) + prior));
            vertices += 1.0;
        }
    }
    [vertices, worst]
}

fn agreement(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let rows = SEEDS.map(|seed| work.row(("agreement", seed), || of_seed(scene, seed)));
    let rows = rows.into_iter().collect::<Result<Vec<_>>>()?;
    let of = |grid: usize, value: &dyn Fn(&Row) -> f64| rows.iter().map(|r| value(&r[grid])).collect::<Vec<f64>>();
    let mut sizes = Table::new(&[
        "grid",
        "vertices",
        "share of the dense grid's",
        "structure, bytes",
        "bytes for queries",
        "dense : this",
        "sums while running, MB",
    ]);
    let dense = |value: &dyn Fn(&Row) -> f64| mean(&of(2, value));
    for (grid, name) in NAMES.iter().enumerate() {
        let vertices = of(grid, &|row| row.vertices);
        let share = 100.0 * mean(&vertices) / dense(&|row| row.vertices);
        let bytes = mean(&of(grid, &|row| row.bytes));
        sizes.row(&[
            (*name).to_string(),
            whole_spread(&vertices),
            format!("{share:.1} %"),
            whole(mean(&of(grid, &|row| row.structure))),
            whole(bytes),
            format!("{:.1}", dense(&|row| row.bytes) / bytes),
            format!("{:.1}", mean(&of(grid, &|row| row.sums)) / 1e6),
        ]);
    }
    let mut hessians =
        Table::new(&["octree", "vertices surrounded by finest leaves", "largest relative difference of H"]);
    let mut fields = Table::new(&["octree against dense", "points", "mean", "99 %", "max"]);
    for (grid, name) in NAMES.iter().enumerate().take(2) {
        let worst = of(grid, &|row| row.finest[1]).into_iter().fold(0.0, f64::max);
        let vertices = whole_spread(&of(grid, &|row| row.finest[0]));
        hessians.row(&[(*name).to_string(), vertices, format!("{worst:.1e}")]);
        let mut add = |place: &str, values: fn(&Row) -> [f64; 3]| {
            let k = |k: usize| of(grid, &|row| values(row)[k]);
            fields.row(&[
                format!("{name}, {place}"),
                whole(POINTS as f64),
                spread_e(&k(0)),
                spread_e(&k(1)),
                spread(&k(2), 4),
            ]);
        };
        add("box", |row| row.space);
        add("surfaces", |row| row.surfaces);
    }
    let body = format!("{}\n{}\n{}", sizes.text(), hessians.text(), fields.text());
    Ok((format!("{} The largest difference of H is over all seeds.", words(scene, &SEEDS)), body))
}

/// Seconds of the parts of a run; see [`times`].
type Times = (f64, f64, [f64; 3]);

/// Where the time goes: one seed, wall time.
fn times(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let (occupancy, evaluating, summing): Times = work.row("times", || {
        let grids = grids(scene);
        let clock = Clock::start();
        let run = scene.estimation(scene.settings, grids[2]).prepare()?;
        let occupancy = clock.elapsed().wall;
        let clock = Clock::start();
        let outcomes = run.finish_on(&grids)?;
        let all = clock.elapsed().wall;
        let summing = [0, 1, 2].map(|grid| outcomes[grid].summing.as_secs_f64());
        Ok((occupancy, all - summing.iter().sum::<f64>(), summing))
    })?;
    let mut table = Table::new(&["part of the run", "time, s"]);
    table.row(&["occupancy grid".into(), format!("{occupancy:.1}")]);
    table.row(&["field and Jacobians".into(), format!("{evaluating:.1}")]);
    for (name, seconds) in NAMES.iter().zip(summing) {
        table.row(&[format!("sums and field, {name}"), format!("{seconds:.2}")]);
    }
    Ok((format!("{} Wall time.", words(scene, &SEEDS[..1])), table.text().into()))
}

fn ranking(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let truth = Truth::lego(&Program::data()?, 1, STRIDE)?;
    let averages = vec![RayAverage::WeightedMean, RayAverage::USpread];
    let ranking: Ranking = work.row(("ranking", STRIDE, SEEDS), || {
        let mut readings = Vec::new();
        let [octree, _, dense] = grids(scene);
        for seed in SEEDS {
            let run = scene.estimation(scene.settings.seed(seed), dense).prepare()?;
            for (name, outcome) in ["octree", "dense"].into_iter().zip(run.finish_on(&[octree, dense])?) {
                // The first keeps its sums, for the number of rays.
                let field = if readings.is_empty() { outcome.field } else { outcome.field.without_sums() };
                readings.push(Reading { name: name.into(), field, averages: averages.clone() });
            }
        }
        truth.rank(scene, &readings)
    })?;
    let mut table = Table::new(&["measure", "AUSE (MAE)", "AUSE (RMSE)"]);
    let per_seed = 2 * averages.len();
    for i in 0..per_seed {
        let of = |value: fn(&common::ranking::Rank) -> f64| {
            let values: Vec<f64> = (0..SEEDS.len()).map(|s| value(&ranking.ranks[s * per_seed + i])).collect();
            spread(&values, 4)
        };
        table.row(&[ranking.ranks[i].name.clone(), of(|rank| rank.mae), of(|rank| rank.rmse)]);
    }
    let others = &ranking.ranks[SEEDS.len() * per_seed..];
    for rank in others {
        table.row(&[rank.name.clone(), format!("{:.4}", rank.mae), format!("{:.4}", rank.rmse)]);
    }
    plot(&ranking, &ranking.ranks[..averages.len()], others)?;
    let depth = ranking.depth;
    let words = format!(
        "{} {} test views, every {STRIDE}th pixel along x and y: {} pixels. PSNR {:.2} dB in the mean over views; \
         depth error {:.4} scene units in the median, {:.4} in the mean, 95 % within {:.4}.",
        words(scene, &SEEDS),
        truth.views(),
        whole(depth.pixels as f64),
        ranking.psnr,
        depth.median,
        depth.mean,
        depth.percentile_95,
    );
    Ok((words, table.text().into()))
}

/// Sparsification curves of the first seed's octree and of the measures without a Hessian.
fn plot(ranking: &Ranking, own: &[common::ranking::Rank], others: &[common::ranking::Rank]) -> Result<()> {
    let points = |rank: &common::ranking::Rank, k: usize| rank.curve.iter().map(|p| (p[0], p[k])).collect();
    let mut curves: Vec<Curve> = own
        .iter()
        .chain(others)
        .map(|rank| Curve {
            name: format!("{} ({:.3})", rank.name, rank.mae),
            points: points(rank, 1),
            reference: false,
        })
        .collect();
    curves.push(Curve { name: "oracle".into(), points: points(&ranking.ranks[0], 2), reference: true });
    let axes = ["removed share of pixels", "mean absolute depth error, scene units"];
    write_plot(&folder().join("lego_ause.svg"), "lego, MLP (AUSE)", axes, &curves)
}
