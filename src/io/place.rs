//! Where files go, and which paths are the same file.

use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Longest chain of symbolic links that is followed, as on Linux.
const MOST_LINKS: usize = 40;

/// The folder that holds what `path` names.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// `path` with symbolic links at its end resolved. The result need not exist.
///
/// # Errors
/// If the links form a circle.
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

/// Checks that a file can be put at `path`: there is a regular file, or nothing.
///
/// Folders are not replaced by files. Neither are devices and pipes: others hold them open, and a new file under
/// their name would not reach them.
///
/// # Errors
/// If `path` is anything else.
pub fn check_replaceable(path: &Path) -> Result<()> {
    let found = match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => "a folder",
        Ok(metadata) if !metadata.is_file() => "a device or a pipe",
        // Such as /dev/stdout, even where it leads to a file: the shell has that file open.
        Ok(_) if is_of_the_system(folder_of(path)) => "a device or a pipe",
        _ => return Ok(()),
    };
    Err(Error::malformed(path, "output path", "a file", found))
}

/// True if a folder holds devices, or open files of processes. Folders inside `/dev`, such as `/dev/shm`, do not
/// count.
fn is_of_the_system(folder: &Path) -> bool {
    let folder = folder.canonicalize().unwrap_or_default();
    cfg!(unix) && (folder == Path::new("/dev") || folder.starts_with("/proc"))
}

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
    #[must_use]
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
        symlink("circle", path("circle")).unwrap();
        let same = |a: &str, b: &str| Identity::new(&path(a)) == Identity::new(&path(b));
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
