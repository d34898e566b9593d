//! Line plots as SVG.

use std::io::Write;
use std::path::Path;

use plotters::prelude::*;

use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// Width and height of a plot with its legend, pixels.
const SIZE: [u32; 2] = [1060, 480];
/// Width of the legend, which stands beside the curves so that it covers none.
const LEGEND: u32 = 320;
/// Height of a line of the legend.
const ENTRY: i32 = 20;

/// One line of a plot.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y).
    pub points: Vec<(f64, f64)>,
    /// Draws the line thin and grey, as a reference for the others.
    pub reference: bool,
}

/// Curves over common axes.
#[derive(Debug, Clone)]
pub struct Plot {
    /// Text above.
    pub title: &'static str,
    /// Text at the axes, x first.
    pub axes: [&'static str; 2],
    /// The lines.
    pub curves: Vec<Curve>,
}

/// Writes plots side by side, in a file that appears when it is committed.
///
/// # Errors
/// If the file cannot be written.
pub fn stage_plots(path: &Path, plots: &[Plot]) -> Result<AtomicFile> {
    stage(path, plots.len(), |areas| {
        areas.iter().zip(plots).try_for_each(|(area, plot)| draw(area, plot.title, plot.axes, &plot.curves))
    })
}

/// Writes curves over common axes as one plot.
///
/// # Errors
/// If the file cannot be written.
pub fn write_plot(path: &Path, title: &str, axes: [&str; 2], curves: &[Curve]) -> Result<()> {
    stage(path, 1, |areas| draw(&areas[0], title, axes, curves))?.commit()
}

/// Part of a picture.
type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// A file of so many areas side by side, drawn on by `draw`.
fn stage(path: &Path, columns: usize, draw: impl Fn(&[Area]) -> Drawn) -> Result<AtomicFile> {
    let mut svg = String::new();
    let size = (SIZE[0] * columns as u32, SIZE[1]);
    let mut all = || -> Drawn {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root.split_evenly((1, columns)))?;
        root.present()?;
        Ok(())
    };
    all().map_err(|e| Error::malformed(path, "plot", "drawable curves", e.to_string()))?;
    let mut file = AtomicFile::create(path)?;
    file.write_all(svg.as_bytes()).map_err(Error::io(path, "cannot write"))?;
    Ok(file)
}

fn draw(area: &Area, title: &str, axes: [&str; 2], curves: &[Curve]) -> Drawn {
    let all = || curves.iter().flat_map(|c| &c.points).filter(|p| p.0.is_finite() && p.1.is_finite());
    let range = |value: fn(&(f64, f64)) -> f64| {
        let (low, high) = all().map(value).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low < high { (low, high) } else { (low - 0.5, low + 0.5) }
    };
    let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
    let (axes_area, legend) = area.split_horizontally(SIZE[0] - LEGEND);
    let mut chart = ChartBuilder::on(&axes_area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(60)
        .build_cartesian_2d(x0..x1, y0..y1 + 0.04 * (y1 - y0))?;
    chart.configure_mesh().light_line_style(WHITE).x_desc(axes[0]).y_desc(axes[1]).draw()?;
    for (i, curve) in curves.iter().enumerate() {
        let (r, g, b) = if curve.reference { (120, 120, 120) } else { Palette99::pick(i).rgb() };
        let color = RGBColor(r, g, b);
        let style = color.stroke_width(if curve.reference { 1 } else { 2 });
        chart.draw_series(LineSeries::new(curve.points.iter().copied(), style))?;
        let y = 48 + ENTRY * i as i32;
        legend.draw(&PathElement::new([(0, y), (18, y)], style))?;
        legend.draw(&Text::new(in_xml(&curve.name), (24, y - 7), ("sans-serif", 13)))?;
    }
    Ok(())
}

/// The text without characters that XML forbids, escaped or not; the backend escapes the others.
fn in_xml(text: &str) -> String {
    text.chars().map(|c| if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') { ' ' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_xml_cannot_hold_is_drawn_without_what_it_forbids() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plot.svg");
        let name = "a\u{1}b\u{7f}c\u{ffff}d <&> \u{85}e".to_owned();
        let curve = Curve { name, points: vec![(0.0, 0.0), (1.0, 1.0)], reference: false };
        write_plot(&path, "title", ["x", "y"], &[curve]).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        assert!(svg.contains("a b c d &lt;&amp;&gt;"), "{svg}");
        let is_forbidden = |c: char| (c.is_control() && c != '\n') || c == '\u{ffff}';
        assert_eq!(svg.chars().find(|c| is_forbidden(*c)), None);
    }

    #[test]
    fn the_legend_stands_beside_the_curves() {
        let curve = |k: usize| Curve {
            name: format!("curve {k}"),
            points: (0..=20).map(|i| (f64::from(i) / 20.0, k as f64 * f64::from(i))).collect(),
            reference: k == 0,
        };
        let curves: Vec<Curve> = (0..6).map(curve).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plot.svg");
        write_plot(&path, "title", ["x", "y"], &curves).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        let beside = f64::from(SIZE[0] - LEGEND);
        // Curves are the lines of 21 points.
        let lines = svg.split("points=\"").skip(1).map(|rest| rest.split('"').next().unwrap_or_default());
        let lines =
            lines.map(|points| points.split_whitespace().collect::<Vec<_>>()).filter(|points| points.len() == 21);
        let ends: Vec<f64> = lines.map(|points| points[20].split(',').next().unwrap().parse().unwrap()).collect();
        assert!(ends.len() == 6 && ends.iter().all(|x| *x < beside), "{ends:?}");
        for curve in &curves {
            let (before, _) = svg.split_once(&curve.name).unwrap_or_else(|| panic!("no {}", curve.name));
            let (_, x) = before.rsplit_once("<text x=\"").unwrap();
            let x: f64 = x.split('"').next().unwrap().parse().unwrap();
            assert!(x > beside, "{}: {x}", curve.name);
        }
    }
}
