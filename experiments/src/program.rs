//! An experiment's command line, and its way to the report.

use std::path::PathBuf;

use octobayes::{Error, Result};

use super::clock::Time;
use super::index;
use super::report::{self, Stamp};
use super::tables;
use super::work::Work;

/// Folder of the reports.
#[must_use]
pub fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The data folder, if `OCTOBAYES_DATA` names one.
pub fn data() -> Option<PathBuf> {
    std::env::var_os("OCTOBAYES_DATA").map(PathBuf::from)
}

/// The stamp of a block whose rows were made on these days, first and last, in this time.
pub fn stamp(dates: [String; 2], time: Time) -> Stamp {
    Stamp {
        version: env!("CARGO_PKG_VERSION").into(),
        dates,
        threads: rayon::current_num_threads(),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        minutes: [time.wall, time.cpu].map(|seconds| seconds / 60.0),
    }
}

/// What a part needs beside the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    Nothing,
    /// The folder that `OCTOBAYES_DATA` names.
    Data,
}

/// A running experiment.
pub struct Program {
    name: &'static str,
    /// Parts in the order in which they run, whether they are wanted or not.
    parts: Vec<(&'static str, Needs)>,
    chosen: Vec<String>,
    work: PathBuf,
    fresh: bool,
}

impl Program {
    /// Reads the command line of the experiment `name`.
    ///
    /// # Errors
    /// If it names no part of the experiment.
    pub fn start(name: &'static str, parts: &[(&'static str, Needs)]) -> Result<Self> {
        Self::with(name, parts, std::env::args().skip(1))
    }

    /// The experiment with these words behind its name.
    fn with(
        name: &'static str,
        parts: &[(&'static str, Needs)],
        mut words: impl Iterator<Item = String>,
    ) -> Result<Self> {
        let mut out = Self {
            name,
            parts: parts.to_vec(),
            chosen: Vec::new(),
            work: folder().join("../target/experiments").join(name),
            fresh: false,
        };
        while let Some(word) = words.next() {
            match word.as_str() {
                "--fresh" => out.fresh = true,
                "--work" => {
                    let folder = words.next().ok_or_else(|| Error::setting("--work", "a folder", "nothing"))?;
                    out.work = folder.into();
                }
                part if parts.iter().any(|(name, _)| *name == part) => out.chosen.push(word),
                _ => {
                    let names: Vec<&str> = parts.iter().map(|(name, _)| *name).collect();
                    let expected = format!("some of {}, --work DIR, --fresh", names.join(", "));
                    return Err(Error::setting("arguments", expected, format!("`{word}`")));
                }
            }
        }
        Ok(out)
    }

    /// Runs a part if it is wanted, writes its block, and brings the table of all reports up to date.
    ///
    /// A block that has one line keeps one line: the tables of a long report go to CSV files.
    ///
    /// `make` returns the settings in words, and the block. A part that needs data is skipped without, unless it was
    /// asked for.
    ///
    /// # Errors
    /// Those of `make`, or if the report has no such block or cannot be written.
    pub fn part(&self, part: &str, make: impl FnOnce(&Work) -> Result<(String, String)>) -> Result<()> {
        if !self.runs(part, data().is_some())? {
            return Ok(());
        }
        let work = Work::open(self.work.join(part), self.fresh)?;
        let (settings, body) = make(&work)?;
        let stamp = stamp(work.dates(), work.time());
        let body = format!("{stamp} {settings}\n\n{}", body.trim_matches('\n'));
        println!("## {part}\n\n{body}\n");
        let path = folder().join(format!("{}.md", self.name));
        if report::is_one_line(&path, part)? {
            tables::write(&folder().join("tables"), &format!("{}_{part}", self.name), &body)?;
            report::rewrite(&path, part, body.lines().next().unwrap_or_default())?;
        } else {
            report::rewrite(&path, part, &body)?;
        }
        work.done()?;
        index::update(&folder())
    }

    /// Whether a part is to run, with or without data.
    fn runs(&self, part: &str, has_data: bool) -> Result<bool> {
        let (_, needs) = self.parts.iter().find(|(name, _)| *name == part).expect("a part of the experiment");
        let is_asked_for = self.chosen.iter().any(|c| c == part);
        if !is_asked_for && !self.chosen.is_empty() {
            return Ok(false);
        }
        if *needs == Needs::Data && !has_data {
            if is_asked_for {
                return Err(Error::setting("OCTOBAYES_DATA", "the data folder", "nothing"));
            }
            eprintln!("{part}: skipped, because OCTOBAYES_DATA is not set");
            return Ok(false);
        }
        Ok(true)
    }

    /// The data folder.
    ///
    /// # Errors
    /// If `OCTOBAYES_DATA` is not set.
    pub fn data() -> Result<PathBuf> {
        data().ok_or_else(|| Error::setting("OCTOBAYES_DATA", "the data folder", "nothing"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: [(&str, Needs); 2] = [("courtyard", Needs::Nothing), ("lego", Needs::Data)];

    fn with(words: &[&str]) -> Result<Program> {
        Program::with("one", &PARTS, words.iter().map(|word| (*word).to_string()))
    }

    #[test]
    fn all_parts_run_unless_some_are_named() {
        let all = with(&[]).unwrap();
        assert!(all.runs("courtyard", true).unwrap() && all.runs("lego", true).unwrap());
        let one = with(&["lego", "--work", "here", "--fresh"]).unwrap();
        assert!(!one.runs("courtyard", true).unwrap() && one.runs("lego", true).unwrap());
        assert_eq!((one.work.as_path(), one.fresh), (std::path::Path::new("here"), true));
    }

    #[test]
    fn a_part_without_its_data_is_skipped_or_refused() {
        assert!(!with(&[]).unwrap().runs("lego", false).unwrap(), "skipped among all parts");
        let refusal = with(&["lego"]).unwrap().runs("lego", false).unwrap_err().to_string();
        assert!(refusal.contains("OCTOBAYES_DATA"), "refused where it was asked for: {refusal}");
        assert!(with(&["courtyard"]).unwrap().runs("courtyard", false).unwrap());
    }

    #[test]
    fn words_that_name_nothing_are_refused_with_what_there_is() {
        let refusal = with(&["garden"]).err().expect("no such part").to_string();
        assert!(refusal.contains("courtyard, lego") && refusal.contains("`garden`"), "{refusal}");
        assert!(with(&["--work"]).is_err());
    }
}
