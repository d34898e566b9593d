//! Question: what error does a user buy with what time and memory?
//!
//! Time and |Δ log10 U| of the dense grid with the paper's random rays and of the octree with each feature switched on
//! one after the other; over rays, levels and scenes; the profile of a run; queries; files; bytes of sums. Errors are
//! against a dense grid of more random rays with exact derivatives ([`measure::reference`]). Writes the blocks of
//! `experiments/speed_vs_error.md` and its plots.

mod allocation;
mod measure;
mod parts;
mod profile;
mod queries;
mod sums;

use octobayes::Result;

use common::program::{Needs, Program};
use common::ranking::Truth;
use common::scenes::Scene;

/// Rays of the paper's workload.
const PAPER: u64 = 4_096_000;
/// Rays of the reference that scenes are compared with.
pub const MANY: u64 = 5 * PAPER;
/// Of the test views one in so many for the depth ranking, and of their pixels along x and y.
const EVERY: usize = 5;
const STRIDE: u32 = 2;

fn main() -> Result<()> {
    let parts = [
        ("targets", Needs::Data),
        ("profile", Needs::Data),
        ("differences", Needs::Data),
        ("ablation", Needs::Data),
        ("audit", Needs::Data),
        ("rays", Needs::Data),
        ("scenes", Needs::Data),
        ("trained", Needs::Data),
        ("allocation", Needs::Data),
        ("levels", Needs::Data),
        ("queries", Needs::Data),
        ("sums", Needs::Data),
    ];
    let program = Program::start("speed_vs_error", &parts)?;
    let lego = || Scene::lego(&Program::data()?);
    let at_most = |scene: Scene, rays: u64| Scene { settings: scene.settings.rays(rays), ..scene };
    program.part("targets", |work| parts::targets(work, &at_most(lego()?, PAPER)))?;
    program.part("profile", |work| profile::profile(work, &lego()?, &Scene::lego_mlp(&Program::data()?)?))?;
    program.part("differences", |work| {
        let data = Program::data()?;
        let scenes = [
            Scene::lego(&data)?,
            at_most(Scene::ignatius(&data)?, 204_800),
            at_most(Scene::garden(&data)?, 20_480),
            at_most(Scene::lego_mlp(&data)?, 8_192),
        ];
        parts::differences(work, &scenes)
    })?;
    program.part("ablation", |work| parts::ablation(work, &lego()?))?;
    program.part("audit", |work| parts::audit(work, &lego()?))?;
    program.part("rays", |work| {
        let truth = Truth::lego(&Program::data()?, EVERY, STRIDE)?;
        parts::rays(work, &[(lego()?, u64::MAX, MANY)], Some(&truth))
    })?;
    program.part("scenes", |work| {
        let data = Program::data()?;
        let scenes = [
            (Scene::ignatius(&data)?, PAPER / 4, MANY),
            // A ray meets matter nearly everywhere: it takes ten times as long as one of lego.
            (Scene::garden(&data)?, PAPER / 40, PAPER / 4),
            (Scene::city()?, PAPER / 4, MANY),
        ];
        parts::rays(work, &scenes, None)
    })?;
    program.part("trained", |work| {
        let armadillo = Scene::armadillo(&Program::data()?, work.folder())?;
        parts::rays(work, &[(armadillo, PAPER / 4, MANY)], None)
    })?;
    program.part("allocation", |work| {
        let data = Program::data()?;
        let scenes = [Scene::lego(&data)?, Scene::ignatius(&data)?, Scene::city()?];
        allocation::allocation(work, &scenes, PAPER)
    })?;
    program.part("levels", |work| parts::levels(work, &lego()?))?;
    program.part("queries", |work| queries::queries(work, &lego()?))?;
    program.part("sums", |work| sums::sums(work, &lego()?))
}
