//! Question: does the uncertainty tell where a model that saw too little is wrong, and better than what costs nothing?
//!
//! Trains hash grids on few views or on one half of scenes whose depth is known, computes their uncertainty, and ranks
//! the depth error of held-out views by every reading of H, beside measures without a Hessian and ensembles of ten.
//!
//!     cargo run --release --example few_views -- [--quick] [--rays N] [--work DIR] [--budget MINUTES] [SCENE ...]
//!
//! Scenes come in order of importance. Everything that was computed is kept in the work folder (target/few_views): a
//! run that was stopped goes on where it was, and scenes that are done are not done again. The block of
//! `experiments/few_views.md` is rewritten after every scene, with pictures and plots beside it, unless only some
//! scenes, other rays or `--quick` were asked for; then the tables are printed. Needs `OCTOBAYES_DATA`; `--quick` needs
//! nothing: one small scene of a knot that this program makes, a short training, an ensemble of three.

#[path = "../common/mod.rs"]
mod common;
mod data;
mod model;
mod picture;
mod plan;
mod report;
mod scene;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use octobayes::Result;

use common::work::Dated;
use plan::{Plan, Scene};
use scene::SceneResult;

/// What the command line asks for.
struct Arguments {
    plan: Plan,
    work: PathBuf,
    budget: Option<Duration>,
    scenes: Vec<String>,
}

fn arguments() -> Arguments {
    let mut out =
        Arguments { plan: Plan::full(), work: PathBuf::from("target/few_views"), budget: None, scenes: Vec::new() };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = |name: &str| words.next().unwrap_or_else(|| panic!("{name} needs a value"));
        match word.as_str() {
            "--quick" => {
                out.plan = Plan::quick();
                out.work = out.work.with_file_name("few_views_quick");
            }
            "--rays" => out.plan.rays = value("--rays").parse().expect("--rays, a number"),
            "--work" => out.work = value("--work").into(),
            "--budget" => {
                let minutes: f64 = value("--budget").parse().expect("--budget in minutes");
                out.budget = Some(Duration::from_secs_f64(60.0 * minutes));
            }
            _ => out.scenes.push(word),
        }
    }
    out
}

fn main() -> Result<()> {
    let Arguments { plan, work, budget, scenes } = arguments();
    let is_whole = scenes.is_empty() && plan == Plan::full();
    std::fs::create_dir_all(&work).map_err(octobayes::Error::io(&work, "cannot create the folder"))?;
    let start = Instant::now();
    let wanted = |scene: &Scene| scenes.is_empty() || scenes.iter().any(|name| name == scene.name);
    let all: Vec<Scene> = plan.scenes().into_iter().filter(wanted).collect();
    // One model of every scene first: ten cost ten times as much, and a study that is stopped should know every scene a
    // little.
    let single = all.iter().map(|scene| Scene { ensemble: scene.ensemble && plan.quick, ..scene.clone() });
    let mut results: Vec<Option<Dated<SceneResult>>> = vec![None; all.len()];
    let rounds: Vec<(usize, Scene)> = single.enumerate().chain(all.iter().cloned().enumerate()).collect();
    let (mut done, mut left) = (Vec::new(), Vec::new());
    for (i, scene) in rounds {
        // A scene that is done takes no time; one that is not is not begun when time is up.
        let is_late = budget.is_some_and(|budget| start.elapsed() > budget);
        results[i] = scene::result(&scene, &plan, &work, is_late)?.or(results[i].take());
        done = results.iter().flatten().cloned().collect::<Vec<_>>();
        let is_left = |(scene, result): &(&Scene, &Option<Dated<SceneResult>>)| {
            result.as_ref().is_none_or(|r| scene.ensemble && r.value.costs.ensemble.is_none())
        };
        let name = |(scene, result): (&Scene, &Option<Dated<SceneResult>>)| {
            if result.is_some() { format!("the ensemble of {}", scene.name) } else { scene.name.to_string() }
        };
        left = all.iter().zip(&results).filter(is_left).map(name).collect();
        if is_whole && !done.is_empty() {
            report::write(&plan, &done, &left, &work)?;
        }
    }
    if !is_whole {
        let done: Vec<SceneResult> = done.into_iter().map(|result| result.value).collect();
        println!("{}", report::tables(&plan, &done, &left));
    }
    Ok(())
}
