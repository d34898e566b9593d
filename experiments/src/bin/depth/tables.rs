//! The tables of the report.

use std::collections::BTreeMap;

use crate::judge::{Row, Scored};
use common::table::{Table, deviation, mean};

/// Values of all rows.
fn of(rows: &[&Row], value: impl Fn(&Row) -> f64) -> Vec<f64> {
    rows.iter().map(|row| value(row)).collect()
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
