//! One model: its uncertainty, and held-out views of it before and after the clean-up.

use std::path::Path;

use glam::DVec3;
use octobayes::estimate::{Estimation, GridSettings, Model, RaySettings};
use octobayes::monitor::Silent;
use octobayes::render::{GradientMethod, RenderedView};
use octobayes::uncertainty::BakedField;
use octobayes::{Error, Result};
use octobayes_data::Hemisphere;
use octobayes_evaluation::{CleanUp, THRESHOLDS, TrueView, clean_up};
use octobayes_show::picture::{Panel, color_panel, write_sheet};
use octobayes_train::Selection;
use serde::{Deserialize, Serialize};

use crate::data::{Data, Dataset, SIDE};
use crate::model::{Architecture, STEPS};
use common::program::folder;
use common::settings::describe;

/// Held-out views of each model, and those that pictures show.
const VIEWS: usize = 12;
const PICTURED: usize = 3;
/// About so many pixels along the sides of a view are compared.
const COMPARED: u32 = 66;
/// Width that small pictures are enlarged to, about.
const WIDTH: u32 = 140;

/// One model that saw too little, or enough.
pub struct Scene {
    pub name: &'static str,
    pub data: Data,
    pub views: Selection,
    pub half: Option<Hemisphere>,
    pub architecture: Architecture,
}

/// What a threshold leaves.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Cleaned {
    /// Of the official scale; none for the model as it is.
    pub threshold: Option<f64>,
    /// Of whole images, dB.
    pub psnr: f64,
    pub ssim: f64,
    /// Share of the pixels that should show matter and do.
    pub coverage: f64,
}

/// One scene.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    pub views: usize,
    /// The model as it is, then by threshold.
    pub cleaned: Vec<Cleaned>,
}

fn rays() -> RaySettings {
    RaySettings::default().rays(480_000).gradient(GradientMethod::Auto)
}

pub fn settings() -> String {
    let described = describe(&rays(), &GridSettings::default(), &[]);
    format!("Images of {SIDE} × {SIDE} pixels, {STEPS} steps; {VIEWS} held-out views. {described} Seed 0.")
}

pub fn measure(scene: &Scene) -> Result<Row> {
    let made = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = Dataset::open(scene, made.path())?;
    let model = scene.architecture.model(&data)?;
    let field = Estimation::new(&model, &data.cameras()).rays(rays()).run()?.field;
    let shown = model.for_images(&RaySettings::for_images(), &Silent)?;
    let stride = (data.test[0].camera.resolution[0] / COMPARED).max(1);
    let truths = spread(&data.test)
        .map(|frame| TrueView::read(frame, None, DVec3::ONE, model.pixel_offset(), stride))
        .collect::<Result<Vec<_>>>()?;
    let cleaned = clean_up(&model, &*shown, &BakedField::new(&field), &truths, &THRESHOLDS, &Silent)?;
    if scene.data.may_be_pictured() {
        let slug = scene.name.replace(", ", "-").replace(' ', "-");
        picture(&folder().join(format!("clean_up/{slug}.png")), scene.data, &truths, &cleaned)?;
    }
    let of = |&(cleaned, _): &(CleanUp, Vec<RenderedView>)| {
        let CleanUp { threshold, psnr, ssim, coverage, .. } = cleaned;
        Cleaned { threshold, psnr, ssim, coverage }
    };
    Ok(Row { scene: scene.name.into(), views: data.training.len(), cleaned: cleaned.iter().map(of).collect() })
}

/// Some of all things, spread evenly.
fn spread<T>(all: &[T]) -> impl Iterator<Item = &T> {
    let n = all.len().min(VIEWS);
    (0..n).map(move |i| &all[(2 * i + 1) * all.len() / (2 * n)])
}

/// A panel as large as can be looked at.
fn enlarged(panel: Panel) -> Panel {
    let factor = (WIDTH / panel.image.width()).max(1);
    let [w, h] = [panel.image.width(), panel.image.height()].map(|n| factor * n);
    Panel { image: image::imageops::resize(&panel.image, w, h, image::imageops::FilterType::Nearest), ..panel }
}

/// Before and after the clean-up, one row a view.
fn picture(path: &Path, data: Data, truths: &[TrueView], cleaned: &[(CleanUp, Vec<RenderedView>)]) -> Result<()> {
    let all: Vec<CleanUp> = cleaned.iter().map(|(c, _)| *c).collect();
    let best = CleanUp::best(&all).and_then(|best| best.threshold);
    let is_shown = |c: &CleanUp| c.threshold.is_none() || [Some(0.9), Some(0.4), best].contains(&c.threshold);
    let row = |(v, truth): (usize, &TrueView)| {
        let panel = || color_panel("true image", truth.camera.resolution, truth.colors.iter().copied());
        let mut row: Vec<Panel> = data.has_own_images().then(panel).into_iter().collect();
        row.extend(cleaned.iter().filter(|(c, _)| is_shown(c)).map(|(c, views)| {
            let name = c.threshold.map_or("as it is".into(), |t| format!("threshold {t}"));
            color_panel(&name, views[v].resolution, views[v].pixels.iter().map(|p| p.color))
        }));
        row.into_iter().map(enlarged).collect()
    };
    write_sheet(path, &truths.iter().enumerate().step_by(VIEWS / PICTURED).map(row).collect::<Vec<Vec<Panel>>>())
}
