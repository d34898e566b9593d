//! `completions`: shell completions and man pages.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::CommandFactory;
use clap_complete::Shell;

use super::Cli;
use super::files::CommandFiles;
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// Write completions for a shell, or man pages
///
/// A shell's completions go to stdout, for the file in which your shell looks for them. Man pages are one file for
/// the program and one for each verb.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes completions bash > ~/.local/share/bash-completion/completions/octobayes\n  \
    octobayes completions fish > ~/.config/fish/completions/octobayes.fish\n  \
    octobayes completions zsh > \"${fpath[1]}/_octobayes\"\n  \
    octobayes completions man -o ~/.local/share/man/man1")]
pub struct Args {
    /// What to write
    #[arg(value_name = "SHELL|man", value_parser = parse_target)]
    target: Target,

    /// Folder for the man pages, made if it is not there
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Target {
    Shell(Shell),
    Man,
}

/// A shell, or `man`.
fn parse_target(text: &str) -> std::result::Result<Target, String> {
    if text == "man" {
        return Ok(Target::Man);
    }
    let shell = text.parse::<Shell>();
    shell.map(Target::Shell).map_err(|_| "expected bash, elvish, fish, powershell, zsh, or man".to_string())
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        match (self.target, self.output) {
            (Target::Shell(shell), None) => {
                let mut script = Vec::new();
                clap_complete::generate(shell, &mut Cli::command(), "octobayes", &mut script);
                say!("{}", String::from_utf8_lossy(&script).trim_end())
            }
            (Target::Man, Some(folder)) => write_man_pages(&folder),
            (Target::Shell(_), Some(folder)) => {
                let expected = "only with man: completions go to stdout";
                Err(Error::setting("--output", expected, folder.display().to_string()))
            }
            (Target::Man, None) => Err(Error::setting("--output", "a folder for the man pages", "none")),
        }
    }
}

/// Writes `octobayes.1`, and `octobayes-VERB.1` for each verb.
fn write_man_pages(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(Error::io(folder, "cannot create the folder"))?;
    let mut program = Cli::command().disable_help_subcommand(true);
    program.build();
    let verbs = program.get_subcommands().map(|verb| {
        let name = format!("octobayes-{}", verb.get_name());
        (folder.join(format!("{name}.1")), name, verb.clone())
    });
    let whole = (folder.join("octobayes.1"), "octobayes".to_string(), program.clone());
    let pages: Vec<_> = [whole].into_iter().chain(verbs).collect();
    CommandFiles::default().outputs("a page in --output", pages.iter().map(|(path, ..)| path)).check()?;
    for (path, name, command) in &pages {
        let mut page = Vec::new();
        let mut file = AtomicFile::create(path)?;
        let drawn = clap_mangen::Man::new(command.clone()).title(name.as_str()).render(&mut page);
        drawn.and_then(|()| file.write_all(&page)).map_err(Error::io(path, "cannot write"))?;
        file.commit()?;
    }
    say!("{}: {} man pages", folder.display(), pages.len())
}
