//! A rendered view as a row of labelled panels.

use crate::picture::{Bar, Panel, color_panel, scalar_panel};
use crate::render::RenderedView;

/// Meaning of a small U, in two lines.
const CONSTRAINED: [&str; 2] = ["well", "constrained"];

/// Ends of the colour bars, the same for all rows of a sheet.
#[derive(Clone, Copy)]
pub struct Ranges {
    /// Median depth, scene units.
    pub depth: [f64; 2],
    /// log10 U.
    pub log10: [f64; 2],
    /// log10 U of the prior.
    pub prior: f64,
}

/// Colour, median depth and log10 U of a view.
pub fn view_panels(view: &RenderedView, name: &str, ranges: Ranges) -> Vec<Panel> {
    let colors = view.pixels.iter().map(|p| p.color);
    let depths = view.pixels.iter().map(|p| if p.opacity > 0.5 { p.median_depth } else { f64::NAN });
    let depth_bar = Bar::new(ranges.depth, colorous::VIRIDIS);
    let mut panels = vec![
        color_panel(&format!("{name}: colour"), view.resolution, colors),
        scalar_panel("median depth (scene units)", view.resolution, depths, depth_bar),
    ];
    if let Some(log10) = view.log10_uncertainty.first() {
        let shown = log10.iter().zip(&view.pixels).map(|(u, p)| if p.opacity > 0.05 { *u } else { f64::NAN });
        let bar = Bar::new(ranges.log10, colorous::INFERNO).meaning(CONSTRAINED, ranges.prior, "never seen");
        panels.push(scalar_panel("log10 U (U in scene units)", view.resolution, shown, bar));
    }
    panels
}

/// Smallest and largest median depth over the pixels of some views that show matter (opacity above ½).
pub fn depth_range<'a>(views: impl IntoIterator<Item = &'a RenderedView>) -> [f64; 2] {
    let seen = views.into_iter().flat_map(|v| &v.pixels).filter(|p| p.opacity > 0.5).map(|p| p.median_depth);
    let (low, high) = seen.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(d), h.max(d)));
    if low < high { [low, high] } else { [0.0, 1.0] }
}
