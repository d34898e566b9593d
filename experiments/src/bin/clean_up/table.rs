//! The table of the report.

use crate::scene::{Cleaned, Row};
use common::table::Table;

/// A clean-up that shows less of what should be seen is no gain.
const LEAST_COVERAGE: f64 = 0.7;
/// Gains below this are rounding, dB.
const LEAST_GAIN: f64 = 0.005;

pub fn table(rows: &[Row]) -> String {
    let mut table = Table::new(&[
        "scene",
        "training views",
        "as it is",
        "threshold 0.9",
        "threshold 0.4",
        "best",
        "its threshold",
        "best with coverage of 0.7 and more",
        "gain, dB",
    ]);
    let mut gains = Vec::new();
    for Row { scene, views, cleaned } in rows {
        let at = |threshold| cleaned.iter().find(|c| c.threshold == threshold);
        let best = |least: f64| {
            let enough = cleaned.iter().filter(|c| c.threshold.is_some() && c.coverage >= least);
            enough.max_by(|a, b| a.psnr.total_cmp(&b.psnr))
        };
        let gain = best(LEAST_COVERAGE).zip(at(None)).map(|(best, plain)| best.psnr - plain.psnr);
        gains.extend(gain.filter(|gain| *gain > LEAST_GAIN));
        table.row(&[
            scene.clone(),
            views.to_string(),
            cell(at(None)),
            cell(at(Some(0.9))),
            cell(at(Some(0.4))),
            cell(best(0.0)),
            best(0.0).and_then(|c| c.threshold).map_or("–".into(), |t| format!("{t:.1}")),
            cell(best(LEAST_COVERAGE)),
            gain.map_or("–".into(), |gain| format!("{gain:+.2}")),
        ]);
    }
    let largest = gains.iter().copied().fold(0.0, f64::max);
    format!(
        "{} of {} scenes gain PSNR at a coverage of {LEAST_COVERAGE} and more, by up to {largest:.2} dB. \
         PSNR, dB / SSIM / coverage:\n\n{}",
        gains.len(),
        rows.len(),
        table.text()
    )
}

fn cell(cleaned: Option<&Cleaned>) -> String {
    cleaned.map_or("–".into(), |c| format!("{:.2} / {:.3} / {:.2}", c.psnr, c.ssim, c.coverage))
}
