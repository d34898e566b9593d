//! Question: when can the numbers be believed?
//!
//! Prints the tables of `experiments/hard_cases.md` and writes its plots; arguments choose parts: `cases steps sums honesty`, by default all.
//! Parts on real models need `OCTOBAYES_DATA` and say so where it is missing.

mod cases;
mod honesty;
mod scenes;
mod steps;
mod sums;
mod waves;
// The tests use all of both.
#[allow(dead_code)]
#[path = "../../tests/zoo/compare.rs"]
mod compare;
#[allow(dead_code)]
#[path = "../../tests/zoo/oracle/mod.rs"]
mod oracle;

use octobayes::Result;

fn main() -> Result<()> {
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    let wants = |part: &str| chosen.is_empty() || chosen.iter().any(|c| c == part);
    println!("{} threads, seed 0", rayon::current_num_threads());
    if wants("cases") {
        cases::cases()?;
    }
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
