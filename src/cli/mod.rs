//! The command line, one file per verb. Results go to stdout, progress and warnings to stderr. A failure is one
//! line on stderr and exit code 2 (130 after Ctrl-C, SIGTERM or SIGHUP).

/// Prints one or more lines to stdout: `say!(…)?`.
macro_rules! say {
    ($($arg:tt)*) => { crate::cli::streams::say(format_args!($($arg)*)) };
}

/// Prints one or more lines to stderr, or drops them if stderr cannot be written.
macro_rules! announce {
    ($($arg:tt)*) => { crate::cli::streams::announce(format_args!($($arg)*)) };
}

mod accumulate;
mod belongs;
mod calibrate;
mod compare;
mod completions;
mod convert;
mod demo;
mod evaluate;
mod export;
mod files;
mod flags;
mod info;
mod merge;
mod opened;
mod options;
mod panels;
mod plan;
mod progress;
mod query;
mod render;
mod report;
mod streams;
mod synth;
mod train;
mod uncertainty;
mod view;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::{Error, Result};
use progress::Bars;

/// Where can a trained radiance field (NeRF) be trusted?
///
/// Asks of every part of space how far it could be moved without any training image noticing (Bayes' Rays, Goli et
/// al., CVPR 2024). Stores the answer on an adaptive octree that is fine where images are sensitive. Start with
/// `octobayes demo`.
#[derive(Parser)]
#[command(name = "octobayes", version, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,

    /// Number of threads; results do not depend on it [default: all cores]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_THREADS))]
    threads: Option<u16>,
}

/// Most threads, and CPUs of a job. Each has buffers of its own.
const MOST_THREADS: i64 = 1024;

#[derive(Subcommand)]
enum Verb {
    Demo(demo::Args),
    // Boxed: it has the most options.
    Uncertainty(Box<uncertainty::Args>),
    // Boxed: it has as many.
    Plan(Box<plan::Args>),
    Accumulate(accumulate::Args),
    Query(query::Args),
    Compare(compare::Args),
    Render(render::Args),
    View(view::Args),
    Evaluate(evaluate::Args),
    Calibrate(calibrate::Args),
    Export(export::Args),
    Convert(convert::Args),
    Merge(merge::Args),
    Info(info::Args),
    Synth(synth::Args),
    // Boxed: it has many options.
    Train(Box<train::Args>),
    Completions(completions::Args),
}

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse_from(query::with_points(std::env::args_os())) {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    if let Some(threads) = cli.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads));
        // No pool exists yet: the system refuses so many.
        if let Err(error) = pool.build_global() {
            return ended(Err(Error::setting(
                "--threads",
                "a number of threads that the system can start",
                format!("{threads}: {error}"),
            )));
        }
    }
    ended(run(cli.verb))
}

/// Help goes to stdout, a wrong command line to stderr.
fn usage(error: &clap::Error) -> ExitCode {
    match (error.print(), error.use_stderr()) {
        (printed, false) => ended(streams::arrived(printed)),
        (_, true) => ExitCode::from(2),
    }
}

/// The exit code of what a verb came to. Says on stderr why it failed.
fn ended(result: Result<()>) -> ExitCode {
    let Err(error) = result else { return ExitCode::SUCCESS };
    let goes_on = if matches!(error, Error::Stopped { .. }) { "; --resume goes on" } else { "" };
    let code = error.exit_code();
    announce!("error: {}{goes_on}", flags::in_flags(error));
    ExitCode::from(code)
}

fn run(verb: Verb) -> Result<()> {
    let bars = &Bars::new();
    // The other verbs end at once if they are asked to.
    if !matches!(
        verb,
        Verb::Query(_) | Verb::Compare(_) | Verb::Convert(_) | Verb::Merge(_) | Verb::Info(_) | Verb::Completions(_)
    ) {
        bars.listen();
    }
    match verb {
        Verb::Demo(args) => args.run(bars),
        Verb::Uncertainty(args) => args.run(bars),
        Verb::Plan(args) => args.run(bars),
        Verb::Accumulate(args) => args.run(bars),
        Verb::Query(args) => args.run(bars),
        Verb::Compare(args) => args.run(),
        Verb::Render(args) => args.run(bars),
        Verb::View(args) => args.run(bars),
        Verb::Evaluate(args) => args.run(bars),
        Verb::Calibrate(args) => args.run(bars),
        Verb::Export(args) => args.run(bars),
        Verb::Convert(args) => args.run(),
        Verb::Merge(args) => args.run(),
        Verb::Info(args) => args.run(),
        Verb::Synth(args) => args.run(bars),
        Verb::Train(args) => args.run(bars),
        Verb::Completions(args) => args.run(),
    }
}
