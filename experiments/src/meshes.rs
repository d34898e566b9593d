//! Meshes, and which cameras look at them.

use glam::DVec3;
use octobayes::{Error, Result};
use octobayes_data::Hemisphere;
use octobayes_synth::{Mesh, MeshScene, Up};

use crate::program::Program;

/// A mesh of the data folder and the axis of its file that points up.
pub const MESHES: [(&str, Up); 4] =
    [("spot", Up::Y), ("stanford-bunny", Up::Y), ("armadillo", Up::Y), ("nefertiti", Up::Z)];

/// Where cameras stand: on one side, or all around.
pub const SIDES: [(&str, Option<Hemisphere>); 2] = [("one side", Some(Hemisphere::Left)), ("all round", None)];

/// The file of a mesh.
pub fn file(mesh: &str) -> Result<std::path::PathBuf> {
    Ok(Program::data()?.join(format!("meshes/{mesh}.obj")))
}

/// A mesh as `synth` places it.
pub fn read(mesh: &str, up: Up) -> Result<MeshScene> {
    Ok(MeshScene::new(Mesh::read(&file(mesh)?)?.placed(up).0))
}

/// Longest edge of a mesh's box, scene units.
pub fn length(scene: &MeshScene) -> f64 {
    let used = || scene.mesh().vertices().iter().copied();
    (used().fold(DVec3::NEG_INFINITY, DVec3::max) - used().fold(DVec3::INFINITY, DVec3::min)).max_element()
}

/// A temporary folder.
pub fn folder() -> Result<tempfile::TempDir> {
    tempfile::tempdir().map_err(Error::io(std::path::Path::new("a temporary folder"), "cannot create"))
}
