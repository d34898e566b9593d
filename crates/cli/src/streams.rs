//! What the command line prints: results on stdout, which must arrive; notes, warnings and errors on stderr, which
//! may be lost.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::path::Path;

use octobayes::monitor::Message;
use octobayes::{Error, Result};

/// Prints a line to stdout. A reader that has seen enough (`| head`) is no failure.
pub fn say(text: Arguments) -> Result<()> {
    arrived(writeln!(std::io::stdout(), "{text}"))
}

/// What writing to stdout came to. A reader that has seen enough (`| head`) is no failure.
pub fn arrived(written: std::io::Result<()>) -> Result<()> {
    match written {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::io(Path::new("stdout"), "cannot write")(e)),
        _ => Ok(()),
    }
}

/// Prints a line to stderr, at once and in one piece. Drops it if stderr cannot be written (`2>&1 | head`, a log on
/// a full disk): the work goes on.
pub fn announce(text: Arguments) {
    let _ = std::io::stderr().write_all(format!("{text}\n").as_bytes());
}

/// Prints what a user should know to stderr.
pub fn tell(remark: Message) {
    match remark {
        Message::Note(text) => announce(format_args!("note: {text}")),
        Message::Warning(text) => announce(format_args!("warning: {text}")),
    }
}

/// The error of the stream under a writer of CSV, whose kind `std::io::Error::from` would hide.
pub fn of_csv(error: csv::Error) -> std::io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => std::io::Error::other(format!("{other:?}")),
    }
}
