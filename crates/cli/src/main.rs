//! The command line, one file per verb. Results go to stdout, progress and warnings to stderr. A failure is one
//! line on stderr and exit code 2 (130 after Ctrl-C or SIGTERM).

// Both macros panic if the stream cannot be written: `say!` and `announce!` do not.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

/// Prints one or more lines to stdout: `say!(…)?`.
macro_rules! say {
    ($($arg:tt)*) => { crate::streams::say(format_args!($($arg)*)) };
}

/// Prints one or more lines to stderr, or drops them if stderr cannot be written.
macro_rules! announce {
    ($($arg:tt)*) => { crate::streams::announce(format_args!($($arg)*)) };
}

mod clean;
mod compare;
mod completions;
mod demo;
mod depth;
mod evaluate;
mod export;
mod files;
mod given;
mod info;
mod measure;
mod merge;
mod next_view;
mod opened;
mod options;
mod panels;
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

use clap::{ArgAction, CommandFactory, FromArgMatches, Parser, Subcommand};

use given::Given;
use octobayes::{Error, Result};
use octobayes_session::in_flags;
use progress::{Bars, ignore_limit_of_files};

/// Where can a trained radiance field (NeRF) be trusted?
///
/// Computes how far each part of space could move before any training image changed (Bayes' Rays, Goli et al., CVPR
/// 2024), and stores it on an adaptive octree that is fine where images are sensitive. Start with `octobayes demo`.
#[derive(Parser)]
#[command(name = "octobayes", version, max_term_width = 110, disable_help_flag = true)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,

    /// Number of threads; results do not depend on it [default: all cores]
    #[arg(
        long,
        global = true,
        value_name = "N",
        value_parser = options::count::<u16>(1..=MAX_THREADS),
        help_heading = options::heading::GLOBAL,
    )]
    threads: Option<u16>,

    /// Print help: -h the usual options, --help all of them
    #[arg(short, long, global = true, action = ArgAction::Help, help_heading = options::heading::GLOBAL)]
    help: Option<bool>,
}

/// Most threads. Each has buffers of its own.
const MAX_THREADS: u64 = 1024;

#[derive(Subcommand)]
enum Verb {
    Demo(demo::Args),
    // Boxed: it has the most options.
    Uncertainty(Box<uncertainty::Args>),
    // Boxed: it has many options.
    Clean(Box<clean::Args>),
    // Boxed: it has many options.
    Depth(Box<depth::Args>),
    // Boxed: it has many options.
    Measure(Box<measure::Args>),
    Query(query::Args),
    Compare(compare::Args),
    Render(render::Args),
    View(view::Args),
    // Boxed: it has many options.
    Evaluate(Box<evaluate::Args>),
    // Boxed: it has many options.
    NextView(Box<next_view::Args>),
    Export(export::Args),
    Merge(merge::Args),
    Info(info::Args),
    Synth(synth::Args),
    // Boxed: it has many options.
    Train(Box<train::Args>),
    #[command(hide = true)]
    Completions(completions::Args),
}

fn main() -> ExitCode {
    let mut command = Cli::command();
    let matches = match command.try_get_matches_from_mut(query::with_points(std::env::args_os())) {
        Ok(matches) => matches,
        Err(error) => return usage(&error),
    };
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => return usage(&error.format(&mut command)),
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
    ended(run(cli.verb, &Given::of(&command, &matches)))
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
    let goes_on = if matches!(error, Error::Stopped { .. }) { "; the same command goes on" } else { "" };
    let code = error.exit_code();
    announce!("error: {}{goes_on}", in_flags(error));
    ExitCode::from(code)
}

fn run(verb: Verb, given: &Given) -> Result<()> {
    ignore_limit_of_files();
    let bars = &Bars::new();
    // The other verbs end at once on a signal; `query` and `export` do so for some of their work.
    if !matches!(
        verb,
        Verb::Query(_) | Verb::Compare(_) | Verb::Export(_) | Verb::Merge(_) | Verb::Info(_) | Verb::Completions(_)
    ) {
        bars.listen();
    }
    match verb {
        Verb::Demo(args) => args.run(bars),
        Verb::Uncertainty(args) => args.run(given, bars),
        Verb::Clean(args) => args.run(bars),
        Verb::Depth(args) => args.run(bars),
        Verb::Measure(args) => args.run(bars),
        Verb::Query(args) => args.run(bars),
        Verb::Compare(args) => args.run(),
        Verb::Render(args) => args.run(bars),
        Verb::View(args) => args.run(bars),
        Verb::Evaluate(args) => args.run(given, bars),
        Verb::NextView(args) => args.run(bars),
        Verb::Export(args) => args.run(given, bars),
        Verb::Merge(args) => args.run(),
        Verb::Info(args) => args.run(),
        Verb::Synth(args) => args.run(bars),
        Verb::Train(args) => args.run(given, bars),
        Verb::Completions(args) => args.run(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Arg;
    use clap::error::ErrorKind;

    /// The parser's message for some words after a verb. Conflicts are found before what is missing.
    fn refusal(verb: &str, words: &[&str]) -> Option<clap::Error> {
        Cli::command().try_get_matches_from([&["octobayes", verb], words].concat()).err()
    }

    /// An option of a verb with a value that it takes.
    fn given(verb: &str, option: &Arg) -> String {
        const VALUES: [&str; 21] = [
            "0,0,0,1,0,0,2",
            "1",
            "2",
            "8",
            "64",
            "1000",
            "20000",
            "0.5",
            "all",
            "0/2",
            "auto",
            "x.oct",
            "90%",
            "0,1",
            "1,1,1",
            "0..2",
            "l2:0,0,0,1",
            "1GiB",
            "1h",
            "-1,-1,-1,1,1,1",
            "0,0,0,1,0,0",
        ];
        let flag = format!("--{}", option.get_long().unwrap());
        if !option.get_action().takes_values() {
            return flag;
        }
        let possible = option.get_possible_values();
        let values = possible.iter().map(clap::builder::PossibleValue::get_name).chain(VALUES);
        let is_taken = |given: &String| {
            let kind = refusal(verb, &[given]).map(|error| error.kind());
            !matches!(kind, Some(ErrorKind::ValueValidation | ErrorKind::InvalidValue))
        };
        let mut given = values.map(|value| format!("{flag}={value}"));
        given.find(is_taken).unwrap_or_else(|| panic!("no value for {verb} {flag}"))
    }

    /// Every pair of options of every verb, in both orders: those that the definition sets against each other are
    /// refused by a message that names both, and no others.
    #[test]
    fn options_that_exclude_each_other_do_so_in_any_order() {
        let mut command = Cli::command();
        command.build();
        let mut count = 0;
        for verb in command.get_subcommands().filter(|verb| verb.get_name() != "help") {
            let name = verb.get_name();
            let excludes =
                |a: &Arg, b: &Arg| verb.get_arg_conflicts_with(a).iter().any(|other| other.get_id() == b.get_id());
            let options: Vec<&Arg> = verb.get_opts().filter(|o| o.get_long().is_some_and(|l| l != "help")).collect();
            let words: Vec<String> = options.iter().map(|option| given(name, option)).collect();
            for i in 0..options.len() {
                for j in 0..i {
                    let (a, b) = (options[i], options[j]);
                    let expected = excludes(a, b) || excludes(b, a);
                    count += usize::from(expected);
                    for pair in [[&words[i], &words[j]], [&words[j], &words[i]]] {
                        let error = refusal(name, &pair.map(String::as_str));
                        let said = error.filter(|error| error.kind() == ErrorKind::ArgumentConflict);
                        let said = said.map(|error| error.to_string());
                        assert_eq!(said.is_some(), expected, "{name} {pair:?}: {said:?}");
                        let names = [a, b].map(|option| format!("--{}", option.get_long().unwrap()));
                        let is_named = said.is_none_or(|said| names.iter().all(|name| said.contains(name)));
                        assert!(is_named, "{name} {pair:?}");
                    }
                }
            }
        }
        assert!(count > 20, "conflicts are found at all: {count}");
    }
}
