//! Errors of depth of lego's splats on held-out views, and what ranks them.

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{Outputs, Probe, RayAverage, RenderedView, Renderer};
use octobayes::{Error, Result};
use octobayes_data::{Frame, Views};
use octobayes_depth::TrainingViews;
use octobayes_evaluation::{DepthMeaning, EvaluatedView, Evaluator, Reading, Score, TrueView};
use octobayes_splats::{Hits, SplatRenderer, Splats};
use serde::{Deserialize, Serialize};

use crate::blocks::{Blocks, Sums};
use common::halved;
use common::program::Program;
use common::settings::seeds;
use common::table::Table;
use common::work::Work;

const MODELS: [(&str, &str); 3] =
    [("lego_15k_sh3", "100 views"), ("lego_half12_6k_sh2", "12 views, one side"), ("lego_10views_5k_sh2", "10 views")];
const LEVELS: [u8; 2] = [5, 6];
const SEED: u64 = 0;
const RAYS: u64 = 1_000_000;
/// Error of the models' colours that the scale of the data presumes.
const NOISE: f64 = 0.03;
/// Half the edge of the box, scene units.
const HALF: f64 = 1.4;
/// Position of rays in a pixel.
const MIDDLE: f64 = 0.5;

/// Which pixels count.
const PIXELS: [&str; 2] = ["All pixels of known depth.", "Without the pixels at the edge of the silhouette."];

/// One measure of one model.
#[derive(Serialize, Deserialize)]
struct Row {
    name: String,
    /// Of [`PIXELS`]: AUSE of the mean absolute error, pooled over views, and Spearman's ρ with it.
    ranks: [[f64; 2]; 2],
    /// Shares of the errors within the normal density's intervals of 50, 68, 90 and 95 %, if it is a deviation.
    held: Option<[f64; 4]>,
}

pub fn settings() -> String {
    format!(
        "200 × 200 pixels, 40 held-out views; {RAYS} rays, box of edge {}, `--scale data --noise {NOISE}`, covariance \
         block. {}",
        2.0 * HALF,
        seeds(&[SEED]),
    )
}

pub fn tables(work: &Work) -> Result<String> {
    let rows = |(model, _): &(&str, &str)| work.row((model, LEVELS, SEED, RAYS), || measure(model));
    let all: Vec<Vec<Row>> = MODELS.iter().map(rows).collect::<Result<_>>()?;
    let mut text = String::new();
    for (k, pixels) in PIXELS.iter().enumerate() {
        let head = MODELS.iter().flat_map(|(_, trained)| [format!("{trained}: AUSE"), "ρ".into()]);
        let head: Vec<String> = ["measure".to_string()].into_iter().chain(head).collect();
        let mut table = Table::new(&head.iter().map(String::as_str).collect::<Vec<_>>());
        for (m, row) in all[0].iter().enumerate() {
            let figures = all.iter().flat_map(|rows| rows[m].ranks[k]).map(|figure| format!("{figure:.3}"));
            table.row(&[row.name.clone()].into_iter().chain(figures).collect::<Vec<_>>());
        }
        text += &format!("{pixels}\n\n{}\n", table.text());
    }
    text += "Coverage without calibration.\n\n";
    let mut table = Table::new(&["trained on", "deviation", "50 % holds", "68 %", "90 %", "95 %"]);
    for ((_, trained), rows) in MODELS.iter().zip(&all) {
        for row in rows {
            if let Some(held) = row.held {
                let cells = held.map(|share| format!("{share:.3}"));
                table.row(&[vec![trained.to_string(), row.name.clone()], cells.to_vec()].concat());
            }
        }
    }
    Ok(text + table.text())
}

fn measure(model: &str) -> Result<Vec<Row>> {
    let data = Program::data()?;
    let file = |end: &str| data.join(format!("splats-trained/{model}{end}"));
    let splats = Splats::read(&file(".ply"))?;
    let cameras = Views::read(&file("_transforms.json"), None)?.cameras();
    let domain = Domain::Box(Aabb::centered_cube(HALF));
    let scale = DataScale::from_cameras(&cameras, NOISE, &domain)?;
    let mut sums = Sums::new(&splats);
    let mut readings = Vec::new();
    for level in LEVELS {
        let grid = GridSettings::default().level(level).covariance(Covariance::Block).keep_sums(true);
        let run = Estimation::new(&splats, &cameras).domain(domain).grid(grid.scale(Scale::Data(scale)));
        let is_first = level == LEVELS[0];
        let run = run.tap(|batches| {
            if is_first {
                sums.add(batches);
            }
            Ok(())
        });
        let field = run.rays(RaySettings::default().rays(RAYS).seed(SEED)).run()?.field;
        let averages = [RayAverage::USpreadPerRootRay, RayAverage::WeightedMean];
        let name = format!("U, level {level},");
        readings.extend(Reading::from_field(&name, &field, Some(&[Covariance::Block]), Some(&averages))?);
    }
    let model = Judged { splats: &splats, cameras: &cameras, blocks: sums.blocks(&scale, RAYS), readings };
    model.rows()
}

/// A model with its readings.
struct Judged<'a> {
    splats: &'a Splats,
    cameras: &'a [Camera],
    blocks: Blocks,
    readings: Vec<Reading>,
}

/// Measures of every splat by itself.
const BY_ITSELF: [&str; 2] = ["mean log U, every splat by itself", "FisherRF, colours"];

impl Judged<'_> {
    fn rows(&self) -> Result<Vec<Row>> {
        let lego = Program::data()?.join("nerf-lego-400");
        let folder = tempfile::tempdir().map_err(Error::io(&lego, "no temporary folder"))?;
        halved::write(&lego, folder.path())?;
        let renderer = SplatRenderer::new(self.splats, Vec3::ONE);
        let training = TrainingViews::render(&renderer, self.cameras, MIDDLE, &Silent)?;
        let evaluator = Evaluator { training: Some(&training), ..Evaluator::new(&renderer, &self.readings) };
        let mut views = Vec::new();
        let mut inside = Vec::new();
        for (seed, truth) in (0..).zip(&self.truths(folder.path())?) {
            let mut view = evaluator.evaluate(truth, seed, &Silent)?;
            view.measures.extend(self.by_itself(&renderer, truth, &view)?);
            view.rendered = RenderedView::default();
            let of_inside = |i: &usize| !is_at_edge(truth, *i);
            inside.push(part(&view, &view.pixels.iter().map(of_inside).collect::<Vec<_>>()));
            views.push(view);
        }
        let measures = evaluator.measures();
        let names = measures.iter().map(|measure| evaluator.name(*measure));
        let names: Vec<String> = names.chain(BY_ITSELF.map(String::from)).collect();
        let of = |(m, name): (usize, &String)| {
            let score = |views: &[EvaluatedView]| {
                let score = Score::new(views, m).expect("pixels with depth and some error");
                [score.ause_pooled.mae, score.rank_correlation]
            };
            let calibration = (m < measures.len()).then(|| evaluator.calibration(&views, m)).flatten();
            let held = calibration.map(|found| [0, 1, 2, 3].map(|k| found.coverage[k][1]));
            Row { name: name.clone(), ranks: [score(&views), score(&inside)], held }
        };
        Ok(names.iter().enumerate().map(of).collect())
    }

    fn truths(&self, folder: &Path) -> Result<Vec<TrueView>> {
        let views = Views::read(&folder.join("transforms_test.json"), None)?;
        let found = halved::depth(folder).find(&views.path, &views.frames, &views.frames)?;
        let depth = DepthMeaning { encoding: found.encoding, bounds: self.splats.bounds(), jump: 0.0 };
        let read = |frame: &Frame| TrueView::read(frame, Some(&depth), DVec3::ONE, MIDDLE, 1);
        found.frames.iter().map(read).collect()
    }

    /// [`BY_ITSELF`] at the pixels of a view.
    fn by_itself(&self, renderer: &SplatRenderer, truth: &TrueView, view: &EvaluatedView) -> Result<[Vec<f64>; 2]> {
        let probe = Probe { field: &self.blocks, averages: &[RayAverage::WeightedMean] };
        let shown = renderer.image(&truth.camera, MIDDLE, &[probe], &Silent)?;
        let prepared = renderer.prepare(&truth.camera, Outputs::Colors);
        let (width, mut hits) = (truth.camera.resolution[0] as usize, Hits::default());
        let fisher = |&i: &usize| {
            prepared.hits([i % width, i / width].map(|n| n as f64 + MIDDLE), &mut hits);
            // The trace of the pixel's information, by that of training.
            hits.list.iter().map(|hit| hit.weight().powi(2) / self.blocks.fisher[prepared.splat(hit)]).sum()
        };
        let fisher = view.pixels.iter().map(fisher).collect();
        Ok([view.pixels.iter().map(|&i| shown.log10_uncertainty[0][i]).collect(), fisher])
    }
}

/// Whether one of a pixel's eight neighbours has no depth, where maps are means over the object and what is behind it.
fn is_at_edge(truth: &TrueView, i: usize) -> bool {
    let [width, height] = truth.camera.resolution.map(|n| n as usize);
    let around = |n: usize, most: usize| n.saturating_sub(1)..=(n + 1).min(most - 1);
    let mut near = around(i / width, height).flat_map(|y| around(i % width, width).map(move |x| y * width + x));
    near.any(|n| truth.distance[n].is_none())
}

/// Some of the pixels of a view.
fn part(view: &EvaluatedView, kept: &[bool]) -> EvaluatedView {
    let of = |values: &[f64]| values.iter().zip(kept).filter(|(_, kept)| **kept).map(|(value, _)| *value).collect();
    EvaluatedView {
        pixels: view.pixels.iter().zip(kept).filter(|(_, kept)| **kept).map(|(i, _)| *i).collect(),
        absolute_error: of(&view.absolute_error),
        measures: view.measures.iter().map(|measure| of(measure)).collect(),
        spread: of(&view.spread),
        ..view.clone()
    }
}
