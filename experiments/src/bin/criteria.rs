//! Question: what does each refinement criterion cost, and what error does it leave?
//!
//! Octrees under every criterion against the dense grid of the same rays: vertices, bytes, |Δ log10 U| at random points
//! of the box and on visible surfaces. Writes the blocks of `experiments/criteria.md`.

use octobayes::Result;
use octobayes::estimate::{GridKind, GridSettings, Outcome};
use octobayes::posterior::Criterion;
use octobayes::uncertainty::{Difference, UncertaintyField, compare};
use serde::{Deserialize, Serialize};

use common::program::{Needs, Program};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread, spread_e, whole, whole_spread};
use common::work::Work;

const SEEDS: [u64; 3] = [0, 1, 2];
/// Points of a comparison: of the box, and at most on surfaces.
const POINTS: usize = 200_000;

fn main() -> Result<()> {
    let program = Program::start("criteria", &[("courtyard", Needs::Nothing), ("lego", Needs::Data)])?;
    program.part("courtyard", |work| study(work, &Scene::courtyard()))?;
    program.part("lego", |work| study(work, &Scene::lego(&Program::data()?)?))
}

/// A criterion with its tolerance and, for ray counts, the fewest rays of a vertex.
type Rule = (&'static [Criterion], f64, f64);

const RULES: [Rule; 9] = [
    (&[Criterion::Sensitivity], 0.0, 0.0),
    (&[Criterion::Sensitivity], 0.001, 0.0),
    (&[Criterion::Sensitivity], 0.01, 0.0),
    (&[Criterion::Sensitivity], 0.1, 0.0),
    (&[Criterion::Density], 0.01, 0.0),
    (&[Criterion::Sensitivity, Criterion::Density], 0.01, 0.0),
    (&[Criterion::RayCount], 0.01, 2.0),
    (&[Criterion::RayCount], 0.01, 4.0),
    (&[Criterion::RayCount], 0.01, 16.0),
];

/// One octree beside the dense grid.
#[derive(Serialize, Deserialize)]
struct Row {
    vertices: f64,
    bytes: f64,
    dense_bytes: f64,
    /// In the box: mean, maximum.
    space: [f64; 2],
    /// On surfaces: mean, 95 %, maximum.
    surfaces: [f64; 3],
}

impl Row {
    fn new(octree: &UncertaintyField, dense: &UncertaintyField) -> Result<Self> {
        let summary = octree.summary();
        let compared = compare(octree, dense, POINTS, 1)?;
        let of = |d: &Option<Difference>, value: fn(&Difference) -> f64| d.as_ref().map_or(f64::NAN, value);
        let (space, surfaces) = (&compared.in_box, &compared.on_surfaces);
        Ok(Self {
            vertices: summary.vertices as f64,
            bytes: summary.query_bytes as f64,
            dense_bytes: dense.query_memory() as f64,
            space: [of(space, |d| d.mean), of(space, |d| d.max)],
            surfaces: [of(surfaces, |d| d.mean), of(surfaces, |d| d.percentile_95), of(surfaces, |d| d.max)],
        })
    }
}

/// All octrees of one seed. Those without limits share one stream of rays with the dense grid.
fn of_seed(scene: &Scene, settings: GridSettings, seed: u64) -> Result<Vec<Row>> {
    let rays = scene.settings.seed(seed);
    let grid = |(criteria, tolerance, ray_count): &Rule| {
        settings.criteria(criteria.iter().copied().collect()).tolerance(*tolerance).ray_count(*ray_count)
    };
    let (limited, free): (Vec<GridSettings>, Vec<GridSettings>) =
        RULES.iter().map(grid).partition(GridSettings::is_limited);
    let dense = settings.grid(GridKind::Dense);
    let all: Vec<GridSettings> = [dense].into_iter().chain(free).collect();
    let mut fields = scene.estimation(rays, dense).prepare()?.finish_on(&all)?.into_iter().map(|outcome| outcome.field);
    let dense = fields.next().expect("the dense grid is the first").without_sums();
    let dense = scene.with_surfaces(dense, rays, POINTS)?;
    let mut rows = fields.map(|field| Row::new(&field, &dense)).collect::<Result<Vec<Row>>>()?;
    for grid in limited {
        let Outcome { field, .. } = scene.estimation(rays, grid).run()?;
        rows.push(Row::new(&field, &dense)?);
    }
    Ok(rows)
}

fn study(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let settings = scene.grid;
    let rows = SEEDS.map(|seed| work.row(("criteria", scene.name, seed), || of_seed(scene, settings, seed)));
    let rows = rows.into_iter().collect::<Result<Vec<_>>>()?;
    let mut table = Table::new(&[
        "refine",
        "tolerance",
        "min rays",
        "vertices",
        "bytes",
        "dense : this",
        "box: mean",
        "max",
        "surfaces: mean",
        "95 %",
        "max",
    ]);
    for (i, (criteria, tolerance, min_rays)) in RULES.iter().enumerate() {
        let of = |value: &dyn Fn(&Row) -> f64| rows.iter().map(|rows| value(&rows[i])).collect::<Vec<f64>>();
        let names: octobayes::posterior::Criteria = criteria.iter().copied().collect();
        table.row(&[
            names.to_string(),
            tolerance.to_string(),
            min_rays.to_string(),
            whole_spread(&of(&|r| r.vertices)),
            whole(mean(&of(&|r| r.bytes))),
            format!("{:.1}", mean(&of(&|r| r.dense_bytes / r.bytes))),
            spread_e(&of(&|r| r.space[0])),
            spread(&of(&|r| r.space[1]), 4),
            spread_e(&of(&|r| r.surfaces[0])),
            spread(&of(&|r| r.surfaces[1]), 4),
            spread(&of(&|r| r.surfaces[2]), 4),
        ]);
    }
    let dense = whole(mean(&rows.iter().map(|rows| rows[0].dense_bytes).collect::<Vec<f64>>()));
    let cameras = scene.cameras.len();
    let words = format!(
        "{}, {cameras} cameras; the dense grid takes {dense} bytes. {} {} Points: {} of the box, as many on surfaces.",
        scene.name,
        describe(&scene.settings, &settings, &["grid", "tolerance"]),
        seeds(&SEEDS),
        whole(POINTS as f64),
    );
    Ok((words, table.text().into()))
}
