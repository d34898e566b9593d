//! Curves of an evaluation, as SVG and as CSV.

use std::path::Path;

use octobayes::io::{AtomicFile, cell};
use octobayes::{Error, Result};
use octobayes_evaluation::metrics::{STEPS, Sparsification};
use octobayes_evaluation::{Report, Scored};
use octobayes_show::picture::{Curve, Plot, stage_plots};

/// Most curves of a plot beside the reference: those with the least area. The CSV has all.
const MAX_CURVES: usize = 5;
/// Most of them that are readings of fields: at least one is a baseline.
const MAX_READINGS: usize = 4;

/// Draws how errors are ranked and, if there are deviations of depth, how reliable these are, in a file to be
/// committed.
pub fn plot(report: &Report, path: &Path) -> Result<AtomicFile> {
    let plots: Vec<Plot> = [sparsification(report)].into_iter().chain(reliability(report)).collect();
    stage_plots(path, &plots)
}

/// The curves of mean absolute error, in scene units.
fn sparsification(report: &Report) -> Plot {
    let curve = |name: String, s: &Sparsification, values: &[f64], reference| {
        let points = s.removed.iter().zip(values).map(|(&r, &v)| (r, v * s.largest)).collect();
        Curve { name, points, reference }
    };
    let of = |Scored { name, score, .. }: &Scored| {
        let s = &score.curves[0];
        curve(format!("{name} (AUSE {:.3})", s.area), s, &s.by_uncertainty, false)
    };
    let (readings, baselines) = (best(&report.readings), best(&report.baselines));
    let shown = readings.into_iter().take(MAX_READINGS).chain(baselines).take(MAX_CURVES);
    let mut curves: Vec<Curve> = shown.map(of).collect();
    let oracle = report.scored().next().map(|Scored { score, .. }| &score.curves[0]);
    curves.extend(oracle.map(|s| curve("oracle: largest errors removed first".into(), s, &s.by_error, true)));
    let axes = ["removed share of pixels", "mean absolute depth error"];
    Plot { title: "Mean depth error left, scene units", axes, curves }
}

/// The measures from the least area between their curve and the oracle's to the largest.
fn best(measures: &[Scored]) -> Vec<&Scored> {
    let mut sorted: Vec<&Scored> = measures.iter().collect();
    sorted.sort_by(|a, b| a.score.curves[0].area.total_cmp(&b.score.curves[0].area));
    sorted
}

/// The shares of errors within the intervals that should hold them; `None` without deviations from a field.
fn reliability(report: &Report) -> Option<Plot> {
    report.readings.iter().any(|scored| scored.calibration.is_some()).then(|| {
        let mut best: Vec<_> = report.calibrated_measures().collect();
        best.sort_by(|a, b| a.1.auce.total_cmp(&b.1.auce));
        let mut curves: Vec<Curve> = best
            .into_iter()
            .take(MAX_CURVES)
            .map(|(name, c)| Curve {
                name: format!("{name} (AUCE {:.3})", c.auce),
                points: c.reliability.iter().map(|&[p, found]| (p, found)).collect(),
                reference: false,
            })
            .collect();
        let diagonal = vec![(0.0, 0.0), (1.0, 1.0)];
        curves.push(Curve { name: "what it should be".into(), points: diagonal, reference: true });
        let axes = ["share of errors that the interval should hold", "share that it holds"];
        Plot { title: "Reliability of the deviation of depth", axes, curves }
    })
}

/// Writes one row per error kind and removed share, with values in scene units, in a file to be committed.
pub fn csv(report: &Report, path: &Path) -> Result<AtomicFile> {
    let mut file = AtomicFile::create(path)?;
    let mut write = || -> csv::Result<()> {
        let mut csv = csv::Writer::from_writer(&mut file);
        let names: Vec<String> = report.scored().map(|scored| cell(scored.name.clone())).collect();
        csv.write_record(["error", "removed", "oracle"].into_iter().chain(names.iter().map(|n| &**n)))?;
        for (e, kind) in ["mae", "mse", "rmse"].into_iter().enumerate() {
            let curves: Vec<&Sparsification> = report.scored().map(|scored| &scored.score.curves[e]).collect();
            for k in 0..STEPS {
                let head = [kind.into(), curves[0].removed[k].to_string()];
                let oracle = curves[0].by_error[k] * curves[0].largest;
                let values = curves.iter().map(|s| s.by_uncertainty[k] * s.largest);
                csv.write_record(head.into_iter().chain([oracle].into_iter().chain(values).map(|v| v.to_string())))?;
            }
        }
        csv.flush()?;
        Ok(())
    };
    write().map_err(|e| Error::io(path, "cannot write")(e.into()))?;
    Ok(file)
}
