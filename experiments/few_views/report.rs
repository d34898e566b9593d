//! The tables, as Markdown, and the block of the report.

use std::fmt::Write as _;
use std::path::Path;

use octobayes::evaluate::Baseline;
use octobayes::posterior::Covariance;
use octobayes::{Error, Result};

use crate::common::clock::Time;
use crate::common::index;
use crate::common::program::{folder, stamp};
use crate::common::report;
use crate::common::table::{self, deviation, mean as mean_of};
use crate::common::work::Dated;
use crate::picture::{DEFAULT, FOUND, best_baseline, best_reading, title};
use crate::plan::{AVERAGES, COVARIANCES, Plan};
use crate::scene::{CleanUpRow, Entry, Kind, SceneResult};

/// The block of the report.
const BLOCK: &str = "tables";

/// A table with its title.
struct Table(String, table::Table);

impl Table {
    fn new(title: &str, head: &[String]) -> Self {
        let head: Vec<&str> = head.iter().map(String::as_str).collect();
        Self(format!("\n### {title}\n\n"), table::Table::new(&head))
    }

    fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.1.row(&cells.into_iter().collect::<Vec<String>>());
    }

    fn text(&self) -> String {
        format!("{}{}", self.0, self.1.text())
    }
}

fn heads(names: &[&str]) -> Vec<String> {
    names.iter().map(|n| (*n).into()).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    mean_of(&values.collect::<Vec<f64>>())
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".into(), |v| format!("{v:.digits$}"))
}

/// A number of the area table.
type Pick = fn(&Entry) -> f64;

/// The default's area relative to that of the best measure without a Hessian.
fn ratio(result: &SceneResult, entry: &Entry) -> f64 {
    entry.mae / best_baseline(&result.entries).map_or(f64::NAN, |b| b.mae)
}

/// All tables of the scenes done; says which were not.
pub fn tables(plan: &Plan, done: &[SceneResult], left: &[String]) -> String {
    let mut out = String::new();
    if done.is_empty() {
        return "\nNo scene is done.\n".into();
    }
    let left = if left.is_empty() { "none".into() } else { left.join("; ") };
    writeln!(out, "\n{} scenes done. Not run: {left}.", done.len()).expect("writing to a string");
    out += &scenes(done).text();
    for (name, pick) in [
        ("AUSE of the mean absolute error, all pixels together", (|e| e.mae) as Pick),
        ("AUSE of the RMSE, all pixels together", |e| e.rmse),
        ("AUSE of the mean absolute error, mean over views", |e| e.per_view),
    ] {
        out += &areas(name, done, pick).text();
    }
    out += &choices(plan, done);
    out += &targets(done);
    out += &clean_ups(done).text();
    out += &costs(plan, done).text();
    out
}

fn scenes(done: &[SceneResult]) -> Table {
    let head = [
        "scene",
        "views",
        "PSNR train",
        "PSNR test",
        "test views",
        "pixels",
        "nothing shown",
        "error: median",
        "MAE",
        "95 %",
    ];
    let mut table = Table::new("Models and their depth errors (scene units)", &heads(&head));
    for r in done {
        table.row([
            r.name.clone(),
            r.views.to_string(),
            optional(r.costs.training.map(|t| t.psnr), 2),
            format!("{:.2}", r.psnr_test),
            r.test_views.to_string(),
            r.depth.pixels.to_string(),
            r.empty.to_string(),
            format!("{:.4}", r.depth.median),
            format!("{:.4}", r.depth.mean),
            format!("{:.4}", r.depth.percentile_95),
        ]);
    }
    table
}

/// The columns of the area tables: kind, name, variant.
fn columns() -> Vec<(Kind, &'static str, &'static str)> {
    let spread = COVARIANCES.iter().map(|c| (Kind::RayAverage, c.name(), "spread"));
    let mean = (Kind::RayAverage, "diagonal", "weighted-mean");
    let baselines =
        [Baseline::RayVariance, Baseline::RayEntropy, Baseline::Transparency, Baseline::RayCount, Baseline::Random];
    let ensembles = [Baseline::EnsembleVariance, Baseline::DensityAware];
    spread
        .chain([mean, FOUND])
        .chain(baselines.map(|b| (Kind::Baseline, b.name(), "")))
        .chain(ensembles.map(|b| (Kind::Ensemble, b.name(), "")))
        .collect()
}

/// One row a scene; the best of each row without an ensemble is bold, and the last row is over scenes.
fn areas(name: &str, done: &[SceneResult], pick: Pick) -> Table {
    let columns = columns();
    let mut head = heads(&["scene"]);
    head.extend(columns.iter().map(|(kind, name, variant)| match kind {
        Kind::Level => format!("{name}, level {variant}, spread"),
        Kind::RayAverage => format!("{name}, {variant}"),
        _ => (*name).to_string(),
    }));
    let mut table = Table::new(name, &head);
    let of = |r: &SceneResult, (kind, name, variant): (Kind, &str, &str)| r.entry(kind, name, variant).map(pick);
    for r in done {
        let single = columns.iter().filter(|c| c.0 != Kind::Ensemble).filter_map(|&c| of(r, c));
        let best = single.fold(f64::INFINITY, f64::min);
        let cell = |c: &(Kind, &str, &str)| {
            let value = of(r, *c);
            let text = optional(value, 3);
            if value == Some(best) { format!("**{text}**") } else { text }
        };
        table.row([r.name.clone()].into_iter().chain(columns.iter().map(cell)));
    }
    let means = columns.iter().map(|&c| {
        let values: Vec<f64> = done.iter().filter_map(|r| of(r, c)).collect();
        // A mean over other scenes than the neighbouring columns' would mislead.
        if values.len() < done.len() {
            "–".into()
        } else {
            format!("{:.3} ± {:.3}", mean_of(&values), deviation(&values))
        }
    });
    table.row(["mean ± deviation over scenes".to_string()].into_iter().chain(means));
    table
}

/// Means over scenes of every choice of a reading: ray average, level, λ.
fn choices(plan: &Plan, done: &[SceneResult]) -> String {
    let mut out = String::new();
    let mut add = |title: &str, what: &str, kind: Kind, variants: Vec<String>| {
        let head = heads(&[what]).into_iter().chain(COVARIANCES.iter().map(|c| c.name().to_string()));
        let mut table = Table::new(title, &head.collect::<Vec<_>>());
        for variant in variants {
            let cell = |c: Covariance| {
                // The default level and λ are among the ray averages.
                let entries: Vec<(&SceneResult, &Entry)> = done
                    .iter()
                    .filter_map(|r| {
                        let own = r.entry(kind, c.name(), &variant);
                        Some((
                            r,
                            own.or_else(|| {
                                r.entry(Kind::RayAverage, c.name(), "spread").filter(|_| variant.ends_with('*'))
                            })?,
                        ))
                    })
                    .collect();
                if entries.is_empty() {
                    return "–".into();
                }
                let area = mean(entries.iter().map(|(_, e)| e.mae));
                let wins = entries.iter().filter(|(r, e)| ratio(r, e) < 1.0).count();
                let worst = entries.iter().map(|(r, e)| ratio(r, e)).fold(0.0, f64::max);
                format!("{area:.3} ({wins} of {}, {worst:.2})", entries.len())
            };
            table.row([variant.clone()].into_iter().chain(COVARIANCES.map(cell)));
        }
        out.push_str(&table.text());
    };
    let what = "mean AUSE (MAE) over scenes (scenes in which it beats the best measure without a Hessian, worst \
                ratio to that)";
    let averages = AVERAGES.iter().map(|a| a.name().to_string()).collect();
    add(&format!("Ray average, level {}: {what}", plan.level), "ray average", Kind::RayAverage, averages);
    let mut levels = plan.other_levels.clone();
    levels.sort_unstable();
    let mut levels: Vec<String> = levels.iter().map(u8::to_string).collect();
    levels.push(format!("{} *", plan.level));
    add("Level, averaged as `spread` (* the default)", "level", Kind::Level, levels);
    let mut lambdas: Vec<(f64, String)> = plan.lambdas.iter().map(|f| (*f, format!("{f:e}"))).collect();
    lambdas.push((1.0, "1 *".into()));
    lambdas.sort_by(|a, b| a.0.total_cmp(&b.0));
    let lambdas = lambdas.into_iter().map(|l| l.1).collect();
    add("λ, as a factor of the default, averaged as `spread` (* the default)", "factor", Kind::Lambda, lambdas);

    let head = heads(&["scene", "best reading of H", "AUSE", "best without a Hessian", "AUSE", "default", "ratio"]);
    let mut table = Table::new("Best of each scene (MAE)", &head);
    for r in done {
        let (Some(reading), Some(baseline)) = (best_reading(&r.entries), best_baseline(&r.entries)) else { continue };
        let default = r.entry(DEFAULT.0, DEFAULT.1, DEFAULT.2);
        table.row([
            r.name.clone(),
            title(reading),
            format!("{:.3}", reading.mae),
            title(baseline),
            format!("{:.3}", baseline.mae),
            optional(default.map(|e| e.mae), 3),
            optional(default.map(|e| ratio(r, e)), 2),
        ]);
    }
    out + &table.text()
}

/// The targets, as met or missed. Scenes that were seen from everywhere do not count for the first two.
fn targets(done: &[SceneResult]) -> String {
    let mut out = String::from("\n### Targets\n\n");
    let few: Vec<&SceneResult> = done.iter().filter(|r| !r.name.contains("100 views")).collect();
    let of =
        |r: &SceneResult, kind, name: &str, variant: &str| r.entry(kind, name, variant).map_or(f64::NAN, |e| e.mae);
    let default = mean(few.iter().map(|r| of(r, DEFAULT.0, DEFAULT.1, DEFAULT.2)));
    let single = [Baseline::RayVariance, Baseline::RayEntropy, Baseline::Transparency, Baseline::RayCount];
    let means = single.map(|b| (b.name(), mean(few.iter().map(|r| of(r, Kind::Baseline, b.name(), "")))));
    let best = means.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or(("none", f64::NAN));
    let verdict = |met: bool| if met { "met" } else { "missed" };
    let mut line = |text: String| out.push_str(&format!("- {text}\n"));
    line(format!(
        "Few-view and half scenes ({}): mean AUSE {default:.3} of the default reading, {:.3} of the best measure \
         without a Hessian ({}), ratio {:.2}; at most 0.90 wanted: **{}**.",
        few.len(),
        best.1,
        best.0,
        default / best.1,
        verdict(default <= 0.9 * best.1)
    ));
    let (kind, name, variant) = FOUND;
    let found = mean(few.iter().map(|r| of(r, kind, name, variant)));
    let wins = few.iter().filter(|r| r.entry(kind, name, variant).is_some_and(|e| ratio(r, e) < 1.0)).count();
    if found.is_finite() {
        line(format!(
            "The same for `{name}` at level {variant}, chosen on the first two scenes: {found:.3}, ratio {:.2}; it \
             beats the best such measure of the scene itself in {wins} of {}.",
            found / best.1,
            few.len()
        ));
    }
    let with: Vec<&&SceneResult> = few.iter().filter(|r| r.costs.ensemble.is_some()).collect();
    if !with.is_empty() {
        let default = mean(with.iter().map(|r| of(r, DEFAULT.0, DEFAULT.1, DEFAULT.2)));
        let ensemble = mean(with.iter().map(|r| of(r, Kind::Ensemble, Baseline::EnsembleVariance.name(), "")));
        let ours =
            mean(with.iter().map(|r| r.costs.estimation.time.cpu + r.costs.training.map_or(0.0, |t| t.time.cpu)));
        let theirs = mean(with.iter().map(|r| r.costs.ensemble.map_or(0.0, |t| t.cpu)));
        let alone = mean(with.iter().map(|r| r.costs.estimation.time.cpu));
        line(format!(
            "The {} scenes with ensembles: mean AUSE {default:.3} of the default reading, {ensemble:.3} of the \
             ensemble's depth variance, ratio {:.2}; at most 1.15 wanted: **{}**. Processor time of one model and its \
             uncertainty {ours:.0} s ({alone:.0} s of it the uncertainty), of the ensemble {theirs:.0} s: {:.2} \
             ({:.2} for the uncertainty alone); at most 0.10 wanted: **{}** ({} for the uncertainty alone).",
            with.len(),
            default / ensemble,
            verdict(default <= 1.15 * ensemble),
            ours / theirs,
            alone / theirs,
            verdict(ours <= 0.1 * theirs),
            verdict(alone <= 0.1 * theirs)
        ));
    }
    let gains: Vec<String> = done
        .iter()
        .filter_map(|r| {
            let best = r.clean_up[1..].iter().filter(|c| c.coverage >= 0.7).max_by(|a, b| a.psnr.total_cmp(&b.psnr))?;
            let gain = best.psnr - r.clean_up[0].psnr;
            (gain > 0.005).then(|| format!("{} (+{gain:.2} dB)", r.name))
        })
        .collect();
    line(format!(
        "Clean-up with a gain of PSNR (whole held-out images, best threshold) at a coverage of at least 0.7: {} \
         scenes, 3 wanted: **{}**{}{}.",
        gains.len(),
        verdict(gains.len() >= 3),
        if gains.is_empty() { "" } else { ": " },
        gains.join(", ")
    ));
    out
}

fn clean_ups(done: &[SceneResult]) -> Table {
    let head =
        ["scene", "as it is", "threshold 0.9", "threshold 0.4", "best", "its threshold", "best with coverage >= 0.7"];
    let mut table =
        Table::new("Clean-up by the default reading: PSNR dB / SSIM / SSIMULACRA 2 / coverage", &heads(&head));
    let cell = |c: Option<&CleanUpRow>| {
        c.map_or("–".into(), |c| format!("{:.2} / {:.3} / {:.0} / {:.2}", c.psnr, c.ssim, c.ssimulacra2, c.coverage))
    };
    for r in done {
        let at = |t: Option<f64>| r.clean_up.iter().find(|c| c.threshold == t);
        let cleaned = &r.clean_up[1..];
        let best = |least: f64| {
            let some = cleaned.iter().filter(|c| c.coverage >= least);
            some.reduce(|best, c| if c.psnr > best.psnr { c } else { best })
        };
        table.row([
            r.name.clone(),
            cell(at(None)),
            cell(at(Some(0.9))),
            cell(at(Some(0.4))),
            cell(best(0.0)),
            optional(best(0.0).and_then(|c| c.threshold), 1),
            cell(best(0.7)),
        ]);
    }
    table
}

fn costs(plan: &Plan, done: &[SceneResult]) -> Table {
    let head = [
        "scene",
        "training, s",
        "model, MB",
        "uncertainty, s",
        "its vertices",
        "for queries, MB",
        "while summing, MB",
        "rendering the views, s",
        "one reading more, s",
        "ray measures more, s",
        "ensemble: training, s",
        "its rendering, s",
        "its models, MB",
    ];
    let mut table = Table::new("Processor seconds (all threads together) and memory of each measure", &heads(&head));
    for r in done {
        let c = &r.costs;
        let megabytes = |bytes: usize| format!("{:.1}", bytes as f64 / 1e6);
        let members = c.ensemble.map(|_| plan.members as f64);
        table.row([
            r.name.clone(),
            optional(c.training.map(|t| t.time.cpu), 1),
            megabytes(c.model_bytes),
            format!("{:.1}", c.estimation.time.cpu),
            c.estimation.vertices.to_string(),
            megabytes(c.estimation.query_bytes),
            megabytes(c.estimation.summing_bytes),
            format!("{:.1}", c.rendering.cpu),
            format!("{:.1}", c.reading.cpu),
            "within the rendering".into(),
            optional(c.ensemble.map(|e| e.cpu), 0),
            optional(members.map(|n| n * c.rendering.cpu), 0),
            optional(members.map(|n| n * c.model_bytes as f64 / 1e6), 1),
        ]);
    }
    table
}

/// Rows of pictures and plots, as links.
fn pictures(plan: &Plan, folder: &str, done: &[SceneResult]) -> String {
    let mut out = String::from("\n### Pictures\n");
    for r in done {
        let Some(scene) = plan.scenes().into_iter().find(|scene| scene.name == r.name) else { continue };
        let (name, slug) = (&r.name, &r.slug);
        let mut line = format!("\n**{name}** ([sparsification]({folder}/{slug}.svg)");
        line += &if scene.data.may_be_pictured() {
            format!(", [clean-up]({folder}/{slug}-clean-up.png))\n")
        } else {
            ")\n".into()
        };
        out += &line;
    }
    out
}

/// Rewrites the report's block and copies the pictures beside it.
pub fn write(plan: &Plan, results: &[Dated<SceneResult>], left: &[String], work: &Path) -> Result<()> {
    let done: Vec<SceneResult> = results.iter().map(|result| result.value.clone()).collect();
    let reports = folder();
    let pictured = reports.join("few_views");
    for r in &done {
        for (from, to) in [("sparsification.svg", ".svg"), ("clean-up.png", "-clean-up.png")] {
            let (from, to) = (work.join(&r.slug).join(from), pictured.join(format!("{}{to}", r.slug)));
            if from.exists() {
                std::fs::copy(&from, &to).map_err(Error::io(&from, "cannot copy"))?;
            }
        }
    }
    let time = results.iter().fold(Time::default(), |time, result| time + result.time);
    let dates = || results.iter().map(|result| result.date.clone());
    let dates = [dates().min(), dates().max()].map(Option::unwrap_or_default);
    let words = format!(
        "Level {}, {} rays, the field's own derivatives, tolerance 0.01, seed 0 of rays and of training ({} steps; \
         ensembles: seeds 0 to {}). Spread is over scenes.",
        plan.level,
        table::whole(plan.rays as f64),
        plan.steps,
        plan.members - 1,
    );
    let body =
        format!("{} {words}\n{}{}", stamp(dates, time), tables(plan, &done, left), pictures(plan, "few_views", &done));
    report::rewrite(&reports.join("few_views.md"), BLOCK, &body)?;
    index::update(&reports)
}
