//! Questions: do depth errors lie within the deviations that a field of the data's scale gives them? What ranks them
//! best? What tells surfaces that no training view saw?
//!
//! Hash grids trained on few or one-sided views of meshes that are ray-traced here, with exact depth, and of lego, and
//! models of lego that others trained, and of photographs of a kitchen, judged on held-out views. Writes the blocks of
//! `experiments/depth.md`.

mod baselines;
mod candidates;
mod deviation;
mod judge;
mod kinds;
mod parameters;
mod pictures;
mod pretrained;
mod scene;
mod tables;
mod warp;

use octobayes::Result;
use octobayes::render::RayAverage;
use octobayes_evaluation::Baseline;
use octobayes_synth::Up;

use common::program::{Needs, Program};
use common::settings::{describe, seeds};
use common::work::Work;
use judge::{LEVELS, Row, STRIDE, grid, measure, rays};
use scene::{SIDE, Scene, Seen, TEST_VIEWS};

const SEEDS: [u64; 3] = [0, 1, 2];
/// Steps of training, and those of models of greater strength.
const STEPS: u64 = 1000;
const STRONG: u64 = 6000;
/// Models of an ensemble, the judged one among them.
const ENSEMBLE: u64 = 10;

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
const LEGO: (&str, Up) = ("lego", Up::Z);
const KITCHEN: (&str, Up) = ("kitchen", Up::Z);

/// Scenes by which anything was chosen: the density of errors, and the default for ranking.
const CHOOSING: [((&str, Up), Seen); 6] =
    [(SPOT, FEW), (SPOT, HALF), (ARMADILLO, FEW), (BUNNY, HALF), (NEFERTITI, FEW), (BUNNY, HOLE)];
/// Scenes by which nothing was chosen.
const TESTING: [((&str, Up), Seen); 10] = [
    (BUNNY, FEW),
    (ARMADILLO, HALF),
    (NEFERTITI, HALF),
    (SPOT, HOLE),
    (ARMADILLO, HOLE),
    (NEFERTITI, HOLE),
    (BUNNY, SIDE_ONLY),
    (SPOT, SIDE_ONLY),
    (ARMADILLO, SIDE_ONLY),
    (NEFERTITI, SIDE_ONLY),
];
/// Scenes by which the deviation of `depth` was fitted.
const FITTED: [((&str, Up), Seen); 4] = [(SPOT, FEW), (SPOT, HALF), (BUNNY, HALF), (BUNNY, HOLE)];
/// Scenes of other meshes, by which it is judged; the first few beside an ensemble.
const JUDGED: [((&str, Up), Seen); 8] = [
    (ARMADILLO, HALF),
    (NEFERTITI, HOLE),
    (ARMADILLO, FEW),
    (NEFERTITI, FEW),
    (NEFERTITI, HALF),
    (ARMADILLO, HOLE),
    (ARMADILLO, SIDE_ONLY),
    (NEFERTITI, SIDE_ONLY),
];
const BESIDE_ENSEMBLES: usize = 3;
/// Lego has its own block: its depth maps have steps wider than many errors.
const OF_LEGO: [((&str, Up), Seen); 4] = [(LEGO, FEW), (LEGO, HALF), (LEGO, HOLE), (LEGO, SIDE_ONLY)];
/// Photographs, with the depth of a sensor.
const OF_A_KITCHEN: [((&str, Up), Seen); 1] = [(KITCHEN, Seen::Few(15))];

/// Scenes that pictures are made of: those of meshes whose terms allow it.
const PICTURED: [((&str, Up), Seen); 3] = [(SPOT, HALF), (BUNNY, HALF), (ARMADILLO, HALF)];

fn scenes(cases: &[((&'static str, Up), Seen)], steps: u64) -> Vec<Scene> {
    cases.iter().map(|&((mesh, up), seen)| Scene { mesh, up, seen, steps }).collect()
}

fn main() -> Result<()> {
    let program = Program::start(
        "depth",
        &[
            ("built-in", Needs::Nothing),
            ("pictures", Needs::Nothing),
            ("views", Needs::Data),
            ("meshes", Needs::Data),
            ("ensembles", Needs::Data),
            ("strong", Needs::Data),
            ("lego", Needs::Data),
            ("kitchen", Needs::Data),
            ("kinds", Needs::Data),
            ("deviation", Needs::Data),
            ("deviation-elsewhere", Needs::Data),
            ("pretrained", Needs::Data),
        ],
    )?;
    program.part("built-in", |work| {
        let scenes = scenes(&[(KNOT, FEW), (KNOT, HALF)], STEPS);
        let rows = study(work, &scenes, &SEEDS, 1)?;
        Ok((settings(STEPS, &SEEDS), tables::beside(&rows, &meshes(&scenes), Baseline::RayVariance.name())))
    })?;
    program.part("pictures", |_| {
        let scene = scenes(&[(KNOT, FEW)], STRONG)[0];
        Ok((settings_with(SIDE, 1, STRONG, &SEEDS[..1]), pictures::for_the_book(&scene)?))
    })?;
    program.part("views", |_| {
        let scenes = scenes(&PICTURED, STEPS);
        Ok((settings_with(SIDE, 1, STEPS, &SEEDS[..1]), pictures::for_the_report(&scenes)?))
    })?;
    program.part("meshes", |work| {
        let scenes = scenes(&[&CHOOSING[..], &TESTING].concat(), STEPS);
        let rows = study(work, &scenes, &SEEDS, 1)?;
        let (choosing, testing) = rows.split_at(CHOOSING.len());
        let text = [
            tables::ranking(choosing, testing, &meshes(&scenes[CHOOSING.len()..])),
            tables::never_seen(testing),
            tables::costs(&rows),
        ];
        Ok((settings(STEPS, &SEEDS), text.join("\n")))
    })?;
    program.part("ensembles", |work| {
        let scenes = scenes(&TESTING, STEPS);
        let rows = study(work, &scenes, &SEEDS[..1], ENSEMBLE)?;
        let text = [tables::beside(&rows, &meshes(&scenes), Baseline::EnsembleVariance.name()), tables::costs(&rows)];
        Ok((settings(STEPS, &SEEDS[..1]), text.join("\n")))
    })?;
    program.part("strong", |work| {
        let scenes = scenes(&TESTING, STRONG);
        let rows = study(work, &scenes, &SEEDS, 1)?;
        let text = [
            tables::beside(&rows, &meshes(&scenes), &default_ranking()),
            tables::never_seen(&rows),
            tables::costs(&rows),
        ];
        Ok((settings(STRONG, &SEEDS), text.join("\n")))
    })?;
    program.part("lego", |work| of_lego(work, &OF_LEGO))?;
    program.part("kitchen", |work| {
        let scenes = scenes(&OF_A_KITCHEN, STEPS);
        let rows = study(work, &scenes, &SEEDS, 1)?;
        let ranking = tables::beside(&rows, &meshes(&scenes), &default_ranking());
        let (described, of, pixels) = (describe(&rays(), &grid(), &[]), seeds(&SEEDS), compared(STRIDE));
        let settings = format!("320 × 240 pixels, {STEPS} steps; {pixels} of the 10 held-out views. {described} {of}");
        Ok((settings, ranking))
    })?;
    program.part("kinds", |work| {
        let measure = |scene: &Scene| work.row((scene.name(), scene.steps), || kinds::measure(scene, SEEDS[0]));
        let rows = scenes(&JUDGED[..4], STEPS).iter().map(measure).collect::<Result<Vec<_>>>()?;
        Ok((settings(STEPS, &SEEDS[..1]), kinds::table(&rows)))
    })?;
    program.part("deviation", |work| {
        let [fitted, tested] = [&FITTED[..], &JUDGED].map(|cases| scenes(cases, STEPS));
        let measure = |scene: &Scene| {
            let others = if tested.iter().take(BESIDE_ENSEMBLES).any(|t| t.name() == scene.name()) { 4 } else { 0 };
            work.row((scene.name(), scene.steps), || {
                deviation::measure(scene, deviation::Kind::Volume, SEEDS[0], others)
            })
        };
        let fitted = fitted.iter().map(&measure).collect::<Result<Vec<_>>>()?;
        let rows = tested.iter().map(&measure).collect::<Result<Vec<_>>>()?;
        let table = deviation::table(&names(&tested), &rows);
        let text = format!("{table}\n### Exponents that spot and the bunny give\n\n{}", deviation::fit(&fitted));
        Ok((deviation_settings(&format!("{SIDE} × {SIDE}")), text))
    })?;
    program.part("deviation-elsewhere", |work| {
        use deviation::Kind::{Splats, Volume};
        let case = |case: ((&'static str, Up), Seen), steps: u64, kind| (scenes(&[case], steps)[0], kind);
        let lego = (LEGO, Seen::Few(20));
        let cases = [
            case(lego, STEPS, Volume),
            case(OF_A_KITCHEN[0], STEPS, Volume),
            case((ARMADILLO, FEW), STEPS, Splats),
            case((NEFERTITI, HALF), STEPS, Splats),
            case(lego, STEPS, Splats),
            case((KNOT, FEW), STEPS, Volume),
            case((KNOT, HALF), STEPS, Volume),
            case((ARMADILLO, FEW), STRONG, Volume),
            case((NEFERTITI, HALF), STRONG, Volume),
        ];
        let measure = |(scene, kind): &(Scene, deviation::Kind)| {
            let key = (scene.name(), scene.steps, kind, SEEDS[0]);
            work.row(key, || deviation::measure(scene, *kind, SEEDS[0], 0))
        };
        let name = |(scene, kind): &(Scene, deviation::Kind)| {
            let steps = if scene.steps == STRONG { format!(", {STRONG} steps") } else { String::new() };
            let splats = if *kind == Splats { ", splats" } else { "" };
            format!("{}{splats}{steps}", scene.name())
        };
        let rows = cases.iter().map(measure).collect::<Result<Vec<_>>>()?;
        let text = deviation::lines(&cases.iter().map(name).collect::<Vec<_>>(), &rows);
        Ok((deviation_settings("200 × 200 (lego 400 × 400, kitchen 320 × 240)"), text))
    })?;
    program.part("pretrained", |work| {
        let row = |name: &&str| Ok(vec![work.row(name, || pretrained::measure(name))?]);
        let rows = pretrained::NAMES.iter().map(row).collect::<Result<Vec<_>>>()?;
        let text =
            [tables::beside(&rows, &["lego"; pretrained::NAMES.len()], &default_ranking()), tables::costs(&rows)];
        Ok((pretrained::settings(), text.join("\n")))
    })
}

/// Ranking on lego, whose images have twice the side of the meshes'.
fn of_lego(work: &Work, cases: &[((&'static str, Up), Seen)]) -> Result<(String, String)> {
    let scenes = scenes(cases, STEPS);
    let rows = study(work, &scenes, &SEEDS, 1)?;
    let ranking = tables::beside(&rows, &meshes(&scenes), &default_ranking());
    Ok((settings_with(2 * SIDE, 2 * STRIDE, STEPS, &SEEDS), ranking))
}

/// All rows of each scene, each beside an ensemble of so many if it is more than one.
fn study(work: &Work, scenes: &[Scene], seeds: &[u64], ensemble: u64) -> Result<Vec<Vec<Row>>> {
    // Seeds outside: if it is interrupted, whole seeds are done.
    let mut all = vec![Vec::new(); scenes.len()];
    for &seed in seeds {
        for (scene, rows) in scenes.iter().zip(&mut all) {
            let key = (scene.name(), scene.steps, ensemble, seed);
            rows.push(work.row(key, || measure(scene, seed, ensemble))?);
        }
    }
    Ok(all)
}

fn names(scenes: &[Scene]) -> Vec<String> {
    scenes.iter().map(Scene::name).collect()
}

fn meshes(scenes: &[Scene]) -> Vec<&'static str> {
    scenes.iter().map(|scene| scene.mesh).collect()
}

/// The measure that rendering ranks pixels by, unless told otherwise.
fn default_ranking() -> String {
    format!("block {}, {}", LEVELS[1], RayAverage::USpreadPerRootRay.name())
}

fn settings(steps: u64, of: &[u64]) -> String {
    settings_with(SIDE, STRIDE, steps, of)
}

/// Which pixels of a view are compared, in words.
#[must_use]
pub fn compared(every: u32) -> String {
    if every == 1 { "all pixels".into() } else { format!("one pixel in {every} along x and y") }
}

fn deviation_settings(size: &str) -> String {
    let (described, of) = (describe(&rays(), &grid(), &[]), seeds(&SEEDS[..1]));
    let every = deviation::EVERY;
    format!("{size} pixels, {STEPS} steps; all pixels of one in {every} of the held-out views. {described} {of}")
}

/// `every`: of the pixels of the held-out views, one in so many counts along x and y.
fn settings_with(side: u32, every: u32, steps: u64, of: &[u64]) -> String {
    let described = describe(&rays(), &grid(), &[]);
    let (of, pixels) = (seeds(of), compared(every));
    format!("{side} × {side} pixels, {steps} steps; {pixels} of {TEST_VIEWS} held-out views. {described} {of}")
}
