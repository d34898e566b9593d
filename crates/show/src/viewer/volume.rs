//! A volume's page: cells as small as fit into its file, and what scripts read beside them.

use std::path::Path;

use glam::Vec3;
use serde_json::{Value, json};

use super::bricks::{Codes, PRIOR, RAYS, Source, bricks};
use super::grid::{CELLS, Grid};
use super::pack::{Packed, Pages};
use super::page::{Page, Parts, write};
use super::seen::{SeenRay, look, spread};
use octobayes::field::RadianceField;
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes::render::Tracer;
use octobayes::uncertainty::BakedField;
use octobayes::{Error, Result};

const SCRIPTS: [&str; 2] = [include_str!("web/volume.js"), include_str!("web/volume-renderer.js")];
const SHADER: &str = include_str!("web/march.glsl");
/// Cameras over whose directions colours are averaged.
const EYES: usize = 48;
/// About how many rays the volume is fitted to, times the square of its cells along the longest edge, and at most; and
/// the share of them that is traced with this much of the visible surfaces left by the slider.
const RAYS_SEEN: f64 = 8.0;
const MAX_RAYS: f64 = 4e6;
const RAYS_BEHIND: f64 = 0.25;
const BEHIND: [f64; 2] = [2.0 / 3.0, 1.0 / 3.0];
/// Most memory for the values at the corners of the field's leaves, bytes: rays query U millions of times.
const MAX_BAKED_BYTES: usize = 512 << 20;

/// Files grow as this power of the resolution: 2 for thin surfaces, 3 for fog.
const GROWTH: f64 = 2.5;
/// Numbers of cells that differ by less than this share are near.
const SNAP_SHARE: f64 = 0.06;
/// Cells along the longest edge, at least.
const COARSEST: u32 = 32;
/// The same for a first try, from which the size of finer ones is extrapolated.
const PILOT: u32 = 48;

/// What a file shows of a volume.
pub struct VolumeView<'a> {
    /// The model.
    pub model: &'a dyn RadianceField,
    /// Traces rays through the model.
    pub tracer: &'a Tracer<'a>,
    /// What is shown beside it.
    pub page: Page<'a>,
}

/// What was written.
#[derive(Debug, Clone, Copy)]
pub struct ShownVolume {
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
pub fn write_volume(
    path: &Path,
    view: &VolumeView,
    cells: u32,
    budget: usize,
    monitor: &dyn Monitor,
) -> Result<ShownVolume> {
    // A coarse volume takes little time, and predicts the finest one that fits.
    let pilot = (cells > 2 * PILOT).then_some(PILOT);
    let mut now = pilot.unwrap_or(cells);
    let mut is_pilot = pilot.is_some();
    let cameras: Vec<Camera> = view.page.frames.iter().map(|frame| frame.camera).collect();
    let occupancy = view.tracer.marcher.occupancy.as_ref().expect("pictures are rendered with occupancy");
    let eyes: Vec<Vec3> = spread(&cameras, EYES).iter().map(|camera| camera.position.as_vec3()).collect();
    let rays_of = |cells: u32| (RAYS_SEEN * f64::from(cells).powi(2)).min(MAX_RAYS);
    let baked = &BakedField::within(MAX_BAKED_BYTES, view.page.field);
    let mut rays = seen(view, baked, &cameras, rays_of(now), monitor)?;
    loop {
        let seen_rays = [rays.0.as_slice(), rays.1.as_slice()];
        let source =
            Source { model: view.model, field: view.page.field, baked, occupancy, eyes: &eyes, rays: seen_rays };
        let grid = Grid::new(view.model.bounds(), view.page.field.lattice().domain(), now);
        let (pages, found, codes) = bricks(&grid, &source, monitor)?;
        let count = found.len();
        let packed = Packed::new(&pages, &found);
        drop(found);
        let page = page(view, &grid, (&pages, &packed), codes, now);
        if page.len() <= budget && !is_pilot {
            write(path, &page)?;
            return Ok(ShownVolume { cells: now, bytes: page.len(), bricks: count });
        }
        if now <= COARSEST {
            let expected = format!("at least {} bytes, for {COARSEST} cells along the longest edge", page.len());
            return Err(Error::setting("size of the viewer", expected, format!("{budget}")));
        }
        let fixed = page.len() - packed.bytes();
        let share = budget.saturating_sub(fixed) as f64 / packed.bytes() as f64;
        let most = if is_pilot { cells } else { now - 1 };
        now = ((0.98 * f64::from(now) * share.powf(1.0 / GROWTH)) as u32).clamp(COARSEST, most);
        now = snapped(now, view.page.field.lattice().cells_per_axis()).min(most);
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
    view: &VolumeView,
    field: &BakedField,
    cameras: &[Camera],
    count: f64,
    monitor: &dyn Monitor,
) -> Result<(Vec<SeenRay>, Vec<SeenRay>)> {
    let rays = look(view.tracer, (field, f64::INFINITY), cameras, view.page.offset, count, monitor)?;
    let mut of_surface: Vec<f64> = rays.iter().map(|ray| f64::from(ray.log10)).filter(|u| u.is_finite()).collect();
    of_surface.sort_unstable_by(f64::total_cmp);
    let mut behind = Vec::new();
    for share in BEHIND {
        let Some(&threshold) = of_surface.get((share * of_surface.len() as f64) as usize) else { continue };
        let count = RAYS_BEHIND * count;
        behind.extend(look(view.tracer, (field, threshold), cameras, view.page.offset, count, monitor)?);
    }
    Ok((rays, behind))
}

/// The page as text.
fn page(view: &VolumeView, grid: &Grid, (pages, packed): (&Pages, &Packed), codes: Codes, cells: u32) -> String {
    let about = about(view, grid, pages, codes, cells);
    let data = [("march", SHADER), ("pages", &packed.pages), ("planes", &packed.planes)];
    view.page.text([grid.bounds; 2], &Parts { scripts: &SCRIPTS, data: &data, about, is_volume: true })
}

/// What the scripts of a volume read.
fn about(view: &VolumeView, grid: &Grid, pages: &Pages, codes: Codes, cells: u32) -> Value {
    let field = view.page.field;
    json!({
        "cells": cells,
        "grid": { "origin": grid.origin.to_array(), "edge": grid.edge, "bricks": grid.bricks, "cellsPerBrick": CELLS },
        "atlas": pages.atlas,
        "codes": { "low": codes.low, "last": PRIOR, "rays": codes.rays, "lastRays": RAYS, "density": codes.density },
        "holdsField": grid.holds(field.lattice()),
        "knowsRays": !field.rays().is_empty(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::page::tests::check;
    use octobayes::estimate::{Estimation, GridSettings, RaySettings};
    use octobayes::field::ClosedForm;
    use octobayes::monitor::Silent;
    use octobayes_data::Frame;

    /// Writes the viewer of a ball.
    fn written(cells: u32, budget: usize, title: &str) -> Result<(ShownVolume, String)> {
        let ball = ClosedForm::ball();
        let cameras = ClosedForm::half_circle(3, [24; 2]);
        let rays = RaySettings::default().rays(2000).occupancy(32);
        let run = Estimation::new(&ball, &cameras).rays(rays).grid(GridSettings::default().level(5));
        let field = run.run()?.field;
        let tracer = rays.tracer(&ball, 0.0, &Silent)?;
        let frame = |camera| Frame::new(camera, "</script><b>", "");
        let frames: Vec<Frame> = cameras.into_iter().map(frame).collect();
        let surface: Vec<Vec3> = field.surface().iter().copied().map(Vec3::from_array).collect();
        let page = Page {
            field: &field,
            frames: &frames,
            planned: &[],
            offset: 0.5,
            background: tracer.background,
            surface: &surface,
            range: [2.0, field.prior().log10()],
            title,
            unit: (1.0, "scene units"),
        };
        let view = VolumeView { model: &ball, tracer: &tracer, page };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.html");
        let shown = write_volume(&path, &view, cells, budget, &Silent)?;
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
    fn names_cannot_end_the_page_s_data() {
        let (_, page) = written(32, 10_000_000, "a & <script>").unwrap();
        assert!(page.contains("<title>a &amp; &lt;script>") && !page.contains("</script><b>"), "names are data");
        check(&page);
    }
}
