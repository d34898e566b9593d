//! How far from the limit: error bars against the errors found with twenty times the rays.

use octobayes::Result;
use octobayes::estimate::{GridSettings, RaySettings, estimate, estimate_with_error_bars};
use octobayes::monitor::Silent;
use octobayes::octree::VertexId;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Support, UncertaintyField};

use super::scenes::{Scene, scenes};

/// Rays of the run that stands for the limit, per ray of the run that is judged.
const MORE: u64 = 20;

/// A vertex that moved: rays, log10 U minus its limit, its error bar.
struct Judged {
    rays: u32,
    error: f64,
    bar: Option<f64>,
}

/// Tables of every scene and number of groups.
pub fn honesty() -> Result<()> {
    println!(
        "\n# How far from the limit\n\nVertices that the run or the one of {MORE} times the rays moved by more than half a decade."
    );
    for scene in scenes()? {
        let grid =
            GridSettings { level: scene.level, tolerance: 0.0, surface_points: 20_000, ..GridSettings::default() };
        let settings = RaySettings { rays: scene.rays, gradient: GradientMethod::Auto, ..RaySettings::default() };
        let many = RaySettings { rays: MORE * scene.rays, seed: 77, ..settings };
        let (limit, _) = estimate(&*scene.field, &scene.cameras, &many, &grid, &Silent)?;
        for groups in [2, 8, 16] {
            let (field, _) =
                estimate_with_error_bars(&*scene.field, &scene.cameras, &settings, &grid, groups, &Silent)?;
            table(&scene, groups, &judged(&field, &limit));
            on_surfaces(&field, &limit, groups);
        }
    }
    Ok(())
}

/// Vertices of both fields' octrees; where one has none, it says the prior.
fn judged(field: &UncertaintyField, limit: &UncertaintyField) -> Vec<Judged> {
    let (Support::Octree(a), Support::Octree(b)) = (field.support(), limit.support()) else { return Vec::new() };
    let (bars, evidence) = (field.error_bars(), field.evidence().unwrap_or_default());
    let moved = field.prior() / 10_f64.sqrt();
    let mut out = Vec::new();
    let mut judge = |mine: Option<usize>, theirs: Option<usize>| {
        let u = mine.map_or(field.prior(), |v| field.deviations().get(v));
        let at_limit = theirs.map_or(limit.prior(), |v| limit.deviations().get(v));
        if u.min(at_limit) < moved {
            let bar = mine.zip(bars).and_then(|(v, bars)| bars.get(v));
            out.push(Judged { rays: mine.map_or(0, |v| evidence[v].rays), error: (u / at_limit).log10(), bar });
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

fn table(scene: &Scene, groups: u16, all: &[Judged]) {
    println!("\n## {}, level {}, {} rays, {groups} groups\n", scene.name, scene.level, scene.rays);
    println!(
        "| rays of a vertex | vertices | error known | bias | true rms | estimated | ratio | true mean | estimated | ratio |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let bins = [(0, 1), (1, 2), (2, 4), (4, 8), (8, 16), (16, 32), (32, 64), (64, 128), (128, u32::MAX), (0, u32::MAX)];
    for (least, below) in bins {
        let bin: Vec<&Judged> = all.iter().filter(|j| (least..below).contains(&j.rays)).collect();
        if bin.len() < 30 {
            continue;
        }
        let known: Vec<(f64, f64)> = bin.iter().filter_map(|j| j.bar.map(|bar| (j.error, bar))).collect();
        let n = known.len() as f64;
        let name = match (least, below) {
            (0, u32::MAX) => "all".into(),
            (least, u32::MAX) => format!("{least} and more"),
            (least, below) if below == least + 1 => format!("{least}"),
            (least, below) => format!("{least} to {}", below - 1),
        };
        let share = n / bin.len() as f64;
        if known.len() < 30 {
            println!("| {name} | {} | {share:.2} | | | | | | | |", bin.len());
            continue;
        }
        let rms = |f: fn(&(f64, f64)) -> f64| (known.iter().map(|p| f(p).powi(2)).sum::<f64>() / n).sqrt();
        let mean = |f: fn(&(f64, f64)) -> f64| known.iter().map(f).sum::<f64>() / n;
        let (true_rms, rms) = (rms(|p| p.0), rms(|p| p.1));
        let (true_mean, estimated) = (mean(|p| p.0.abs()), mean_of_absolute(groups) * mean(|p| p.1));
        println!(
            "| {name} | {} | {share:.2} | {:+.3} | {true_rms:.3} | {rms:.3} | {:.2} | {true_mean:.3} | {estimated:.3} | {:.2} |",
            bin.len(),
            mean(|p| p.0),
            rms / true_rms,
            estimated / true_mean
        );
    }
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
