//! A view with its errors of depth beside their deviations, and how reliable these are, for the book.

use std::path::Path;

use glam::DVec3;
use image::imageops::{FilterType, resize};
use octobayes::dataset::Views;
use octobayes::estimate::{Estimation, RaySettings};
use octobayes::evaluate::{EvaluatedView, Evaluator, Measure, Reading, TrueView};
use octobayes::field::RadianceField;
use octobayes::internal::{Bar, Curve, Panel, color_panel, scalar_panel, write_plot, write_sheet};
use octobayes::metrics::quantile;
use octobayes::monitor::Silent;
use octobayes::posterior::{DataScale, Scale};
use octobayes::{Error, Result};

use crate::common::program::folder;
use crate::judge::{grid, rays, truth_files};
use crate::scene::Scene;

/// Pixels of a panel for each pixel of a view.
const ENLARGED: u32 = 2;
/// Of the errors and deviations that the colour bar spans.
const SHOWN: f64 = 0.97;

/// Draws the view of median mean error, and the reliability of all views. Returns what they show, in words.
pub fn draw(scene: &Scene) -> Result<String> {
    let temporary = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(temporary.path())?;
    let model = scene.train(&data, 0)?;
    let scale = DataScale::from_cameras(&data.cameras, DataScale::noise_of(model.psnr), &data.domain)?;
    let estimation = Estimation::new(&model.field, &data.cameras).rays(rays()).grid(grid().scale(Scale::Data(scale)));
    let field = estimation.run()?.field;
    let settings = RaySettings::for_images();
    let differentiation = settings.differentiation(&model.field, field.lattice())?;
    let readings = [Reading { name: "block".into(), field, averages: Vec::new() }];
    let evaluator = Evaluator {
        differentiation: Some(differentiation),
        ..Evaluator::new(settings.tracer(&model.field, 0.0, &Silent)?, &readings)
    };
    let deviation = evaluator.measures().iter().position(|m| *m == Measure::DepthDeviation(0)).expect("its deviation");
    let mut views = Vec::new();
    for frame in Views::read(&data.folder.join("transforms_test.json"), None)?.frames {
        let offset = model.field.pixel_offset();
        let truth = TrueView::read(&frame, Some(&truth_files(&data.folder)), DVec3::ONE, offset, 1)?;
        views.push(evaluator.evaluate(&truth, 0, &Silent)?);
    }
    let images = folder().join("../docs/src/images");
    let calibration = evaluator.calibration(&views, deviation);
    let calibration = calibration.ok_or_else(|| Error::malformed(&images, "views", "errors of depth", "none"))?;
    let predictive = calibration.predictive();
    let mean = |view: &EvaluatedView| view.absolute_error.iter().sum::<f64>() / view.absolute_error.len() as f64;
    views.sort_by(|a, b| mean(a).total_cmp(&mean(b)));
    panels(&images.join("depth_error.png"), &views[views.len() / 2], deviation)?;
    let found = predictive.reliability.iter().map(|&[nominal, held]| (nominal, held)).collect();
    let curves = [
        Curve { name: format!("√(Var + s²), AUCE {:.3}", predictive.auce), points: found, reference: false },
        Curve { name: "what it should be".into(), points: vec![(0.0, 0.0), (1.0, 1.0)], reference: true },
    ];
    let axes = ["share of errors that the interval should hold", "share that it holds"];
    write_plot(&images.join("reliability.svg"), "Reliability of the deviation of depth", axes, &curves)?;
    let held: Vec<String> = predictive.coverage.iter().map(|[_, held]| format!("{:.1}", 100.0 * held)).collect();
    Ok(format!(
        "{}: intervals for 50, 68, 90 and 95 % hold {} % of the errors; AUCE {:.3}.\n",
        scene.name(),
        held.join(", "),
        predictive.auce
    ))
}

/// Model, errors of depth, and their deviations on the same scale.
fn panels(path: &Path, view: &EvaluatedView, deviation: usize) -> Result<()> {
    let size = view.rendered.resolution;
    let centimetres = |values: &[f64]| {
        let mut image = vec![f64::NAN; view.rendered.pixels.len()];
        view.pixels.iter().zip(values).for_each(|(&i, value)| image[i] = 100.0 * value);
        image
    };
    let [errors, deviations] = [&view.absolute_error, &view.measures[deviation]].map(|values| centimetres(values));
    let mut all: Vec<f64> = errors.iter().chain(&deviations).copied().filter(|v| v.is_finite()).collect();
    all.sort_unstable_by(f64::total_cmp);
    let bar = || Bar::new([0.0, quantile(&all, SHOWN)], colorous::INFERNO);
    let row = vec![
        color_panel("model", size, view.rendered.pixels.iter().map(|pixel| pixel.color)),
        scalar_panel("error of depth, cm", size, errors.iter().copied(), bar()),
        scalar_panel("standard deviation of depth, cm", size, deviations.iter().copied(), bar()),
    ];
    write_sheet(path, &[row.into_iter().map(enlarged).collect()])
}

fn enlarged(panel: Panel) -> Panel {
    let [width, height] = [panel.image.width(), panel.image.height()].map(|side| ENLARGED * side);
    Panel { image: resize(&panel.image, width, height, FilterType::Nearest), ..panel }
}
