//! What is written about the program: its pages, reports and sources.

mod architecture;
mod book;
#[path = "../../experiments/common/mod.rs"]
mod common;
mod reports;
