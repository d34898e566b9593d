//! Which paths are the same file.

use std::path::{Path, PathBuf};

use crate::io::place::{destination, folder_of};

/// What distinguishes one file from another, whether or not it exists yet.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Identity {
    /// Device and inode number of an existing file. Hard links are the same file.
    Number(u64, u64),
    /// A path whose folder has no symbolic links.
    Name(PathBuf),
}

impl Identity {
    /// The identity of the file at `path`, with symbolic links resolved.
    pub fn new(path: &Path) -> Self {
        #[cfg(unix)]
        if let Ok(metadata) = std::fs::metadata(path) {
            use std::os::unix::fs::MetadataExt;
            return Self::Number(metadata.dev(), metadata.ino());
        }
        if let Ok(path) = path.canonicalize() {
            return Self::Name(path);
        }
        let path = destination(path).unwrap_or_else(|_| path.to_path_buf());
        let folder = folder_of(&path);
        let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
        Self::Name(path.file_name().map_or(folder.clone(), |name| folder.join(name)))
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn a_file_is_the_same_by_any_name() {
        let desk = tempfile::tempdir().unwrap();
        let path = |name: &str| desk.path().join(name);
        std::fs::create_dir(path("folder")).unwrap();
        symlink("folder", path("other")).unwrap();
        for name in ["there", "apart"] {
            std::fs::write(path(name), "").unwrap();
        }
        std::fs::hard_link(path("there"), path("hard")).unwrap();
        symlink("there", path("soft")).unwrap();
        symlink("soft", path("softer")).unwrap();
        symlink("folder/new", path("dangling")).unwrap();
        let same = |a: &str, b: &str| Identity::new(&path(a)) == Identity::new(&path(b));
        for name in ["hard", "soft", "softer", "folder/../there", "other/../there", "./there"] {
            assert!(same("there", name) && !same("apart", name), "{name}");
        }
        for name in ["folder/new", "other/new", "dangling", "folder/./new"] {
            assert!(same("folder/new", name) && !same("new", name), "{name}");
        }
    }
}
