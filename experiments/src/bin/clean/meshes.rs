//! Splats trained on few views of meshes: on two the rule is fitted, on the others it is tested.

use octobayes::Result;
use octobayes_clean::{Rule, Strength};
use octobayes_synth::Up;

use common::meshes::MESHES;
use common::table::{Table, mean};
use common::work::Work;

use crate::judge::Figures;
use crate::methods::{Judged, Row, clean, floating, measure};
use crate::tables;
use crate::trained::{self, HELD_OUT, SIDE, SLACK, STEPS, VIEWS};

/// Meshes on which the rule's constants are fitted.
pub const FITTED: usize = 2;
pub const SEEDS: [u64; 3] = [0, 1, 2];

pub fn settings() -> String {
    format!(
        "{SIDE} × {SIDE} pixels, {STEPS} steps; {HELD_OUT} held-out views all around. A splat is in the air if its \
         centre is farther than {:.0} % of the mesh's length from the mesh, and outside of it; those at or under the \
         ground and outside the box are not judged. Seeds 0, 1 and 2; means over two meshes and these.",
        100.0 * SLACK,
    )
}

/// Every model of some meshes, with its name.
fn models(work: &Work, meshes: &[(&str, Up)], seeds: &[u64]) -> Result<Vec<(String, u64, Judged)>> {
    let mut all = Vec::new();
    for (mesh, up) in meshes {
        for views in VIEWS {
            for &seed in seeds {
                let judged = trained::judged(work, mesh, *up, views, seed)?;
                all.push((format!("{mesh}, {}", views.name), seed, judged));
            }
        }
    }
    Ok(all)
}

/// What other constants of the rule would find, on the meshes that it is fitted on: least precision and mean recall.
pub fn fit(work: &Work) -> Result<String> {
    let models = models(work, &MESHES[..FITTED], &SEEDS)?;
    let mut head = vec!["on".to_string(), "thresholds".into(), "last stage".into()];
    head.extend(Strength::ALL.iter().flat_map(|s| [format!("{s}: least precision"), "mean recall".into()]));
    let mut table = Table::new(&head.iter().map(String::as_str).collect::<Vec<_>>());
    for on in [0.0, 0.25, 0.5] {
        for thresholds in [[0.9, 0.7, 0.5], [0.8, 0.6, 0.4]] {
            for has_free_stage in [false, true] {
                let mut rule = Rule { on, ..Rule::default() };
                for (stage, k) in rule.stages.iter_mut().zip([0, 1, 2, 2]) {
                    stage.threshold = thresholds[k];
                    stage.by_free_share &= has_free_stage;
                }
                let cleaned = models.iter().map(|(.., judged)| Ok((clean(judged, rule)?, &judged.places)));
                let cleaned = cleaned.collect::<Result<Vec<_>>>()?;
                let of = |strength: Strength| {
                    let figures =
                        cleaned.iter().map(|(found, places)| Figures::new(&floating(found, strength), places));
                    let figures: Vec<Figures> = figures.collect();
                    let least = figures.iter().filter_map(|f| f.precision).fold(1.0, f64::min);
                    [least, mean(&figures.iter().map(|f| f.recall).collect::<Vec<_>>())].map(|v| format!("{v:.3}"))
                };
                let last = if has_free_stage { "free share" } else { "front share" };
                let mut row = vec![on.to_string(), format!("{thresholds:?}"), last.into()];
                row.extend(Strength::ALL.into_iter().flat_map(of));
                table.row(&row);
            }
        }
    }
    Ok(table.text().to_string())
}

/// All methods on the meshes that the rule is not fitted on; means over seeds.
pub fn test(work: &Work) -> Result<String> {
    let mut rows: Vec<(String, Row)> = Vec::new();
    for views in VIEWS {
        for (mesh, up) in &MESHES[FITTED..] {
            for seed in SEEDS {
                let row = work.row((mesh, views.name, seed, STEPS, SIDE), || {
                    measure(&trained::judged(work, mesh, *up, views, seed)?)
                })?;
                rows.push((views.name.to_string(), row));
            }
        }
    }
    Ok(format!("{}\n{}", tables::of_scores(&rows), tables::of_removals(&rows)))
}
