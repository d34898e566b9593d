//! Temporary files and folders beside their targets, and what killed runs left of them.
//!
//! A part has the name `.octobayes-TARGET-XXXXXX.part`. The process that writes it holds a lock, which the
//! system releases when that process ends, however it ends. A part that nobody holds is therefore a leftover.

use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::path::Path;

use super::place::folder_of;

/// End of a part's name.
pub const SUFFIX: &str = ".part";
/// Number of random characters in a part's name.
const RANDOM: usize = 6;
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
///
/// # Errors
/// Those of `make`.
pub fn locked<T>(mut make: impl FnMut() -> std::io::Result<T>, file: impl Fn(&T) -> &File) -> std::io::Result<T> {
    loop {
        let part = make()?;
        if lock(file(&part)) != Lock::Taken && is_linked(file(&part)) {
            return Ok(part);
        }
    }
}

/// Removes the parts of `destination` that no process is writing. What cannot be removed stays.
pub fn clear_leftovers(destination: &Path) {
    let prefix = prefix(destination);
    let Ok(entries) = std::fs::read_dir(folder_of(destination)) else { return };
    for entry in entries.flatten().filter(|entry| is_part(&entry.file_name(), &prefix)) {
        // Neither links nor devices.
        let Ok(kind) = entry.file_type().map(|kind| (kind.is_file(), kind.is_dir())) else { continue };
        if kind == (false, false) {
            continue;
        }
        let path = entry.path();
        // The lock is held until the part is gone.
        let Ok(part) = File::open(&path) else { continue };
        if lock(&part) == Lock::Held {
            let _ = if kind.1 { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        }
    }
}

fn is_part(name: &OsStr, prefix: &OsStr) -> bool {
    let rest = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
    let random = rest.and_then(|rest| rest.strip_suffix(SUFFIX.as_bytes()));
    random.is_some_and(|random| random.len() == RANDOM && random.iter().all(u8::is_ascii_alphanumeric))
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
    use rustix::fs::{FlockOperation, flock};
    match flock(file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Lock::Held,
        Err(rustix::io::Errno::WOULDBLOCK) => Lock::Taken,
        Err(_) => Lock::Unsupported,
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

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn leftovers_of_one_target_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("x.oct");
        let held = AtomicFile::create(&target).unwrap();
        let kept = [
            ".octobayes-x.oct-ABCDEFG.part",
            ".octobayes-x.oct-ABCDE!.part",
            ".octobayes-x.oct-abcdef-ABCDEF.part",
            ".octobayes-other.oct-ABCDEF.part",
            ".octobayes-ABCDEF.part",
            "x.oct-ABCDEF.part",
        ];
        for name in kept.into_iter().chain([".octobayes-x.oct-ABCDEF.part", ".octobayes-x.oct-012xyz.part"]) {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        std::fs::create_dir_all(folder.path().join(".octobayes-x.oct-folder.part/images")).unwrap();
        std::os::unix::fs::symlink(folder.path().join(kept[3]), folder.path().join(".octobayes-x.oct-symlnk.part"))
            .unwrap();
        let before = names(folder.path()).len();
        clear_leftovers(&target);
        let left = names(folder.path());
        assert_eq!(left.len(), before - 3, "{left:?}");
        assert!(kept.iter().all(|name| left.iter().any(|left| left == name)), "{left:?}");
        held.commit().unwrap();
        assert!(target.exists());
    }

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
