//! Hash grids trained on few views of meshes: what goes of them by the views, and what by U.

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, Model, RaySettings};
use octobayes::posterior::Covariance;
use octobayes::rays::Pixels;
use octobayes::uncertainty::{BakedField, is_certain};
use octobayes_clean::{Cells, Clean, CleanedVolume, OfCells, Rule, Strength};
use octobayes_models::HashGrid;
use octobayes_synth::Up;
use serde::{Deserialize, Serialize};

use common::meshes::MESHES;
use common::surface::Place;
use common::table::{Table, mean};
use common::work::Work;

use crate::judge::{Figures, Images};
use crate::meshes::{FITTED, SEEDS};
use crate::trained::{GRID_STEPS, HELD_OUT, SIDE, SLACK, Scene, VIEWS, Views};

/// Level of the field of U.
const LEVEL: u8 = 7;
/// Least light of a cell that is judged, in pixels.
const LEAST: f64 = 0.1;
/// Shares of the visible surfaces that thresholds of U leave.
const SHARES: [f64; 2] = [0.99, 0.9];
/// What is removed, in the order of rows.
const REMOVALS: [&str; 6] = ["nothing", "by U: 99 % of surfaces stay", "90 %", "careful", "normal", "strong"];

pub fn settings() -> String {
    format!(
        "{SIDE} × {SIDE} pixels, {GRID_STEPS} steps; {HELD_OUT} held-out views all around. Cells are those of a grid of \
         128³; each counts as much as the light that training pixels get from it, if that is {LEAST} pixels or more. One is in the air if its middle is \
         farther than {:.0} % of the mesh's length from the mesh, and outside of it; those at or under the ground are \
         not judged. Means over two meshes and seeds 0, 1 and 2 (of the fit: seed 0).",
        100.0 * SLACK,
    )
}

/// What is found of one model.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    /// Share of the judged light that comes from the air.
    in_air: f64,
    /// `[REMOVALS]`.
    removals: Vec<(Figures, Images)>,
}

fn cleaned(model: &HashGrid, scene: &Scene, rule: Rule) -> Result<CleanedVolume> {
    let cells = Cells::new(*model.domain(), [model.finest_occupancy() as u32; 3])?;
    Clean::new(&scene.cameras()).rule(rule).volume(model, cells)
}

fn centers(found: &CleanedVolume) -> Vec<Vec3> {
    found.parts.iter().map(|&cell| found.cells.center(cell)).collect()
}

/// Where the cells are that give training pixels some light. The others are many, and are not judged.
fn places(scene: &Scene, found: &CleanedVolume) -> Vec<Place> {
    let centers = centers(found);
    let judged: Vec<usize> = (0..centers.len()).filter(|&i| found.cleaned.evidence.weight[i] >= LEAST).collect();
    let of_judged = scene.places(&judged.iter().map(|&i| centers[i]).collect::<Vec<_>>());
    let mut places = vec![Place::Elsewhere; centers.len()];
    judged.into_iter().zip(of_judged).for_each(|(i, place)| places[i] = place);
    places
}

fn goes(found: &CleanedVolume, strength: Strength) -> Vec<bool> {
    found.cleaned.removed(strength).iter().map(Option::is_some).collect()
}

/// What other constants of the rule would find: least precision and mean recall.
pub fn fit(work: &Work) -> Result<String> {
    let mut models = Vec::new();
    for (mesh, up) in &MESHES[..FITTED] {
        for views in VIEWS {
            let scene = Scene::new(work, mesh, *up, views, SEEDS[0])?;
            let model = scene.hash_grid(SEEDS[0])?;
            // The cells and their light do not depend on the rule.
            let places = places(&scene, &cleaned(&model, &scene, Rule::default())?);
            models.push((model, scene, places));
        }
    }
    let mut head = vec!["reach, cells".to_string(), "on".into()];
    head.extend(Strength::ALL.iter().flat_map(|s| [format!("{s}: least precision"), "mean recall".into()]));
    let mut table = Table::new(&head.iter().map(String::as_str).collect::<Vec<_>>());
    for reach in [0.5, 1.0, 2.0] {
        for on in [0.25, 0.5, 1.0, 2.0] {
            let found = models.iter().map(|(model, scene, places)| {
                let found = cleaned(model, scene, Rule { of_cells: OfCells { on, reach }, ..Rule::default() })?;
                let of = |strength| Figures::weighted(&goes(&found, strength), places, &found.cleaned.evidence.weight);
                Ok(Strength::ALL.map(of))
            });
            let found: Vec<[Figures; 3]> = found.collect::<Result<_>>()?;
            let mut row = vec![reach.to_string(), on.to_string()];
            for strength in Strength::ALL {
                let of = || found.iter().map(|figures| figures[strength as usize]);
                let least = of().filter_map(|f| f.precision).fold(1.0, f64::min);
                let recall = mean(&of().map(|f| f.recall).collect::<Vec<_>>());
                row.extend([least, recall].map(|v| format!("{v:.3}")));
            }
            table.row(&row);
        }
    }
    Ok(table.text().to_string())
}

fn measure(work: &Work, mesh: &str, up: Up, views: Views, seed: u64) -> Result<Row> {
    let scene = Scene::new(work, mesh, up, views, seed)?;
    let (model, cameras) = (scene.hash_grid(seed)?, scene.cameras());
    let found = cleaned(&model, &scene, Rule::default())?;
    let (centers, weights) = (centers(&found), &found.cleaned.evidence.weight);
    let places = places(&scene, &found);
    let figures = |removed: &[bool]| Figures::weighted(removed, &places, weights);

    let grid = GridSettings::default().level(LEVEL).covariance(Covariance::Block);
    let rays = RaySettings::default().background(Vec3::ONE).pixels(Pixels::Every);
    let field = Estimation::new(&model, &cameras).grid(grid).rays(rays).run()?.field;
    let baked = BakedField::new(&field);
    let mut removals = vec![(figures(&vec![false; centers.len()]), Images::of(&model, &scene.truth)?)];
    for log10 in baked.surface_quantiles(SHARES).expect("points on visible surfaces") {
        let removed: Vec<bool> = is_certain(&centers, &baked, log10).iter().map(|kept| !kept).collect();
        let left = model.certain_part(&baked, log10)?.expect("a part of a volume");
        removals.push((figures(&removed), Images::of(&*left, &scene.truth)?));
    }
    for strength in Strength::ALL {
        let cells: Vec<bool> = found.removed(strength).iter().map(Option::is_some).collect();
        removals.push((figures(&goes(&found, strength)), Images::of(&model.without(&cells), &scene.truth)?));
    }
    let all = figures(&vec![true; centers.len()]);
    Ok(Row { in_air: all.precision.unwrap_or(0.0), removals })
}

/// All removals on the meshes that the rule is not fitted on; means over seeds.
pub fn test(work: &Work) -> Result<String> {
    let head = [
        "models",
        "light from the air",
        "removed",
        "share",
        "precision",
        "least",
        "recall",
        "PSNR, dB",
        "floating light",
        "coverage",
        "error of depth",
    ];
    let mut table = Table::new(&head);
    for views in VIEWS {
        let mut rows = Vec::new();
        for (mesh, up) in &MESHES[FITTED..] {
            for seed in SEEDS {
                let key = (mesh, views.name, seed, GRID_STEPS, SIDE);
                rows.push(work.row(key, || measure(work, mesh, *up, views, seed))?);
            }
        }
        let mean_of = |value: &dyn Fn(&Row) -> f64| mean(&rows.iter().map(value).collect::<Vec<_>>());
        for (k, removal) in REMOVALS.iter().enumerate() {
            let precisions: Vec<f64> = rows.iter().filter_map(|row| row.removals[k].0.precision).collect();
            let share = |value: f64| if precisions.is_empty() { "-".into() } else { format!("{value:.3}") };
            let images = |value: fn(&Images) -> f64, digits: usize| {
                let [before, after] = [0, k].map(|k| mean_of(&|row| value(&row.removals[k].1)));
                if k == 0 { format!("{after:.digits$}") } else { format!("{:+.digits$}", after - before) }
            };
            table.row(&[
                views.name.to_string(),
                format!("{:.4}", mean_of(&|row| row.in_air)),
                (*removal).to_string(),
                format!("{:.4}", mean_of(&|row| row.removals[k].0.share)),
                share(mean(&precisions)),
                share(precisions.iter().copied().fold(1.0, f64::min)),
                format!("{:.3}", mean_of(&|row| row.removals[k].0.recall)),
                images(|images| images.psnr, 2),
                images(|images| images.floating, 4),
                images(|images| images.coverage, 4),
                images(|images| images.depth, 4),
            ]);
        }
    }
    Ok(table.text().to_string())
}
