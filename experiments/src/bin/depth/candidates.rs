//! Measures that are put together from others.

use crate::judge::LEVELS;

/// Appends the candidates for ranking and their controls to what the evaluator measured.
///
/// `weights` is the variance of the ray's weights.
pub fn candidates(all: &mut Vec<(String, Vec<f64>)>, weights: &[f64]) {
    let of = |name: String| &all.iter().find(|(found, _)| *found == name).expect("a measure of the evaluator").1;
    let spread = LEVELS.map(|level| of(format!("block {level}, u-spread")));
    let per_ray = of("weights' spread / rays".into());
    let pixels = 0..weights.len();
    // log10 of the training rays around the expected depth.
    let rays = |i: usize| weights[i].sqrt().log10() - per_ray[i].log10();
    let levels = |i: usize| spread.iter().map(|level| level[i]).sum::<f64>() / LEVELS.len() as f64;
    let found = [
        ("block, mean of levels, u-spread".to_owned(), pixels.clone().map(levels).collect()),
        (
            "block, mean of levels, u-spread-per-root-ray".into(),
            pixels.clone().map(|i| levels(i) - 0.5 * rays(i)).collect(),
        ),
        (format!("block {}, u-spread-per-root-ray", LEVELS[1]), pixels.map(|i| spread[1][i] - 0.5 * rays(i)).collect()),
    ];
    all.extend(found);
}
