//! What is printed of an evaluation.

use super::Args;
use octobayes::Result;
use octobayes_data::DepthKind;
use octobayes_depth::CONFIRMING_VIEWS;
use octobayes_evaluation::metrics::{Calibration, Detection, PROBABILITIES};
use octobayes_evaluation::{CleanUp, DepthError, Interval, OfKind, Part, Report, Score, Scored};

/// A curve rises if it is above its start by more than this part of it.
const RISE: f64 = 0.05;

/// JSON without control characters. Those that JSON lets stand in a name are obeyed by some terminals.
fn escaped(json: &serde_json::Value) -> String {
    let escape = |c: char| if c.is_control() { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() };
    json.to_string().chars().map(escape).collect()
}

impl Args {
    /// Prints a report. `first` is the name of the first reading.
    pub(super) fn print(&self, report: &Report, first: &str) -> Result<()> {
        if self.json {
            return say!("{}", escaped(&serde_json::json!(report)));
        }
        report.verdict.iter().try_for_each(|sentence| say!("{sentence}"))?;
        say!("protocol of the evaluation")?;
        let (n, cameras, stride) = (report.views.len(), &report.cameras, report.stride);
        let pixels = if stride == 1 { "every pixel".into() } else { format!("1 pixel in {stride} along x and y") };
        say!("  views        {n} of {cameras}, {pixels}")?;
        match &report.depth_error {
            Some(depth) => self.print_ranking(report, depth)?,
            None => say!("PSNR {:.2} dB (mean over views)", report.psnr)?,
        }
        self.print_interval(report)?;
        self.print_clean_up(report, first)
    }

    fn print_ranking(&self, report: &Report, depth: &DepthError) -> Result<()> {
        let kind = if report.depth_kind == DepthKind::Z { "along the viewing axis" } else { "Euclidean" };
        let folder = report.depth.as_deref().unwrap_or_default();
        say!("  depth        median of the ray's weights, against {kind} depth of {folder}")?;
        let empty = report.pixels_without_depth;
        say!("  mask         alpha 255 and known depth; {empty} pixels left out where the field shows nothing")?;
        say!("  alignment    none")?;
        let mut averages: Vec<&str> = Vec::new();
        for average in report.readings.iter().filter_map(|scored| scored.ray_average) {
            if !averages.contains(&average.name()) {
                averages.push(average.name());
            }
        }
        say!("  U per pixel  log10 U averaged `{}`", averages.join("`, `"))?;
        say!("  AUSE         100 steps, both curves over their common maximum, trapezoid; 0 is a perfect order")?;
        say!("  risk         mean over 100 steps of the error left")?;
        say!("PSNR {:.2} dB (mean over views)", report.psnr)?;
        let DepthError { pixels, median, mean, percentile_95 } = depth;
        say!(
            "depth error over {pixels} pixels: median {median:.4}, mean {mean:.4}, 95 % {percentile_95:.4} scene units"
        )?;
        let width = report.scored().map(|scored| scored.name.chars().count()).max().unwrap_or(0).max(32);
        print_kinds(report, width)?;
        say!("  {:<width$} AUSE, all pixels | mean over views  | risk, scene units  | rank correlation", "")?;
        say!("{}", row(width, "", ["mae", "rmse", "mae", "rmse", "mae", "rmse", "all", "views"].map(String::from)))?;
        if let Some(Scored { score: Score { least_risk, .. }, .. }) = report.scored().next() {
            let mut least: [String; 8] = Default::default();
            [least[4], least[5]] = [least_risk.mae, least_risk.rmse].map(|risk| format!("{risk:.5}"));
            say!("{}", row(width, "the least possible", least))?;
        }
        for (i, Scored { name, score, .. }) in report.scored().enumerate() {
            if i > 0 && i == report.readings.len() {
                say!("  without a Hessian:")?;
            }
            let Score { ause_pooled: all, ause_mean_over_views: mean, risk, .. } = score;
            let [a, b, c, d] = [all.mae, all.rmse, mean.mae, mean.rmse].map(|area| number(area, 4));
            let [e, f] = [risk.mae, risk.rmse].map(|risk| number(risk, 5));
            let ranks = [score.rank_correlation, score.rank_correlation_mean_over_views];
            let [g, h] = ranks.map(|rank| number(rank, 3));
            say!("{}", row(width, name, [a, b, c, d, e, f, g, h]))?;
        }
        warn_of_rises(report);
        print_detection(report, width)?;
        print_calibration(report, width)
    }

    fn print_interval(&self, report: &Report) -> Result<()> {
        let (Some(path), Some(interval)) = (&self.calibrate, &report.calibrated) else { return Ok(()) };
        let Interval { conformal, predicted, left_out } = interval;
        say!("calibrated on these views: {}", path.display())?;
        say!("  {conformal}")?;
        say!("  without calibration, as if errors were normal: {predicted:.3} deviations")?;
        let [least, middle, most] = left_out.map(|share| 100.0 * share);
        if conformal.views > 1 {
            say!("  leaving one view out at a time: coverage {least:.1} to {most:.1} %, median {middle:.1} %")?;
        }
        Ok(())
    }

    fn print_clean_up(&self, report: &Report, first: &str) -> Result<()> {
        let Some(path) = &self.clean_up else { return Ok(()) };
        say!("clean-up by {first}, pictures in {}", path.display())?;
        say!("  log10 U at most   surfaces kept    PSNR, dB   where shown      SSIM   coverage")?;
        let best = CleanUp::best(&report.clean_up).and_then(|best| best.threshold);
        for c in &report.clean_up {
            let log10 = c.log10.map_or("as it is".into(), |u| format!("{u:.2}"));
            let surfaces = c.surfaces.map_or(String::new(), |share| format!("{:.1} %", 100.0 * share));
            let mark = if c.threshold.is_some() && c.threshold == best { "   best PSNR" } else { "" };
            say!(
                "  {log10:>15} {surfaces:>15} {:>11} {:>13} {:>9} {:>10}{mark}",
                number(c.psnr, 2),
                number(c.psnr_shown, 2),
                number(c.ssim, 4),
                number(c.coverage, 3)
            )?;
        }
        Ok(())
    }
}

/// A number in a table; a dash if there is none.
fn number(value: f64, digits: usize) -> String {
    if value.is_nan() {
        return "–".into();
    }
    let text = format!("{value:.digits$}");
    // What rounds to zero has no sign.
    let is_zero = text.bytes().all(|byte| b"-0.".contains(&byte));
    if is_zero { text.trim_start_matches('-').into() } else { text }
}

/// A row of the ranking.
fn row(width: usize, name: &str, cells: [String; 8]) -> String {
    let [a, b, c, d, e, f, g, h] = cells;
    format!("  {name:<width$} {a:>8} {b:>7} | {c:>8} {d:>7} | {e:>8} {f:>9} | {g:>8} {h:>7}")
}

/// A curve that rises makes the common maximum larger, and so its own area smaller.
fn warn_of_rises(report: &Report) {
    for Scored { name, score, .. } in report.readings.iter().filter(|scored| scored.score.rise.mae > RISE) {
        announce!(
            "warning: {name} leaves some of the largest errors for the end, so that the mean error rises by {:.0} % \
             above its start; its AUSE (mae) is {:.4}, and {:.4} in units of the start",
            100.0 * score.rise.mae,
            score.ause_pooled.mae,
            score.ause_from_start.mae
        );
    }
}

/// The first reading, and the deviation of depth that the verdict is about, for each kind of pixel.
fn print_kinds(report: &Report, width: usize) -> Result<()> {
    let Some(first) = report.kinds.first() else { return Ok(()) };
    let by = first.measures[0].name.clone();
    let is_known = |m: &usize| report.kinds.iter().any(|of| of.measures[*m].calibration.is_some());
    let deviation = report.deviation.filter(is_known);
    let nominal = if deviation.is_some() {
        format!("   deviation holds, of {}", PROBABILITIES.map(|p| format!("{:.0}", 100.0 * p)).join("/") + " %")
    } else {
        String::new()
    };
    let head = format!("by {by}, where pixels are");
    let width = width.max(head.chars().count());
    say!("{head:<width$}    share   median error   AUSE mae    rmse{nominal}")?;
    for OfKind { kind, share, depth_error, measures } in &report.kinds {
        let [mae, rmse] = measures[0].ause.map_or([f64::NAN; 2], |ause| [ause.mae, ause.rmse]);
        let held = deviation.and_then(|m| measures[m].calibration.as_ref()).map_or(String::new(), |calibration| {
            let held = calibration.coverage.map(|[_, found]| number(100.0 * found, 0));
            format!("   {}", held.join("/"))
        });
        let [mae, rmse] = [mae, rmse].map(|area| number(area, 3));
        let (share, median) = (100.0 * share, depth_error.median);
        say!(
            "  {:<width$} {share:>5.1} % {median:>14.4} {mae:>10} {rmse:>7}{held}",
            kind.to_string(),
            width = width - 2
        )?;
    }
    Ok(())
}

/// Only if it is known which pixels show what no training view saw.
fn print_detection(report: &Report, width: usize) -> Result<()> {
    let Some(unseen) = report.never_seen else { return Ok(()) };
    let share = 100.0 * unseen.share;
    let head = format!("never seen by {} training views: {share:.1} % of the pixels", unseen.training_views);
    if unseen.share == 0.0 || unseen.share == 1.0 {
        return say!("{head}; there is nothing to detect");
    }
    say!("{head:<width$}    AUROC    AUPR (chance: 0.5, {:.3})", unseen.share, width = width + 2)?;
    for Scored { name, never_seen, .. } in report.scored() {
        if let Some(Detection { auroc, aupr, .. }) = never_seen {
            say!("  {name:<width$} {auroc:>8.3} {aupr:>7.3}")?;
        }
    }
    Ok(())
}

/// Only if a field gives deviations in scene units: the ray's weights alone are there to be compared with.
fn print_calibration(report: &Report, width: usize) -> Result<()> {
    if report.readings.iter().all(|scored| scored.calibration.is_none()) {
        return Ok(());
    }
    let nominal = PROBABILITIES.map(|p| format!("{:>6.0} %", 100.0 * p)).concat();
    say!(
        "{:<width$}{nominal}    AUCE   mean e/s   NLL, nats  (with the best scale)",
        "errors of depth within",
        width = width + 2
    )?;
    let line = |name: &str, c: &Calibration| {
        let held = c.coverage.map(|[_, found]| format!("{:>6} %", number(100.0 * found, 1))).concat();
        let [nll, best] = [c.nll, c.nll_best_scale].map(|nll| number(nll, 2));
        let [auce, ratio] = [number(c.auce, 3), number(c.mean_ratio, 2)];
        say!("  {name:<width$}{held} {auce:>7} {ratio:>10} {nll:>11}  ({best})")
    };
    report.calibrated_measures().try_for_each(|(name, calibration)| line(name, calibration))?;
    let confirmed = report.readings.iter().filter_map(|scored| Some((&*scored.name, scored.confirmed.as_ref()?)));
    for (i, (name, Part { share, calibration })) in confirmed.enumerate() {
        if i == 0 {
            let share = 100.0 * share;
            say!("where {CONFIRMING_VIEWS} training views see a surface at that depth, {share:.1} % of the pixels")?;
        }
        calibration.as_ref().map_or(Ok(()), |calibration| line(name, calibration))?;
    }
    for inside in &report.conformal {
        let held = &inside.interval;
        say!("  {}: {held}; here {:.1} % are", inside.name, 100.0 * inside.share_inside)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn unknown_numbers_are_dashes_and_zero_has_no_sign() {
        let found = [f64::NAN, -0.0004, -0.0, -0.0006, 12.3456, f64::INFINITY].map(|value| number(value, 3));
        assert_eq!(found, ["–", "0.000", "0.000", "-0.001", "12.346", "inf"]);
    }
}
