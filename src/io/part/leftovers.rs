//! Removal of what killed runs left.

use std::ffi::OsStr;
use std::fs::File;
use std::path::Path;

use super::{Lock, SUFFIX, lock, prefix};
use crate::io::place::folder_of;

/// Number of random characters in a part's name.
const RANDOM: usize = 6;

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
}
