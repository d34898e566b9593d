//! How far from the limit: error bars against the errors found with twenty times the rays.

use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::octree::VertexId;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Support, UncertaintyField};
use octobayes::zoo;

use super::scenes::{Scene, scenes};

/// Rays of the run that stands for the limit, per ray of the run that is judged.
const MORE: u64 = 20;

/// A vertex that moved: rays, log10 U minus its limit, its error bar.
struct Judged {
    rays: u32,
    error: f64,
    bar: Option<f64>,
}

/// Rays of a scene of the zoo, and groups of its error bars.
const ZOO_RAYS: u64 = 16_384;
const ZOO_GROUPS: u16 = 8;

/// Tables of every scene and number of groups, and of the zoo.
pub fn honesty() -> Result<()> {
    println!(
        "\n# How far from the limit\n\nVertices that the run or the one of {MORE} times the rays moved by more than half a decade."
    );
    for scene in scenes()? {
        let limit = scene.limit()?;
        for groups in [2, 8, 16] {
            let field = scene.with_error_bars(groups)?;
            table(&scene, groups, &judged(&field, &limit));
            on_surfaces(&field, &limit, groups);
        }
    }
    zoo_table()
}

impl Scene {
    fn grid(&self) -> GridSettings {
        GridSettings::default().level(self.level).tolerance(0.0).surface_points(20_000)
    }

    fn settings(&self) -> RaySettings {
        RaySettings::default().rays(self.rays).gradient(GradientMethod::Auto)
    }

    /// What stands for the limit.
    fn limit(&self) -> Result<UncertaintyField> {
        let many = self.settings().rays(MORE * self.rays).seed(77);
        Ok(Estimation::new(&*self.field, &self.cameras).rays(many).grid(self.grid()).run()?.field)
    }

    fn with_error_bars(&self, groups: u16) -> Result<UncertaintyField> {
        let (field, cameras) = (&*self.field, &self.cameras);
        Ok(Estimation::new(field, cameras).rays(self.settings()).grid(self.grid()).error_bars(groups).run()?.field)
    }
}

/// Vertices of both fields' octrees; where one has none, it says the prior.
fn judged(field: &UncertaintyField, limit: &UncertaintyField) -> Vec<Judged> {
    let (Support::Octree(a), Support::Octree(b)) = (field.support(), limit.support()) else { return Vec::new() };
    let (bars, sums) = (field.error_bars(), field.sums().unwrap_or_default());
    let moved = field.prior() / 10_f64.sqrt();
    let mut out = Vec::new();
    let mut judge = |mine: Option<usize>, theirs: Option<usize>| {
        let u = mine.map_or(field.prior(), |v| field.deviations().get(v));
        let at_limit = theirs.map_or(limit.prior(), |v| limit.deviations().get(v));
        if u.min(at_limit) < moved {
            let bar = mine.zip(bars).and_then(|(v, bars)| bars.get(v));
            out.push(Judged { rays: mine.map_or(0, |v| sums[v].rays), error: (u / at_limit).log10(), bar });
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
struct Calibration {
    known: usize,
    bias: f64,
    true_rms: f64,
    rms: f64,
    true_mean: f64,
    mean: f64,
}

impl Calibration {
    fn of(judged: &[&Judged], groups: u16) -> Self {
        let known: Vec<(f64, f64)> = judged.iter().filter_map(|j| j.bar.map(|bar| (j.error, bar))).collect();
        let n = known.len() as f64;
        let rms = |f: fn(&(f64, f64)) -> f64| (known.iter().map(|p| f(p).powi(2)).sum::<f64>() / n).sqrt();
        let mean = |f: fn(&(f64, f64)) -> f64| known.iter().map(f).sum::<f64>() / n;
        Self {
            known: known.len(),
            bias: mean(|p| p.0),
            true_rms: rms(|p| p.0),
            rms: rms(|p| p.1),
            true_mean: mean(|p| p.0.abs()),
            mean: mean_of_absolute(groups) * mean(|p| p.1),
        }
    }

    /// The row of a table: what it is of, how many vertices, share of known errors, and the rest unless too few are known.
    fn row(&self, name: &str, vertices: usize) -> String {
        let share = self.known as f64 / vertices as f64;
        if self.known < FEWEST {
            return format!("| {name} | {vertices} | {share:.2} | | | | | | | |");
        }
        let Self { bias, true_rms, rms, true_mean, mean, .. } = self;
        format!(
            "| {name} | {vertices} | {share:.2} | {bias:+.3} | {true_rms:.3} | {rms:.3} | {:.2} | {true_mean:.3} | {mean:.3} | {:.2} |",
            rms / true_rms,
            mean / true_mean
        )
    }
}

/// Fewer vertices say nothing of a calibration.
const FEWEST: usize = 30;

/// Prints the head of a table of [`Calibration::row`]s.
fn head(of: &str) {
    println!("| {of} | vertices | error known | bias | true rms | estimated | ratio | true mean | estimated | ratio |");
    println!("|---|---|---|---|---|---|---|---|---|---|");
}

fn table(scene: &Scene, groups: u16, all: &[Judged]) {
    println!("\n## {}, level {}, {} rays, {groups} groups\n", scene.name, scene.level, scene.rays);
    head("rays of a vertex");
    let bins = [(0, 1), (1, 2), (2, 4), (4, 8), (8, 16), (16, 32), (32, 64), (64, 128), (128, u32::MAX), (0, u32::MAX)];
    for (least, below) in bins {
        let bin: Vec<&Judged> = all.iter().filter(|j| (least..below).contains(&j.rays)).collect();
        if bin.len() < FEWEST {
            continue;
        }
        let name = match (least, below) {
            (0, u32::MAX) => "all".into(),
            (least, u32::MAX) => format!("{least} and more"),
            (least, below) if below == least + 1 => format!("{least}"),
            (least, below) => format!("{least} to {}", below - 1),
        };
        println!("{}", Calibration::of(&bin, groups).row(&name, bin.len()));
    }
}

/// All scenes of the zoo that are not refused and move enough vertices, one row each.
fn zoo_table() -> Result<()> {
    println!("\n## The zoo, {ZOO_RAYS} rays, {ZOO_GROUPS} groups, every scene at its own level\n");
    head("scene");
    for hard in zoo::all().into_iter().filter(|scene| scene.verdict != zoo::Verdict::Refused) {
        let (name, level, cameras) = (hard.name, hard.level, hard.cameras());
        let scene = Scene { name, field: Box::new(hard.field), cameras, level, rays: ZOO_RAYS };
        let limit = scene.limit()?;
        let judged = judged(&scene.with_error_bars(ZOO_GROUPS)?, &limit);
        if judged.len() >= FEWEST {
            let all: Vec<&Judged> = judged.iter().collect();
            println!("{}", Calibration::of(&all, ZOO_GROUPS).row(name, all.len()));
        }
    }
    Ok(())
}

/// The same at points between vertices, where errors are added as if all were off to the same side.
fn on_surfaces(field: &UncertaintyField, limit: &UncertaintyField, groups: u16) {
    let answers = limit.surface().iter().map(|&x| {
        let answer = field.query(x.into());
        (answer.uncertainty.log10() - limit.log10(x.into()), answer.log10_error)
    });
    let answers: Vec<(f64, Option<f64>)> = answers.collect();
    if answers.is_empty() {
        return;
    }
    let known: Vec<(f64, f64)> = answers.iter().filter_map(|a| a.1.map(|bar| (a.0, bar))).collect();
    let rms = |f: fn(&(f64, f64)) -> f64| (known.iter().map(|p| f(p).powi(2)).sum::<f64>() / known.len() as f64).sqrt();
    let (found, estimated) = (rms(|p| p.0), rms(|p| p.1));
    println!(
        "\n{} points on surfaces, {groups} groups: error known at {:.1} %; there true rms {found:.3}, estimated {estimated:.3}, ratio {:.2}",
        answers.len(),
        100.0 * known.len() as f64 / answers.len() as f64,
        estimated / found
    );
}
