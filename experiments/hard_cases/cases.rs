//! Every scene of the zoo against the oracle in f64.

use octobayes::Result;
use octobayes::zoo::{self, Verdict};

use crate::compare::{Case, error, nothing_left_out};
use crate::oracle::Derivatives;

/// Rays per scene: errors of single vertices do not depend on it much, the oracle's time does.
const RAYS: u64 = 1024;

/// Prints case × error × verdict.
pub fn cases() -> Result<()> {
    println!("{RAYS} rays, seed 0, the scene's own level, dense grid; all vertices of the lattice\n");
    println!("| scene | vertices | ‖ΔH‖/‖H‖ | \\|Δ log10 U\\|: mean | max | exact derivatives: mean | max | verdict |");
    println!("|---|---|---|---|---|---|---|---|");
    for scene in zoo::all() {
        let cameras = scene.cameras();
        let case = Case { field: &scene.field, cameras: &cameras, level: scene.level, rays: RAYS };
        let (name, verdict) = (scene.name, scene.verdict.words());
        let run = match case.run(case.defaults()) {
            Err(refusal) if scene.verdict == Verdict::Refused => {
                println!("| {name} | | | | | | | {verdict}: `{refusal}` |");
                continue;
            }
            run => run?,
        };
        let (rays, grid) = case.defaults();
        let whole = case.run(nothing_left_out(rays, grid))?;
        let same = case.oracle(&run, Derivatives::Differences(run.h));
        let exact = case.oracle(&run, Derivatives::Exact);
        let [rounding, default, derivatives] =
            [error(&case, &whole, &same), error(&case, &run, &same), error(&case, &run, &exact)];
        let ([mean, largest], [exact_mean, exact_largest]) = (default.worst(), derivatives.worst());
        let dropped =
            if run.progress.dropped > 0 { format!(", {} rays dropped", run.progress.dropped) } else { String::new() };
        // Where rays are dropped, leaving nothing out drops more: of those that meet the fault behind opaque matter.
        let rounding = match whole.progress.dropped == run.progress.dropped {
            true => format!("{:.0e}", rounding.hessian),
            false => String::new(),
        };
        println!(
            "| {name} | {} | {rounding} | {mean:.0e} | {largest:.0e} | {exact_mean:.0e} | {exact_largest:.0e} | {verdict}{dropped} |",
            default.moved,
        );
    }
    Ok(())
}
