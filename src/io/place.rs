//! Where files go.

use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// The folder that holds what `path` names.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// `path` with symbolic links at its end resolved. The result need not exist.
#[must_use]
pub fn destination(path: &Path) -> PathBuf {
    // As many links as Linux follows.
    (0..40).fold(path.to_path_buf(), |path, _| match path.read_link() {
        // A relative link is relative to its own folder.
        Ok(target) => folder_of(&path).join(target),
        Err(_) => path,
    })
}

/// Checks that a file can be put at `path`: there is a regular file, or nothing.
///
/// Folders are not replaced by files. Neither are devices and pipes: others hold them open, and a new file under
/// their name would not reach them.
pub fn check_replaceable(path: &Path) -> Result<()> {
    // Such as /dev/stdout, even where it leads to a file: the shell has that file open.
    let is_held = cfg!(unix)
        && (folder_of(path) == Path::new("/dev") || path.starts_with("/dev/fd") || path.starts_with("/proc"));
    let found = match path.metadata() {
        Ok(metadata) if metadata.is_dir() => "a folder",
        Ok(metadata) if !metadata.is_file() || is_held => "a device or a pipe",
        Err(_) if destination(path).is_symlink() => "symbolic links without an end",
        _ => return Ok(()),
    };
    Err(Error::malformed(path, "output path", "a file", found))
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_are_followed_to_their_end_and_only_files_are_replaced() {
        let desk = tempfile::tempdir().unwrap();
        let path = |name: &str| desk.path().join(name);
        std::fs::write(path("there"), "").unwrap();
        let links = [("there", "soft"), ("soft", "softer"), ("folder/new", "dangling"), ("circle", "circle")];
        for (to, name) in links.into_iter().chain([("/dev/null", "device")]) {
            symlink(to, path(name)).unwrap();
        }
        assert_eq!(destination(&path("softer")), path("there"));
        assert_eq!(destination(&path("dangling")), path("folder/new"));
        for name in ["there", "softer", "dangling", "new"] {
            check_replaceable(&path(name)).unwrap();
        }
        let others = [path("."), path("circle"), path("device"), "/dev/null".into(), "/dev/stdout".into()];
        for (path, found) in others.iter().zip(["a folder", "symbolic", "a device", "a device", "a device"]) {
            let error = check_replaceable(path).unwrap_err().to_string();
            assert!(error.contains(&format!("expected a file, found {found}")), "{error}");
        }
    }
}
