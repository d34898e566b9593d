//! Options, and the words that give them again.

use std::ffi::{OsStr, OsString};

use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};

/// Options of the command line, and the words by which another process is given the same.
pub struct Words<T> {
    pub options: T,
    given: Vec<(String, Vec<OsString>)>,
}

impl<T> Words<T> {
    /// The words of all options that were given, except those of the fields `left_out`. Positional arguments come last,
    /// so that other options can stand before.
    pub fn without(&self, left_out: &[&str]) -> Vec<OsString> {
        let given = self.given.iter().filter(|(id, _)| !left_out.contains(&id.as_str()));
        given.flat_map(|(_, words)| words).cloned().collect()
    }
}

/// What was given for `arg`, as words.
fn words(arg: &Arg, matches: &ArgMatches) -> Vec<OsString> {
    let values: Vec<&OsStr> = matches.get_raw(arg.get_id().as_str()).into_iter().flatten().collect();
    let Some(long) = arg.get_long() else {
        // A name that begins with `-` is taken for an option unless something says that options end here.
        let looks_like_option = values.iter().any(|value| value.as_encoded_bytes().starts_with(b"-"));
        let end = looks_like_option.then(|| "--".into());
        return end.into_iter().chain(values.into_iter().map(OsStr::to_os_string)).collect();
    };
    let name = OsString::from(format!("--{long}"));
    if matches!(arg.get_action(), ArgAction::SetTrue) {
        return vec![name];
    }
    let with = |value: &OsStr| match value.as_encoded_bytes() {
        // A box may begin so, and would be taken for an option.
        [b'-', ..] => vec![[&name, OsStr::new("="), value].into_iter().collect()],
        _ => vec![name.clone(), value.to_os_string()],
    };
    match arg.get_value_delimiter() {
        Some(delimiter) => with(&values.join(OsStr::new(&delimiter.to_string()))),
        None => values.into_iter().flat_map(with).collect(),
    }
}

impl<T: Args> FromArgMatches for Words<T> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let known = T::augment_args(Command::new("options"));
        let is_given = |arg: &&Arg| matches.value_source(arg.get_id().as_str()) == Some(ValueSource::CommandLine);
        let (positional, named): (Vec<&Arg>, Vec<&Arg>) =
            known.get_arguments().filter(is_given).partition(|arg| arg.is_positional());
        let given = named.into_iter().chain(positional).map(|arg| (arg.get_id().to_string(), words(arg, matches)));
        Ok(Self { given: given.collect(), options: T::from_arg_matches(matches)? })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl<T: Args> Args for Words<T> {
    fn augment_args(command: Command) -> Command {
        T::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        T::augment_args_for_update(command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::uncertainty;

    fn replayed(given: &[&str]) -> Vec<OsString> {
        let command = || Words::<uncertainty::Args>::augment_args(Command::new("plan"));
        let parse = |words: Vec<OsString>| {
            let matches = command().no_binary_name(true).try_get_matches_from(words).unwrap();
            Words::<uncertainty::Args>::from_arg_matches(&matches).unwrap().without(&["output", "json"])
        };
        let first = parse(given.iter().map(OsString::from).collect());
        // What the words say is what was said.
        let output = [OsString::from("--output=other.oct")];
        assert_eq!(parse(output.into_iter().chain(first.clone()).collect()), first);
        first
    }

    #[test]
    fn words_say_what_was_given_and_nothing_else() {
        let words = replayed(&[
            "it's a model.npz",
            "-o",
            "a.oct",
            "--json",
            "--box",
            "-1,-1,-1,1,1,1",
            "--refine",
            "sensitivity,density",
            "--rays",
            "1M",
            "--keep-sums",
            "--cameras=$HOME/ü \"x\".json",
            "--checkpoint-every",
            "1h 30min",
        ]);
        let expected: [&[&str]; 7] = [
            &["--cameras", "$HOME/ü \"x\".json"],
            &["--refine", "sensitivity,density"],
            &["--keep-sums"],
            &["--rays", "1M"],
            &["--box=-1,-1,-1,1,1,1"],
            &["--checkpoint-every", "1h 30min"],
            &["it's a model.npz"],
        ];
        assert_eq!(words, expected.concat(), "in the order of --help, the model last");
    }

    #[test]
    fn a_model_may_look_like_an_option() {
        assert_eq!(replayed(&["-o", "a.oct", "--", "-x.npz"]), ["--", "-x.npz"]);
    }
}
