//! The program, started in a folder.

use std::path::Path;
use std::process::{Command, Output};

/// Runs the program with words that single spaces part.
pub fn run(folder: &Path, args: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_octobayes")).current_dir(folder).args(args.split(' ')).output().unwrap()
}

/// The same, and returns stdout. Panics on failure.
pub fn good(folder: &Path, args: &str) -> String {
    let output = run(folder, args);
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}
