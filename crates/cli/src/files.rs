//! The files of a command. They are checked before any work, so that no file is lost to another.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use octobayes::io::AtomicFile;
use octobayes::io::place::{destination, folder_of};
use octobayes::{Error, Result};
use octobayes_data::{Views, taken_for};

/// All files that a command reads and writes, by the names of their options.
///
/// A file that is read and written by design, such as the checkpoint of a resumed run, is an output.
#[derive(Clone, Default)]
pub struct CommandFiles {
    inputs: Vec<(String, PathBuf)>,
    outputs: Vec<(String, PathBuf)>,
}

impl CommandFiles {
    /// Adds a file to read, or a folder.
    pub fn input(mut self, option: &str, path: impl AsRef<Path>) -> Self {
        self.inputs.push((option.into(), path.as_ref().into()));
        self
    }

    /// Adds files to read, if any.
    pub fn inputs(self, option: &str, paths: impl IntoIterator<Item = impl AsRef<Path>>) -> Self {
        paths.into_iter().fold(self, |files, path| files.input(option, path))
    }

    /// Adds the files that `--cameras` means, if it is given.
    pub fn cameras(self, path: Option<&Path>) -> Self {
        // A folder that is still one holds no cameras, which its reader reports.
        let files = path.iter().flat_map(|path| Views::files(path)).filter(|file| !file.is_dir());
        self.inputs("--cameras", files)
    }

    /// Adds the images of the file of --cameras.
    pub fn images(self, views: &Views) -> Self {
        self.images_of("--cameras", views)
    }

    /// Adds the images of the camera file of an option.
    pub fn images_of(self, option: &str, views: &Views) -> Self {
        let images = views.frames.iter().map(|frame| &frame.image).filter(|image| !image.as_os_str().is_empty());
        self.inputs(&format!("an image of {option}"), images)
    }

    /// Adds a file to write.
    pub fn output(mut self, option: impl Into<String>, path: impl AsRef<Path>) -> Self {
        self.outputs.push((option.into(), path.as_ref().into()));
        self
    }

    /// Adds files to write, if any.
    pub fn outputs(self, option: &str, paths: impl IntoIterator<Item = impl AsRef<Path>>) -> Self {
        paths.into_iter().fold(self, |files, path| files.output(option, path))
    }

    /// Checks that every output can be written, that it is a different file from all others, and that it does not seem
    /// to be the cameras of a data set.
    pub fn check(&self) -> Result<()> {
        let others = self.inputs.iter().map(|input| (only_name(&input.1), input));
        let mut others: HashMap<PathBuf, &(String, PathBuf)> = others.collect();
        for output in &self.outputs {
            let (option, path) = output;
            if let Some((other, name)) = others.insert(only_name(path), output) {
                let found = format!("{}, the same file as {} of {other}", path.display(), name.display());
                return Err(Error::setting(option, "a file of its own", found));
            }
            if let Some(other) = taken_for(path) {
                let expected = "a folder without a data set, whose cameras this file would seem to be";
                let found = format!("{}, beside {}", path.display(), other.display());
                return Err(Error::setting(option, expected, found));
            }
            drop(AtomicFile::create(path)?);
        }
        Ok(())
    }
}

/// The path of a file, or of one that does not exist yet, without symbolic links. A hard link is a file of its own:
/// what is written there leaves its other names alone.
fn only_name(path: &Path) -> PathBuf {
    let path = destination(path);
    let there = path.canonicalize();
    let new = || Some(folder_of(&path).canonicalize().ok()?.join(path.file_name()?));
    there.ok().or_else(new).unwrap_or(path)
}
