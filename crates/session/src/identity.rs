//! What a run was computed from: names of files with checksums of their content.

use std::path::{Path, PathBuf};

use octobayes::{Error, Result};

/// A file's name and checksum. A built-in scene has only a name.
fn identity(file: &Path) -> Result<String> {
    let name = file.to_string_lossy();
    if name.starts_with("scene:") {
        return Ok(name.into());
    }
    Ok(format!("{name} ({:08x})", crc32fast::hash(&octobayes::io::read(file)?)))
}

/// What `read` reads from `files`, and the names and checksums of these.
///
/// # Errors
/// As `read`. If a file cannot be read, or has changed meanwhile: the result would be named by another content.
pub fn unchanged<T>(files: impl Fn() -> Vec<PathBuf>, read: impl FnOnce() -> Result<T>) -> Result<(T, Vec<String>)> {
    let names = || files().iter().map(|file| identity(file)).collect::<Result<Vec<String>>>();
    let before = names();
    let content = read()?;
    // Checked only now: if a file is at fault, its reader explains it better.
    let before = before?;
    let now = names()?;
    if let Some((before, now)) = before.iter().zip(&now).find(|(before, now)| before != now) {
        return Err(Error::setting("an input file", format!("{before}, as before it was read"), now));
    }
    Ok((content, before))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_changes_while_it_is_read_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("x");
        std::fs::write(&file, "before").unwrap();
        let read = |change: Option<&str>| {
            unchanged(
                || vec![file.clone()],
                || change.map_or(Ok(()), |text| std::fs::write(&file, text).map_err(Error::io(&file, "cannot write"))),
            )
        };
        let (_, names) = read(None).unwrap();
        assert_eq!(names, [format!("{} ({:08x})", file.display(), crc32fast::hash(b"before"))]);
        assert!(read(Some("after")).unwrap_err().to_string().contains("as before it was read"));
    }
}
