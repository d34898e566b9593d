//! The page: data, scripts and words in one file that opens from disk.

use std::io::Write;
use std::path::Path;

use glam::Vec3;
use serde_json::{Value, json};

use super::bricks::{Codes, PRIOR, RAYS, Source, bricks};
use super::grid::{CELLS, Grid};
use super::pack::{Packed, Pages};
use super::seen::{SeenRay, look, spread};
use crate::dataset::Frame;
use crate::field::RadianceField;
use crate::geometry::{Camera, Domain, Norm};
use crate::io::AtomicFile;
use crate::monitor::Monitor;
use crate::render::Tracer;
use crate::uncertainty::{BakedField, UncertaintyField};
use crate::{Error, Result};

/// The scripts, in the order in which they are read.
const SCRIPTS: [&str; 9] = [
    include_str!("web/data.js"),
    include_str!("web/space.js"),
    include_str!("web/volume.js"),
    include_str!("web/renderer.js"),
    include_str!("web/camera.js"),
    include_str!("web/overlay.js"),
    include_str!("web/panel.js"),
    include_str!("web/input.js"),
    include_str!("web/main.js"),
];
const PAGE: &str = include_str!("web/page.html");
const STYLE: &str = include_str!("web/style.css");
const SHADER: &str = include_str!("web/march.glsl");
/// Bars of the histogram.
const BARS: usize = 48;
/// Most values of log10 U on visible surfaces in the file.
const QUANTILES: usize = 1000;
/// Cameras over whose directions colours are averaged.
const EYES: usize = 48;
/// About how many rays the volume is fitted to, times the square of its cells along the longest edge, and at most; and
/// the share of them that is traced with this much of the visible surfaces left by the slider.
const RAYS_SEEN: f64 = 12.0;
const MAX_RAYS: f64 = 4e6;
const RAYS_BEHIND: f64 = 0.3;
const BEHIND: [f64; 2] = [2.0 / 3.0, 1.0 / 3.0];
/// Most memory for the values at the corners of the field's leaves, bytes: rays query U millions of times.
const MAX_BAKED_BYTES: usize = 512 << 20;
/// Most cameras in the file.
const CAMERAS: usize = 1000;

/// The power of the resolution with which files grow: 2 for thin surfaces, 3 for fog.
const GROWTH: f64 = 2.5;
/// Numbers of cells that differ by less than this share are near.
const SNAP_SHARE: f64 = 0.06;
/// Cells along the longest edge, at least.
const COARSEST: u32 = 32;
/// The same for a first try, from which the size of finer ones is extrapolated.
const PILOT: u32 = 96;

/// What a file shows.
pub struct View<'a> {
    /// The model.
    pub model: &'a dyn RadianceField,
    /// Its uncertainty.
    pub field: &'a UncertaintyField,
    /// Traces rays through the model.
    pub tracer: &'a Tracer<'a>,
    /// The training cameras.
    pub frames: &'a [Frame],
    /// Where in a pixel rays pass.
    pub offset: f64,
    /// Points on visible surfaces, for the histogram.
    pub surface: &'a [Vec3],
    /// Ends of the colour bar of log10 U.
    pub range: [f64; 2],
    /// Name of the model, for people.
    pub title: &'a str,
}

/// What was written.
#[derive(Debug, Clone, Copy)]
pub struct Shown {
    /// Cells along the longest edge.
    pub cells: u32,
    /// Bytes of the file.
    pub bytes: usize,
    /// Bricks with matter.
    pub bricks: usize,
}

/// Writes the viewer: `cells` along the longest edge, or the largest number that fits into `budget` bytes.
///
/// # Errors
/// If the file cannot be written, if even a coarse volume does not fit, or [`Error::Interrupted`].
pub fn write_view(path: &Path, view: &View, cells: u32, budget: usize, monitor: &dyn Monitor) -> Result<Shown> {
    // A coarse volume takes little time, and predicts the finest one that fits.
    let pilot = (cells > 2 * PILOT).then_some(PILOT);
    let mut now = pilot.unwrap_or(cells);
    let mut is_pilot = pilot.is_some();
    let cameras: Vec<Camera> = view.frames.iter().map(|frame| frame.camera).collect();
    let occupancy = view.tracer.marcher.occupancy.as_ref().expect("pictures are rendered with occupancy");
    let eyes: Vec<Vec3> = spread(&cameras, EYES).iter().map(|camera| camera.position.as_vec3()).collect();
    let rays_of = |cells: u32| (RAYS_SEEN * f64::from(cells).powi(2)).min(MAX_RAYS);
    let baked = &BakedField::within(MAX_BAKED_BYTES, view.field);
    let mut rays = seen(view, baked, &cameras, rays_of(now), monitor)?;
    loop {
        let seen_rays = [rays.0.as_slice(), rays.1.as_slice()];
        let source = Source { model: view.model, field: view.field, baked, occupancy, eyes: &eyes, rays: seen_rays };
        let grid = Grid::new(view.model.bounds(), view.field.lattice().domain(), now);
        let (pages, found, codes) = bricks(&grid, &source, monitor)?;
        let count = found.len();
        let packed = Packed::new(&pages, &found);
        drop(found);
        let page = page(view, &grid, (&pages, &packed), codes, now);
        if page.len() <= budget && !is_pilot {
            let mut file = AtomicFile::create(path)?;
            file.write_all(page.as_bytes()).map_err(Error::io(path, "cannot write"))?;
            file.commit()?;
            return Ok(Shown { cells: now, bytes: page.len(), bricks: count });
        }
        if now <= COARSEST {
            let expected = format!("at least {} bytes, for {COARSEST} cells along the longest edge", page.len());
            return Err(Error::setting("size of the viewer", expected, format!("{budget}")));
        }
        let fixed = page.len() - packed.bytes();
        let share = budget.saturating_sub(fixed) as f64 / packed.bytes() as f64;
        let most = if is_pilot { cells } else { now - 1 };
        now = ((0.98 * f64::from(now) * share.powf(1.0 / GROWTH)) as u32).clamp(COARSEST, most);
        now = snapped(now, view.field.lattice().cells_per_axis()).min(most);
        if is_pilot {
            rays = seen(view, baked, &cameras, rays_of(now), monitor)?;
        }
        is_pilot = false;
    }
}

/// A number of cells near to `cells` that makes the field's `vertices` along an edge a subset of the samples, if there
/// is one: U can then be interpolated as in the field.
fn snapped(cells: u32, vertices: u32) -> u32 {
    let whole = (f64::from(cells) / f64::from(vertices)).round() as u32 * vertices;
    if f64::from(cells.abs_diff(whole)) <= SNAP_SHARE * f64::from(cells) { whole } else { cells }
}

/// What cameras see; and what they would see if the slider had removed a third or two of the visible surfaces.
fn seen(
    view: &View,
    field: &BakedField,
    cameras: &[Camera],
    count: f64,
    monitor: &dyn Monitor,
) -> Result<(Vec<SeenRay>, Vec<SeenRay>)> {
    let rays = look(view.tracer, (field, f64::INFINITY), cameras, view.offset, count, monitor)?;
    let mut of_surface: Vec<f64> = rays.iter().map(|ray| f64::from(ray.log10)).filter(|u| u.is_finite()).collect();
    of_surface.sort_unstable_by(f64::total_cmp);
    let mut behind = Vec::new();
    for share in BEHIND {
        let Some(&threshold) = of_surface.get((share * of_surface.len() as f64) as usize) else { continue };
        let count = RAYS_BEHIND * count;
        behind.extend(look(view.tracer, (field, threshold), cameras, view.offset, count, monitor)?);
    }
    Ok((rays, behind))
}

/// The page as text.
fn page(view: &View, grid: &Grid, (pages, packed): (&Pages, &Packed), codes: Codes, cells: u32) -> String {
    let about = about(view, grid, pages, codes, cells).to_string();
    // `</script>` in a name would end the data.
    let about = about.replace('<', "\\u003c");
    let scripts = SCRIPTS.join("\n");
    let title = view.title.replace('&', "&amp;").replace('<', "&lt;");
    let parts: [(&str, &str); 7] = [
        ("{{TITLE}}", &title),
        ("{{STYLE}}", STYLE),
        ("{{SHADER}}", SHADER),
        ("{{ABOUT}}", &about),
        ("{{PAGES}}", &packed.pages),
        ("{{PLANES}}", &packed.planes),
        ("{{SCRIPTS}}", &scripts),
    ];
    // Piece by piece: what is filled in is not searched.
    let (mut out, mut rest) = (String::with_capacity(packed.bytes() + 200_000), PAGE);
    for (mark, text) in parts {
        let (before, after) = rest.split_once(mark).expect("the page has every mark, in this order");
        out.push_str(before);
        out.push_str(text);
        rest = after;
    }
    out + rest
}

/// Everything but the volume.
fn about(view: &View, grid: &Grid, pages: &Pages, codes: Codes, cells: u32) -> Value {
    let field = view.field;
    let contraction = match &grid.domain {
        Domain::Contracted { center, radius, norm } => {
            json!({ "center": center, "radius": radius, "norm": if *norm == Norm::L2 { "l2" } else { "linf" } })
        }
        _ => Value::Null,
    };
    let map = |gradient: colorous::Gradient| -> Vec<[u8; 3]> {
        (0..256).map(|i| gradient.eval_rational(i, 256).as_array()).collect()
    };
    let spacing = view.frames.len().div_ceil(CAMERAS).max(1);
    let camera = |(index, frame): (usize, &Frame)| {
        let Camera { position, axes, focal, center, resolution, distortion } = frame.camera;
        json!({
            "index": index, "name": frame.name, "position": position.to_array(), "axes": axes.to_cols_array(),
            "focal": focal, "center": center, "resolution": resolution,
            "isDistorted": distortion != crate::geometry::Distortion::default(),
        })
    };
    let found = view.field.query_all(view.surface);
    let mut known: Vec<f64> = found.iter().map(|found| found.uncertainty.log10()).collect();
    known.sort_unstable_by(f64::total_cmp);
    json!({
        "title": view.title,
        "cells": cells,
        "contraction": contraction,
        "bounds": { "min": grid.bounds.min().to_array(), "max": grid.bounds.max().to_array() },
        "grid": { "origin": grid.origin.to_array(), "edge": grid.edge, "bricks": grid.bricks, "cellsPerBrick": CELLS },
        "atlas": pages.atlas,
        "codes": { "low": codes.low, "prior": codes.prior, "last": PRIOR, "rays": codes.rays, "lastRays": RAYS,
            "density": codes.density },
        "holdsField": grid.holds(field.lattice()),
        "knowsRays": !field.rays().is_empty(),
        "knowsUnseen": field.visits().is_some(),
        "quantity": field.protocol().scale.quantity(),
        "isLength": matches!(field.protocol().scale, crate::posterior::Scale::Data(_)),
        "range": view.range,
        "histogram": histogram(&known, view.range[0], codes),
        "surfaces": quantiles(&known),
        "background": view.tracer.background.to_array(),
        "pixelOffset": view.offset,
        "maps": { "uncertainty": map(colorous::INFERNO), "depth": map(colorous::VIRIDIS) },
        "cameras": view.frames.iter().enumerate().step_by(spacing).map(camera).collect::<Vec<_>>(),
    })
}

/// Numbers of surface points by log10 U, from the lower end of the colour bar to the prior.
fn histogram(known: &[f64], low: f64, codes: Codes) -> Vec<u64> {
    let mut bars = vec![0; BARS];
    for log10 in known {
        let share = (log10 - low) / (codes.prior - low);
        bars[((share * BARS as f64).max(0.0) as usize).min(BARS - 1)] += 1;
    }
    bars
}

/// At most [`QUANTILES`] of the sorted numbers, evenly spread over their ranks: shares of them are right within a
/// thousandth.
fn quantiles(known: &[f64]) -> Vec<f64> {
    let count = known.len().min(QUANTILES);
    let rounded = |log10: f64| (1e4 * log10).round() / 1e4;
    (0..count).map(|k| rounded(known[(2 * k + 1) * known.len() / (2 * count)])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Estimation, GridSettings, RaySettings};
    use crate::field::ClosedForm;
    use crate::monitor::Silent;

    /// Writes the viewer of a ball.
    fn written(cells: u32, budget: usize, title: &str) -> Result<(Shown, String)> {
        let ball = ClosedForm::ball();
        let cameras = ClosedForm::half_circle(3, [24; 2]);
        let rays = RaySettings::default().rays(2000).occupancy(32);
        let run = Estimation::new(&ball, &cameras).rays(rays).grid(GridSettings::default().level(5));
        let field = run.run()?.field;
        let tracer = rays.tracer(&ball, 0.0, &Silent)?;
        let frame = |camera| Frame::new(camera, "</script><b>", "");
        let frames: Vec<Frame> = cameras.into_iter().map(frame).collect();
        let surface: Vec<Vec3> = field.surface().iter().copied().map(Vec3::from_array).collect();
        let view = View {
            model: &ball,
            field: &field,
            tracer: &tracer,
            frames: &frames,
            offset: 0.5,
            surface: &surface,
            range: [2.0, field.prior().log10()],
            title,
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.html");
        let shown = write_view(&path, &view, cells, budget, &Silent)?;
        Ok((shown, std::fs::read_to_string(path).unwrap()))
    }

    #[test]
    fn a_budget_is_kept_and_told() {
        let (whole, page) = written(64, 10_000_000, "ball").unwrap();
        assert!(whole.cells == 64 && whole.bytes == page.len() && whole.bricks > 10, "{whole:?}");
        let budget = whole.bytes - 10_000;
        let (less, page) = written(64, budget, "ball").unwrap();
        assert!(less.cells < 64 && page.len() <= budget && less.bytes == page.len(), "{less:?}");
        // The scripts alone are larger.
        let error = written(64, 10_000, "ball").unwrap_err().to_string();
        assert!(error.contains("size of the viewer") && error.contains("32 cells"), "{error}");
    }

    #[test]
    fn shares_of_surfaces_are_counted_not_read_off_bars() {
        let known: Vec<f64> = (0..5003).map(|i| f64::from(i) / 5002.0).collect();
        let kept = quantiles(&known);
        assert_eq!(kept.len(), QUANTILES);
        for threshold in [0.0, 0.1234, 0.5, 0.99, 1.0] {
            let share = |of: &[f64]| of.iter().filter(|log10| **log10 <= threshold).count() as f64 / of.len() as f64;
            assert!((share(&kept) - share(&known)).abs() <= 1e-3, "{threshold}: {} {}", share(&kept), share(&known));
        }
        // A point at the prior is above every threshold below it, though its bar's middle is not.
        let prior = 2.4082;
        assert_eq!(quantiles(&[1.0, prior]), [1.0, prior]);
        assert!(quantiles(&[]).is_empty());
    }

    #[test]
    fn names_cannot_end_the_page_s_data() {
        let (_, page) = written(32, 10_000_000, "a & <script>").unwrap();
        assert!(page.contains("<title>a &amp; &lt;script>") && !page.contains("</script><b>"), "names are data");
        // The page has as many ends as scripts, whatever its data.
        assert_eq!(page.matches("</script>").count(), PAGE.matches("</script>").count());
        assert!(!page.contains("{{"), "every mark is filled in");
    }
}
