//! The tables of time against error.

use octobayes::Result;
use octobayes::estimate::{GridKind, GridSettings, RaySettings};
use octobayes::metrics::median;
use octobayes::posterior::{Criterion, Pooling};
use octobayes::rays::Pixels;
use octobayes::render::{GradientMethod, RayAverage};
use octobayes_evaluation::Reading;
use octobayes_show::picture::{Curve, write_plot};

use super::measure::{POINTS, Row, Rows, Run, SEEDS, alternating, grid, ratio, reference, run};
use common::program::folder;
use common::ranking::Truth;
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, spread, spread_e, whole};
use common::work::Work;

const TIMES: &str = "Times are wall times of everything between the open model and the finished field";
const ERRORS: &str = "Errors are |Δ log10 U| against a dense grid of 20,480,000 random rays of another seed, with \
                      exact derivatives and cutoff 1e-8";
/// The columns that [`Rows::errors`] fills.
const ERROR_COLUMNS: [&str; 6] = ["surfaces: mean", "95 %", "max", "box: mean", "95 %", "max"];

/// The paper's workload, three times each.
pub fn targets(work: &Work, lego: &Scene) -> Result<(String, String)> {
    const WAYS: [GradientMethod; 3] =
        [GradientMethod::Analytic, GradientMethod::FiniteDifference, GradientMethod::ForwardDifference];
    let head = ["derivatives", "s, median of 3", "least", "most", "rays / s", "times own derivatives"];
    let mut table = Table::new(&head);
    let times = alternating(&WAYS, &SEEDS, |&gradient, time| {
        let make = || Ok(run(lego, &lego.settings.gradient(gradient), &grid(GridKind::Octree, 8))?.seconds);
        work.row((format!("{gradient:?}"), time), make).map(Some)
    })?;
    for (gradient, of) in WAYS.iter().zip(&times) {
        let middle = median(of.iter().copied());
        let least = of.iter().copied().fold(f64::INFINITY, f64::min);
        let most = of.iter().copied().fold(0.0, f64::max);
        let seconds = [middle, least, most].map(|seconds| format!("{seconds:.2}"));
        let speed = whole(lego.settings.rays as f64 / middle);
        table.row(&[&[format!("{gradient:?}")][..], &seconds, &[speed, ratio(of, &times[0])]].concat());
    }
    let described = describe(&lego.settings, &lego.grid, &["gradient"]);
    Ok((format!("{}. {described} {} {TIMES}.", lego.name, seeds(&[0])), table.text().into()))
}

/// Each feature switched on behind the others.
pub fn ablation(work: &Work, lego: &Scene) -> Result<(String, String)> {
    let reference = reference(work, lego, super::MANY)?;
    let paper = lego.settings.pixels(Pixels::Random).cutoff(1e-8).gradient(GradientMethod::FiniteDifference);
    let (dense, octree) = (grid(GridKind::Dense, 8), grid(GridKind::Octree, 8));
    let culled = paper.cutoff(RaySettings::default().cutoff);
    let coarse = paper.cutoff(1e-4);
    let sobol = culled.pixels(Pixels::Sobol);
    let analytic = sobol.gradient(GradientMethod::Analytic);
    let features: [(&str, RaySettings, GridSettings); 8] = [
        ("dense grid, random rays, differences, cutoff 1e-8", paper, dense),
        ("octree instead", paper, octree),
        ("+ cutoff 1e-6 (default)", culled, octree),
        ("  or cutoff 1e-4", coarse, octree),
        ("+ low-discrepancy rays (default)", sobol, octree),
        ("+ the field's own derivatives (`--gradient auto`)", analytic, octree),
        ("+ `--pooling auto`", analytic, octree.pooling(Pooling::Auto)),
        ("dense grid with all of the rays' features", analytic, dense),
    ];
    let head = ["", "s, median", "samples / ray", "bytes for queries"];
    let mut table = Table::new(&[&head[..], &ERROR_COLUMNS].concat());
    let rows = alternating(&features, &SEEDS, |(name, rays, grid), seed| {
        let make = || Row::new(&run(lego, &rays.seed(seed), grid)?, Some(&reference));
        work.row((name, rays.rays, seed), make).map(Some)
    })?;
    for ((name, rays, _), rows) in features.iter().zip(rows) {
        let rows = Rows(rows);
        let head = [
            (*name).to_string(),
            format!("{:.2}", rows.seconds()),
            format!("{:.1}", rows.mean(|row| row.samples) / rays.rays as f64),
            whole(rows.mean(|row| row.bytes)),
        ];
        table.row(&[&head[..], &rows.errors()].concat());
    }
    let described = describe(&lego.settings, &octree, &["gradient", "pixels", "cutoff", "grid", "pooling"]);
    Ok((format!("{}. {described} {} {TIMES}. {ERRORS}.", lego.name, seeds(&SEEDS)), table.text().into()))
}

/// Central and forward differences against the models' own derivatives, with the same rays.
pub fn differences(work: &Work, scenes: &[Scene]) -> Result<(String, String)> {
    use GradientMethod::{Analytic, FiniteDifference, ForwardDifference};
    let ways = [
        ("the model's own", Analytic, None),
        ("central, h = 1/512 (default)", FiniteDifference, None),
        ("central, h = 1/2048", FiniteDifference, Some(1.0 / 2048.0)),
        ("forward, h = 1/512", ForwardDifference, Some(1.0 / 512.0)),
        ("forward, h = 1/2048 (default)", ForwardDifference, None),
    ];
    let head = ["scene", "rays", "differences", "s, median", "to the model's own"];
    let mut table = Table::new(&[&head[..], &ERROR_COLUMNS].concat());
    for scene in scenes {
        let settings = scene.settings.gradient(Analytic);
        let name = ("exact", scene.name, settings.rays);
        let exact = work.field(name, || {
            scene.with_surfaces(run(scene, &settings, &grid(GridKind::Octree, 8))?.field, settings, POINTS)
        })?;
        // Of one seed, like the exact field; three times for the time.
        let rows = alternating(&ways, &SEEDS, |&(name, gradient, step), time| {
            let settings = settings.gradient(gradient).step(step);
            let make = || Row::new(&run(scene, &settings, &grid(GridKind::Octree, 8))?, Some(&exact));
            work.row((scene.name, name, time), make).map(Some)
        })?;
        let rows: Vec<Rows> = rows.into_iter().map(Rows).collect();
        let times: Vec<Vec<f64>> = rows.iter().map(|rows| rows.all(|row| row.seconds)).collect();
        for (((name, ..), rows), of) in ways.iter().zip(&rows).zip(&times) {
            let head = [
                scene.name.to_string(),
                whole(settings.rays as f64),
                (*name).to_string(),
                format!("{:.2}", rows.seconds()),
                ratio(of, &times[0]),
            ];
            let errors = [rows.0[0].surfaces, rows.0[0].space].concat();
            table.row(&[&head[..], &errors.into_iter().map(|e| format!("{e:.4}")).collect::<Vec<_>>()].concat());
        }
    }
    let described = describe(&scenes[0].settings, &grid(GridKind::Octree, 8), &["rays", "gradient", "step"]);
    let words = format!(
        "{described} {} {TIMES}, medians of 3. h in edges of the lattice. Errors are |Δ log10 U| against the same rays \
         with the model's own derivatives.",
        seeds(&[0])
    );
    Ok((words, table.text().into()))
}

/// What `--audit` measures, and what is promised.
pub fn audit(work: &Work, lego: &Scene) -> Result<(String, String)> {
    let octree = grid(GridKind::Octree, 8);
    let of = |seed| {
        work.row(("audit", seed), || {
            let rays = lego.settings.seed(seed).gradient(GradientMethod::FiniteDifference);
            let audit = lego.estimation(rays, octree).prepare()?.audit()?;
            let derivatives = audit.derivatives.expect("differences are not exact");
            Ok((audit.rays, [&audit.cutoff, &derivatives].map(|e| [e.mean, e.percentile_95])))
        })
    };
    let found = SEEDS.into_iter().map(of).collect::<Result<Vec<(u64, [[f64; 2]; 2])>>>()?;
    let mut table = Table::new(&["approximation", "log10 U: mean", "95 % within"]);
    for (i, name) in ["samples left out", "finite differences; none with `--gradient auto`"].iter().enumerate() {
        let cells = [0, 1].map(|k| spread_e(&found.iter().map(|(_, e)| e[i][k]).collect::<Vec<f64>>()));
        table.row(&[&[(*name).to_string()][..], &cells].concat());
    }
    let rays = whole(found[0].0 as f64);
    let described = describe(&lego.settings, &octree, &[]);
    let words = format!("{}, {rays} audited rays. {described} {}", lego.name, seeds(&SEEDS));
    Ok((words, table.text().into()))
}

/// A way to spend time.
struct Method {
    name: &'static str,
    rays: fn(RaySettings) -> RaySettings,
    grid: fn(GridSettings) -> GridSettings,
    /// Most rays that it is run with.
    most: u64,
    /// Most rays that it is run with under all seeds; more are drawn under the first.
    repeated: u64,
}

const METHODS: [Method; 5] = [
    Method {
        name: "dense, random",
        rays: |rays| rays.pixels(Pixels::Random).gradient(GradientMethod::FiniteDifference),
        grid: |grid| grid.grid(GridKind::Dense),
        most: 4_096_000,
        repeated: 102_400,
    },
    Method {
        name: "octree, differences",
        rays: |rays| rays.gradient(GradientMethod::FiniteDifference),
        grid: |grid| grid,
        most: 4_096_000,
        repeated: 102_400,
    },
    Method { name: "octree, own derivatives", rays: own, grid: |grid| grid, most: u64::MAX, repeated: 1_024_000 },
    Method {
        name: "own, `--pooling auto`",
        rays: own,
        grid: |grid| grid.pooling(Pooling::Auto),
        most: u64::MAX,
        repeated: 1_024_000,
    },
    Method {
        name: "own, `--refine sensitivity,ray-count`",
        rays: own,
        grid: |grid| grid.criteria([Criterion::Sensitivity, Criterion::RayCount].into_iter().collect()),
        most: 1_024_000,
        repeated: 102_400,
    },
];

fn own(rays: RaySettings) -> RaySettings {
    rays.gradient(GradientMethod::Auto)
}

/// Rays a second of the published algorithm in JAX: a tuned program that is not part of this repository, on the machine
/// of the report and from the same cameras. It reads no other kind of model than these scenes have.
const PEER_SPEEDS: [(&str, f64); 2] = [("lego", 13_366.0), ("Ignatius", 10_792.0)];

/// The peer's curve: it draws random rays for a dense grid, so its errors are those of the first method, at the times
/// that it takes for as many rays.
fn peer(random: &Curve, rays_per_second: f64) -> Curve {
    let points = COUNTS.iter().zip(&random.points);
    let points = points.map(|(&rays, &(_, error))| ((rays as f64 / rays_per_second).log10(), error)).collect();
    Curve { name: "published algorithm in JAX".into(), points, reference: true }
}

/// Numbers of rays.
const COUNTS: [u64; 7] = [10_240, 40_960, 102_400, 409_600, 1_024_000, 4_096_000, 10_240_000];

/// Error over rays, time and memory, with a plot for each scene; AUSE where the truth is known.
///
/// Scenes come with their most rays, and with those of their reference.
pub fn rays(work: &Work, scenes: &[(Scene, u64, u64)], truth: Option<&Truth>) -> Result<(String, String)> {
    let head = ["scene", "rays", "method", "s, median", "bytes for queries"];
    let mut table = Table::new(&[&head[..], &ERROR_COLUMNS, &["AUSE (MAE), `u-spread`"]].concat());
    for (scene, most, of_reference) in scenes {
        let reference = reference(work, scene, *of_reference)?;
        let mut curves: Vec<Curve> =
            METHODS.iter().map(|m| Curve { name: m.name.into(), points: Vec::new(), reference: false }).collect();
        for rays in COUNTS.into_iter().filter(|rays| rays <= most) {
            let fitting: Vec<usize> = (0..METHODS.len()).filter(|&i| rays <= METHODS[i].most).collect();
            let rows = alternating(&fitting, &SEEDS, |&i, seed| {
                let Method { name, rays: with, grid: on, repeated, .. } = &METHODS[i];
                if rays > *repeated && seed != SEEDS[0] {
                    return Ok(None);
                }
                let settings = with(scene.settings.rays(rays)).seed(seed);
                let make = || {
                    let run = run(scene, &settings, &on(grid(GridKind::Octree, 8)))?;
                    let mut row = Row::new(&run, Some(&reference))?;
                    row.ause = truth.map(|truth| ause(scene, truth, run)).transpose()?;
                    Ok(row)
                };
                work.row((format!("{}, {name}", scene.name), rays, seed), make).map(Some)
            })?;
            for (i, rows) in fitting.into_iter().zip(rows) {
                let (Method { name, .. }, curve, rows) = (&METHODS[i], &mut curves[i], Rows(rows));
                curve.points.push((rows.seconds().log10(), rows.mean(|row| row.surfaces[0]).log10()));
                let ause: Option<Vec<f64>> = rows.0.iter().map(|row| row.ause).collect();
                let head = [
                    scene.name.to_string(),
                    whole(rays as f64),
                    (*name).to_string(),
                    format!("{:.2}", rows.seconds()),
                    whole(rows.mean(|row| row.bytes)),
                ];
                let ause = ause.map_or("–".into(), |values| spread(&values, 3));
                table.row(&[&head[..], &rows.errors(), &[ause]].concat());
            }
        }
        let word = scene.name.split([' ', ',']).next().unwrap_or(scene.name);
        if let Some((_, speed)) = PEER_SPEEDS.iter().find(|(name, _)| *name == word) {
            curves.push(peer(&curves[0], *speed));
        }
        let file = folder().join(format!("speed_vs_error_{word}.svg"));
        let title = format!("{}: error on surfaces against time", scene.name);
        write_plot(&file, &title, ["log10 seconds", "log10 mean |Δ log10 U|"], &curves)?;
    }
    let varied = ["rays", "pixels", "gradient", "grid", "occupancy", "pooling"];
    let described = describe(&scenes[0].0.settings, &grid(GridKind::Octree, 8), &varied);
    let references: Vec<String> =
        scenes.iter().map(|(scene, _, rays)| format!("{} for {}", whole(*rays as f64), scene.name)).collect();
    Ok((
        format!(
            "{described} {} Rows without a spread are of the first seed alone. {TIMES}. Errors are |Δ log10 U| against \
             a dense grid of random rays of another seed, with exact derivatives and cutoff 1e-8: {}.",
            seeds(&SEEDS),
            references.join(", ")
        ),
        table.text().into(),
    ))
}

fn ause(scene: &Scene, truth: &Truth, run: Run) -> Result<f64> {
    let reading = Reading { name: "U".into(), field: run.field, averages: vec![RayAverage::USpread] };
    Ok(truth.rank(scene, &[reading])?.ranks[0].mae)
}

/// Time per ray over levels, on leaves as fine as the lattice, and no finer than four rays a vertex support.
pub fn levels(work: &Work, lego: &Scene) -> Result<(String, String)> {
    let mut table = Table::new(&[
        "level",
        "leaves",
        "s, median",
        "to level 8",
        "µs / ray",
        "vertices",
        "bytes for queries",
        "dense f32 grid, bytes",
    ]);
    let rays = lego.settings.gradient(GradientMethod::Analytic);
    let free = (7..=11).map(|level| (grid(GridKind::Octree, level), "as fine as the level"));
    let criteria = [Criterion::Sensitivity, Criterion::RayCount].into_iter().collect();
    let limited =
        (8..=12).map(|level| (grid(GridKind::Octree, level).criteria(criteria), "`--refine sensitivity,ray-count`"));
    let ways: Vec<(GridSettings, &str)> = free.chain(limited).collect();
    let rows = alternating(&ways, &SEEDS, |(grid, leaves), seed| {
        let make = || Row::new(&run(lego, &rays.seed(seed), grid)?, None);
        work.row((format!("level {}, {leaves}", grid.level), rays.rays, seed), make).map(Some)
    })?;
    let rows: Vec<Rows> = rows.into_iter().map(Rows).collect();
    let times: Vec<Vec<f64>> = rows.iter().map(|rows| rows.all(|row| row.seconds)).collect();
    let level_8 = ways.iter().position(|(grid, _)| grid.level == 8).expect("level 8 is among them");
    for (((grid, leaves), rows), of) in ways.iter().zip(&rows).zip(&times) {
        let dense = 4 * grid.lattice(octobayes::geometry::Domain::Box(lego.field.bounds()))?.dense_vertices();
        table.row(&[
            grid.level.to_string(),
            (*leaves).into(),
            format!("{:.2}", rows.seconds()),
            ratio(of, &times[level_8]),
            format!("{:.1}", rows.seconds() * 1e6 / rays.rays as f64),
            whole(rows.mean(|row| row.vertices)),
            whole(rows.mean(|row| row.bytes)),
            whole(dense as f64),
        ]);
    }
    let described = describe(&rays, &grid(GridKind::Octree, 8), &["level"]);
    Ok((format!("{}. {described} {} {TIMES}.", lego.name, seeds(&SEEDS)), table.text().into()))
}
