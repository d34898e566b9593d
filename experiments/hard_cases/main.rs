//! Question: on which scenes can the numbers be believed?
//!
//! Prints the tables of `experiments/hard_cases.md`; arguments choose parts, by default all.

mod cases;
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
    if wants("cases") {
        cases::cases()?;
    }
    Ok(())
}
