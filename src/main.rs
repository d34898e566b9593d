//! The command line: parses, calls the library, prints.

use std::process::ExitCode;

fn main() -> ExitCode {
    octobayes::internal::main()
}
