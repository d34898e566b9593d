//! Where files go, and which paths are the same file.

use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Symbolic links that are followed one after the other, as on Linux.
const MOST_LINKS: usize = 40;

/// The folder that a path names something in.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The path behind symbolic links at the end of `path`; it need not exist.
///
/// # Errors
/// If links lead in a circle.
pub fn destination(path: &Path) -> Result<PathBuf> {
    let mut destination = path.to_path_buf();
    for _ in 0..=MOST_LINKS {
        match std::fs::read_link(&destination) {
            // A relative link is relative to its own folder.
            Ok(target) => destination = folder_of(&destination).join(target),
            Err(_) => return Ok(destination),
        }
    }
    Err(Error::malformed(path, "output path", "a file", "symbolic links without an end"))
}

/// Makes sure that a file can be put at `path`: that there is a file, or nothing.
///
/// A folder is not replaced by a file. Nor are devices and pipes: others hold them open, and a file under their name
/// would not reach them.
///
/// # Errors
/// If there is something else.
pub fn check_replaceable(path: &Path) -> Result<()> {
    let found = match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => "a folder",
        Ok(metadata) if !metadata.is_file() => "a device or a pipe",
        // Such as /dev/stdout, even where it leads to a file: the shell has it open.
        Ok(_) if is_of_the_system(folder_of(path)) => "a device or a pipe",
        _ => return Ok(()),
    };
    Err(Error::malformed(path, "output path", "a file", found))
}

/// Whether a folder holds devices, or open files of processes. Folders in `/dev`, as `/dev/shm`, are like any other.
fn is_of_the_system(folder: &Path) -> bool {
    let folder = folder.canonicalize().unwrap_or_default();
    cfg!(unix) && (folder == Path::new("/dev") || folder.starts_with("/proc"))
}

/// What tells one file from another, whether or not it exists yet.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Identity {
    /// Device and number of an existing file: hard links are the same file.
    Number(u64, u64),
    /// Name in a folder without links.
    Name(PathBuf),
}

impl Identity {
    /// Of the file at `path`, behind symbolic links.
    #[must_use]
    pub fn of(path: &Path) -> Self {
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
        symlink("circle", path("circle")).unwrap();
        let same = |a: &str, b: &str| Identity::of(&path(a)) == Identity::of(&path(b));
        for name in ["hard", "soft", "softer", "folder/../there", "other/../there", "./there"] {
            assert!(same("there", name) && !same("apart", name), "{name}");
        }
        for name in ["folder/new", "other/new", "dangling", "folder/./new"] {
            assert!(same("folder/new", name) && !same("new", name), "{name}");
        }
        assert_eq!(destination(&path("softer")).unwrap(), path("there"));
        assert_eq!(destination(&path("dangling")).unwrap(), path("folder/new"));
        assert!(destination(&path("circle")).unwrap_err().to_string().contains("without an end"));
    }

    #[test]
    fn only_files_are_replaced() {
        let desk = tempfile::tempdir().unwrap();
        let path = |name: &str| desk.path().join(name);
        std::fs::write(path("file"), "").unwrap();
        symlink("file", path("link")).unwrap();
        symlink("/dev/null", path("device")).unwrap();
        for name in ["file", "link", "new"] {
            check_replaceable(&path(name)).unwrap();
        }
        for name in [PathBuf::from("."), "/dev/null".into(), "/dev/stdout".into(), path("device")] {
            let error = check_replaceable(&name).unwrap_err().to_string();
            assert!(error.contains("expected a file, found a "), "{error}");
        }
        if Path::new("/dev/shm").is_dir() {
            check_replaceable(Path::new("/dev/shm/x")).unwrap();
        }
    }
}
