//! Question: what error does a user buy with what time and memory?
//!
//! Time and |Δ log10 U| of the dense grid with the paper's random rays and of the octree with each feature switched on one after the other; over rays,
//! levels and scenes; the profile of a run; queries; files. Errors are against a dense grid of twenty times as many random rays with exact
//! derivatives ([`measure::reference`]). Needs `OCTOBAYES_DATA`. Prints the tables of `experiments/speed_vs_error.md` and writes its plots;
//! arguments choose parts: `ablation rays scenes levels targets profile queries`, by default all.

mod ause;
mod measure;
mod parts;
mod profile;
mod queries;
mod scenes;

use std::path::PathBuf;

use octobayes::Result;

fn main() -> Result<()> {
    let data = PathBuf::from(std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA names the data folder"));
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    let wants = |part: &str| chosen.is_empty() || chosen.iter().any(|c| c == part);
    println!("two cores wanted, {} threads, seed 0, level 8 unless said otherwise", rayon::current_num_threads());
    let lego = scenes::lego(&data)?;
    if wants("targets") {
        parts::targets(&lego)?;
    }
    if wants("profile") {
        profile::profile(&lego)?;
        profile::network(&scenes::lego_mlp(&data)?);
    }
    if wants("levels") {
        parts::levels(&lego)?;
    }
    if wants("queries") {
        queries::queries(&lego)?;
    }
    if wants("ablation") || wants("rays") {
        // Twenty times as many as all rows but the last have.
        let reference = measure::reference(&lego, 8, 20 * 1_024_000)?;
        if wants("ablation") {
            parts::ablation(&lego, &reference)?;
        }
        if wants("rays") {
            parts::rays(&lego, &reference, Some(&ause::Truth::lego(&data)?))?;
        }
    }
    if wants("scenes") {
        for scene in [scenes::ignatius(&data)?, scenes::garden(&data)?, scenes::city()?] {
            let reference = measure::reference(&scene, 8, 20 * scene.rays)?;
            parts::rays(&scene, &reference, None)?;
        }
    }
    Ok(())
}
