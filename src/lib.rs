//! x
pub mod error;
pub mod estimate;
pub mod field;
pub mod geometry;
pub mod io;
pub mod monitor;
pub mod octree;
pub use error::{Error, Result};
pub mod render;
pub mod posterior;
pub mod uncertainty;
pub mod dataset;
pub mod metrics;
pub mod picture;
pub mod cli;
