//! The tables of the report.

use std::collections::BTreeMap;

use octobayes::uncertainty::Residuals;
use octobayes_evaluation::metrics::{ErrorDensity, PROBABILITIES};

use crate::joint::{Fit, Joint};
use crate::judge::{Row, Scored};
use crate::scene::Scene;
use common::table::{Table, deviation, mean, spread};

/// Values of all rows.
fn of(rows: &[&Row], value: impl Fn(&Row) -> f64) -> Vec<f64> {
    rows.iter().map(|row| value(row)).collect()
}

/// Coverage of the intervals, by scene and over all.
pub fn coverage(names: &[String], rows: &[Vec<Row>]) -> String {
    let mut table = Table::new(&[
        "scene",
        "PSNR, dB",
        "median error",
        "intervals of",
        "50 %",
        "68 %",
        "90 %",
        "95 %",
        "AUCE",
        "NLL",
        "best scale",
    ]);
    let mut add = |name: &str, rows: &[&Row]| {
        for (b, bar) in ["√(Var + s²), Student", "√(Var + s²), normal", "s alone, Student"].into_iter().enumerate()
        {
            let first = |text: String| if b == 0 { text } else { String::new() };
            let of = |value: &dyn Fn(&Row) -> f64, digits| spread(&of(rows, value), digits);
            let mut cells = vec![first(name.into()), first(of(&|row| row.psnr, 2)), first(of(&|row| row.error, 4))];
            cells.push(bar.into());
            cells.extend((0..PROBABILITIES.len()).map(|p| of(&|row| 100.0 * row.bars[b].held[p], 1)));
            cells.extend([
                of(&|row| row.bars[b].auce, 3),
                of(&|row| row.bars[b].nll[0], 2),
                of(&|row| row.bars[b].nll[1], 2),
            ]);
            table.row(&cells);
        }
    };
    for (name, rows) in names.iter().zip(rows) {
        add(name, &rows.iter().collect::<Vec<_>>());
    }
    add("all", &rows.iter().flatten().collect::<Vec<_>>());
    format!("### Coverage\n\n{}", table.text())
}

/// The mean over the models of a scene, for each measure.
fn by_scene(rows: &[Vec<Row>], m: usize, value: impl Fn(&Scored) -> f64) -> Vec<f64> {
    rows.iter().map(|rows| mean(&rows.iter().map(|row| value(&row.scored[m])).collect::<Vec<_>>())).collect()
}

/// Every measure on the scenes by which the default was chosen, and on the others, which are of these `meshes`.
pub fn ranking(choosing: &[Vec<Row>], testing: &[Vec<Row>], meshes: &[&str]) -> String {
    let mut table = Table::new(&[
        "measure",
        "chosen on: MAE",
        "RMSE",
        "tested on: MAE",
        "RMSE",
        "rank correlation",
        "mean over views",
        "less than the best (MAE)",
        "(RMSE)",
    ]);
    let measures = choosing[0][0].scored.len();
    let sum = |m: usize| mean(&by_scene(choosing, m, |s| s.mae)) + mean(&by_scene(choosing, m, |s| s.rmse));
    let mut order: Vec<usize> = (0..measures).collect();
    order.sort_by(|&a, &b| sum(a).total_cmp(&sum(b)));
    let best = order[0];
    for &m in &order {
        let of = |rows, value: &dyn Fn(&Scored) -> f64| format!("{:.3}", mean(&by_scene(rows, m, value)));
        // The best of the chosen ones against this, pair by pair of the scenes tested on.
        let paired = |value: &dyn Fn(&Scored) -> f64| {
            let pairs = by_scene(testing, m, value).into_iter().zip(by_scene(testing, best, value));
            interval(meshes, &pairs.map(|(other, best)| other - best).collect::<Vec<_>>())
        };
        table.row(&[
            testing[0][0].scored[m].name.clone(),
            of(choosing, &|s| s.mae),
            of(choosing, &|s| s.rmse),
            of(testing, &|s| s.mae),
            of(testing, &|s| s.rmse),
            of(testing, &|s| s.spearman[0]),
            of(testing, &|s| s.spearman[1]),
            paired(&|s| s.mae),
            paired(&|s| s.rmse),
        ]);
    }
    format!("### Ranking\n\n{}", table.text())
}

/// Every measure on scenes of these `meshes`, and each beside the one of this name.
pub fn beside(rows: &[Vec<Row>], meshes: &[&str], reference: &str) -> String {
    let [mae, rmse] = ["MAE", "RMSE"].map(|kind| format!("less than {reference} ({kind})"));
    let mut table = Table::new(&["measure", "MAE", "RMSE", "rank correlation", "mean over views", &mae, &rmse]);
    let scored = &rows[0][0].scored;
    let reference = scored.iter().position(|found| found.name == reference).expect("a measure of the study");
    let sum = |m: usize| mean(&by_scene(rows, m, |s| s.mae)) + mean(&by_scene(rows, m, |s| s.rmse));
    let mut order: Vec<usize> = (0..scored.len()).collect();
    order.sort_by(|&a, &b| sum(a).total_cmp(&sum(b)));
    for m in order {
        let of = |value: &dyn Fn(&Scored) -> f64| format!("{:.3}", mean(&by_scene(rows, m, value)));
        let paired = |value: &dyn Fn(&Scored) -> f64| {
            let pairs = by_scene(rows, m, value).into_iter().zip(by_scene(rows, reference, value));
            interval(meshes, &pairs.map(|(other, reference)| other - reference).collect::<Vec<_>>())
        };
        table.row(&[
            scored[m].name.clone(),
            of(&|s| s.mae),
            of(&|s| s.rmse),
            of(&|s| s.spearman[0]),
            of(&|s| s.spearman[1]),
            paired(&|s| s.mae),
            paired(&|s| s.rmse),
        ]);
    }
    format!("### Ranking\n\n{}", table.text())
}

/// Mean of paired differences, and the interval that holds the mean over meshes like these with 95 %; none for one
/// mesh. Views of one mesh are no independent scenes: what is compared are means over them.
fn interval(meshes: &[&str], differences: &[f64]) -> String {
    /// Two-sided quantiles of Student's t at 95 %, for 1, 2, 3 and 4 degrees of freedom.
    const T: [f64; 4] = [12.71, 4.30, 3.18, 2.78];
    let mut by_mesh: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (mesh, difference) in meshes.iter().zip(differences) {
        by_mesh.entry(mesh).or_default().push(*difference);
    }
    let means: Vec<f64> = by_mesh.values().map(|differences| mean(differences)).collect();
    let middle = mean(&means);
    let Some(t) = means.len().checked_sub(2).map(|freedom| T[freedom]) else { return format!("{middle:+.3}") };
    let half = t * deviation(&means) / (means.len() as f64).sqrt();
    format!("{middle:+.3} ({:+.3} to {:+.3})", middle - half, middle + half)
}

/// How well each measure tells surfaces that no training view saw.
pub fn never_seen(rows: &[Vec<Row>]) -> String {
    let mut table = Table::new(&["measure", "AUROC", "worst scene", "AUPR", "never seen, %"]);
    let measures = rows[0][0].scored.len();
    let of = |m: usize| -> Option<[Vec<f64>; 3]> {
        let found = |value: &dyn Fn(octobayes_evaluation::metrics::Detection) -> f64| -> Option<Vec<f64>> {
            let scene = |rows: &Vec<Row>| {
                let values: Option<Vec<f64>> = rows.iter().map(|row| row.scored[m].never_seen.map(value)).collect();
                values.map(|values| mean(&values))
            };
            rows.iter().map(scene).collect()
        };
        Some([found(&|d| d.auroc)?, found(&|d| d.aupr)?, found(&|d| d.positives)?])
    };
    let mut all: Vec<(usize, [Vec<f64>; 3])> = (0..measures).filter_map(|m| Some((m, of(m)?))).collect();
    all.sort_by(|a, b| mean(&b.1[0]).total_cmp(&mean(&a.1[0])));
    for (m, [auroc, aupr, share]) in all {
        table.row(&[
            rows[0][0].scored[m].name.clone(),
            format!("{:.3}", mean(&auroc)),
            format!("{:.3}", auroc.iter().copied().fold(f64::INFINITY, f64::min)),
            format!("{:.3}", mean(&aupr)),
            format!("{:.1}", 100.0 * mean(&share)),
        ]);
    }
    format!("### Never seen\n\n{}", table.text())
}

/// The joint variance, with constants fitted to all other scenes.
pub fn joint(scenes: &[Scene], rows: &[Vec<Row>]) -> String {
    let mut table =
        Table::new(&["scene", "a²", "c", "50 %", "68 %", "90 %", "95 %", "NLL", "a = 1, c = 0", "best scale"]);
    let fits: Vec<Vec<Fit>> = rows.iter().map(|rows| rows.iter().map(Fit::new).collect()).collect();
    let mut all: Vec<[f64; 7]> = Vec::new();
    for (scene, own) in scenes.iter().zip(rows) {
        // Not only this view of the mesh: every model of it is left out.
        let others = scenes.iter().zip(&fits).filter(|(other, _)| other.mesh != scene.mesh);
        let fitted = Fit::best(others.flat_map(|(_, fits)| fits));
        let of = |joint: Joint| own.iter().map(move |row| joint.calibration(row, 0.0));
        let found: Vec<[f64; 7]> = of(fitted)
            .zip(of(Joint { factor: 1.0, length: 0.0 }))
            .map(|(joint, plain)| {
                let (joint, plain) = (joint.of(ErrorDensity::PREDICTIVE), plain.of(ErrorDensity::PREDICTIVE));
                let [a, b, c, d] = joint.coverage.map(|[_, share]| 100.0 * share);
                [a, b, c, d, joint.nll, plain.nll, joint.nll_best_scale]
            })
            .collect();
        let column = |k: usize| mean(&found.iter().map(|row| row[k]).collect::<Vec<_>>());
        all.push(std::array::from_fn(column));
        let mut cells = vec![scene.name(), format!("{}", fitted.factor), format!("{}", fitted.length)];
        cells.extend(numbers(&all[all.len() - 1]));
        table.row(&cells);
    }
    let means: [f64; 7] = std::array::from_fn(|k| mean(&all.iter().map(|row| row[k]).collect::<Vec<_>>()));
    let mut cells = vec!["all".to_owned(), String::new(), String::new()];
    cells.extend(numbers(&means));
    table.row(&cells);
    format!("### With the residuals of the training images\n\n{}", table.text())
}

/// Values of c that are tried, as shares of the longest edge of the field's box.
const SHARES: [[u32; 2]; 9] = [[0, 1], [1, 60], [1, 40], [1, 30], [1, 20], [1, 15], [3, 40], [1, 10], [3, 20]];

/// The joint variance with a² = 1 and several c: means over scenes, and the shares on the scenes that hold least and
/// most. `of` says which scenes these are; `truth` is the variance of the depth maps themselves, squared scene units.
pub fn lengths(of: &str, rows: &[Vec<Row>], truth: f64) -> String {
    let mut table = Table::new(&["c / edge", "50 %", "68 %", "90 %", "95 %", "NLL", "AUSE: MAE", "RMSE"]);
    for [over, under] in SHARES {
        let share = f64::from(over) / f64::from(under);
        let of = |row: &Row| {
            let joint = Joint { factor: 1.0, length: share * row.edge };
            let calibration = joint.calibration(row, truth);
            let found = calibration.of(ErrorDensity::PREDICTIVE);
            let [a, b, c, d] = found.coverage.map(|[_, share]| 100.0 * share);
            let [mae, rmse] = joint.ranking(row);
            [a, b, c, d, found.nll, mae, rmse]
        };
        let scenes: Vec<Vec<[f64; 7]>> = rows.iter().map(|rows| rows.iter().map(of).collect()).collect();
        let column = |k: usize| -> Vec<f64> {
            scenes.iter().map(|rows| mean(&rows.iter().map(|row| row[k]).collect::<Vec<_>>())).collect()
        };
        let default = if (share - Residuals::LENGTH_SHARE).abs() < 1e-9 { " (`--images`)" } else { "" };
        let mut cells = vec![if over == 0 { "0".into() } else { format!("{over}/{under}{default}") }];
        cells.extend((0..4).map(|k| {
            let found = column(k);
            let [low, high] = [f64::min, f64::max].map(|either| found.iter().copied().reduce(either).unwrap_or(0.0));
            format!("{:.1} ({low:.1} to {high:.1})", mean(&found))
        }));
        cells.extend((4..7).map(|k| format!("{:.3}", mean(&column(k)))));
        table.row(&cells);
    }
    let edges: Vec<f64> = rows.iter().flatten().map(|row| row.edge).collect();
    let edges = format!("Longest edge of the boxes: {:.2} scene units.", mean(&edges));
    format!("### By the weight of the residuals{of}\n\n{edges}\n\n{}", table.text())
}

fn numbers(row: &[f64; 7]) -> impl Iterator<Item = String> {
    row.iter().enumerate().map(|(k, value)| if k < 4 { format!("{value:.1}") } else { format!("{value:.3}") })
}

/// Processor seconds of a model.
pub fn costs(rows: &[Vec<Row>]) -> String {
    let mut table = Table::new(&["processor seconds of a model", "mean"]);
    let all: Vec<&Row> = rows.iter().flatten().collect();
    let names =
        ["training", "uncertainty at level 7", "evaluation, all measures", "training the others of the ensemble"];
    for (k, name) in names.iter().enumerate() {
        if all.iter().all(|row| row.seconds[k] == 0.0) {
            continue;
        }
        table.row(&[(*name).to_owned(), format!("{:.1}", mean(&of(&all, |row| row.seconds[k])))]);
    }
    format!("### Cost\n\n{}", table.text())
}
