//! What can go wrong around the program: faulty input, files in the way, failures of the machine, runs that are killed.

mod desk;
mod errors;
mod files;
#[cfg(unix)]
#[path = "../interrupt/mod.rs"]
mod interrupt;
mod machine;
#[path = "../arrays/npz.rs"]
mod npz;
mod paths;
#[path = "../program/mod.rs"]
mod program;
mod survives;
// The tests of damaged files use all of this module.
#[allow(dead_code)]
#[path = "../untrusted/mod.rs"]
mod untrusted;

use untrusted::arrays;
