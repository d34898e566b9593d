//! A rendered view as a row of labelled panels.

use crate::picture::{Bar, LOG10_RANGE, Panel, color_panel, scalar_panel};
use crate::render::RenderedView;

/// Colour, median depth and log10 U of a view; `depth_range` keeps rows of one sheet comparable.
pub fn view_panels(view: &RenderedView, name: &str, depth_range: [f64; 2]) -> Vec<Panel> {
    let colors = view.pixels.iter().map(|p| p.color);
    let depths = view.pixels.iter().map(|p| if p.opacity > 0.5 { p.median_depth } else { f64::NAN });
    let depth_bar = Bar { range: depth_range, gradient: colorous::VIRIDIS };
    let mut panels = vec![
        color_panel(&format!("{name}: colour"), view.resolution, colors),
        scalar_panel("median depth (scene units)", view.resolution, depths, depth_bar),
    ];
    if let Some(log10) = view.log10_uncertainty.first() {
        let shown = log10.iter().zip(&view.pixels).map(|(u, p)| if p.opacity > 0.05 { *u } else { f64::NAN });
        let bar = Bar { range: LOG10_RANGE, gradient: colorous::INFERNO };
        panels.push(scalar_panel("log10 U (U in scene units)", view.resolution, shown, bar));
    }
    panels
}

/// Smallest and largest median depth of what is seen in some views.
pub fn depth_range<'a>(views: impl IntoIterator<Item = &'a RenderedView>) -> [f64; 2] {
    let seen = views.into_iter().flat_map(|v| &v.pixels).filter(|p| p.opacity > 0.5).map(|p| p.median_depth);
    let (low, high) = seen.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(d), h.max(d)));
    if low < high { [low, high] } else { [0.0, 1.0] }
}
