//! The tables of a report's part.

use common::table::{Table, mean};

use crate::methods::{REMOVALS, Row, SCORES};

/// Models of one kind: name, and a row for each.
type Kind<'a> = (&'a str, Vec<&'a Row>);

/// Models by their name.
fn kinds(rows: &[(String, Row)]) -> Vec<Kind<'_>> {
    rows.chunk_by(|a, b| a.0 == b.0)
        .map(|chunk| (chunk[0].0.as_str(), chunk.iter().map(|(_, row)| row).collect()))
        .collect()
}

fn mean_of(rows: &[&Row], value: impl Fn(&Row) -> f64) -> f64 {
    mean(&rows.iter().map(|row| value(row)).collect::<Vec<_>>())
}

/// Mean recall of every score.
pub fn of_scores(rows: &[(String, Row)]) -> String {
    let kinds = kinds(rows);
    let names = kinds.iter().map(|(name, _)| *name);
    let mut table = Table::new(&["recall at a precision of 0.95"].into_iter().chain(names).collect::<Vec<_>>());
    for (k, name) in SCORES.iter().enumerate() {
        let cells = kinds.iter().map(|(_, rows)| format!("{:.3}", mean_of(rows, |row| row.found[k])));
        table.row(&[(*name).to_string()].into_iter().chain(cells).collect::<Vec<_>>());
    }
    table.text().to_string()
}

/// What every removal takes and does, in the mean; and the least precision of all models.
pub fn of_removals(rows: &[(String, Row)]) -> String {
    let head = [
        "models",
        "in the air",
        "removed",
        "share",
        "precision",
        "recall",
        "of `floating`: precision",
        "least",
        "PSNR, dB",
        "floating light",
        "coverage",
        "error of depth",
        "seconds",
    ];
    let mut table = Table::new(&head);
    for (name, rows) in kinds(rows) {
        for (k, removal) in REMOVALS.iter().enumerate() {
            let precisions: Vec<f64> = rows.iter().filter_map(|row| row.removals[k].0.precision).collect();
            let floating = |row: &&Row| row.floating[k.checked_sub(2)?].precision;
            let floating: Vec<f64> = rows.iter().filter_map(floating).collect();
            let share = |values: &[f64], value: f64| if values.is_empty() { "-".into() } else { format!("{value:.3}") };
            let least = floating.iter().copied().fold(1.0, f64::min);
            let images = |value: fn(&crate::judge::Images) -> f64, digits: usize| {
                let [before, after] = [0, k].map(|k| mean_of(&rows, |row| value(&row.removals[k].1)));
                if k == 0 { format!("{after:.digits$}") } else { format!("{:+.digits$}", after - before) }
            };
            table.row(&[
                name.to_string(),
                format!("{:.3}", mean_of(&rows, |row| row.in_air)),
                (*removal).to_string(),
                format!("{:.3}", mean_of(&rows, |row| row.removals[k].0.share)),
                share(&precisions, mean(&precisions)),
                format!("{:.3}", mean_of(&rows, |row| row.removals[k].0.recall)),
                share(&floating, mean(&floating)),
                share(&floating, least),
                images(|images| images.psnr, 2),
                images(|images| images.floating, 4),
                images(|images| images.coverage, 4),
                images(|images| images.depth, 4),
                if floating.is_empty() { "-".into() } else { format!("{:.1}", mean_of(&rows, |row| row.seconds)) },
            ]);
        }
    }
    table.text().to_string()
}
