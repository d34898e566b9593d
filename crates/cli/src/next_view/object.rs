//! The part of the scene that matters.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::DVec3;

use crate::options::parse_box;
use octobayes::geometry::{Aabb, Lattice};
use octobayes::{Error, Result};
use octobayes_next_view::NearMesh;
use octobayes_synth::Mesh;

/// What an option names.
#[derive(Debug, Clone)]
pub enum Object {
    /// A box.
    Box(Aabb),
    /// A mesh.
    Mesh(PathBuf),
}

/// The places that count.
pub enum Places {
    /// Those in a box.
    Box(Aabb),
    /// Those near to a mesh.
    Mesh(NearMesh),
}

impl FromStr for Object {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let is_mesh = Path::new(text).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("obj"));
        if is_mesh { Ok(Self::Mesh(text.into())) } else { parse_box(text).map(Self::Box) }
    }
}

impl Object {
    /// The file that is read.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::Box(_) => None,
            Self::Mesh(path) => Some(path),
        }
    }

    /// The places in the domain of `lattice`.
    pub fn places(&self, lattice: &Lattice) -> Result<Places> {
        match self {
            Self::Box(bounds) => Ok(Places::Box(*bounds)),
            Self::Mesh(path) => {
                let mesh = Mesh::read(path)?;
                let triangles = (0..mesh.faces().len() as u32).map(|face| mesh.corners(face));
                let expected = "a mesh in the field's domain, in scene units";
                let near = NearMesh::new(triangles, lattice);
                near.map(Places::Mesh).ok_or_else(|| Error::malformed(path, "mesh", expected, "one outside of it"))
            }
        }
    }
}

impl Places {
    /// Whether a scene point is among them.
    pub fn contains(&self, x: DVec3) -> bool {
        match self {
            Self::Box(bounds) => bounds.contains(x.as_vec3()),
            Self::Mesh(near) => near.contains(x),
        }
    }
}
