//! The command line: parses its arguments, calls the library, prints.

use std::process::ExitCode;

fn main() -> ExitCode {
    octobayes::cli::main()
}
