//! Files for other people's tools: a field's leaves, the surfaces that its training views show, and what it says of
//! them.
//!
//! What grows with the field is written as it is computed, so that a field takes little more memory than its own. The
//! book's chapter on `export` says what every file holds.

mod axes;
mod cells;
mod hyper_tree;
mod leaves;
mod mesh;
mod ply;
mod points;
mod report;

pub use hyper_tree::write_hyper_tree;
pub use leaves::write_leaves;
pub use mesh::{MeshSettings, write_mesh};
pub use points::{Surfaces, surfaces, write_points};
pub use report::write_report;
