//! Whether some steps of training after a removal gain more than the same steps without it.

use octobayes::Result;
use octobayes::monitor::Silent;
use octobayes_clean::{Rule, Strength};
use octobayes_splats::Splats;
use octobayes_train::{Shot, SplatSettings, refit};
use serde::{Deserialize, Serialize};

use common::meshes::MESHES;
use common::table::{Table, mean};
use common::work::Work;

use crate::judge::Images;
use crate::lego;
use crate::meshes::{FITTED, SEEDS};
use crate::methods::{Judged, clean};
use crate::trained::{Scene, VIEWS, judged};

const STEPS: u64 = 300;
/// What is trained further, in the order of rows.
const STARTS: [&str; 4] = ["nothing removed", "careful", "normal", "strong"];

pub fn settings() -> String {
    format!(
        "{STEPS} steps at the rates of the end of a run, at which splats hardly move and none are added. Two meshes, \
         seeds 0, 1 and 2, with held-out images of 160 × 160 pixels; lego as above. Changes are from the model before all."
    )
}

/// Held-out images of one model.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    before: Images,
    /// `[STARTS]`: without and with the steps.
    after: Vec<[Images; 2]>,
}

fn measure(judged: &Judged, shots: &[Shot], seed: u64) -> Result<Row> {
    let cleaned = clean(judged, Rule::default())?;
    let settings = SplatSettings::default().seed(seed);
    let mut starts: Vec<Splats> = vec![judged.splats.clone()];
    for strength in Strength::ALL {
        let kept: Vec<bool> = cleaned.removed(strength).iter().map(Option::is_none).collect();
        starts.push(judged.splats.clone().keep(&kept)?);
    }
    let after = starts.iter().map(|start| {
        let refitted = refit(start, shots, settings, STEPS, &Silent)?.splats;
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
    let mut models = Vec::new();
    for views in VIEWS {
        let mut rows = Vec::new();
        for (mesh, up) in &MESHES[FITTED..] {
            for seed in SEEDS {
                let measure = || {
                    let scene = Scene::new(work, mesh, *up, views, seed)?;
                    measure(&judged(work, mesh, *up, views, seed)?, &scene.shots, seed)
                };
                rows.push(work.row((mesh, views.name, seed, STEPS), measure)?);
            }
        }
        models.push((views.name.to_string(), rows));
    }
    for (model, name) in lego::MODELS {
        let measure = || {
            let judged = lego::judged(model)?;
            measure(&judged, &lego::shots(&judged.cameras)?, 0)
        };
        models.push((format!("lego, {name}"), vec![work.row((model, STEPS), measure)?]));
    }
    for (name, rows) in &models {
        for (k, start) in STARTS.iter().enumerate() {
            let change = |value: fn(&Images) -> f64, digits: usize| {
                [0, 1].map(|with| {
                    let changes = rows.iter().map(|row| value(&row.after[k][with]) - value(&row.before));
                    format!("{:+.digits$}", mean(&changes.collect::<Vec<_>>()))
                })
            };
            let mut row = vec![name.clone(), (*start).to_string()];
            row.extend(change(|images| images.psnr, 2));
            row.extend(change(|images| images.floating, 4));
            row.extend(change(|images| images.depth, 4));
            table.row(&row);
        }
    }
    Ok(table.text().to_string())
}
