//! Folders that appear complete or not at all.

use std::path::{Path, PathBuf};

use crate::io::{destination, folder_of};
use crate::{Error, Result};

/// A folder under a temporary name beside its target, renamed when complete, removed with its content if dropped before.
pub struct StagedFolder {
    staged: tempfile::TempDir,
    target: PathBuf,
}

impl StagedFolder {
    /// Starts a folder that will become `target`.
    ///
    /// # Errors
    /// If `target` is a file or a folder with something in it, or the folder around it cannot be written.
    pub fn create(target: &Path) -> Result<Self> {
        if target.exists() {
            let mut entries = std::fs::read_dir(target).map_err(Error::io(target, "cannot read the folder"))?;
            if entries.next().is_some() {
                return Err(Error::malformed(target, "output folder", "a new or empty folder", "files in it"));
            }
        }
        // As for files: a link stays, and what it leads to is replaced.
        let destination = destination(target)?;
        let parent = folder_of(&destination);
        let mut builder = tempfile::Builder::new();
        builder.prefix(".octobayes-").suffix(".part");
        #[cfg(unix)]
        {
            // As for files: the usual permissions, the umask applies.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o777));
        }
        let staged = builder.tempdir_in(parent).map_err(Error::io(target, "cannot create the folder"))?;
        Ok(Self { staged, target: destination })
    }

    /// Where the content goes for now.
    pub fn path(&self) -> &Path {
        self.staged.path()
    }

    /// Gives the folder its name.
    ///
    /// # Errors
    /// If the target is no longer free.
    pub fn commit(mut self) -> Result<()> {
        if self.target.exists() {
            // Removes an empty folder only.
            std::fs::remove_dir(&self.target).map_err(Error::io(&self.target, "cannot replace the folder"))?;
        }
        std::fs::rename(self.staged.path(), &self.target)
            .map_err(Error::io(&self.target, "cannot rename the finished folder"))?;
        self.staged.disable_cleanup(true);
        Ok(())
    }
}
