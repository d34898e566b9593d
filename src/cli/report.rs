//! What runs print: protocol and results, human-readable or as JSON.

use std::time::Duration;

use serde_json::{Value, json};

use crate::Result;
use crate::error::printable;
use crate::estimate::{Audit, GridKind, GridSettings, Plan, SamplingError, StepCheck};
use crate::io::memory::peak;
use crate::posterior::{DataScale, Prior, Scale};
use crate::rays::Pixels;
use crate::render::GradientMethod;
use crate::uncertainty::{
    Answers, Comparison, Conformal, Correlations, Difference, ErrorSummary, Misfit, Summary, UncertaintyField,
};

/// A number of bytes, human-readable.
pub fn bytes(n: usize) -> String {
    let n = n as f64;
    match n {
        n if n < 1e3 => format!("{n} B"),
        n if n < 1e6 => format!("{:.1} kB", n / 1e3),
        n if n < 1e9 => format!("{:.2} MB", n / 1e6),
        n => format!("{:.2} GB", n / 1e9),
    }
}

/// A number, human-readable: four digits, without an exponent where none is needed.
pub fn short(x: f64) -> String {
    match x.abs() {
        0.0 => "0".into(),
        a if (1e-3..1e4).contains(&a) => format!("{x:.4}").trim_end_matches('0').trim_end_matches('.').into(),
        _ => format!("{x:.3e}"),
    }
}

/// Time and memory of a run, and the check of its step.
pub struct Cost {
    /// Time from the first ray to the finished field.
    pub elapsed: Duration,
    /// Largest size of the sums, bytes.
    pub sums_bytes: usize,
    /// Check of the finite-difference step, if there is one.
    pub step: Option<StepCheck>,
}

/// The protocol of a field as text, one setting per line.
pub fn protocol(field: &UncertaintyField) -> String {
    let p = field.protocol();
    let lattice = field.lattice();
    let known = |v: Option<String>| v.unwrap_or_else(|| "not stated".into());
    let mut out = String::new();
    let mut line = |name: &str, value: String| out.push_str(&format!("  {name:<12} {value}\n"));
    line("source", printable(&p.source));
    line("domain", lattice.domain().to_string());
    line(
        "level",
        format!(
            "{} ({} cells per axis, edge {:.6})",
            lattice.level(),
            lattice.cells_per_axis(),
            lattice.edge().max_element()
        ),
    );
    line("rays", format!("{} ({} dropped as not finite)", p.rays, p.dropped));
    let part = p.shard.filter(|s| s.of > 1).map(|s| format!("{} of {} of {} rays", s.index, s.of, s.rays));
    part.into_iter().for_each(|part| line("shard", part));
    line("pixels", known(p.pixels.map(|p| if p == Pixels::Sobol { "Owen-scrambled Sobol" } else { "random" }.into())));
    let sequences = match field.draws().len() {
        0 | 1 => String::new(),
        several => format!(", {several} sequences of pixels"),
    };
    line("seed", known(p.seed.map(|s| format!("{s}{sequences}"))));
    let prior = if p.prior == Prior::Volume { ", times the volume of cells" } else { "" };
    line("lambda", format!("{:.6e} per scene unit²{prior}", p.lambda));
    line(
        "scale",
        match p.scale {
            Scale::Data(DataScale { pixels, noise, prior_deviation }) => format!(
                "data: a deviation in scene units, from {pixels} pixels of noise {noise:.4}; prior \
                 {prior_deviation:.4} along each axis"
            ),
            _ => "paper: one ray of noise 1/2; for ranking, not a length (--scale data)".into(),
        },
    );
    line("covariance", p.covariance.name().into());
    line("pooling", if p.min_rays > 0.0 { format!("below about {} rays", p.min_rays) } else { "none".into() });
    let limits = if field.limits().is_unlimited() { "" } else { ", limited" };
    line("refinement", format!("{}, tolerance {} in log10 U{limits}", p.criteria, p.tolerance));
    line("march step", known(p.march_step.map(|s| format!("{s:.6} scene units"))));
    let stencil = match p.gradient {
        Some(GradientMethod::ForwardDifference) => "forward to x + 2h",
        _ => "central",
    };
    let differences =
        p.difference_step.map(|h| format!("{stencil}, h = [{:.6}, {:.6}, {:.6}] scene units", h[0], h[1], h[2]));
    let own = p.gradient.filter(|&g| g == GradientMethod::Analytic).map(|_| "none: the field's own derivatives".into());
    line("difference", known(differences.or(own)));
    line("cutoff", known(p.cutoff.map(|c| format!("{c:e}, not part of the tolerance (--audit)"))));
    line("background", known(p.background.map(|b| format!("{b:?}"))));
    line("pixel offset", known(p.pixel_offset.map(|o| o.to_string())));
    line("interval", field.conformal().map_or("none: not calibrated".into(), interval));
    if let Some(correlations) = field.correlations() {
        line("correlations", format!("{} draws of all displacements together", correlations.draws()));
    }
    if !field.coarser().is_empty() {
        let levels: Vec<String> = field.coarser().iter().map(|field| field.lattice().level().to_string()).collect();
        line("coarser levels", format!("{}, read by `u-spread` and `u-spread-per-root-ray`", levels.join(", ")));
    }
    if let Some(misfit) = field.misfit() {
        line("misfit", self::misfit(misfit));
    }
    line("error bars", field.error_summary().map_or("none".into(), |e| error_bars(&e)));
    out.trim_end().to_string()
}

/// A calibrated interval of depth in one line.
pub fn interval(c: &Conformal) -> String {
    let Conformal { probability, factor, pixels, views } = c;
    format!(
        "{:.0} % of depth errors below {factor:.3} deviations, by {pixels} pixels of {views} views",
        100.0 * probability
    )
}

/// What training left unexplained in one line.
fn misfit(m: &Misfit) -> String {
    format!(
        "where it shows matter, the model is off its training images by {:.4} of their range (root mean square); \
         kept on level {}, counted by deviations of depth",
        m.mean(),
        m.level()
    )
}

/// Error bars in one line.
fn error_bars(e: &ErrorSummary) -> String {
    let share = 100.0 * e.known as f64 / e.moved.max(1) as f64;
    format!(
        "{} groups of rays: log10 U of moved vertices is off by {:.3} (root mean square), half of them by less than \
         {:.3}; known at {share:.0} %",
        e.groups, e.root_mean_square, e.median
    )
}

/// The protocol as JSON.
pub fn protocol_json(field: &UncertaintyField) -> Value {
    json!({
        "protocol": field.protocol(),
        "origin": field.protocol().origin,
        "box": field.lattice().domain().bounds().map(|b| json!({
            "min": b.min().to_array(), "max": b.max().to_array(),
        })),
        "domain": field.lattice().domain(),
        "level": field.lattice().level(),
        "draws": field.draws(),
        "limited": !field.limits().is_unlimited(),
        "error_bars": field.error_summary(),
        "correlations": field.correlations().map(Correlations::draws),
        "coarser_levels": field.coarser().len(),
        "misfit": field.misfit().map(|misfit| json!({ "root_mean_square": misfit.mean(), "level": misfit.level() })),
    })
}

/// What a field consists of, in one line.
pub fn summary(s: &Summary) -> String {
    let leaves: Vec<String> = s.leaves_per_level.iter().enumerate().map(|(l, n)| format!("{l}:{n}")).collect();
    let leaves = if leaves.is_empty() { String::new() } else { format!(", leaves {}", leaves.join(" ")) };
    format!(
        "{} level {}: {} vertices, {} for queries ({} structure, {:.2} B per vertex){leaves}",
        s.grid,
        s.level,
        s.vertices,
        bytes(s.query_bytes),
        bytes(s.structure_bytes),
        s.structure_bytes as f64 / s.vertices.max(1) as f64
    )
}

/// Percentiles of log10 U over visible surfaces, by which thresholds are chosen; empty if there are no such points.
///
/// # Errors
/// If the field cannot be read.
pub fn surfaces(field: &dyn Answers) -> Result<String> {
    let Some(log10) = field.surface_quantiles(PERCENTS.map(|percent| 0.01 * percent))? else {
        return Ok(String::new());
    };
    let listed: Vec<String> = PERCENTS.iter().zip(log10).map(|(p, log10)| format!("{log10:.2} ({p}%)")).collect();
    let quantity = field.protocol().scale.quantity();
    let prior = field.protocol().prior_deviation().log10();
    Ok(format!("\n  {quantity} on visible surfaces: {}; prior {prior:.2}", listed.join(", ")))
}

/// The same as JSON.
pub fn surfaces_json(field: &UncertaintyField) -> Value {
    let log10 = field.surface_quantiles(PERCENTS.map(|percent| 0.01 * percent));
    json!({
        "percent": PERCENTS,
        "log10_uncertainty": log10,
        "prior": field.prior().log10(),
        "unseen_share": field.visits().map(crate::posterior::Visits::unseen_share),
    })
}

/// A share of the time that is worth a word.
const NOTABLE: f64 = 0.95;

/// Percents of the visible surfaces of which log10 U is told.
const PERCENTS: [f64; 5] = [1.0, 10.0, 50.0, 90.0, 99.0];

/// Table of |Δ log10 U|.
pub fn comparison(c: &Comparison) -> String {
    let row = |name: &str, d: &Option<Difference>| match d {
        None => format!("  {name:<10} no points: neither field holds surface points"),
        Some(d) => format!(
            "  {name:<10} {:>9}  {:>10.6}  {:>10.6}  {:>10.6}  {:>10.6}  at [{:.4}, {:.4}, {:.4}]: {:.4} and {:.4}",
            d.points,
            d.mean,
            d.percentile_95,
            d.percentile_99,
            d.max,
            d.max_at[0],
            d.max_at[1],
            d.max_at[2],
            d.log10_at_max[0],
            d.log10_at_max[1]
        ),
    };
    format!(
        "|Δ log10 U|     points        mean        95 %        99 %         max  where: log10 U of both\n{}\n{}",
        row("in box", &c.in_box),
        row("surfaces", &c.on_surfaces)
    )
}

/// Says on stderr what a run is expected to need.
pub fn plan(plan: &Plan, grid: &GridSettings) {
    let memory = |b: f64| bytes(b as usize);
    let time = plan.time.as_secs_f64();
    announce!(
        "plan: level {}, about {:.2e} vertices, {} the peak of the process, a file of {}, {time:.0} s",
        grid.level,
        plan.vertices,
        memory(plan.peak()),
        memory(plan.file)
    );
    given_up(plan).into_iter().for_each(|text| announce!("{text}"));
}

/// Says on stderr what the field's own derivatives would save, if they would.
pub fn own_derivatives(ratio: f64) {
    if ratio < NOTABLE {
        announce!(
            "note: the model knows its own derivatives; with --gradient auto its rays take about {:.0} % of the time",
            100.0 * ratio
        );
    }
}

/// What a plan gives up to stay within its limits, if it does.
pub fn given_up(plan: &Plan) -> Option<String> {
    if plan.rays_per_vertex <= 0.0 {
        return None;
    }
    let shares: Vec<String> = plan
        .given_up
        .iter()
        .enumerate()
        .filter(|(_, share)| **share > 0.0)
        .map(|(levels, share)| format!("{levels}: {:.1} %", 100.0 * share))
        .collect();
    // A larger leaf has the mean over a hat of twice the edge instead of the finest hat's value. H at surfaces
    // grows about eightfold, which is divided out. What is left is the variation of U within the larger hat.
    Some(format!(
        "      leaves that have {:.1} rays a vertex or are {} levels coarser: {:.1} % of vertices given up;\n      \
         levels given up by share of what rays touch: {}; log10 U is the larger leaf's there",
        plan.rays_per_vertex,
        plan.given_up.len() - 1,
        100.0 * (1.0 - plan.vertices / plan.vertices_unlimited.max(1.0)),
        shares.join(", ")
    ))
}

/// Warns on stderr if a finite-difference step is badly placed.
pub fn step(check: &StepCheck) {
    if check.is_bad {
        let (here, best) = (check.errors.at(check.step), check.errors.best());
        // Errors relative to the derivative itself: beyond it, their size means nothing.
        let percent = |v: f64| if v <= 1.0 { format!("{:.2} %", 100.0 * v) } else { "more than 100 %".into() };
        let exact = if check.knows_derivatives {
            "; --gradient auto uses the field's own derivatives, which are exact"
        } else {
            ""
        };
        // Only central differences may be as wide as noise asks for.
        let central = if check.is_forward { "--gradient finite-difference " } else { "" };
        announce!(
            "warning: with --step {} differences of the density are off by {} (rounding and noise {}, \
             truncation {}); with {central}--step {:.2e} by {}{exact}",
            check.step,
            percent(here.total()),
            percent(here.noise),
            percent(here.truncation),
            best.step,
            percent(best.total())
        );
    }
}

/// The check of a step as JSON.
fn step_json(check: &StepCheck) -> Value {
    let (here, best) = (check.errors.at(check.step), check.errors.best());
    json!({
        "step": check.step,
        "points": check.errors.points,
        "noise_level": check.errors.noise,
        "curvature": check.errors.curvature,
        "error": here.total(),
        "error_by_noise": here.noise,
        "error_by_truncation": here.truncation,
        "best_step": best.step,
        "best_error": best.total(),
        "badly_placed": check.is_bad,
        "field_knows_derivatives": check.knows_derivatives,
    })
}

/// Says on stderr what a run's approximations cost.
pub fn audit(audit: &Audit, grid: &GridSettings) {
    let row = |name: &str, e: &SamplingError| {
        announce!("  {name:<44} {:.1e} in the mean, 95 % within {:.1e}", e.mean, e.percentile_95);
    };
    announce!("error budget in log10 U:");
    match grid.grid {
        GridKind::Dense => announce!("  {:<44} none", "coarser leaves"),
        GridKind::Octree => announce!("  {:<44} at most {:.1e}, certain", "coarser leaves", grid.tolerance),
    }
    row("cutoff", &audit.cutoff);
    match &audit.derivatives {
        Some(error) => row("finite differences", error),
        None => announce!("  {:<44} the field's own, exact", "derivatives"),
    }
    let n = audit.cutoff.vertices;
    announce!(
        "  (measured on {} rays, {n} vertices that they moved; for the rays' own error: --rays auto)",
        audit.rays
    );
}

/// Says on stderr how close a run to a mean error came.
pub fn sampling_error(error: &SamplingError, rays: u64, wanted: f64) {
    let SamplingError { vertices, mean, percentile_95 } = error;
    if *vertices == 0 {
        announce!("note: {rays} rays; no ray constrains anything");
        return;
    }
    let within = if *mean <= wanted { "within" } else { "not within" };
    announce!(
        "note: {rays} rays; log10 U is off by {mean:.3} in the mean, 95 % by at most {percentile_95:.3} (two halves, \
         {vertices} vertices that rays moved): {within} {wanted}"
    );
}

/// Prints the results of a finished run.
///
/// # Errors
/// If stdout cannot be written.
pub fn finished(field: &UncertaintyField, cost: &Cost, as_json: bool) -> Result<()> {
    let s = field.summary();
    if as_json {
        let mut value = protocol_json(field);
        value["summary"] = json!(s);
        value["surfaces"] = surfaces_json(field);
        value["threads"] = json!(rayon::current_num_threads());
        value["seconds"] = json!(cost.elapsed.as_secs_f64());
        value["peak_bytes"] = json!(peak());
        value["posterior_bytes"] = json!(cost.sums_bytes);
        value["differences"] = json!(cost.step.as_ref().map(step_json));
        say!("{value}")?;
    } else {
        say!("protocol\n{}\n  threads      {}", protocol(field), rayon::current_num_threads())?;
        say!("field\n  {}{}", summary(&s), surfaces(field)?)?;
        let peak = peak().map_or(String::new(), |peak| format!(", {} the peak of the process", bytes(peak as usize)));
        say!("  {} while summing{peak}, {:.1} s", bytes(cost.sums_bytes), cost.elapsed.as_secs_f64())?;
    }
    Ok(())
}
