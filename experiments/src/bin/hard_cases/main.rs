//! Question: when can the numbers be believed?
//!
//! Hard scenes against an oracle in f64, the finite-difference step, the precision of sums, and error bars against the
//! errors themselves. Writes the blocks of `experiments/hard_cases.md` and its plots.

mod cases;
mod honesty;
mod steps;
mod sums;
mod target;
mod waves;
// The tests use all of these, this program a part.
#[allow(dead_code)]
#[path = "../../../../tests/accuracy/compare.rs"]
mod compare;
#[allow(dead_code)]
#[path = "../../../../tests/accuracy/oracle/mod.rs"]
mod oracle;
#[allow(dead_code)]
#[path = "../../../../tests/accuracy/scenes/mod.rs"]
mod scenes;

use octobayes::Result;
use octobayes::posterior::Pooling;

use common::program::{Needs, Program};
use common::scenes::Scene;

fn lego(pooling: Pooling) -> Result<Scene> {
    let lego = Scene::lego(&Program::data()?)?;
    Ok(Scene { settings: lego.settings.rays(204_800), grid: lego.grid.level(7).pooling(pooling), ..lego })
}

fn main() -> Result<()> {
    let parts = [
        ("cases", Needs::Nothing),
        ("forward", Needs::Nothing),
        ("steps", Needs::Nothing),
        ("steps-lego", Needs::Data),
        ("sums", Needs::Nothing),
        ("error-bars", Needs::Nothing),
        ("error-bars-lego", Needs::Data),
        ("error-bars-lego-pooled", Needs::Data),
        ("error-bars-zoo", Needs::Nothing),
        ("error-bars-pooled", Needs::Nothing),
        ("target-error", Needs::Nothing),
    ];
    let program = Program::start("hard_cases", &parts)?;
    program.part("cases", cases::cases)?;
    program.part("forward", cases::forward)?;
    program.part("steps", |work| steps::steps(work, &steps::waves(), "hard_cases_steps.svg"))?;
    program.part("steps-lego", |work| {
        let data = Program::data()?;
        let [png, mlp] = [Scene::lego(&data)?, Scene::lego_mlp(&data)?];
        let png = Scene { settings: png.settings.rays(1024), ..png };
        let mlp = Scene { settings: mlp.settings.rays(256), ..mlp };
        steps::steps(work, &[png, mlp], "hard_cases_steps_lego.svg")
    })?;
    program.part("sums", |_| sums::sums())?;
    program.part("error-bars", |work| {
        let courtyard = Scene::built_in("courtyard")?;
        let courtyard = Scene { settings: courtyard.settings.rays(102_400), ..courtyard };
        honesty::scenes(work, &[courtyard, Scene::built_in("wall")?, Scene::built_in("floater")?])
    })?;
    program.part("error-bars-lego", |work| honesty::scenes(work, &[lego(Pooling::Off)?]))?;
    program.part("error-bars-lego-pooled", |work| honesty::scenes(work, &[lego(Pooling::Auto)?]))?;
    program.part("error-bars-zoo", |work| honesty::zoo(work, Pooling::Off))?;
    program.part("error-bars-pooled", |work| honesty::zoo(work, Pooling::Auto))?;
    program.part("target-error", target::zoo)
}
