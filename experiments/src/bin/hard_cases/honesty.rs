//! How far from the limit: error bars against the errors found with twenty times the rays.

use octobayes::estimate::{GridSettings, RaySettings};
use octobayes::octree::VertexId;
use octobayes::posterior::Pooling;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Support, UncertaintyField};
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use crate::scenes::{self as hard, Verdict};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread, whole};
use common::work::Work;

/// Rays of the run that stands for the limit, per ray of the run that is judged.
pub const MORE: u64 = 20;

/// A vertex that moved: rays, log10 U minus its limit, its error bar.
pub struct Judged {
    pub rays: u32,
    pub error: f64,
    bar: Option<f64>,
    /// Whether it moved by more than half a decade in the run that is judged.
    pub has_moved: bool,
}

/// Rays of a scene of the zoo.
pub const ZOO_RAYS: u64 = 16_384;

pub const SEEDS: [u64; 3] = [0, 1, 2];
/// Of the run that stands for the limit.
pub const LIMIT_SEED: u64 = 77;
const GROUPS: [u16; 3] = [2, 8, 16];
/// The number of groups by default.
const DEFAULT_GROUPS: u16 = 8;

/// Pooling needs a tolerance, below which vertices have not moved.
pub fn grid(scene: &Scene) -> GridSettings {
    scene.grid.tolerance(if scene.grid.pooling.is_on() { 0.01 } else { 0.0 })
}

pub fn settings(scene: &Scene) -> RaySettings {
    scene.settings.gradient(GradientMethod::Auto)
}

/// What stands for the limit.
pub fn limit(scene: &Scene) -> Result<UncertaintyField> {
    let many = settings(scene).rays(MORE * scene.settings.rays).seed(LIMIT_SEED);
    let grid = scene.grid.pooling(Pooling::Off).tolerance(0.0);
    Ok(scene.estimation(many, grid).run()?.field.without_sums())
}

fn with_error_bars(scene: &Scene, seed: u64, groups: u16) -> Result<UncertaintyField> {
    Ok(scene.estimation(settings(scene).seed(seed), grid(scene)).error_bars(groups).run()?.field)
}

/// Calibrations of one seed and number of groups.
#[derive(Serialize, Deserialize)]
struct OfSeed {
    all: Option<Calibration>,
    /// By the number of rays of a vertex.
    bins: Vec<Option<Calibration>>,
    /// Points on surfaces: share whose error is known, rms of errors there, rms of error bars there.
    surfaces: [f64; 3],
}

fn of_seed(scene: &Scene, limit: &UncertaintyField, seed: u64, groups: u16) -> Result<OfSeed> {
    let field = with_error_bars(scene, seed, groups)?;
    let judged = judged(&field, limit);
    let of = |(least, below): (u32, u32)| {
        let bin: Vec<&Judged> = judged.iter().filter(|j| (least..below).contains(&j.rays)).collect();
        Calibration::of(&bin, groups)
    };
    Ok(OfSeed {
        all: of((0, u32::MAX)),
        bins: BINS.into_iter().map(of).collect(),
        surfaces: on_surfaces(&field, limit),
    })
}

/// Numbers of rays of a vertex, and one more than the last.
const BINS: [(u32, u32); 8] = [(1, 2), (2, 4), (4, 8), (8, 16), (16, 32), (32, 64), (64, 128), (128, u32::MAX)];

fn bin_name((least, below): (u32, u32)) -> String {
    match below {
        u32::MAX => format!("{least} and more"),
        _ if below == least + 1 => least.to_string(),
        _ => format!("{least} to {}", below - 1),
    }
}

/// Columns behind the first ones of a table of calibrations.
const COLUMNS: [&str; 9] =
    ["vertices", "error known", "bias", "true rms", "estimated", "ratio", "true mean", "estimated", "ratio"];

/// Cells of [`COLUMNS`], over the seeds that have enough vertices; `None` if none has.
fn cells<'a>(seeds: impl Iterator<Item = &'a Option<Calibration>>) -> Option<Vec<String>> {
    let all: Vec<&Calibration> = seeds.flatten().collect();
    if all.is_empty() {
        return None;
    }
    let of = |value: fn(&Calibration) -> f64| all.iter().map(|c| value(c)).collect::<Vec<f64>>();
    let mut cells = vec![
        whole(mean(&of(|c| c.vertices as f64))),
        format!("{:.2}", mean(&of(|c| c.known as f64 / c.vertices as f64))),
    ];
    if all.iter().any(|c| c.known < FEWEST) {
        cells.extend(vec![String::new(); 7]);
        return Some(cells);
    }
    let number = |value: fn(&Calibration) -> f64| format!("{:.3}", mean(&of(value)));
    cells.extend([
        format!("{:+.3}", mean(&of(|c| c.bias))),
        number(|c| c.true_rms),
        number(|c| c.rms),
        spread(&of(|c| c.rms / c.true_rms), 2),
        number(|c| c.true_mean),
        number(|c| c.mean),
        spread(&of(|c| c.mean / c.true_mean), 2),
    ]);
    Some(cells)
}

/// What all tables share.
fn words(scene: &Scene) -> String {
    format!(
        "{} {} The limit: {MORE} times the rays, seed {LIMIT_SEED}. Vertices that either moved by more than half a \
         decade.",
        describe(&settings(scene), &grid(scene), &["rays", "level"]),
        seeds(&SEEDS),
    )
}

/// Every scene with every number of groups, by the rays of a vertex with the default number, and on surfaces.
pub fn scenes(work: &Work, scenes: &[Scene]) -> Result<(String, String)> {
    let mut all = Table::new(&[&["scene", "level", "rays", "groups"][..], &COLUMNS[..]].concat());
    let mut bins = Table::new(&[&["scene", "rays of a vertex"][..], &COLUMNS[..]].concat());
    let mut surfaces = Table::new(&["scene", "groups", "error known", "true rms", "estimated", "ratio"]);
    for scene in scenes {
        let (name, level, rays) = (scene.name, scene.grid.level, scene.settings.rays);
        let limit = work.field(("limit", name, level, rays), || limit(scene))?;
        for groups in GROUPS {
            let of = |seed| work.row((name, level, rays, groups, seed), || of_seed(scene, &limit, seed, groups));
            let found = SEEDS.into_iter().map(of).collect::<Result<Vec<OfSeed>>>()?;
            let head = [name.to_string(), level.to_string(), whole(rays as f64), groups.to_string()];
            if let Some(cells) = cells(found.iter().map(|seed| &seed.all)) {
                all.row(&[&head[..], &cells[..]].concat());
            }
            for (b, bin) in BINS.into_iter().enumerate().filter(|_| groups == DEFAULT_GROUPS) {
                if let Some(cells) = cells(found.iter().map(|seed| &seed.bins[b])) {
                    bins.row(&[&[name.to_string(), bin_name(bin)][..], &cells[..]].concat());
                }
            }
            let of = |value: fn(&[f64; 3]) -> f64| found.iter().map(|seed| value(&seed.surfaces)).collect::<Vec<f64>>();
            surfaces.row(&[
                name.to_string(),
                groups.to_string(),
                format!("{:.3}", mean(&of(|s| s[0]))),
                format!("{:.3}", mean(&of(|s| s[1]))),
                format!("{:.3}", mean(&of(|s| s[2]))),
                spread(&of(|s| s[2] / s[1]), 2),
            ]);
        }
    }
    let body = format!(
        "All vertices:\n\n{}\nBy the rays of a vertex, {DEFAULT_GROUPS} groups:\n\n{}\nAt points on surfaces:\n\n{}",
        all.text(),
        bins.text(),
        surfaces.text()
    );
    Ok((words(&scenes[0]), body))
}

/// Vertices of both fields' octrees; where one has none, it says the prior.
pub fn judged(field: &UncertaintyField, limit: &UncertaintyField) -> Vec<Judged> {
    let (Support::Octree(a), Support::Octree(b)) = (field.support(), limit.support()) else { return Vec::new() };
    let (bars, sums) = (field.error_bars(), field.sums().unwrap_or_default());
    let moved = field.prior() / 10_f64.sqrt();
    let mut out = Vec::new();
    let mut judge = |mine: Option<usize>, theirs: Option<usize>| {
        let u = mine.map_or(field.prior(), |v| field.deviations().get(v));
        let at_limit = theirs.map_or(limit.prior(), |v| limit.deviations().get(v));
        if u.min(at_limit) < moved {
            let bar = mine.zip(bars).and_then(|(v, bars)| bars.get(v));
            let (rays, error) = (mine.map_or(0, |v| sums[v].rays), (u / at_limit).log10());
            out.push(Judged { rays, error, bar, has_moved: u < moved });
        }
    };
    for (v, point) in a.vertex_positions().enumerate() {
        judge(Some(v), b.vertex(point).map(|VertexId(w)| w as usize));
    }
    for (w, point) in b.vertex_positions().enumerate() {
        if a.vertex(point).is_none() {
            judge(None, Some(w));
        }
    }
    out
}

/// E|x| over E[s], x normal and s its standard deviation estimated from so many groups (Holtzman's c₄).
fn mean_of_absolute(groups: u16) -> f64 {
    // Γ((n+1)/2) / Γ(n/2) by its recurrence, from n = 1: 1/√π.
    let ratio = (1..groups - 1).fold(1.0 / std::f64::consts::PI.sqrt(), |r, n| f64::from(n) / 2.0 / r);
    let c4 = (2.0 / f64::from(groups - 1)).sqrt() * ratio;
    (2.0 / std::f64::consts::PI).sqrt() / c4
}

/// What error bars say of vertices whose error they know, and what is true.
#[derive(Serialize, Deserialize)]
struct Calibration {
    vertices: usize,
    known: usize,
    bias: f64,
    true_rms: f64,
    rms: f64,
    true_mean: f64,
    mean: f64,
}

/// Fewer vertices say nothing of a calibration.
pub const FEWEST: usize = 30;

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|v| v * v).collect();
    mean(&squares).sqrt()
}

impl Calibration {
    /// Of these vertices; `None` if they are too few.
    fn of(judged: &[&Judged], groups: u16) -> Option<Self> {
        if judged.len() < FEWEST {
            return None;
        }
        let known: Vec<(f64, f64)> = judged.iter().filter_map(|j| j.bar.map(|bar| (j.error, bar))).collect();
        // Nothing is known of vertices that one group alone has seen.
        let sure = if known.is_empty() { vec![(0.0, 0.0)] } else { known.clone() };
        let mean_of = |f: fn(&(f64, f64)) -> f64| mean(&sure.iter().map(f).collect::<Vec<f64>>());
        Some(Self {
            vertices: judged.len(),
            known: known.len(),
            bias: mean_of(|p| p.0),
            true_rms: rms(sure.iter().map(|p| p.0)),
            rms: rms(sure.iter().map(|p| p.1)),
            true_mean: mean_of(|p| p.0.abs()),
            mean: mean_of_absolute(groups) * mean_of(|p| p.1),
        })
    }
}

/// All scenes of the zoo that are not refused.
pub fn zoo_scenes() -> impl Iterator<Item = Scene> {
    hard::all().into_iter().filter(|scene| scene.verdict != Verdict::Refused).map(|case| Scene {
        name: case.name,
        cameras: case.cameras(),
        settings: RaySettings::default().rays(ZOO_RAYS),
        grid: GridSettings::default().level(hard::LEVEL),
        field: Box::new(case.field),
    })
}

/// All scenes of the zoo that move enough vertices, one row each; `pooling` is that of the runs that are judged, never
/// of the limit.
pub fn zoo(work: &Work, pooling: Pooling) -> Result<(String, String)> {
    let mut table = Table::new(&[&["scene"][..], &COLUMNS[..]].concat());
    let mut said = String::new();
    for scene in zoo_scenes() {
        let name = scene.name;
        let limit = work.field(("limit", name, ZOO_RAYS), || limit(&scene))?;
        let scene = Scene { grid: scene.grid.pooling(pooling), ..scene };
        said = words(&scene);
        // A group whose rays meet a fault too often is refused as a run of its own would be.
        let make = |seed| match of_seed(&scene, &limit, seed, DEFAULT_GROUPS) {
            Err(Error::NonFinite { .. }) => Ok(None),
            made => made.map(Some),
        };
        let of = |seed| work.row((name, ZOO_RAYS, DEFAULT_GROUPS, pooling, seed), || make(seed));
        let found = SEEDS.into_iter().map(of).collect::<Result<Vec<Option<OfSeed>>>>()?;
        if let Some(cells) = cells(found.iter().flatten().map(|seed| &seed.all)) {
            table.row(&[&[name.to_string()][..], &cells[..]].concat());
        }
    }
    let rays = whole(ZOO_RAYS as f64);
    let words = format!(
        "{rays} rays, {DEFAULT_GROUPS} groups, every scene at its own level; a seed is left out if one of its groups \
         meets too many faults. {said}"
    );
    Ok((words, table.text().into()))
}

/// Points between vertices, where errors are added as if all were off to the same side: see [`OfSeed::surfaces`].
fn on_surfaces(field: &UncertaintyField, limit: &UncertaintyField) -> [f64; 3] {
    let answer = |&x: &[f32; 3]| {
        let answer = field.query(x.into());
        answer.log10_error.map(|bar| (answer.uncertainty.log10() - limit.log10(x.into()), bar))
    };
    let points = limit.surface();
    let known: Vec<(f64, f64)> = points.iter().filter_map(answer).collect();
    if known.is_empty() {
        return [0.0; 3];
    }
    [known.len() as f64 / points.len() as f64, rms(known.iter().map(|p| p.0)), rms(known.iter().map(|p| p.1))]
}
