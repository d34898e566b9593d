//! The checkpoint of a long run: where its state is saved, and how often.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::FieldBuilder;
use super::state::{self, RunKey};
use crate::rays::RunProgress;
use crate::{Error, Result};

/// A file that lets a run survive Ctrl-C, `kill -9` and power cuts. The resumed run ends with the same bits.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    path: PathBuf,
    every: Duration,
    resume: bool,
}

impl Checkpoint {
    /// Creates a checkpoint at `path`, written once a minute. A run in groups appends `.0`, `.1`, … for its groups.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), every: Duration::from_secs(60), resume: false }
    }

    /// Sets the time between two writes.
    #[must_use]
    pub fn every(self, every: Duration) -> Self {
        Self { every, ..self }
    }

    /// Resumes from the file if it exists. Otherwise an existing file is an error, because it may hold hours of work.
    #[must_use]
    pub fn resume(self, resume: bool) -> Self {
        Self { resume, ..self }
    }

    /// The files of a run in `groups` groups, or of a run without groups.
    #[must_use]
    pub fn files(&self, groups: Option<u16>) -> Vec<PathBuf> {
        let file = |g| {
            let mut path = self.path.clone();
            path.as_mut_os_string().push(format!(".{g}"));
            path
        };
        groups.map_or_else(|| vec![self.path.clone()], |n| (0..n).map(file).collect())
    }

    /// Returns an error if a file would be overwritten.
    pub(super) fn check(&self, files: &[PathBuf]) -> Result<()> {
        match files.iter().find(|file| file.exists() && !self.resume) {
            Some(file) => {
                let found = format!("{}, the state of an unfinished run", file.display());
                Err(Error::setting("checkpoint", "no file, or a run that resumes", found))
            }
            None => Ok(()),
        }
    }

    /// Total number of rays in those files that exist and hold a complete state.
    #[must_use]
    pub fn rays(&self, groups: Option<u16>) -> u64 {
        self.files(groups).iter().filter_map(|file| state::progress(file).ok()).map(|progress| progress.rays).sum()
    }

    /// Removes the files of a run whose result is saved.
    ///
    /// # Errors
    /// If a file exists and cannot be removed.
    pub fn remove(&self, groups: Option<u16>) -> Result<()> {
        let files = self.files(groups);
        let mut there = files.iter().filter(|file| file.exists());
        there.try_for_each(|file| std::fs::remove_file(file).map_err(Error::io(file, "cannot remove")))
    }
}

/// Saves one builder's state at intervals; does nothing without a file.
pub(super) struct Saver<'a> {
    file: Option<&'a Path>,
    every: Duration,
    saved: Instant,
}

impl<'a> Saver<'a> {
    /// Creates a saver for `file` with the interval of `checkpoint`.
    pub fn new(checkpoint: Option<&Checkpoint>, file: Option<&'a Path>) -> Self {
        Self { file, every: checkpoint.map_or(Duration::MAX, |c| c.every), saved: Instant::now() }
    }

    /// Restores the state in the file, if there is one, and returns its progress.
    pub fn restore(&self, builder: &mut FieldBuilder, key: &RunKey) -> Result<RunProgress> {
        match self.file.filter(|file| file.exists()) {
            Some(file) => builder.restore(file, key),
            None => Ok(RunProgress::default()),
        }
    }

    /// Saves if the interval has passed.
    pub fn save_if_due(
        &mut self,
        builder: &FieldBuilder,
        key: impl FnOnce() -> RunKey,
        progress: RunProgress,
    ) -> Result<()> {
        if self.file.is_some() && self.saved.elapsed() >= self.every {
            self.save(builder, key, progress)
        } else {
            Ok(())
        }
    }

    /// Saves now.
    pub fn save(&mut self, builder: &FieldBuilder, key: impl FnOnce() -> RunKey, progress: RunProgress) -> Result<()> {
        let Some(file) = self.file else { return Ok(()) };
        builder.save(file, &key(), progress)?;
        self.saved = Instant::now();
        Ok(())
    }
}
