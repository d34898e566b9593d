//! Whether some steps of training after a removal gain more than the same steps without it.

use octobayes::Result;
use octobayes_clean::{Rule, Strength};
use octobayes_splats::Splats;
use octobayes_synth::Up;
use serde::{Deserialize, Serialize};

use common::meshes::MESHES;
use common::table::{Table, mean};
use common::work::Work;

use crate::judge::Images;
use crate::meshes::{FITTED, SEEDS};
use crate::methods::clean;
use crate::trained::{Scene, VIEWS, Views, judged};

const STEPS: u64 = 300;
/// What is trained further, in the order of rows.
const STARTS: [&str; 4] = ["nothing removed", "careful", "normal", "strong"];

pub fn settings() -> String {
    format!(
        "{STEPS} steps at the rates of the end of a run, at which splats hardly move and none are added. Two meshes, \
         seeds 0, 1 and 2; held-out images of 160 × 160 pixels. Changes are from the model before all."
    )
}

/// Held-out images of one model.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    before: Images,
    /// `[STARTS]`: without and with the steps.
    after: Vec<[Images; 2]>,
}

fn measure(work: &Work, mesh: &str, up: Up, views: Views, seed: u64) -> Result<Row> {
    let judged = judged(work, mesh, up, views, seed)?;
    let scene = Scene::new(work, mesh, up, views, seed)?;
    let cleaned = clean(&judged, Rule::default())?;
    let mut starts: Vec<Splats> = vec![judged.splats.clone()];
    for strength in Strength::ALL {
        let kept: Vec<bool> = cleaned.removed(strength).iter().map(Option::is_none).collect();
        starts.push(judged.splats.clone().keep(&kept)?);
    }
    let after = starts.iter().map(|start| {
        let refitted = scene.refit(start, STEPS, seed)?;
        Ok([Images::of(start, &judged.truth)?, Images::of(&refitted, &judged.truth)?])
    });
    Ok(Row { before: Images::of(&judged.splats, &judged.truth)?, after: after.collect::<Result<_>>()? })
}

pub fn test(work: &Work) -> Result<String> {
    let head = [
        "models",
        "removed",
        "PSNR, dB: without steps",
        "with",
        "floating light: without",
        "with",
        "error of depth: without",
        "with",
    ];
    let mut table = Table::new(&head);
    for views in VIEWS {
        let mut rows = Vec::new();
        for (mesh, up) in &MESHES[FITTED..] {
            for seed in SEEDS {
                rows.push(work.row((mesh, views.name, seed, STEPS), || measure(work, mesh, *up, views, seed))?);
            }
        }
        for (k, start) in STARTS.iter().enumerate() {
            let change = |value: fn(&Images) -> f64, digits: usize| {
                [0, 1].map(|with| {
                    let changes = rows.iter().map(|row| value(&row.after[k][with]) - value(&row.before));
                    format!("{:+.digits$}", mean(&changes.collect::<Vec<_>>()))
                })
            };
            let mut row = vec![views.name.to_string(), (*start).to_string()];
            row.extend(change(|images| images.psnr, 2));
            row.extend(change(|images| images.floating, 4));
            row.extend(change(|images| images.depth, 4));
            table.row(&row);
        }
    }
    Ok(table.text().to_string())
}
