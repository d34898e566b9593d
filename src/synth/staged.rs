//! Folders that appear complete or not at all.

use std::path::{Path, PathBuf};

use crate::io::{destination, folder_of};
use crate::{Error, Result};

/// A folder under a temporary name beside its target.
///
/// It is renamed when complete. If it is dropped before, it is removed with its content.
pub struct StagedFolder {
    staged: tempfile::TempDir,
    target: PathBuf,
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
        let destination = destination(target)?;
        let parent = folder_of(&destination);
        let mut builder = tempfile::Builder::new();
        builder.prefix(".octobayes-").suffix(".part");
        #[cfg(unix)]
        {
            // As for files: the usual permissions, under the umask.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o777));
        }
        let staged = builder.tempdir_in(parent).map_err(Error::io(target, "cannot create the folder"))?;
        Ok(Self { staged, target: destination })
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
