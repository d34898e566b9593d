//! What a block's rows share, in words.

use octobayes::estimate::{GridSettings, RaySettings};

/// The settings of a block. Those that vary from row to row are `varied`, by their first word, and left to the table.
#[must_use]
pub fn describe(rays: &RaySettings, grid: &GridSettings, varied: &[&str]) -> String {
    let step = rays.step.map_or("default".into(), |step| format!("{step} edges"));
    let all = [
        ("level", grid.level.to_string()),
        ("rays", super::table::whole(rays.rays as f64)),
        ("pixels", format!("{:?}", rays.pixels)),
        ("gradient", format!("{:?}", rays.gradient)),
        ("step", step),
        ("cutoff", format!("{:e}", rays.cutoff)),
        ("occupancy", rays.occupancy.to_string()),
        ("grid", format!("{:?}", grid.grid)),
        ("tolerance", grid.tolerance.to_string()),
        ("pooling", grid.pooling.to_string()),
        ("covariance", grid.covariance.name().into()),
    ];
    let kept = all.into_iter().filter(|(name, _)| !varied.contains(name));
    let words: Vec<String> = kept.map(|(name, value)| format!("{name} {value}")).collect();
    format!("Settings: {}.", words.join(", "))
}

/// Seeds in words.
pub fn seeds(seeds: &[u64]) -> String {
    let list: Vec<String> = seeds.iter().map(u64::to_string).collect();
    match seeds.len() {
        1 => format!("Seed {}.", list[0]),
        n => format!("Seeds {}; mean ± standard deviation over these {n}.", list.join(", ")),
    }
}
