//! The floater filter of splat-transform, run as it is shipped, beside `clean`.
//!
//! It voxelizes splats on a GPU: `SPLAT_TRANSFORM` names its `bin/cli.mjs`, and node runs it with this environment, in
//! which `VK_ICD_FILENAMES` may name a Vulkan driver that works in software.

use std::collections::HashSet;
use std::path::Path;
use std::process::Command;

use octobayes::{Error, Result};
use octobayes_clean::Rule;
use octobayes_splats::Splats;
use serde::{Deserialize, Serialize};

use common::clock::Clock;
use common::meshes::MESHES;
use common::recall::precision_of;
use common::table::Table;
use common::work::Work;

use crate::judge::{self, Figures};
use crate::lego;
use crate::meshes::{FITTED, SEEDS};
use crate::methods::{Judged, clean, order};
use crate::trained::{self, VIEWS};

/// The variable that names the program.
pub const VARIABLE: &str = "SPLAT_TRANSFORM";
/// Edge of a voxel, scene units; opacity from which a voxel is solid; least share of a splat in solid voxels. The first
/// are the defaults.
const SETTINGS: [[f64; 3]; 9] = [
    [0.05, 0.1, 0.004],
    [0.05, 0.1, 0.1],
    [0.05, 0.5, 0.004],
    [0.05, 0.5, 0.1],
    [0.05, 0.9, 0.1],
    [0.1, 0.1, 0.004],
    [0.1, 0.5, 0.1],
    [0.025, 0.1, 0.004],
    [0.025, 0.5, 0.1],
];

/// The defaults, and the one with the largest recall of those with a precision of 0.9 on lego from 12 views.
const OF_MESHES: [[f64; 3]; 2] = [SETTINGS[0], SETTINGS[3]];

pub fn settings() -> String {
    "splat-transform 2.7.1, `--filter-floaters SIZE,OPACITY,MIN`, on a Vulkan driver that works in software: its seconds \
     are not those of a GPU. Of meshes, seed 0. The precision of `clean` is that of its order at the same recall."
        .into()
}

/// What a setting does.
#[derive(Clone, Serialize, Deserialize)]
struct Row {
    figures: Figures,
    /// Precision of `clean` at the same recall.
    clean: f64,
    seconds: f64,
}

fn filtered(cli: &Path, input: &Path, output: &Path, [size, opacity, min]: [f64; 3]) -> Result<f64> {
    let clock = Clock::start();
    let mut command = Command::new("node");
    command.arg(cli).arg("--overwrite").arg(input).arg("--filter-floaters").arg(format!("{size},{opacity},{min}"));
    let ended = command.arg(output).output().map_err(Error::io(cli, "cannot run"))?;
    if !ended.status.success() {
        let found = String::from_utf8_lossy(&ended.stderr).chars().take(400).collect::<String>();
        return Err(Error::setting("splat-transform", "to run on this GPU, or on a software driver", found));
    }
    Ok(clock.elapsed().wall)
}

fn measure(cli: &Path, work: &Work, judged: &Judged, settings: [f64; 3]) -> Result<Row> {
    let (input, output) = (work.folder().join("input.ply"), work.folder().join("output.ply"));
    judged.splats.write(&input)?;
    let seconds = filtered(cli, &input, &output, settings)?;
    // It keeps the numbers of the splats that stay.
    let place = |splats: &Splats, i: usize| splats.mean(i).to_array().map(f32::to_bits);
    let left = Splats::read(&output)?;
    let stays: HashSet<[u32; 3]> = (0..left.len()).map(|i| place(&left, i)).collect();
    let removed: Vec<bool> = (0..judged.splats.len()).map(|i| !stays.contains(&place(&judged.splats, i))).collect();
    let figures = Figures::new(&removed, &judged.places);
    let (score, is_air) = judge::judged(&order(&clean(judged, Rule::default())?), &judged.places);
    Ok(Row { figures, clean: precision_of(figures.recall, &score, &is_air), seconds })
}

/// All settings on the two models of lego from few views, and some on one model of each kind of the test meshes.
pub fn test(cli: &Path, work: &Work) -> Result<String> {
    let head = ["model", "size, opacity, min", "share", "precision", "recall", "precision of `clean`", "seconds"];
    let mut table = Table::new(&head);
    let mut add = |name: &str, chosen: &[[f64; 3]], judged: &dyn Fn() -> Result<Judged>| -> Result<()> {
        for &settings in chosen {
            let row = work.row((name, settings), || measure(cli, work, &judged()?, settings))?;
            let Figures { share, precision, recall } = row.figures;
            let [size, opacity, min] = settings;
            table.row(&[
                name.to_string(),
                format!("{size}, {opacity}, {min}"),
                format!("{share:.3}"),
                precision.map_or("-".into(), |precision| format!("{precision:.3}")),
                format!("{recall:.3}"),
                format!("{:.3}", row.clean),
                format!("{:.0}", row.seconds),
            ]);
        }
        Ok(())
    };
    for (model, name) in &lego::MODELS[..2] {
        add(&format!("lego, {name}"), &SETTINGS, &|| lego::judged(model))?;
    }
    for (mesh, up) in &MESHES[FITTED..] {
        for views in VIEWS {
            let judged = || trained::judged(work, mesh, *up, views, SEEDS[0]);
            add(&format!("{mesh}, {}", views.name), &OF_MESHES, &judged)?;
        }
    }
    Ok(table.text().to_string())
}
