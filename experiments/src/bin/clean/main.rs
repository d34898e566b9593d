//! Question: how many floaters of splats does `clean` remove, how many others with them, and what does it do to images?
//!
//! `fit`: the constants of the rule, on splats that are trained here on few views of two meshes. `meshes`: all methods
//! on two other meshes, beside the true surface. `lego`: on splats that others trained, beside true depth.

mod judge;
mod lego;
mod meshes;
mod methods;
mod tables;
mod trained;

use octobayes::Result;

use common::program::{Needs, Program};

fn main() -> Result<()> {
    let parts = [("fit", Needs::Data), ("meshes", Needs::Data), ("lego", Needs::Data)];
    let program = Program::start("clean", &parts)?;
    program.part("fit", |work| Ok((meshes::settings(), meshes::fit(work)?)))?;
    program.part("meshes", |work| Ok((meshes::settings(), meshes::test(work)?)))?;
    program.part("lego", |work| {
        let row = |(model, name): &(&str, &str)| {
            let row = work.row(model, || methods::measure(&lego::judged(model)?))?;
            Ok((format!("lego, {name}"), row))
        };
        let rows: Vec<_> = lego::MODELS.iter().map(row).collect::<Result<_>>()?;
        Ok((lego::settings(), format!("{}\n{}", tables::of_scores(&rows), tables::of_removals(&rows))))
    })
}
