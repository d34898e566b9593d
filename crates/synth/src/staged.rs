//! Folders that appear complete or not at all.

use std::fs::File;
use std::path::{Path, PathBuf};

use octobayes::io::beside;
use octobayes::io::place::destination;
use octobayes::{Error, Result};

/// A folder under a temporary name beside its target.
///
/// It is renamed when complete. If it is dropped before, it is removed with its content. What a killed process left
/// of it is removed when the same target is written again.
pub struct StagedFolder {
    staged: tempfile::TempDir,
    target: PathBuf,
    /// Says that the folder is no leftover, where folders have locks.
    _lock: Option<File>,
}

impl StagedFolder {
    /// Starts a folder that will become `target`.
    ///
    /// # Errors
    /// If `target` is a file or a non-empty folder, or if its parent folder cannot be written.
    pub fn create(target: &Path) -> Result<Self> {
        if target.exists() {
            let mut entries = std::fs::read_dir(target).map_err(Error::io(target, "cannot read the folder"))?;
            if entries.next().is_some() {
                return Err(Error::malformed(target, "output folder", "a new or empty folder", "files in it"));
            }
        }
        // As for files: a link stays, and what it points to is replaced.
        let destination = destination(target);
        let lock = |staged: &tempfile::TempDir| File::open(staged).ok().filter(|folder| folder.lock().is_ok());
        let (staged, lock) = beside(&destination, 0o777, |builder, parent| builder.tempdir_in(parent), lock)
            .map_err(Error::io(target, "cannot create the folder"))?;
        Ok(Self { staged, target: destination, _lock: lock })
    }

    /// Path of the folder while it is being filled.
    pub fn path(&self) -> &Path {
        self.staged.path()
    }

    /// Renames the folder to its target.
    ///
    /// # Errors
    /// If the target is no longer free.
    pub fn commit(mut self) -> Result<()> {
        if self.target.exists() {
            // Removes only an empty folder.
            std::fs::remove_dir(&self.target).map_err(Error::io(&self.target, "cannot replace the folder"))?;
        }
        std::fs::rename(self.staged.path(), &self.target)
            .map_err(Error::io(&self.target, "cannot rename the finished folder"))?;
        self.staged.disable_cleanup(true);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A process that removes leftovers may find a folder between its creation and its lock.
    #[test]
    fn writers_of_one_folder_take_nothing_from_each_other() {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("set");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..300 {
                        let staged = StagedFolder::create(&target).unwrap();
                        std::fs::write(staged.path().join("x"), "content").unwrap();
                    }
                });
            }
        });
        assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 0, "a part is left");
    }
}
