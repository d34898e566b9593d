//! Every scene of the zoo against the oracle in f64.

use octobayes::Result;
use octobayes::render::GradientMethod;
use serde::{Deserialize, Serialize};

use crate::compare::{Case, error, nothing_left_out};
use crate::oracle::Derivatives;
use crate::scenes::{self, Verdict};
use common::settings::describe;
use common::table::{Table, whole_spread};
use common::work::Work;

/// Rays per scene: errors of single vertices do not depend on it much, the oracle's time does.
const RAYS: u64 = 1024;
const SEEDS: [u64; 3] = [0, 1, 2];

/// What became of a scene with one seed.
#[derive(Serialize, Deserialize)]
enum Found {
    Refused(String),
    Compared {
        moved: f64,
        dropped: f64,
        /// Largest ‖ΔH‖ / ‖H‖ with nothing left out; `None` where that drops other rays.
        rounding: Option<f64>,
        /// |Δ log10 U|, mean and maximum: against the same differences, against exact derivatives.
        default: [f64; 2],
        exact: [f64; 2],
    },
}

fn words(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Handled => "handled",
        Verdict::Limit => "the method's own limit",
        Verdict::Refused => "refused with an error",
    }
}

fn look(scene: &scenes::HardScene, seed: u64, gradient: GradientMethod) -> Result<Found> {
    let cameras = scene.cameras();
    let case = Case { field: &scene.field, cameras: &cameras, level: scenes::LEVEL, rays: RAYS };
    let (rays, grid) = case.defaults();
    let rays = rays.seed(seed).gradient(gradient);
    let run = match case.run((rays, grid)) {
        Err(refusal) if scene.verdict == Verdict::Refused => return Ok(Found::Refused(refusal.to_string())),
        run => run?,
    };
    let whole = case.run(nothing_left_out(rays, grid))?;
    let same = case.oracle(&run, Derivatives::Differences(run.h));
    let exact = case.oracle(&run, Derivatives::Exact);
    let [rounding, default, exact] =
        [error(&case, &whole, &same), error(&case, &run, &same), error(&case, &run, &exact)];
    // Where rays are dropped, leaving nothing out drops more: of those that meet the fault behind opaque matter.
    let is_same = whole.progress.dropped == run.progress.dropped;
    Ok(Found::Compared {
        moved: default.moved as f64,
        dropped: run.progress.dropped as f64,
        rounding: is_same.then_some(rounding.hessian),
        default: default.worst(),
        exact: exact.worst(),
    })
}

/// Mean over seeds of a mean, and the largest of maxima.
fn worst(values: &[[f64; 2]]) -> [String; 2] {
    let mean = values.iter().map(|v| v[0]).sum::<f64>() / values.len() as f64;
    [format!("{mean:.0e}"), format!("{:.0e}", values.iter().map(|v| v[1]).fold(0.0, f64::max))]
}

/// Case × error × verdict.
pub fn cases(work: &Work) -> Result<(String, String)> {
    let mut table = Table::new(&[
        "scene",
        "vertices",
        "‖ΔH‖/‖H‖",
        "\\|Δ log10 U\\|: mean",
        "max",
        "exact derivatives: mean",
        "max",
        "verdict",
    ]);
    let mut settings = String::new();
    for scene in scenes::all() {
        let cameras = scene.cameras();
        let (rays, grid) = Case { field: &scene.field, cameras: &cameras, level: scenes::LEVEL, rays: RAYS }.defaults();
        settings = describe(&rays, &grid, &["level"]);
        let found =
            SEEDS.map(|seed| work.row((scene.name, RAYS, seed), || look(&scene, seed, GradientMethod::default())));
        let found = found.into_iter().collect::<Result<Vec<_>>>()?;
        let (name, mut verdict) = (scene.name.to_string(), words(scene.verdict).to_string());
        let (mut counts, mut drops, mut rounding) = (Vec::new(), Vec::new(), Some(0.0_f64));
        let (mut default, mut exact, mut refusal) = (Vec::new(), Vec::new(), None);
        for found in found {
            match found {
                Found::Refused(words) => refusal = Some(words),
                Found::Compared { moved, dropped, rounding: one, default: d, exact: e } => {
                    counts.push(moved);
                    drops.push(dropped);
                    rounding = rounding.zip(one).map(|(a, b)| a.max(b));
                    default.push(d);
                    exact.push(e);
                }
            }
        }
        if let Some(words) = refusal {
            let row = [name, format!("{verdict}: `{words}`")];
            table.row(&[&row[..1], &vec![String::new(); 6], &row[1..]].concat());
            continue;
        }
        if drops.iter().any(|&n| n > 0.0) {
            verdict += &format!(", {} rays dropped", whole_spread(&drops));
        }
        let ([mean, largest], [exact_mean, exact_largest]) = (worst(&default), worst(&exact));
        let rounding = rounding.map_or(String::new(), |r| format!("{r:.0e}"));
        table.row(&[name, whole_spread(&counts), rounding, mean, largest, exact_mean, exact_largest, verdict]);
    }
    let list: Vec<String> = SEEDS.iter().map(u64::to_string).collect();
    let words = format!(
        "{settings} Every scene at its own level, all vertices of the lattice. Seeds {}: counts are mean ± standard \
         deviation, means of |Δ log10 U| are means over seeds, maxima are over all seeds.",
        list.join(", ")
    );
    Ok((words, table.text().into()))
}

/// Scene × error against exact derivatives, by central and by forward differences.
pub fn forward(work: &Work) -> Result<(String, String)> {
    let methods = [GradientMethod::FiniteDifference, GradientMethod::ForwardDifference];
    let mut table = Table::new(&["scene", "central: mean", "max", "forward: mean", "max", "forward / central"]);
    let mut worse = (0, 0);
    for scene in scenes::all() {
        let mut exact = Vec::new();
        for method in methods {
            let mut found = Vec::new();
            for seed in SEEDS {
                let key = (scene.name, RAYS, seed, format!("{method:?}"));
                if let Found::Compared { exact, .. } = work.row(key, || look(&scene, seed, method))? {
                    found.push(exact);
                }
            }
            exact.push(found);
        }
        // Scenes that are refused, and those whose rays see nothing.
        if exact.iter().any(|found| found.iter().all(|[mean, _]| *mean == 0.0)) {
            continue;
        }
        let mean = |found: &[[f64; 2]]| found.iter().map(|error| error[0]).sum::<f64>() / found.len() as f64;
        let ratio = mean(&exact[1]) / mean(&exact[0]);
        worse = (worse.0 + usize::from(ratio > 1.0), worse.1 + 1);
        let ([central, central_max], [forward, forward_max]) = (worst(&exact[0]), worst(&exact[1]));
        let row = [scene.name.into(), central, central_max, forward, forward_max, format!("{ratio:.1}")];
        table.row(&row);
    }
    let list: Vec<String> = SEEDS.iter().map(u64::to_string).collect();
    let words = format!(
        "Settings: those of the first table. Seeds {}: |Δ log10 U| against exact derivatives, mean over seeds and \
         largest over seeds. Forward differences have the larger mean error on {} of {} scenes.",
        list.join(", "),
        worse.0,
        worse.1
    );
    Ok((words, table.text().into()))
}
