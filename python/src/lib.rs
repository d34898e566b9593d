//! The part of the Python package `octobayes` that is Rust.
//!
//! `octobayes/` beside this crate is what users import; it checks arguments, and hands over NumPy arrays of the types
//! that are expected here. A field in Python is called in one place only ([`work`]).
#![allow(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]

mod clean;
mod depth;
mod errors;
mod export;
mod field;
mod fields;
mod judge;
mod model;
mod options;
mod plan;
mod pool;
mod run;
mod splats;
mod view;
mod work;

use pyo3::prelude::*;

/// The bindings; `octobayes` is what to import.
#[pymodule]
fn _octobayes(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<field::Uncertainty>()?;
    module.add_class::<model::Model>()?;
    module.add_class::<splats::Splats>()?;
    module.add_function(wrap_pyfunction!(options::defaults, module)?)?;
    module.add_function(wrap_pyfunction!(options::keeps_sums, module)?)?;
    module.add_function(wrap_pyfunction!(run::uncertainty, module)?)?;
    module.add_function(wrap_pyfunction!(run::read_cameras, module)?)?;
    module.add_function(wrap_pyfunction!(field::load, module)?)?;
    module.add_function(wrap_pyfunction!(fields::compare, module)?)?;
    module.add_function(wrap_pyfunction!(fields::merge, module)?)?;
    module.add_function(wrap_pyfunction!(fields::accumulate, module)?)?;
    module.add_function(wrap_pyfunction!(export::export_field, module)?)?;
    module.add_function(wrap_pyfunction!(export::export_surfaces, module)?)?;
    module.add_function(wrap_pyfunction!(splats::seen_splats, module)?)?;
    module.add_function(wrap_pyfunction!(clean::clean, module)?)?;
    module.add_function(wrap_pyfunction!(splats::export_splats, module)?)?;
    module.add_function(wrap_pyfunction!(view::render, module)?)?;
    module.add_function(wrap_pyfunction!(depth::depth, module)?)?;
    module.add_function(wrap_pyfunction!(depth::measure, module)?)?;
    module.add_function(wrap_pyfunction!(judge::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(plan::next_view, module)?)?;
    Ok(())
}
