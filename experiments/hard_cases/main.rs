//! Question: when can the numbers be believed?
//!
//! Prints the tables of `experiments/hard_cases.md` and writes its plots; arguments choose parts: `honesty steps sums`, by default all.
//! Parts on real models need `OCTOBAYES_DATA` and say so where it is missing.

mod honesty;
mod scenes;
mod steps;
mod sums;
mod waves;

use octobayes::Result;

fn main() -> Result<()> {
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    let wants = |part: &str| chosen.is_empty() || chosen.iter().any(|c| c == part);
    println!("{} threads, seed 0", rayon::current_num_threads());
    if wants("steps") {
        steps::steps()?;
    }
    if wants("sums") {
        sums::sums()?;
    }
    if wants("honesty") {
        honesty::honesty()?;
    }
    Ok(())
}
