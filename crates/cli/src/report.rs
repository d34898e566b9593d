//! What runs print: record and results, human-readable or as JSON.

use octobayes::Result;
use octobayes::error::printable;
use octobayes::estimate::{ErrorBudget, MarchShift, RayError, SamplingError};
use octobayes::posterior::{DataScale, Pooling, Scale};
use octobayes::rays::Pixels;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Comparison, Difference, Summary, UncertaintyField};
pub use octobayes_session::memory::bytes;
use octobayes_session::memory::peak;
use octobayes_session::{Finished, PERCENTS};

/// The record of a field as text, one setting per line.
pub fn record(field: &UncertaintyField) -> String {
    let p = field.record();
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
    line(
        "pixels",
        known(p.pixels.map(|pixels| {
            match pixels {
                Pixels::Sobol => "Owen-scrambled Sobol",
                Pixels::Every => "every pixel once",
                Pixels::Random => "random",
            }
            .into()
        })),
    );
    let sequences = match field.ray_sets().len() {
        0 | 1 => String::new(),
        several => format!(", {several} sequences of pixels"),
    };
    line("seed", known(p.seed.map(|s| format!("{s}{sequences}"))));
    line("lambda", format!("{:.6e} per scene unit²", p.lambda));
    line(
        "scale",
        match p.scale {
            Scale::Data(DataScale { pixels, noise, prior_deviation, .. }) => format!(
                "data: a deviation in scene units, from {pixels} pixels of noise {noise:.4}; prior \
                 {prior_deviation:.4} along each axis"
            ),
            _ => "paper: one ray of noise 1/2; for ranking, not a length (--scale data)".into(),
        },
    );
    line("covariance", p.covariance.name().into());
    line(
        "pooling",
        match p.pooling {
            Pooling::Off => "none".into(),
            Pooling::Auto => "by the rays around a vertex".into(),
        },
    );
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
    out.trim_end().to_string()
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

/// Percentiles of log10 U over visible surfaces, by which thresholds are chosen, as a line; empty without such points.
pub fn surfaces(field: &UncertaintyField) -> String {
    let Some(log10) = field.surface_quantiles(PERCENTS.map(|percent| 0.01 * percent)) else {
        return String::new();
    };
    let listed: Vec<String> = PERCENTS.iter().zip(log10).map(|(p, log10)| format!("{log10:.2} ({p}%)")).collect();
    let quantity = field.record().scale.quantity();
    let prior = field.prior().log10();
    format!("{quantity} on visible surfaces: {}; prior {prior:.2}\n", listed.join(", "))
}

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

/// How far log10 U is from its limit, as a table.
pub fn errors(budget: &ErrorBudget) -> String {
    let mut out = format!("{:<42}     mean     95 %\n", "errors of log10 U, decades");
    let mut line = |name: &str, what: &str| out.push_str(&format!("  {name:<38} {what}\n"));
    let measured = |e: &SamplingError, how: String| format!("{:>8.1e} {:>8.1e}  {how}", e.mean, e.percentile_95);
    let leaves = match (budget.coarse_leaves, budget.is_limited) {
        (0.0, false) => "none".into(),
        (bound, false) => format!("at most {bound:.1e}, certain"),
        (bound, true) => format!("at most {bound:.1e}, and what leaves limited by rays add"),
    };
    line("coarse leaves", &leaves);
    let rays = match &budget.rays {
        None => "not measured (--target-error, --error-bars)".into(),
        Some(RayError::EveryPixel) => "none: a ray through every training pixel".into(),
        Some(RayError::Halves(error)) => measured(error, format!("two halves, {} vertices", error.vertices)),
        Some(RayError::Groups(e)) => format!(
            "{:.3} root mean square, {:.3} median: {} groups, known at {:.0} % of {} vertices",
            e.root_mean_square,
            e.median,
            e.groups,
            100.0 * e.known as f64 / e.moved.max(1) as f64,
            e.moved
        ),
    };
    line("number of rays", &rays);
    match &budget.audit {
        None => line("samples left out, derivatives, march", "not measured (--audit)"),
        Some(audit) => {
            let how = || format!("{} rays, {} vertices", audit.rays, audit.cutoff.vertices);
            line("samples left out", &measured(&audit.cutoff, how()));
            match &audit.derivatives {
                Some(error) => line("finite differences", &measured(error, how())),
                None => line("derivatives", "the field's own, exact"),
            }
            let (march, finer) = (&audit.march, MarchShift::FINER);
            let how = format!("log10 U with {finer} times as many samples on a ray, minus that of the run");
            line("march step", &format!("{:>+8.1e} {:>8.1e}  {how}", march.shift, march.percentile_95));
        }
    }
    if let Some(check) = &budget.step {
        let (here, best) = (check.errors.at(check.step), check.errors.best());
        let [own, least] = [here.in_log10(), best.in_log10()];
        line(
            "difference step",
            &format!("{own:>8.1e}           with {} cells; {least:.1e} with {:.1e} cells", check.step, best.step),
        );
    }
    out.trim_end().to_string()
}

/// Prints the results of a finished run.
pub fn finished(finished: &Finished, as_json: bool) -> Result<()> {
    if as_json {
        return say!("{}", finished.report());
    }
    let Finished { field, errors: budget, sums_bytes, disk_bytes, elapsed, .. } = finished;
    // What is read first stands first: the record is for those who come back.
    say!("{}field\n  {}", surfaces(field), summary(&field.summary()))?;
    let peak = peak().map_or(String::new(), |peak| format!(", {} the peak of the process", bytes(peak as usize)));
    let disk = if *disk_bytes > 0 { format!(", {} on disk", bytes(*disk_bytes as usize)) } else { String::new() };
    say!("  {} while summing{disk}{peak}, {:.1} s", bytes(*sums_bytes), elapsed.as_secs_f64())?;
    say!("{}", errors(budget))?;
    say!("record\n{}\n  threads      {}", record(field), rayon::current_num_threads())
}
