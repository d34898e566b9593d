//! Where a long run keeps its state.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::estimate::FieldBuilder;
use crate::posterior::checkpoint::RunKey;
use crate::rays::{RunProgress, Shard};
use crate::{Error, Result};

/// A checkpoint file and when it was last written.
pub struct Checkpoint {
    /// The file.
    pub path: PathBuf,
    every: Duration,
    saved: Instant,
}

impl Checkpoint {
    /// A file that is written every so many seconds; one that exists already is not overwritten unless the run resumes.
    pub fn new(path: &Path, every: f64, resume: bool) -> Result<Self> {
        if path.exists() && !resume {
            return Err(Error::malformed(path, "checkpoint", "no file, or --resume", "the state of an unfinished run"));
        }
        let every = Duration::try_from_secs_f64(every).unwrap_or(Duration::MAX);
        Ok(Self { path: path.to_path_buf(), every, saved: Instant::now() })
    }

    /// Takes up the state of the run `key`, if there is one.
    pub fn restore(&self, builder: &mut FieldBuilder, key: &RunKey) -> Result<RunProgress> {
        if self.path.exists() { builder.restore(&self.path, key) } else { Ok(RunProgress::default()) }
    }

    /// Whether it is time to save.
    pub fn is_due(&self) -> bool {
        self.saved.elapsed() >= self.every
    }

    /// Saves.
    pub fn save(&mut self, builder: &FieldBuilder, key: &RunKey, tally: RunProgress) -> Result<()> {
        builder.save(&self.path, key, tally)?;
        self.saved = Instant::now();
        Ok(())
    }

    /// Saves a run that was interrupted, and says how it goes on.
    pub fn save_interrupted(
        &mut self,
        builder: &FieldBuilder,
        key: &RunKey,
        tally: RunProgress,
        share: Shard,
    ) -> Result<()> {
        self.save(builder, key, tally)?;
        let path = self.path.display();
        eprintln!("note: {path} holds {} of {} rays; --resume goes on", tally.rays, share.own_rays());
        Ok(())
    }

    /// Removes the file of a run that is finished.
    pub fn remove(&self) -> Result<()> {
        if self.path.exists() {
            std::fs::remove_file(&self.path).map_err(Error::io(&self.path, "cannot remove"))?;
        }
        Ok(())
    }
}
