//! Question: what does it gain to remove uncertain density from models that saw too little?
//!
//! Models of few views, or of the half of the views on one side, are cleaned up by the paper's thresholds of log10 U,
//! and held-out views of them are compared with the images.
//!
//!     cargo experiment clean_up -- [PART ...] [--work DIR] [--fresh]
//!
//! Rows are kept in the work folder until their block is written: a run that was stopped goes on where it was.

mod data;
mod model;
mod scene;
mod table;

use octobayes::Result;
use octobayes_data::Hemisphere;
use octobayes_synth::Up;
use octobayes_train::Selection;

use common::program::{Needs, Program};
use common::work::Work;
use data::Data;
use model::Architecture;
use scene::{Scene, settings};

const fn few(name: &'static str, data: Data, views: usize) -> Scene {
    Scene { name, data, views: Selection::Count(views), half: None, architecture: Architecture::HashGrid }
}

const fn half(name: &'static str, data: Data, architecture: Architecture) -> Scene {
    Scene { name, data, views: Selection::All, half: Some(Hemisphere::Left), architecture }
}

const fn whole(name: &'static str, architecture: Architecture) -> Scene {
    Scene { name, data: Data::Lego, views: Selection::All, half: None, architecture }
}

const BUNNY: Data = Data::Mesh("stanford-bunny", Up::Y);
const SPOT: Data = Data::Mesh("spot", Up::Y);
const ARMADILLO: Data = Data::Mesh("armadillo", Up::Y);
const NEFERTITI: Data = Data::Mesh("nefertiti", Up::Z);

const SCENES: [Scene; 17] = [
    few("bunny, 8 views", BUNNY, 8),
    half("bunny, left half", BUNNY, Architecture::HashGrid),
    few("spot, 8 views", SPOT, 8),
    half("spot, left half", SPOT, Architecture::HashGrid),
    few("armadillo, 8 views", ARMADILLO, 8),
    half("armadillo, left half", ARMADILLO, Architecture::HashGrid),
    few("nefertiti, 8 views", NEFERTITI, 8),
    half("nefertiti, left half", NEFERTITI, Architecture::HashGrid),
    few("lego, 5 views", Data::Lego, 5),
    few("lego, 10 views", Data::Lego, 10),
    few("lego, 20 views", Data::Lego, 20),
    half("lego, left half", Data::Lego, Architecture::HashGrid),
    half("lego, left half, baked", Data::Lego, Architecture::Baked),
    whole("lego, 100 views", Architecture::HashGrid),
    whole("lego, 100 views, baked", Architecture::Baked),
    whole("lego, 100 views, pretrained MLP", Architecture::Mlp),
    few("kitchen, 15 views", Data::Kitchen, 15),
];

fn main() -> Result<()> {
    let program = Program::start("clean_up", &[("knot", Needs::Nothing), ("scenes", Needs::Data)])?;
    program.part("knot", |work| {
        let scenes = [few("knot, 6 views", Data::Knot, 6), half("knot, left half", Data::Knot, Architecture::HashGrid)];
        measured(&scenes, work)
    })?;
    program.part("scenes", |work| measured(&SCENES, work))
}

fn measured(scenes: &[Scene], work: &Work) -> Result<(String, String)> {
    let rows = scenes.iter().map(|scene| work.row(scene.name, || scene::measure(scene)));
    Ok((settings(), table::table(&rows.collect::<Result<Vec<_>>>()?)))
}
