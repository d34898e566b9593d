//! Pictures before and after clean-up.

use std::path::Path;

use octobayes::Result;
use octobayes::io::AtomicFile;
use octobayes::render::RenderedView;
use octobayes_evaluation::{CleanUp, TrueView};
use octobayes_show::picture::{Panel, color_panel, stage_sheet};

/// Most views on a sheet.
const VIEWS: usize = 4;

/// Indices of the versions to show, without repeats: the field as it is, then the paper's fixed thresholds and that of
/// the best PSNR, from the one that keeps most.
#[must_use]
pub fn shown(cleaned: &[(CleanUp, Vec<RenderedView>)]) -> Vec<usize> {
    let of_threshold = |t: f64| cleaned.iter().position(|(c, _)| c.threshold == Some(t));
    let mut shown: Vec<usize> = [Some(0), of_threshold(0.9), of_threshold(0.4)].into_iter().flatten().collect();
    let all: Vec<CleanUp> = cleaned.iter().map(|(c, _)| *c).collect();
    let best = CleanUp::best(&all).and_then(|best| best.threshold).and_then(of_threshold);
    shown.extend(best.filter(|best| !shown.contains(best)));
    let threshold = |k: usize| cleaned[k].0.threshold.unwrap_or(f64::INFINITY);
    shown.sort_by(|a, b| threshold(*b).total_cmp(&threshold(*a)));
    shown
}

/// Writes one row per view, for views spread evenly over all: the truth, the field as it is, and after clean-up.
pub fn stage(path: &Path, truths: &[TrueView], cleaned: &[(CleanUp, Vec<RenderedView>)]) -> Result<AtomicFile> {
    let step = truths.len().div_ceil(VIEWS).max(1);
    let rows: Vec<Vec<Panel>> = (step / 2..truths.len())
        .step_by(step)
        .map(|v| {
            let truth = &truths[v];
            let mut row = vec![color_panel(
                &format!("{}: truth", truth.name),
                truth.camera.resolution,
                truth.colors.iter().copied(),
            )];
            row.extend(shown(cleaned).into_iter().map(|k| {
                let (cleaned, views) = &cleaned[k];
                let name = cleaned.log10.map_or("as it is".into(), |u| format!("log10 U ≤ {u:.2}"));
                color_panel(&name, views[v].resolution, views[v].pixels.iter().map(|p| p.color))
            }));
            row
        })
        .collect();
    stage_sheet(path, &rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_stand_in_the_order_of_what_they_keep() {
        let version = |threshold: Option<f64>, psnr: f64| {
            let [psnr_shown, ssim, coverage] = [psnr; 3];
            let (log10, surfaces) = (threshold, None);
            (CleanUp { threshold, log10, surfaces, psnr, psnr_shown, ssim, coverage }, Vec::new())
        };
        let all = |best: f64| {
            let psnr = |t: f64| if t == best { 30.0 } else { 20.0 };
            let thresholds = [0.3, 0.4, 0.6, 0.9, 1.0].map(|t| version(Some(t), psnr(t)));
            let all: Vec<_> = [version(None, 25.0)].into_iter().chain(thresholds).collect();
            shown(&all).into_iter().map(|k| all[k].0.threshold).collect::<Vec<_>>()
        };
        assert_eq!(all(0.6), [None, Some(0.9), Some(0.6), Some(0.4)]);
        assert_eq!(all(1.0), [None, Some(1.0), Some(0.9), Some(0.4)]);
        assert_eq!(all(0.9), [None, Some(0.9), Some(0.4)]);
    }
}
