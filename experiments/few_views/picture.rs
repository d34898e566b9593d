//! Pictures and plots of a scene.

use std::path::Path;

use octobayes::Result;
use octobayes::evaluate::{CleanUp, Score, TrueView};
use octobayes::internal::{Curve, Panel, color_panel, write_plot, write_sheet};
use octobayes::render::RenderedView;

use crate::plan::Data;
use crate::scene::{Entry, Kind};

/// Width that small pictures are enlarged to, about.
const WIDTH: u32 = 140;

/// A panel as large as can be looked at.
fn enlarged(panel: Panel) -> Panel {
    let factor = (WIDTH / panel.image.width()).max(1);
    let [w, h] = [panel.image.width(), panel.image.height()].map(|n| factor * n);
    Panel { image: image::imageops::resize(&panel.image, w, h, image::imageops::FilterType::Nearest), ..panel }
}

/// The default reading.
pub const DEFAULT: (Kind, &str, &str) = (Kind::RayAverage, "diagonal", "spread");

/// What an earlier run of this study found to rank best over scenes: chosen with the first two of them, so that their
/// figures flatter it.
pub const FOUND: (Kind, &str, &str) = (Kind::Level, "block", "6");

fn is(entry: &Entry, (kind, name, variant): (Kind, &str, &str)) -> bool {
    entry.kind == kind && entry.name == name && entry.variant == variant
}

/// The Hessian-free measure of one model that ranks best.
pub fn best_baseline(entries: &[Entry]) -> Option<&Entry> {
    let baselines = entries.iter().filter(|e| e.kind == Kind::Baseline);
    baselines.min_by(|a, b| a.mae.total_cmp(&b.mae))
}

/// The reading and ray average at the default level and λ that ranks best.
pub fn best_reading(entries: &[Entry]) -> Option<&Entry> {
    let readings = entries.iter().filter(|e| e.kind == Kind::RayAverage);
    readings.min_by(|a, b| a.mae.total_cmp(&b.mae))
}

/// A measure's name for people.
pub fn title(entry: &Entry) -> String {
    match entry.kind {
        Kind::Baseline | Kind::Ensemble => entry.name.clone(),
        Kind::Level => format!("{}, level {}, spread", entry.name, entry.variant),
        _ => format!("{}, {}", entry.name, entry.variant),
    }
}

/// The measures that are shown: default, best reading, those found best, all without a Hessian, ensembles.
fn shown(entries: &[Entry]) -> Vec<usize> {
    let best = best_reading(entries);
    let wanted = |e: &Entry| match e.kind {
        Kind::RayAverage => is(e, DEFAULT) || best.is_some_and(|b| b == e),
        Kind::Baseline | Kind::Ensemble => true,
        Kind::Level => is(e, FOUND),
        Kind::Lambda => false,
    };
    (0..entries.len()).filter(|&i| wanted(&entries[i])).collect()
}

/// Sparsification curves of mean absolute error, scene units.
pub fn curves(path: &Path, scene: &str, entries: &[Entry], scores: &[Score]) -> Result<()> {
    let curve = |values: &[f64], m: usize| -> Vec<(f64, f64)> {
        let s = &scores[m].pooled[0];
        s.removed.iter().zip(values).map(|(&r, &v)| (r, v * s.largest)).collect()
    };
    let mut all: Vec<Curve> = shown(entries)
        .into_iter()
        .map(|m| Curve {
            name: format!("{} ({:.3})", title(&entries[m]), entries[m].mae),
            points: curve(&scores[m].pooled[0].by_uncertainty, m),
            reference: false,
        })
        .collect();
    let oracle = curve(&scores[0].pooled[0].by_error, 0);
    all.push(Curve { name: "oracle".into(), points: oracle, reference: true });
    let axes = ["removed share of pixels", "mean absolute depth error, scene units"];
    write_plot(path, &format!("{scene} (AUSE)"), axes, &all)
}

/// The true image, if it may be shown.
fn true_image(data: Data, truth: &TrueView) -> Vec<Panel> {
    let panel = || color_panel("true image", truth.camera.resolution, truth.colors.iter().copied());
    data.has_own_images().then(panel).into_iter().collect()
}

/// Before and after the clean-up, one row a view.
pub fn cleaned(path: &Path, data: Data, truths: &[TrueView], cleaned: &[(CleanUp, Vec<RenderedView>)]) -> Result<()> {
    let all: Vec<CleanUp> = cleaned.iter().map(|(c, _)| *c).collect();
    let best = CleanUp::best(&all).and_then(|best| best.threshold);
    let is_shown = |c: &CleanUp| c.threshold.is_none() || [Some(0.9), Some(0.4), best].contains(&c.threshold);
    let rows: Vec<Vec<Panel>> = truths
        .iter()
        .enumerate()
        .take(3)
        .map(|(v, truth)| {
            let mut row = true_image(data, truth);
            row.extend(cleaned.iter().filter(|(c, _)| is_shown(c)).map(|(c, views)| {
                let name = c.threshold.map_or("as it is".into(), |t| format!("threshold {t}"));
                color_panel(&name, views[v].resolution, views[v].pixels.iter().map(|p| p.color))
            }));
            row.into_iter().map(enlarged).collect()
        })
        .collect();
    write_sheet(path, &rows)
}
