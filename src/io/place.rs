//! Where files go, and which paths are the same file.

use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Longest chain of symbolic links that is followed, as on Linux.
const MOST_LINKS: usize = 40;

/// The folder that holds what `path` names.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// `path` with symbolic links at its end resolved. The result need not exist.
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

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_are_followed_to_their_end() {
        let desk = tempfile::tempdir().unwrap();
        let path = |name: &str| desk.path().join(name);
        for (to, name) in [("there", "soft"), ("soft", "softer"), ("folder/new", "dangling"), ("circle", "circle")] {
            symlink(to, path(name)).unwrap();
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
