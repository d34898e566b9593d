//! The program, started in a folder.

use std::path::Path;
use std::process::{Command, Output};

/// The program with these words, in a folder.
pub fn command(folder: &Path, args: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace()).current_dir(folder);
    command
}

pub fn run(folder: &Path, args: &str) -> Output {
    command(folder, args).output().unwrap()
}

/// Exit code, stdout and stderr.
pub fn outcome(folder: &Path, args: &str) -> (Option<i32>, String, String) {
    let output = run(folder, args);
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// What is answered on stdout. Panics on failure.
pub fn good(folder: &Path, args: &str) -> String {
    let (code, answer, said) = outcome(folder, args);
    assert_eq!(code, Some(0), "{args}: {said}");
    answer
}
