//! The results of an evaluation: human-readable, as JSON, as CSV, and as a plot.

use std::path::Path;

use serde_json::json;

use super::Args;
use crate::cli::report;
use crate::dataset::DepthReadings;
use crate::evaluate::{CleanUp, DepthError, EvaluatedView, Evaluator, Measure, Reading, Score};
use crate::io::{AtomicFile, cell};
use crate::metrics::{Calibration, Detection, ErrorKind, STEPS, Sparsification};
use crate::picture::{Curve, Plot, stage_plots};
use crate::{Error, Result};

/// The results of an evaluation.
pub struct Evaluation<'a> {
    pub args: &'a Args,
    pub evaluator: &'a Evaluator<'a>,
    pub measures: Vec<Measure>,
    pub views: &'a [EvaluatedView],
    /// Where the depth maps come from.
    pub source: &'a Path,
    /// What they hold; `None` without true depth.
    pub readings: Option<DepthReadings>,
    /// A score per measure, and the error of depth; `None` without true depth.
    pub ranked: Option<(Vec<Score>, DepthError)>,
    /// One per measure with true depth; `None` for measures that are no deviations of depth.
    pub calibrations: Vec<Option<Calibration>>,
    /// One per measure; `None` unless it is known what was never seen.
    pub detections: Vec<Option<Detection>>,
    /// Empty unless asked for.
    pub cleaned: Vec<CleanUp>,
}

/// The name of an error kind in files.
fn kind_name(kind: ErrorKind) -> String {
    format!("{kind:?}").to_lowercase()
}

/// JSON without control characters. Those that JSON lets stand in a name are obeyed by some terminals.
fn escaped(json: &serde_json::Value) -> String {
    let escape = |c: char| if c.is_control() { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() };
    json.to_string().chars().map(escape).collect()
}

/// Which pixels are used, in words.
fn every_pixel(stride: u32) -> String {
    let ending = match (stride % 10, stride % 100) {
        _ if stride == 1 => return "every pixel".into(),
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("every {stride}{ending} pixel along x and y")
}

impl<'a> Evaluation<'a> {
    pub(super) fn named(&self) -> impl Iterator<Item = (Measure, String, &Score)> {
        self.measures.iter().zip(self.scores()).map(|(&measure, score)| (measure, self.evaluator.name(measure), score))
    }

    fn scores(&self) -> &[Score] {
        self.ranked.as_ref().map_or(&[], |ranked| &ranked.0)
    }

    fn depth(&self) -> Option<&DepthError> {
        self.ranked.as_ref().map(|ranked| &ranked.1)
    }

    pub(super) fn psnr(&self) -> f64 {
        self.views.iter().map(|v| v.psnr).sum::<f64>() / self.views.len() as f64
    }

    pub(super) fn empty(&self) -> usize {
        self.views.iter().map(|v| v.empty).sum()
    }

    /// Draws how errors are ranked and, if there are deviations of depth, how reliable these are, in a file to be
    /// committed.
    pub fn plot(&self, path: &Path) -> Result<AtomicFile> {
        let plots: Vec<Plot> = [self.sparsification()].into_iter().chain(self.reliability()).collect();
        stage_plots(path, &plots)
    }

    /// The curves of mean absolute error, in scene units.
    fn sparsification(&self) -> Plot {
        let points = |s: &Sparsification, values: &[f64]| {
            s.removed.iter().zip(values).map(|(&r, &v)| (r, v * s.largest)).collect()
        };
        let mut curves: Vec<Curve> = self
            .named()
            .map(|(_, name, score)| Curve {
                name: format!("{name} (AUSE {:.3})", score.pooled[0].area),
                points: points(&score.pooled[0], &score.pooled[0].by_uncertainty),
                reference: false,
            })
            .collect();
        if let Some(score) = self.scores().first() {
            let oracle = points(&score.pooled[0], &score.pooled[0].by_error);
            curves.push(Curve { name: "oracle: largest errors removed first".into(), points: oracle, reference: true });
        }
        let axes = ["removed share of pixels", "mean absolute depth error"];
        Plot { title: "Mean depth error left, scene units", axes, curves }
    }

    /// The shares of errors within the intervals that should hold them; `None` without deviations from a field.
    fn reliability(&self) -> Option<Plot> {
        let is_of_field =
            |(measure, ..): (Measure, String, &Calibration)| matches!(measure, Measure::DepthDeviation(_));
        self.calibrated().any(is_of_field).then(|| {
            let points = |curve: &[[f64; 2]]| curve.iter().map(|&[p, found]| (p, found)).collect();
            let mut curves: Vec<Curve> = self
                .calibrated()
                .map(|(_, name, c)| Curve {
                    name: format!("{name} (AUCE {:.3})", c.predictive().auce),
                    points: points(&c.predictive().reliability),
                    reference: false,
                })
                .collect();
            let diagonal = vec![(0.0, 0.0), (1.0, 1.0)];
            curves.push(Curve { name: "what it should be".into(), points: diagonal, reference: true });
            let axes = ["share of errors that the interval should hold", "share that it holds"];
            Plot { title: "Reliability of the deviation of depth", axes, curves }
        })
    }

    /// The measures that are deviations of depth.
    pub(super) fn calibrated(&self) -> impl Iterator<Item = (Measure, String, &Calibration)> {
        let all = self.measures.iter().zip(&self.calibrations);
        all.filter_map(|(&measure, found)| {
            let name = match measure {
                Measure::Baseline(_) => "deviation of the ray's weights".into(),
                _ => self.evaluator.name(measure),
            };
            Some((measure, name, found.as_ref()?))
        })
    }

    /// Writes one row per error kind and removed share, with values in scene units, in a file to be committed.
    pub fn csv(&self, path: &Path) -> Result<AtomicFile> {
        let mut file = AtomicFile::create(path)?;
        let mut write = || -> csv::Result<()> {
            let mut csv = csv::Writer::from_writer(&mut file);
            let names: Vec<String> = self.named().map(|(_, name, _)| cell(name)).collect();
            csv.write_record(["error", "removed", "oracle"].into_iter().chain(names.iter().map(|n| &**n)))?;
            for (e, &kind) in ErrorKind::ALL.iter().enumerate() {
                for k in 0..STEPS {
                    let value = |s: &Sparsification, values: &[f64]| (values[k] * s.largest).to_string();
                    let first = &self.scores()[0].pooled[e];
                    let head = [kind_name(kind), first.removed[k].to_string(), value(first, &first.by_error)];
                    let of = |s: &Score| value(&s.pooled[e], &s.pooled[e].by_uncertainty);
                    csv.write_record(head.into_iter().chain(self.scores().iter().map(of)))?;
                }
            }
            csv.flush()?;
            Ok(())
        };
        write().map_err(|e| Error::io(path, "cannot write")(e.into()))?;
        Ok(file)
    }

    fn json(&self) -> serde_json::Value {
        let by_kind = |values: &dyn Fn(usize) -> f64| -> serde_json::Value {
            ErrorKind::ALL.iter().enumerate().map(|(e, &kind)| (kind_name(kind), json!(values(e)))).collect()
        };
        let (mut readings, mut baselines) = (Vec::new(), Vec::new());
        for (m, (measure, name, score)) in self.named().enumerate() {
            let mut entry = json!({
                "name": name,
                "ause_pooled": by_kind(&|e| score.pooled[e].area),
                "ause_mean_over_views": by_kind(&|e| score.per_view_mean[e]),
                "risk": by_kind(&|e| score.pooled[e].risk()),
                "least_risk": by_kind(&|e| score.pooled[e].least_risk()),
                "rank_correlation": score.rank_correlation,
                "rank_correlation_mean_over_views": score.rank_correlation_per_view,
            });
            if let Some(calibration) = &self.calibrations[m] {
                entry["calibration"] = json!(calibration);
            }
            if let Some(detection) = &self.detections[m] {
                entry["never_seen"] = json!(detection);
            }
            match measure {
                Measure::DepthDeviation(r) => {
                    entry["field"] = report::protocol_json(&self.evaluator.readings[r].field);
                    readings.push(entry);
                }
                Measure::Reading(r, average) => {
                    entry["ray_average"] = json!(average);
                    entry["field"] = report::protocol_json(&self.evaluator.readings[r].field);
                    readings.push(entry);
                }
                Measure::Baseline(_) => baselines.push(entry),
            }
        }
        let args = self.args;
        let views = self.views.iter().map(|v| json!({ "name": v.name, "psnr": v.psnr, "pixels": v.pixels.len() }));
        json!({
            "model": args.model.model, "cameras": args.cameras.cameras,
            "depth": self.ranked.as_ref().map(|_| self.source),
            "training_depth": args.training_depth, "ensemble": args.ensemble,
            "depth_kind": if args.maps.z_depth { "z" } else { "euclidean" }, "stride": args.stride,
            "mask": "alpha 255 and known depth", "alignment": "none",
            "background": args.model.rays.background.to_array(),
            "views": views.collect::<Vec<_>>(),
            "pixels": self.depth().map_or(0, |depth| depth.pixels), "pixels_without_depth": self.empty(),
            "depth_readings": self.readings, "psnr": self.psnr(),
            "depth_error": self.depth().map(|depth| json!({
                "median": depth.median, "mean": depth.mean, "percentile_95": depth.percentile_95,
            })),
            "readings": readings,
            "baselines": baselines,
            "conformal": self.conformal().map(|(reading, share)| json!({
                "name": reading.name, "interval": reading.field.conformal(), "share_inside": share,
            })).collect::<Vec<_>>(),
            "clean_up": self.cleaned,
        })
    }

    pub fn print(&self) -> Result<()> {
        let args = self.args;
        if args.json {
            return say!("{}", escaped(&self.json()));
        }
        for reading in self.evaluator.readings.iter().filter(|_| args.verbose) {
            say!("{}\n{}", reading.name, report::protocol(&reading.field))?;
        }
        say!("protocol of the evaluation")?;
        let (n, cameras) = (self.views.len(), args.cameras.cameras.display());
        say!("  views        {n} of {cameras}, {}", every_pixel(args.stride))?;
        if let Some(depth) = self.depth() {
            self.print_ranking(depth)?;
        } else {
            say!("PSNR {:.2} dB (mean over views)", self.psnr())?;
        }
        self.print_clean_up()
    }

    /// The readings with a calibrated interval, and the share of errors that it holds here.
    pub(super) fn conformal(&self) -> impl Iterator<Item = (&Reading, f64)> {
        self.measures.iter().enumerate().filter_map(|(m, measure)| {
            let Measure::DepthDeviation(r) = *measure else { return None };
            let reading = &self.evaluator.readings[r];
            let factor = reading.field.conformal()?.factor;
            let of_view = |view: &'a EvaluatedView| view.absolute_error.iter().zip(&view.measures[m]);
            let pixels: Vec<bool> = self.views.iter().flat_map(of_view).map(|(e, s)| *e <= factor * s).collect();
            Some((reading, pixels.iter().filter(|inside| **inside).count() as f64 / pixels.len() as f64))
        })
    }

    fn print_clean_up(&self) -> Result<()> {
        let (Some(path), Some(reading)) = (&self.args.clean_up, self.evaluator.readings.first()) else { return Ok(()) };
        say!("clean-up by {}, pictures in {}", reading.name, path.display())?;
        say!("  log10 U at most   surfaces kept    PSNR, dB   where shown      SSIM   SSIMULACRA 2   coverage")?;
        let best = CleanUp::best(&self.cleaned);
        for c in &self.cleaned {
            let log10 = c.log10.map_or("as it is".into(), |u| format!("{u:.2}"));
            let surfaces = c.surfaces.map_or(String::new(), |share| format!("{:.1} %", 100.0 * share));
            let mark = if c.threshold.is_some() && best.is_some_and(|best| best.threshold == c.threshold) {
                "   best PSNR"
            } else {
                ""
            };
            say!(
                "  {log10:>15} {surfaces:>15} {:>11.2} {:>13.2} {:>9.4} {:>14.1} {:>10.3}{mark}",
                c.psnr,
                c.psnr_shown,
                c.ssim,
                c.ssimulacra2,
                c.coverage
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strides_are_counted_as_people_do() {
        let said = [1, 2, 3, 4, 11, 12, 21, 112].map(every_pixel);
        assert_eq!(said[0], "every pixel");
        for (text, number) in said[1..].iter().zip(["2nd", "3rd", "4th", "11th", "12th", "21st", "112th"]) {
            assert_eq!(text, &format!("every {number} pixel along x and y"));
        }
    }
}
