//! Question: does U of Gaussian splats rank errors of depth, splats off the surface, and what images cannot see?
//!
//! `depth`: splats of lego, trained on 100 views, on 12 of one side and on 10, on 40 held-out views with true depth.
//! `trained`: splats that are trained here on few views of four meshes, beside the true surface. `discs`: splats that
//! lie on a mesh, are displaced and then fitted to images again, so that the displacement which is left is known.
//! `speed`: processor time of the parts of a run. Writes the blocks of `experiments/splats.md`.

mod blocks;
mod depth;
mod discs;
mod scores;
mod speed;
mod trained;

use octobayes::Result;

use common::program::{Needs, Program};

fn main() -> Result<()> {
    let parts = [("depth", Needs::Data), ("trained", Needs::Data), ("discs", Needs::Data), ("speed", Needs::Nothing)];
    let program = Program::start("splats", &parts)?;
    program.part("depth", |work| Ok((depth::settings(), depth::tables(work)?)))?;
    program.part("trained", |work| Ok((trained::settings(), trained::tables(work)?)))?;
    program.part("discs", |work| Ok((discs::settings(), discs::tables(work)?)))?;
    program.part("speed", |work| Ok((speed::settings(), speed::table(work)?)))
}
