//! Questions: do depth errors lie within the deviations that a field of the data's scale gives them? What ranks them
//! best? What tells surfaces that no training view saw?
//!
//! Hash grids trained on few or one-sided views of meshes that are ray-traced here, with exact depth, judged on
//! held-out views all around. Writes the blocks of `experiments/depth.md`.

#[path = "../common/mod.rs"]
mod common;

mod candidates;
mod joint;
mod judge;
mod scene;
mod tables;

use octobayes::Result;
use octobayes::synth::Up;

use common::program::{Needs, Program};
use common::settings::{describe, seeds};
use common::work::Work;
use judge::{Row, STRIDE, grid, measure, rays};
use scene::{SIDE, STEPS, Scene, Seen, TEST_VIEWS};

const SEEDS: [u64; 2] = [0, 1];

const HALF: Seen = Seen::Arc(90.0, 270.0);
/// All around but for a hole of 75°.
const HOLE: Seen = Seen::Arc(75.0, 360.0);
/// A trajectory on one side.
const SIDE_ONLY: Seen = Seen::Arc(200.0, 290.0);
const FEW: Seen = Seen::Few(8);

const SPOT: (&str, Up) = ("spot", Up::Y);
const BUNNY: (&str, Up) = ("stanford-bunny", Up::Y);
const ARMADILLO: (&str, Up) = ("armadillo", Up::Y);
const NEFERTITI: (&str, Up) = ("nefertiti", Up::Z);
const KNOT: (&str, Up) = ("knot", Up::Z);

/// Scenes by which anything was chosen: the density of errors, and the default for ranking.
const CHOOSING: [((&str, Up), Seen); 6] =
    [(SPOT, FEW), (SPOT, HALF), (ARMADILLO, FEW), (BUNNY, HALF), (NEFERTITI, FEW), (BUNNY, HOLE)];
/// Scenes by which nothing was chosen.
const TESTING: [((&str, Up), Seen); 8] = [
    (BUNNY, FEW),
    (ARMADILLO, HALF),
    (NEFERTITI, HALF),
    (SPOT, HOLE),
    (ARMADILLO, HOLE),
    (NEFERTITI, HOLE),
    (BUNNY, SIDE_ONLY),
    (SPOT, SIDE_ONLY),
];

fn scene(&((mesh, up), seen): &((&'static str, Up), Seen)) -> Scene {
    Scene { mesh, up, seen }
}

fn main() -> Result<()> {
    let program = Program::start("depth", &[("built-in", Needs::Nothing), ("meshes", Needs::Data)])?;
    program.part("built-in", |work| {
        let scenes = [(KNOT, FEW), (KNOT, HALF)].map(|case| scene(&case));
        let rows = study(work, &scenes)?;
        Ok((settings(), tables::coverage(&scenes, &rows)))
    })?;
    program.part("meshes", |work| {
        let scenes: Vec<Scene> = CHOOSING.iter().chain(&TESTING).map(scene).collect();
        let rows = study(work, &scenes)?;
        let (choosing, testing) = rows.split_at(CHOOSING.len());
        let text = [
            tables::coverage(&scenes, &rows),
            tables::ranking(choosing, testing),
            tables::never_seen(testing),
            tables::joint(&scenes, &rows),
            tables::costs(&rows),
        ];
        Ok((settings(), text.join("\n")))
    })
}

/// All rows of each scene.
fn study(work: &Work, scenes: &[Scene]) -> Result<Vec<Vec<Row>>> {
    // Seeds outside: if it is interrupted, whole seeds are done.
    let mut all = vec![Vec::new(); scenes.len()];
    for seed in SEEDS {
        for (scene, rows) in scenes.iter().zip(&mut all) {
            rows.push(work.row((scene.name(), seed), || measure(scene, seed))?);
        }
    }
    Ok(all)
}

fn settings() -> String {
    let described = describe(&rays(), &grid(), &[]);
    format!(
        "{SIDE} × {SIDE} pixels, {STEPS} steps; every {STRIDE}nd pixel of {TEST_VIEWS} held-out views. {described} {}",
        seeds(&SEEDS)
    )
}
