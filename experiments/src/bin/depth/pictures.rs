//! Views with their errors of depth beside their deviations, and how reliable these are.

use std::path::Path;

use octobayes::estimate::{Estimation, Model, RaySettings};
use octobayes::metrics::quantile;
use octobayes::monitor::Silent;
use octobayes::posterior::{DataScale, Scale};
use octobayes::{Error, Result};
use octobayes_evaluation::metrics::Calibration;
use octobayes_evaluation::{EvaluatedView, Evaluator, Measure, Reading, TrueView};
use octobayes_show::picture::{Bar, Curve, Panel, color_panel, scalar_panel, write_plot, write_sheet};

use crate::judge::{grid, rays};
use crate::scene::Scene;
use common::program::folder;

/// Of the errors and deviations that the colour bar spans.
const SHOWN: f64 = 0.97;

/// Views of a scene with their truth, from the smallest mean error of depth to the largest, and how reliable the
/// deviations of depth are.
struct Judged {
    views: Vec<(TrueView, EvaluatedView)>,
    /// The deviation's index among the measures.
    deviation: usize,
    reliability: Calibration,
}

/// Draws the view of median mean error of the book's scene, and the reliability of all its views. Returns what they
/// show, in words.
pub fn for_the_book(scene: &Scene) -> Result<String> {
    let judged = judge(scene)?;
    let images = folder().join("../docs/src/images");
    write_sheet(&images.join("depth_error.png"), &[judged.panels()])?;
    let reliability = &judged.reliability;
    let found = reliability.reliability.iter().map(|&[nominal, held]| (nominal, held)).collect();
    let curves = [
        Curve { name: format!("σ, AUCE {:.3}", reliability.auce), points: found, reference: false },
        Curve { name: "what it should be".into(), points: vec![(0.0, 0.0), (1.0, 1.0)], reference: true },
    ];
    let axes = ["share of errors that the interval should hold", "share that it holds"];
    write_plot(&images.join("reliability.svg"), "Reliability of the deviation of depth", axes, &curves)?;
    Ok(judged.words(scene))
}

/// Draws the views of median mean error of some scenes beside their true images, into the report's folder. Returns
/// what they show in words, and links to them.
pub fn for_the_report(scenes: &[Scene]) -> Result<String> {
    let mut text = String::new();
    for scene in scenes {
        let judged = judge(scene)?;
        let (truth, _) = judged.median();
        let mut row = vec![color_panel("true image", truth.camera.resolution, truth.colors.iter().copied())];
        row.extend(judged.panels());
        let file = format!("depth/{}.png", scene.name().replace(", ", "-").replace(' ', "-").replace('°', ""));
        write_sheet(&folder().join(&file), &[row])?;
        text += &format!("{}\n![{}]({file})\n\n", judged.words(scene), scene.name());
    }
    Ok(text)
}

fn judge(scene: &Scene) -> Result<Judged> {
    let temporary = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let data = scene.data(temporary.path())?;
    let model = scene.train(&data, 0)?;
    let scale = DataScale::from_cameras(&data.cameras, DataScale::noise_of(model.psnr), &data.domain)?;
    let estimation = Estimation::new(&model.field, &data.cameras).rays(rays()).grid(grid().scale(Scale::Data(scale)));
    let field = estimation.run()?.field;
    let settings = RaySettings::for_images();
    let shown = model.field.for_images(&settings, &Silent)?;
    let readings = [Reading { name: "block".into(), field, averages: Vec::new() }];
    let evaluator = Evaluator::new(&*shown, &readings);
    let deviation = evaluator.measures().iter().position(|m| *m == Measure::DepthDeviation(0)).expect("its deviation");
    let (mut truths, mut views) = (Vec::new(), Vec::new());
    for truth in data.held_out(Model::pixel_offset(&model.field), 1)? {
        views.push(evaluator.evaluate(&truth, 0, &Silent)?);
        truths.push(truth);
    }
    let calibration = evaluator.calibration(&views, deviation);
    let calibration = calibration.ok_or_else(|| Error::malformed(&data.folder, "views", "errors of depth", "none"))?;
    let has_depth = |(_, view): &(TrueView, EvaluatedView)| !view.absolute_error.is_empty();
    let mut views: Vec<(TrueView, EvaluatedView)> = truths.into_iter().zip(views).filter(has_depth).collect();
    let mean = |view: &EvaluatedView| view.absolute_error.iter().sum::<f64>() / view.absolute_error.len() as f64;
    views.sort_by(|(_, a), (_, b)| mean(a).total_cmp(&mean(b)));
    Ok(Judged { views, deviation, reliability: calibration })
}

impl Judged {
    fn median(&self) -> &(TrueView, EvaluatedView) {
        &self.views[self.views.len() / 2]
    }

    fn words(&self, scene: &Scene) -> String {
        let held: Vec<String> =
            self.reliability.coverage.iter().map(|[_, held]| format!("{:.1}", 100.0 * held)).collect();
        format!(
            "{}: intervals for 50, 68, 90 and 95 % hold {} % of the errors; AUCE {:.3}.\n",
            scene.name(),
            held.join(", "),
            self.reliability.auce
        )
    }

    /// The median view: model, errors of depth, and their deviations on the same scale.
    fn panels(&self) -> Vec<Panel> {
        let (_, view) = self.median();
        let size = view.rendered.resolution;
        let centimetres = |values: &[f64]| {
            let mut image = vec![f64::NAN; view.rendered.pixels.len()];
            view.pixels.iter().zip(values).for_each(|(&i, value)| image[i] = 100.0 * value);
            image
        };
        let [errors, deviations] =
            [&view.absolute_error, &view.measures[self.deviation]].map(|values| centimetres(values));
        let mut all: Vec<f64> = errors.iter().chain(&deviations).copied().filter(|v| v.is_finite()).collect();
        all.sort_unstable_by(f64::total_cmp);
        let bar = || Bar::new([0.0, quantile(&all, SHOWN)], colorous::INFERNO);
        vec![
            color_panel("model", size, view.rendered.pixels.iter().map(|pixel| pixel.color)),
            scalar_panel("error of depth, cm", size, errors.iter().copied(), bar()),
            scalar_panel("standard deviation of depth, cm", size, deviations.iter().copied(), bar()),
        ]
    }
}
