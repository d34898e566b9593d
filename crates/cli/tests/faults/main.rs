//! What can go wrong around the program: files in the way, failures of the machine, runs that are killed.

mod files;
#[cfg(unix)]
#[path = "../interrupt/mod.rs"]
mod interrupt;
mod machine;
mod paths;
#[path = "../program/mod.rs"]
mod program;
mod survives;
