//! What is printed of the errors of depth: how each measure ranks them, and whether deviations hold them.

use super::table::Evaluation;
use crate::Result;
use crate::cli::report;
use crate::evaluate::{DepthError, Measure, Score};
use crate::metrics::{Detection, PROBABILITIES};

/// How a ranking of errors is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Ranking {
    /// AUSE by the official code's steps: both curves over their common maximum. 0 is a perfect order
    #[default]
    Bayesrays,
    /// The error left when the most uncertain pixels are removed, averaged over the removed shares (the area under the
    /// risk-coverage curve), in scene units, beside the least that any order could have
    ErrorUnits,
}

impl Evaluation<'_> {
    pub(super) fn print_ranking(&self, depth: &DepthError) -> Result<()> {
        let (args, folder) = (self.args, self.source.display());
        let kind = if args.maps.z_depth { "along the viewing axis" } else { "Euclidean" };
        say!("  depth        median of the ray's weights, against {kind} depth of {folder}")?;
        let empty = self.empty();
        say!("  mask         alpha 255 and known depth; {empty} pixels left out where the field shows nothing")?;
        say!("  alignment    none")?;
        let mut averages: Vec<&str> = Vec::new();
        for average in self.evaluator.readings.iter().flat_map(|reading| &reading.averages) {
            if !averages.contains(&average.name()) {
                averages.push(average.name());
            }
        }
        say!("  U per pixel  log10 U averaged `{}`", averages.join("`, `"))?;
        match args.protocol {
            Ranking::Bayesrays => {
                say!(
                    "  AUSE         100 steps, both curves over their common maximum, trapezoid; 0 is a perfect order"
                )?;
            }
            Ranking::ErrorUnits => say!("  risk         mean over 100 steps of the error left, scene units")?,
        }
        say!("PSNR {:.2} dB (mean over views)", self.psnr())?;
        let DepthError { pixels, median, mean, percentile_95 } = depth;
        say!(
            "depth error over {pixels} pixels: median {median:.4}, mean {mean:.4}, 95 % {percentile_95:.4} scene units"
        )?;
        let width = self.named().map(|(_, name, _)| name.chars().count()).max().unwrap_or(0).max(32);
        self.print_head(width + 2)?;
        let mut before = None;
        for (measure, name, score) in self.named() {
            let is_reading = !matches!(measure, Measure::Baseline(_));
            if before == Some(true) && !is_reading {
                say!("  without a Hessian:")?;
            }
            before = Some(is_reading);
            let [r, s] = [score.rank_correlation, score.rank_correlation_per_view];
            say!("  {name:<width$} {}   | {r:>6.3} {s:>6.3}", self.figures(score))?;
        }
        self.print_detection(width)?;
        self.print_calibration(width)
    }

    fn print_head(&self, width: usize) -> Result<()> {
        let correlation = "| rank correlation, and mean over views";
        match self.args.protocol {
            Ranking::Bayesrays => say!(
                "{:<width$}     mae     mse    rmse   | mean over views   mae     mse    rmse   {correlation}",
                "AUSE, all pixels together"
            ),
            Ranking::ErrorUnits => {
                say!("{:<width$}       mae      rmse   {correlation}", "risk, all pixels together")?;
                let Some((_, _, score)) = self.named().next() else { return Ok(()) };
                let [mae, rmse] = [0, 2].map(|kind| score.pooled[kind].least_risk());
                let rest = width - 2;
                say!("  {:<rest$} {mae:>9.5} {rmse:>9.5}", "the least possible")
            }
        }
    }

    fn figures(&self, score: &Score) -> String {
        match self.args.protocol {
            Ranking::Bayesrays => {
                let [a, b, c] = [0, 1, 2].map(|kind| score.pooled[kind].area);
                let [d, e, f] = [0, 1, 2].map(|kind| score.per_view_mean[kind]);
                format!("{a:>7.4} {b:>7.4} {c:>7.4}   |              {d:>7.4} {e:>7.4} {f:>7.4}")
            }
            Ranking::ErrorUnits => {
                let [mae, rmse] = [0, 2].map(|kind| score.pooled[kind].risk());
                format!("{mae:>9.5} {rmse:>9.5}")
            }
        }
    }

    /// Only if it is known which pixels show what no training view saw.
    fn print_detection(&self, width: usize) -> Result<()> {
        let Some(views) = self.evaluator.truly_seen else { return Ok(()) };
        let pixels: Vec<bool> = self.views.iter().flat_map(|view| &view.never_seen).copied().collect();
        let unseen = pixels.iter().filter(|unseen| **unseen).count();
        let share = 100.0 * unseen as f64 / pixels.len().max(1) as f64;
        let head = format!("never seen by {} training views: {share:.1} % of the pixels", views.len());
        if unseen == 0 || unseen == pixels.len() {
            return say!("{head}; there is nothing to detect");
        }
        say!("{head:<width$}    AUROC    AUPR (chance: 0.5, {:.3})", share / 100.0, width = width + 2)?;
        for ((_, name, _), detection) in self.named().zip(&self.detections) {
            if let Some(Detection { auroc, aupr, .. }) = detection {
                say!("  {name:<width$} {auroc:>8.3} {aupr:>7.3}")?;
            }
        }
        Ok(())
    }

    /// Only if a field gives deviations in scene units: the ray's weights alone are there to be compared with.
    fn print_calibration(&self, width: usize) -> Result<()> {
        if !self.calibrated().any(|(measure, ..)| matches!(measure, Measure::DepthDeviation(_))) {
            return Ok(());
        }
        let nominal = PROBABILITIES.map(|p| format!("{:>6.0} %", 100.0 * p)).concat();
        say!(
            "{:<width$}{nominal}    AUCE   mean e/s   NLL, nats: Gauss  Laplace  Student   (with the best scale)",
            "errors of depth within",
            width = width + 2
        )?;
        for (_, name, c) in self.calibrated() {
            let held = c.predictive().coverage.map(|[_, found]| format!("{:>6.1} %", 100.0 * found)).concat();
            let [gauss, laplace, student] = c.densities.each_ref().map(|of| of.nll);
            let [g, l, s] = c.densities.each_ref().map(|of| of.nll_best_scale);
            say!(
                "  {name:<width$}{held} {:>7.3} {:>10.2} {gauss:>18.2} {laplace:>8.2} {student:>8.2}   \
                 ({g:.2}, {l:.2}, {s:.2})",
                c.predictive().auce,
                c.mean_ratio
            )?;
        }
        for (reading, share) in self.conformal() {
            if let Some(c) = reading.field.conformal() {
                say!("  {}: {}; here {:.1} % are", reading.name, report::interval(c), 100.0 * share)?;
            }
        }
        Ok(())
    }
}
