//! A rendered view as a row of labelled panels.

use octobayes::metrics::quantile;
use octobayes::render::RenderedView;
use octobayes::uncertainty::{Conformal, Unknown, shown_log10};
use octobayes_show::picture::{Bar, Panel, color_panel, scalar_panel};

/// Meaning of a small U, in two lines.
const CONSTRAINED: [&str; 2] = ["well", "constrained"];

/// Ends of the colour bars, the same for all rows of a sheet.
#[derive(Clone, Copy)]
pub struct Ranges {
    /// Median depth, scene units.
    pub depth: [f64; 2],
    /// Standard deviation of depth, scene units.
    pub error: [f64; 2],
    /// The calibrated interval of depth, if there is one.
    pub conformal: Option<Conformal>,
    /// log10 U.
    pub log10: [f64; 2],
    /// log10 U of the prior.
    pub prior: f64,
    /// What log10 U is called.
    pub quantity: &'static str,
}

/// Colour, median depth, its deviation if that is there, and log10 U of a view. log10 U is hatched where no training ray
/// reached what is shown, and grey outside the field's domain.
pub fn view_panels(
    view: &RenderedView,
    deviation: Option<&[f64]>,
    name: &str,
    ranges: Ranges,
    unknown: &[Option<Unknown>],
) -> Vec<Panel> {
    let colors = view.pixels.iter().map(|p| p.color);
    let depths = view.pixels.iter().map(|p| if p.opacity > 0.5 { p.median_depth } else { f64::NAN });
    let depth_bar = Bar::new(ranges.depth, colorous::VIRIDIS);
    let mut panels = vec![
        color_panel(&format!("{name}: colour"), view.resolution, colors),
        scalar_panel("median depth (scene units)", view.resolution, depths, depth_bar),
    ];
    if let Some(deviation) = deviation {
        let bar = Bar::new(ranges.error, colorous::CIVIDIS);
        let title = match ranges.conformal {
            Some(c) => format!("deviation of depth ({:.0} % of errors below {:.2} ×)", 100.0 * c.probability, c.factor),
            None => "deviation of depth (scene units)".into(),
        };
        panels.push(scalar_panel(&title, view.resolution, visible(view, deviation), bar));
    }
    if let Some(log10) = view.log10_uncertainty.first() {
        // What was never seen has the colour of it, whatever lies in front of it or shines through.
        let color = |(u, why): (f64, &Option<Unknown>)| if *why == Some(Unknown::Unseen) { ranges.prior } else { u };
        let shown = shown_log10(view, log10, unknown).into_iter().zip(unknown).map(color);
        let bar = Bar::new(ranges.log10, colorous::INFERNO).meaning(CONSTRAINED, ranges.prior, "never seen");
        let outside = if unknown.contains(&Some(Unknown::Outside)) { "; grey: outside the box" } else { "" };
        let title = format!("{} (hatched: never seen{outside})", ranges.quantity);
        let panel = scalar_panel(&title, view.resolution, shown, bar);
        panels.push(panel.hatched(|i| unknown[i] == Some(Unknown::Unseen)));
    }
    panels
}

/// Smallest and largest median depth over the pixels of some views that show matter (opacity above ½).
pub fn depth_range<'a>(views: impl IntoIterator<Item = &'a RenderedView>) -> [f64; 2] {
    let seen = views.into_iter().flat_map(|v| &v.pixels).filter(|p| p.opacity > 0.5).map(|p| p.median_depth);
    let (low, high) = seen.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(d), h.max(d)));
    if low < high { [low, high] } else { [0.0, 1.0] }
}

/// Deviations of the pixels with matter (opacity above ½); NaN elsewhere.
fn visible<'a>(view: &'a RenderedView, deviation: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
    deviation.iter().zip(&view.pixels).map(|(s, p)| if p.opacity > 0.5 { *s } else { f64::NAN })
}

/// From 0 to the deviation of depth that 95 % of the pixels with matter (opacity above ½) stay below.
pub fn error_range<'a>(views: impl IntoIterator<Item = (&'a RenderedView, &'a Vec<f64>)>) -> [f64; 2] {
    let shown = views.into_iter().flat_map(|(view, deviation)| visible(view, deviation));
    let mut errors: Vec<f64> = shown.filter(|s| s.is_finite()).collect();
    errors.sort_unstable_by(f64::total_cmp);
    [0.0, if errors.is_empty() { 1.0 } else { quantile(&errors, 0.95) }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use octobayes::render::Pixel;

    #[test]
    fn what_was_never_seen_has_the_colour_of_it() {
        let opaque = Pixel { opacity: 1.0, ..Pixel::default() };
        let pixels = vec![opaque; 4];
        let (resolution, log10_uncertainty) = ([4, 1], vec![vec![2.0; 4]]);
        let view = RenderedView { resolution, pixels, log10_uncertainty, ..RenderedView::default() };
        let ranges = Ranges {
            depth: [0.0, 1.0],
            error: [0.0, 1.0],
            conformal: None,
            log10: [2.0, 5.0],
            prior: 5.0,
            quantity: "log10 U",
        };
        let panels = view_panels(&view, None, "x", ranges, &[None, None, None, Some(Unknown::Unseen)]);
        let image = &panels.last().unwrap().image;
        let ends = [0, 255].map(|i| colorous::INFERNO.eval_rational(i, 256).as_array());
        // The last pixel lies between two lines of the hatching.
        let far = |a: [u8; 3], b: [u8; 3]| (0..3).map(|k| a[k].abs_diff(b[k])).max().unwrap();
        let found = [2, 3].map(|x| image.get_pixel(x, 0).0);
        assert!(far(found[0], ends[0]) < 8 && far(found[1], ends[1]) < 8, "{found:?} {ends:?}");
    }
}
