//! Splats with their uncertainty: a `.ply` that renderers and editors of splats read.

use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::leaves::code;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes::posterior::Scale;
use octobayes::render::Outputs;
use octobayes::uncertainty::{BakedField, UncertaintyField, is_certain};
use octobayes_splats::{Hits, SplatRenderer, Splats};

/// A view counts if a splat's share of one of its pixels exceeds this.
const MIN_SHARE: f64 = 0.05;

/// What training views show of each splat.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenSplats {
    /// `[n]`: sum of w, its share of a pixel, over the pixels that were looked at.
    pub weights: Vec<f64>,
    /// `[n]`: number of views in which w exceeds 0.05 at one of these pixels.
    pub views: Vec<u32>,
    /// `[n]`: mean of the splat's colours in these pixels, by w; `None` where none shows it.
    pub colors: Vec<Option<Vec3>>,
    /// Number of pixels that were looked at, and of all pixels.
    pub pixels: [u64; 2],
}

impl SeenSplats {
    /// Looks at about `pixels` pixels of all cameras together, evenly spread over each image.
    ///
    /// # Errors
    /// If a lens distorts, or [`Error::Interrupted`](octobayes::Error::Interrupted).
    pub fn measure(
        renderer: &SplatRenderer,
        cameras: &[Camera],
        pixel_offset: f64,
        pixels: u64,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        SplatRenderer::check_cameras(cameras)?;
        let all: u64 = cameras.iter().map(Camera::pixels).sum();
        let stride = ((all as f64 / pixels.max(1) as f64).sqrt().round() as u32).max(1);
        let n = renderer.splats().len();
        let mut found = Self { weights: vec![0.0; n], views: vec![0; n], colors: Vec::new(), pixels: [0, all] };
        let mut colors = vec![DVec3::ZERO; n];
        monitor.begin("training views", cameras.len() as u64);
        for camera in cameras {
            check(monitor)?;
            let view = renderer.prepare(camera, Outputs::Colors);
            let start = (stride / 2).min(camera.resolution[0] - 1).min(camera.resolution[1] - 1);
            let rows: Vec<u32> = (start..camera.resolution[1]).step_by(stride as usize).collect();
            let of_row = |&row: &u32| {
                let (mut hits, mut found) = (Hits::default(), Vec::new());
                for column in (start..camera.resolution[0]).step_by(stride as usize) {
                    view.hits([column, row].map(|i| f64::from(i) + pixel_offset), &mut hits);
                    found.extend(hits.list.iter().map(|hit| (view.splat(hit), hit.weight())));
                }
                found
            };
            let (mut is_seen, mut of_view) = (vec![false; n], vec![0.0; n]);
            // Rows in their order, so that sums do not depend on threads.
            for (splat, weight) in rows.par_iter().map(of_row).collect::<Vec<_>>().concat() {
                found.weights[splat] += weight;
                of_view[splat] += weight;
                is_seen[splat] |= weight > MIN_SHARE;
            }
            // A splat has one colour in a view.
            view.colors().for_each(|(splat, color)| colors[splat] += of_view[splat] * color);
            found.views.iter_mut().zip(is_seen).for_each(|(views, is_seen)| *views += u32::from(is_seen));
            found.pixels[0] += rows.len() as u64 * u64::from((camera.resolution[0] - start).div_ceil(stride));
            monitor.advance(1);
        }
        monitor.end();
        let mean = |(sum, &weight): (&DVec3, &f64)| (weight > 0.0).then(|| (*sum / weight).as_vec3());
        found.colors = colors.iter().zip(&found.weights).map(mean).collect();
        Ok(found)
    }
}

/// Writes splats with the columns `uncertainty` and `log10_uncertainty` of their centres, `seen` if the field has ray
/// coverage and, if views were looked at, `weight` and `views`. With a threshold, those above it and those never seen
/// are left out. Returns the number of splats in the file.
///
/// # Errors
/// If no splat is left, or the file cannot be written.
pub fn write_splats(
    path: &Path,
    splats: &Splats,
    field: &UncertaintyField,
    seen: Option<&SeenSplats>,
    threshold: Option<f64>,
) -> Result<usize> {
    let kept = match threshold {
        Some(threshold) => is_certain(splats.means(), &BakedField::unbaked(field), threshold),
        None => vec![true; splats.len()],
    };
    let left = threshold.map(|_| splats.clone().keep(&kept)).transpose()?;
    let left = left.as_ref().unwrap_or(splats);
    let means: &[Vec3] = left.means();
    let answers = field.answers(means);
    let uncertainty: Vec<f64> = answers.iter().map(|at| at.estimate.uncertainty).collect();
    let of_kept =
        |values: &dyn Fn(usize) -> f32| -> Vec<f32> { (0..splats.len()).filter(|&i| kept[i]).map(values).collect() };
    let record = field.record();
    let (version, prior) = (env!("CARGO_PKG_VERSION"), field.prior());
    let unit = match record.scale {
        Scale::Data(_) => "in scene units",
        Scale::Paper => "for ranking, not a length (scale `paper`)",
    };
    let mut comments = vec![format!(
        "octobayes {version} uncertainty = one standard deviation of the centre, {unit}, larger is less certain, prior \
         = {prior:e}; log10_uncertainty = its decimal logarithm"
    )];
    let mut columns: Vec<(&str, Vec<f32>)> = vec![
        ("uncertainty", uncertainty.iter().map(|&u| u as f32).collect()),
        ("log10_uncertainty", uncertainty.iter().map(|u| u.log10() as f32).collect()),
    ];
    if answers.iter().any(|at| at.observability.is_some()) {
        columns.push(("seen", answers.iter().map(|at| f32::from(code(at.observability))).collect()));
        comments.push(format!(
            "octobayes {version} seen = 0: no training ray came to the centre with half of its light; 1: rays passed; \
             2: moving it changes training pixels"
        ));
    }
    if let Some(SeenSplats { weights, views, pixels: [looked_at, all], .. }) = seen {
        columns.push(("weight", of_kept(&|i| weights[i] as f32)));
        columns.push(("views", of_kept(&|i| views[i] as f32)));
        comments.push(format!(
            "octobayes {version} weight = sum of the splat's shares of {looked_at} of {all} training pixels; views \
             = training views with a share above {MIN_SHARE}"
        ));
    }
    if let Some(threshold) = threshold {
        comments
            .push(format!("octobayes {version} without splats of log10_uncertainty above {threshold}, or never seen"));
    }
    let columns: Vec<(&str, &[f32])> = columns.iter().map(|(name, values)| (*name, &values[..])).collect();
    left.write_ply(path, &columns, &comments)?;
    Ok(left.len())
}
