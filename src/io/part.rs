//! Temporary files and folders beside their targets, and what killed runs left of them.
//!
//! A part has the name `.octobayes-TARGET-XXXXXX.part`. The process that writes it holds a lock, which the
//! system releases when that process ends, however it ends. A part that nobody holds is therefore a leftover.

#[cfg(any(feature = "cli", feature = "synth"))]
mod leftovers;

use std::ffi::OsString;
use std::fs::File;
#[cfg(unix)]
use std::fs::TryLockError;
use std::path::Path;

#[cfg(any(feature = "cli", feature = "synth"))]
pub use leftovers::clear_leftovers;

/// End of a part's name.
pub const SUFFIX: &str = ".part";
/// Longest name of a target that its part's name repeats, bytes. Most systems allow 255 in all.
const LONGEST_NAME: usize = 180;

/// Start of the names of parts of `destination`.
pub fn prefix(destination: &Path) -> OsString {
    let name = destination.file_name().unwrap_or_default();
    let mut prefix = OsString::from(".octobayes-");
    if name.len() <= LONGEST_NAME {
        prefix.push(name);
    } else {
        prefix.push(format!("{:08x}", crc32fast::hash(name.as_encoded_bytes())));
    }
    prefix.push("-");
    prefix
}

/// Makes a part with `make` and locks it with `file`, the open part.
///
/// Between the two, another run may take the part for a leftover. Then another is made.
pub fn locked<T>(mut make: impl FnMut() -> std::io::Result<T>, file: impl Fn(&T) -> &File) -> std::io::Result<T> {
    loop {
        let part = make()?;
        if lock(file(&part)) != Lock::Taken && is_linked(file(&part)) {
            return Ok(part);
        }
    }
}

/// What became of an attempt to lock a file.
#[derive(PartialEq, Eq)]
enum Lock {
    /// This process has it.
    Held,
    /// Another one has it.
    Taken,
    /// This file system, or this operating system, has no such locks.
    Unsupported,
}

#[cfg(unix)]
fn lock(file: &File) -> Lock {
    match file.try_lock() {
        Ok(()) => Lock::Held,
        Err(TryLockError::WouldBlock) => Lock::Taken,
        Err(TryLockError::Error(_)) => Lock::Unsupported,
    }
}

#[cfg(not(unix))]
fn lock(_file: &File) -> Lock {
    Lock::Unsupported
}

/// True if the file still has a name.
#[cfg(unix)]
fn is_linked(file: &File) -> bool {
    use std::os::unix::fs::MetadataExt;
    file.metadata().map_or(true, |metadata| metadata.nlink() > 0)
}

#[cfg(not(unix))]
fn is_linked(_file: &File) -> bool {
    true
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::io::AtomicFile;

    #[test]
    fn long_names_have_short_parts() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "b"].map(|letter| folder.path().join(letter.repeat(250)));
        AtomicFile::create(&a).unwrap().commit().unwrap();
        assert!(prefix(&a).len() < 30 && prefix(&a) != prefix(&b));
    }

    #[test]
    fn a_part_that_was_taken_for_a_leftover_is_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let mut made = 0;
        let part = locked(
            || {
                made += 1;
                let part = tempfile::NamedTempFile::new_in(folder.path())?;
                if made == 1 {
                    std::fs::remove_file(part.path())?;
                }
                Ok(part)
            },
            tempfile::NamedTempFile::as_file,
        )
        .unwrap();
        assert!(made == 2 && part.path().exists());
    }
}
