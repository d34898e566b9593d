//! Which options stand on the command line, for those that would have no effect there.

use clap::parser::ValueSource;
use clap::{ArgMatches, Command};

use octobayes::{Error, Result};

/// The options that were given, whatever their values.
pub struct Given(Vec<String>);

impl Given {
    /// Those of the verb in `matches`.
    pub fn of(command: &Command, matches: &ArgMatches) -> Self {
        let Some((verb, matches)) = matches.subcommand() else { return Self(Vec::new()) };
        let is_given = |id: &str| matches.value_source(id) == Some(ValueSource::CommandLine);
        let options = command.find_subcommand(verb).into_iter().flat_map(Command::get_arguments);
        let given = options.filter(|option| is_given(option.get_id().as_str()));
        Self(given.filter_map(|option| option.get_long().map(|name| format!("--{name}"))).collect())
    }

    /// Refuses the first of `options` that was given: it would have no effect.
    pub fn refuse(&self, options: &[&str], expected: &str, found: impl Into<String>) -> Result<()> {
        self.refuse_those(|given| options.contains(&given), expected, found.into())
    }

    /// Refuses the first option that was given and is neither one of these nor one that all verbs have.
    pub fn refuse_all_but(&self, options: &[&str], expected: &str, found: String) -> Result<()> {
        self.refuse_those(|given| !options.contains(&given) && given != "--threads", expected, found)
    }

    fn refuse_those(&self, is_refused: impl Fn(&str) -> bool, expected: &str, found: String) -> Result<()> {
        match self.0.iter().find(|given| is_refused(given)) {
            Some(option) => Err(Error::setting(option.clone(), expected, found)),
            None => Ok(()),
        }
    }
}
