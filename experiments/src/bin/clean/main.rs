//! Question: how many floaters does `clean` remove, how much else with them, and what does it do to images?
//!
//! `fit`: the constants of the rule, on splats that are trained here on few views of two meshes. `meshes`: all methods
//! on two other meshes, beside the true surface. `lego`: on splats that others trained, beside true depth.
//! `refit`: whether some steps of training after the removal gain more than without it.
//! `fit_volumes` and `volumes`: the same of hash grids that are trained on the images of the meshes. `splat_transform`:
//! that program's filter.

mod judge;
mod lego;
mod meshes;
mod methods;
mod refit;
mod tables;
mod tool;
mod trained;
mod volumes;

use octobayes::Result;

use common::program::{Needs, Program};

fn main() -> Result<()> {
    let names = ["fit", "meshes", "lego", "refit", "fit_volumes", "volumes", "splat_transform"];
    let parts = names.map(|name| (name, Needs::Data));
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
    })?;
    program.part("refit", |work| Ok((refit::settings(), refit::test(work)?)))?;
    program.part("fit_volumes", |work| Ok((volumes::settings(), volumes::fit(work)?)))?;
    program.part("volumes", |work| Ok((volumes::settings(), volumes::test(work)?)))?;
    match std::env::var_os(tool::VARIABLE) {
        Some(cli) => program.part("splat_transform", |work| Ok((tool::settings(), tool::test(cli.as_ref(), work)?))),
        None => {
            eprintln!("splat_transform is left out: {} names no `bin/cli.mjs`", tool::VARIABLE);
            Ok(())
        }
    }
}
