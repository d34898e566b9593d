//! Files for other tools: a field's leaves, and the surfaces that its training views show, with their U.
//!
//! Data that grow with the field are written as they are computed, so an export takes little more memory than the
//! field. The book's chapter on `export` lists the contents of every file.

mod axes;
mod cells;
mod depth_points;
mod hyper_tree;
mod leaves;
mod mesh;
mod ply;
mod points;
mod report;
mod splats;
mod surface_net;

pub use depth_points::{DepthPoint, write_depth_points};
pub use hyper_tree::write_hyper_tree;
pub use leaves::write_leaves;
pub use mesh::{MeshSettings, write_mesh};
pub use points::{Surfaces, surfaces, write_points};
pub use report::write_report;
pub use splats::write_splats;
