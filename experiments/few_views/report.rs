//! The tables, as Markdown.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use octobayes::evaluate::Baseline;
use octobayes::internal::AtomicFile;
use octobayes::posterior::Covariance;
use octobayes::{Error, Result};

use crate::picture::{DEFAULT, FOUND, best_baseline, best_reading, title};
use crate::plan::{BLENDS, LEVEL_BLENDS, Plan};
use crate::scene::{CleanUpRow, Entry, Kind, SceneResult, variant};

const BEGIN: &str = "<!-- tables: written by the program -->";
const END: &str = "<!-- end of tables -->";

/// Rows of a table.
struct Table(String);

impl Table {
    fn new(title: &str, head: &[String]) -> Self {
        let mut out = Self(format!("\n### {title}\n\n"));
        out.row(head.iter().cloned());
        out.row(head.iter().map(|_| "---".into()));
        out
    }

    fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let cells: Vec<String> = cells.into_iter().collect();
        writeln!(self.0, "| {} |", cells.join(" | ")).expect("writing to a string");
    }
}

fn heads(names: &[&str]) -> Vec<String> {
    names.iter().map(|n| (*n).into()).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
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
    out += &scenes(done).0;
    for (name, pick) in [
        ("AUSE of the mean absolute error, all pixels together", (|e| e.mae) as Pick),
        ("AUSE of the RMSE, all pixels together", |e| e.rmse),
        ("AUSE of the mean absolute error, mean over views", |e| e.per_view),
    ] {
        out += &areas(name, done, pick).0;
    }
    out += &choices(plan, done);
    out += &targets(done);
    out += &clean_ups(done).0;
    out += &costs(plan, done).0;
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
    let spread = Covariance::ALL.iter().map(|c| (Kind::RayAverage, c.name(), "spread"));
    let alone = ["weighted-mean", "at-expected"].map(|v| (Kind::RayAverage, "diagonal", v));
    let baselines =
        [Baseline::RayVariance, Baseline::RayEntropy, Baseline::Transparency, Baseline::RayCount, Baseline::Random];
    let ensembles = [Baseline::EnsembleVariance, Baseline::DensityAware];
    spread
        .chain(alone)
        .chain(FOUND)
        .chain(baselines.map(|b| (Kind::Baseline, b.name(), "")))
        .chain(ensembles.map(|b| (Kind::Ensemble, b.name(), "")))
        .collect()
}

/// One row a scene; the best of each row without an ensemble is bold, and the last row is the mean over scenes.
fn areas(name: &str, done: &[SceneResult], pick: Pick) -> Table {
    let columns = columns();
    let mut head = heads(&["scene"]);
    head.extend(columns.iter().map(|(kind, name, variant)| match kind {
        Kind::Level => format!("{name}, level {variant}"),
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
        optional((values.len() == done.len()).then(|| mean(values.into_iter())), 3)
    });
    table.row(["mean".to_string()].into_iter().chain(means));
    table
}

/// Means over scenes of every choice of a reading: blending, level, λ, total variance.
fn choices(plan: &Plan, done: &[SceneResult]) -> String {
    let mut out = String::new();
    let mut add = |title: &str, what: &str, kind: Kind, variants: Vec<String>| {
        let head = heads(&[what]).into_iter().chain(Covariance::ALL.iter().map(|c| c.name().to_string()));
        let mut table = Table::new(title, &head.collect::<Vec<_>>());
        for variant in variants {
            let cell = |c: Covariance| {
                // The default level and λ are among the blends.
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
            table.row([variant.clone()].into_iter().chain(Covariance::ALL.map(cell)));
        }
        out.push_str(&table.0);
    };
    let what = "mean AUSE (MAE) over scenes (scenes in which it beats the best measure without a Hessian, worst ratio to that)";
    let blends = BLENDS.iter().map(|b| b.name().to_string()).collect();
    add(&format!("Blending, level {}: {what}", plan.level), "blending", Kind::RayAverage, blends);
    let mut levels = plan.other_levels.clone();
    levels.sort_unstable();
    let levels: Vec<String> =
        LEVEL_BLENDS.iter().flat_map(|&b| levels.iter().map(move |&level| variant(level, b))).collect();
    add("Other levels and their blending", "level", Kind::Level, levels);
    let mut lambdas: Vec<(f64, String)> = plan.lambdas.iter().map(|f| (*f, format!("{f:e}"))).collect();
    lambdas.push((1.0, "1 *".into()));
    lambdas.sort_by(|a, b| a.0.total_cmp(&b.0));
    let lambdas = lambdas.into_iter().map(|l| l.1).collect();
    add("λ, as a factor of the default, blended `spread`", "factor", Kind::Lambda, lambdas);
    let variant = vec![String::new()];
    add("Total variance: that of the ray's weights and U's, on one scale", "", Kind::TotalVariance, variant);

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
    out + &table.0
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
        "Few-view and half scenes ({}): mean AUSE {default:.3} of the default reading, {:.3} of the best measure without a Hessian ({}), ratio {:.2}; at most 0.90 \
         wanted: **{}**.",
        few.len(),
        best.1,
        best.0,
        default / best.1,
        verdict(default <= 0.9 * best.1)
    ));
    for (kind, name, variant) in FOUND {
        let found = mean(few.iter().map(|r| of(r, kind, name, variant)));
        let wins = few.iter().filter(|r| r.entry(kind, name, variant).is_some_and(|e| ratio(r, e) < 1.0)).count();
        if found.is_finite() {
            line(format!(
                "The same for `{name}` at level {variant}, chosen on the first two scenes: {found:.3}, ratio {:.2}; it beats the best such measure of the scene itself in {wins} of {}.",
                found / best.1,
                few.len()
            ));
        }
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
            "The {} scenes with ensembles: mean AUSE {default:.3} of the default reading, {ensemble:.3} of the ensemble's depth variance, ratio {:.2}; at most 1.15 wanted: \
             **{}**. Processor time of one model and its uncertainty {ours:.0} s ({alone:.0} s of it the uncertainty), of the ensemble {theirs:.0} s: {:.2} ({:.2} \
             for the uncertainty alone); at most 0.10 wanted: **{}** ({} for the uncertainty alone).",
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
        "Clean-up with a gain of PSNR (whole held-out images, best threshold) at a coverage of at least 0.7: {} scenes, 3 wanted: **{}**{}{}.",
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
            format!(", [clean-up]({folder}/{slug}-clean-up.png))\n\n![{name}]({folder}/{slug}.png)\n")
        } else {
            ")\n".into()
        };
        out += &line;
    }
    out
}

/// Replaces the tables between the report's markers and copies the pictures beside it.
pub fn write(plan: &Plan, done: &[SceneResult], left: &[String], work: &Path, report: Option<&Path>) -> Result<()> {
    let Some(report) = report else { return Ok(()) };
    let text = std::fs::read_to_string(report).map_err(Error::io(report, "cannot read"))?;
    let parts = text.split_once(BEGIN).and_then(|(head, rest)| Some((head, rest.split_once(END)?.1)));
    let (head, tail) =
        parts.ok_or_else(|| Error::malformed(report, "report", format!("`{BEGIN}` and `{END}`"), "no such lines"))?;
    let folder = report.with_extension("");
    std::fs::create_dir_all(&folder).map_err(Error::io(&folder, "cannot create the folder"))?;
    for r in done {
        for (from, to) in [("row.png", ".png"), ("sparsification.svg", ".svg"), ("clean-up.png", "-clean-up.png")] {
            let (from, to) = (work.join(&r.slug).join(from), folder.join(format!("{}{to}", r.slug)));
            if from.exists() {
                std::fs::copy(&from, &to).map_err(Error::io(&from, "cannot copy"))?;
            }
        }
    }
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let new = format!("{head}{BEGIN}\n{}{}\n{END}{tail}", tables(plan, done, left), pictures(plan, &name, done));
    let mut file = AtomicFile::create(report)?;
    file.write_all(new.as_bytes()).map_err(Error::io(report, "cannot write"))?;
    file.commit()
}
