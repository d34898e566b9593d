//! What an evaluation comes to, in two sentences: does U rank the errors of depth here, and are intervals right? Where
//! masks show the object, its pixels alone count: what is around it is often flat, large and easy.
//!
//! Pixels of a view share its errors, so that views count, not pixels: a difference is one if its mean over views is
//! beyond Student's t for 99 % of its standard error. The usual 95 % would be too few, as U is the best of several
//! readings.

use super::{Baseline, EvaluatedView, Evaluator, Measure, OfKind, PixelKind, Report};
use crate::metrics::{ErrorKind, normal, sparsification};

/// Fewer views, each with pixels enough to rank, have no spread to compare a difference with.
const MIN_VIEWS: usize = 4;
/// Fewer pixels leave curves of single pixels.
const MIN_PIXELS: usize = 1000;
/// The nominal coverage that is judged.
const NOMINAL: f64 = 0.9;
/// Coverage as near to the nominal one is right, whatever its spread over views.
const RIGHT_WITHIN: f64 = 0.02;
/// Coverage farther from it is not called right, whatever its spread over views.
const WRONG_BEYOND: f64 = 0.05;

impl Report {
    /// The two sentences. `trained_on` of the views belong to the model's training; `is_doubtful` if depth maps are
    /// probably misread.
    pub(super) fn verdict(
        &self,
        evaluator: &Evaluator,
        views: &[EvaluatedView],
        trained_on: usize,
        is_doubtful: bool,
    ) -> Vec<String> {
        if is_doubtful {
            return vec!["No verdict: most depths are so far off that the depth maps are probably misread.".into()];
        }
        let judged = Pixels::new(self, views);
        let measures = evaluator.measures();
        let is = |baseline| measures.iter().position(|m| *m == Measure::Baseline(baseline));
        let best = (0..self.readings.len()).min_by(|&a, &b| judged.area(a).total_cmp(&judged.area(b)));
        let (Some(best), Some(weights), Some(random)) = (best, is(Baseline::RayVariance), is(Baseline::Random)) else {
            return Vec::new();
        };
        let three = [best, weights, random];
        let of_view = |view: &EvaluatedView| {
            let errors = judged.of(view, &view.absolute_error);
            let area = |m: usize| sparsification(&judged.of(view, &view.measures[m]), &errors, ErrorKind::Mae);
            let [u, weights, random] = three.map(|m| area(m).map(|found| found.area));
            Some([u?, weights?, random?])
        };
        let areas: Vec<[f64; 3]> = views.iter().filter_map(of_view).collect();
        if let Some(few) = few(judged.count, judged.place(), areas.len()) {
            return vec![few];
        }
        let average = self.readings[best].ray_average.map_or(String::new(), |a| format!(" averaged `{}`", a.name()));
        let name = format!("`{}`{average}", self.readings[best].name);
        let name = match self.readings.len() {
            1 => name,
            several => format!("{name}, the best of {several}"),
        };
        let what = format!("{} pixels{}", judged.count, judged.place());
        let mut sentences = vec![ranking(&areas, three.map(|m| judged.area(m)), &name, &what)];
        sentences.push(match evaluator.deviation() {
            None => "Intervals of depth need a field in scene units (`uncertainty --for depth`).".into(),
            Some((m, reading)) => {
                // A calibrated factor is that of the field alone.
                let (nominal, factor, what) =
                    match reading.field.conformal().filter(|_| matches!(measures[m], Measure::DepthDeviation(_))) {
                        Some(interval) => (interval.probability, interval.factor, "calibrated intervals"),
                        None => (NOMINAL, normal::deviations(NOMINAL), "intervals"),
                    };
                // Errors within their interval, and all, of each view.
                let held = |v: &EvaluatedView| -> [f64; 2] {
                    let deviations = judged.of(v, &v.with_rounding(&v.measures[m]));
                    let errors = judged.of(v, &v.absolute_error);
                    let held = errors.iter().zip(&deviations).filter(|(e, s)| **e <= factor * **s).count();
                    [held as f64, errors.len() as f64]
                };
                let counts: Vec<[f64; 2]> = views.iter().map(held).filter(|[_, all]| *all > 0.0).collect();
                let shares: Vec<f64> = counts.iter().map(|[held, all]| held / all).collect();
                let all = counts.iter().map(|[held, _]| held).sum::<f64>() / judged.count as f64;
                intervals(&shares, all, nominal, &format!("{what} of `{}`{}", reading.name, judged.place()))
            }
        });
        if trained_on > 0 {
            sentences
                .push(format!("The model was trained on {trained_on} of these views: on new ones both may be worse."));
        }
        sentences
    }
}

/// The pixels that are judged: those of the object, if masks show it, else all.
struct Pixels<'a> {
    report: &'a Report,
    /// Whether masks show the object, and the figures of its pixels, if it has any.
    is_of_object: bool,
    object: Option<&'a OfKind>,
    count: usize,
}

impl<'a> Pixels<'a> {
    fn new(report: &'a Report, views: &[EvaluatedView]) -> Self {
        let object = report.kinds.iter().find(|of| of.kind == PixelKind::Object);
        let of_object =
            |view: &EvaluatedView| view.of_kind(PixelKind::Object).map(|is| is.iter().filter(|is| **is).count());
        let is_of_object = !views.is_empty() && views.iter().all(|view| of_object(view).is_some());
        let count = if is_of_object { views.iter().filter_map(of_object).sum() } else { report.pixels };
        Self { report, is_of_object, object, count }
    }

    /// Values of the judged pixels of a view.
    fn of(&self, view: &EvaluatedView, values: &[f64]) -> Vec<f64> {
        match view.of_kind(PixelKind::Object).filter(|_| self.is_of_object) {
            Some(is) => values.iter().zip(is).filter(|(_, is)| **is).map(|(value, _)| *value).collect(),
            None => values.to_vec(),
        }
    }

    /// AUSE of the mean absolute error over them, of measure `m`.
    fn area(&self, m: usize) -> f64 {
        match self.object {
            Some(object) => object.measures[m].ause.map_or(f64::NAN, |ause| ause.mae),
            None if self.is_of_object => f64::NAN,
            None => self.report.scored().nth(m).map_or(f64::NAN, |scored| scored.score.ause_pooled.mae),
        }
    }

    fn place(&self) -> &'static str {
        if self.is_of_object { " of the object" } else { "" }
    }
}

/// Why there is no verdict, if there is none.
fn few(pixels: usize, place: &str, views: usize) -> Option<String> {
    (pixels < MIN_PIXELS || views < MIN_VIEWS).then(|| {
        format!(
            "No verdict: {pixels} pixels{place} and {views} views that can be ranked; at least {MIN_PIXELS} and {MIN_VIEWS} \
             are needed."
        )
    })
}

/// `areas` of single views and `pooled` over all pixels: of U, of the variance of the ray's weights, and of chance.
fn ranking(areas: &[[f64; 3]], pooled: [f64; 3], name: &str, pixels: &str) -> String {
    let ahead_of = |other: usize| {
        let differences: Vec<f64> = areas.iter().map(|area| area[other] - area[0]).collect();
        let sign = beyond(&differences, 0.0);
        // What holds of the mean over views, but not of all pixels together, is not clear.
        if f64::from(sign) * (pooled[other] - pooled[0]) > 0.0 { sign } else { 0 }
    };
    let ranks = match ahead_of(2) {
        1 => "ranks",
        0 => "does not clearly rank",
        _ => "does not rank",
    };
    let beside = match ahead_of(1) {
        1 => "is better",
        0 => "is not clearly better or worse",
        _ => "is worse: rank by that, which needs no U",
    };
    let [u, weights, random] = pooled;
    format!(
        "U {ranks} the errors of depth here: AUSE {u:.3} by {name}; {random:.3} by chance, {weights:.3} by the \
         variance of the ray's weights, beside which U {beside} ({pixels} in {} views).",
        areas.len()
    )
}

/// `shares` of the errors of single views that lie within their intervals, and the share of `all`.
fn intervals(shares: &[f64], all: f64, nominal: f64, what: &str) -> String {
    let off = all - nominal;
    let are = match beyond(shares, nominal) {
        _ if off.abs() <= RIGHT_WITHIN => "right",
        sign if sign > 0 && off > 0.0 => "too wide",
        sign if sign < 0 && off < 0.0 => "too narrow",
        _ if off.abs() <= WRONG_BEYOND => "right, as far as so few views show",
        _ => "not clearly right or wrong, as views differ too much",
    };
    let [low, high] = [f64::min, f64::max].map(|f| shares.iter().copied().reduce(f).unwrap_or(f64::NAN));
    format!(
        "The {what} are {are}: nominal {:.0} % covers {:.1} % (single views: {:.0} to {:.0} %).",
        100.0 * nominal,
        100.0 * all,
        100.0 * low,
        100.0 * high
    )
}

/// 1 or −1 if the mean of `values` is above or below `reference` by more than chance, 0 if it is not.
fn beyond(values: &[f64], reference: f64) -> i8 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n - reference;
    let variance = values.iter().map(|v| (v - reference - mean).powi(2)).sum::<f64>() / (n - 1.0);
    match mean.abs() > student_99(n - 1.0) * (variance / n).sqrt() {
        false => 0,
        true if mean > 0.0 => 1,
        true => -1,
    }
}

/// Student's t that 99 % stay within, of `df` ≥ 3 degrees of freedom: the expansion about the normal quantile
/// (Abramowitz and Stegun, 26.7.5), at most 4 % too small.
fn student_99(df: f64) -> f64 {
    let z = 2.575_829_f64;
    let [g1, g2, g3] = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
    ];
    z + g1 / df + g2 / df.powi(2) + g3 / df.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (df, expected) in [(3.0, 5.841), (4.0, 4.604), (9.0, 3.250), (30.0, 2.750)] {
            let ratio = student_99(df) / expected;
            assert!((0.96..1.001).contains(&ratio), "{df}: {ratio}");
        }
        assert_eq!(beyond(&[1.0, 1.1, 0.9, 1.0], 0.0), 1);
        assert_eq!(beyond(&[-1.0, -1.1, -0.9, -1.0], 0.0), -1);
        assert_eq!(beyond(&[1.0, -1.1, 3.0, 0.2], 0.0), 0);
        assert_eq!(beyond(&[0.0; 4], 0.0), 0, "no difference is none");
    }

    #[test]
    fn a_ranking_is_judged_by_views() {
        // U, variance of the weights, chance.
        let clear = [[0.20, 0.30, 0.70], [0.22, 0.33, 0.72], [0.18, 0.28, 0.69], [0.21, 0.30, 0.71]];
        let said = ranking(&clear, [0.2, 0.3, 0.7], "`a block`", "5000 pixels");
        let expected = "U ranks the errors of depth here: AUSE 0.200 by `a block`; 0.700 by chance, 0.300 by the \
                        variance of the ray's weights, beside which U is better (5000 pixels in 4 views).";
        assert_eq!(said, expected);
        // One view decides: ahead in the mean, and no verdict.
        let mixed = [[0.20, 0.19, 0.70], [0.22, 0.21, 0.72], [0.18, 0.17, 0.69], [0.21, 0.60, 0.71]];
        assert!(ranking(&mixed, [0.2, 0.3, 0.7], "a", "5000 pixels").contains("U is not clearly better or worse"));
        let reversed = clear.map(|[u, weights, random]| [weights, u, random]);
        assert!(ranking(&reversed, [0.3, 0.2, 0.7], "a", "5000 pixels").contains("U is worse: rank by that"));
        // Over all pixels together the order is another.
        assert!(ranking(&clear, [0.31, 0.3, 0.7], "a", "5000 pixels").contains("not clearly better"));
        let chance = [[0.70, 0.30, 0.70], [0.69, 0.33, 0.72], [0.72, 0.28, 0.69], [0.71, 0.30, 0.71]];
        assert!(ranking(&chance, [0.7, 0.3, 0.7], "a", "5000 pixels").starts_with("U does not clearly rank"));
        let worse = clear.map(|[u, weights, random]| [random, weights, u]);
        assert!(ranking(&worse, [0.7, 0.3, 0.2], "a", "5000 pixels").starts_with("U does not rank"));
        assert!(few(999, "", 8).is_some() && few(5000, "", 3).is_some() && few(1000, "", 4).is_none());
    }

    #[test]
    fn intervals_are_judged_by_their_coverage() {
        let said = intervals(&[0.52, 0.55, 0.50, 0.54], 0.53, 0.9, "intervals of `a`");
        let expected = "The intervals of `a` are too narrow: nominal 90 % covers 53.0 % (single views: 50 to 55 %).";
        assert_eq!(said, expected);
        assert!(intervals(&[0.98, 0.99, 0.98, 0.97], 0.98, 0.9, "i").contains("are too wide"));
        assert!(intervals(&[0.91, 0.92, 0.91, 0.90], 0.91, 0.9, "i").contains("are right:"));
        assert!(intervals(&[0.80, 0.98, 0.99, 0.97], 0.935, 0.9, "i").contains("right, as far as"));
        assert!(intervals(&[0.20, 0.98, 0.99, 0.97], 0.785, 0.9, "i").contains("not clearly"));
    }
}
