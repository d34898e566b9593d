//! Files that appear complete or not at all.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile};

use super::place::{check_replaceable, destination, folder_of};
use crate::{Error, Result};

/// End of the names of temporary files and folders.
const SUFFIX: &str = ".part";

/// How the names of temporary files of a target begin.
fn prefix_of(target: &Path) -> String {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    // Long names are cut, because most systems allow 255 bytes, and a hash distinguishes them.
    format!(".octobayes-{name:.40}-{:08x}-", crc32fast::hash(name.as_bytes()))
}

/// Removes what killed processes left of a target. A process locks its part as long as it lives.
pub fn remove_leftovers(target: &Path) {
    let prefix = prefix_of(target);
    let others = std::fs::read_dir(folder_of(target)).into_iter().flatten().flatten();
    for path in others.map(|entry| entry.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_part = name.starts_with(&prefix) && name.ends_with(SUFFIX);
        if !is_part {
            continue;
        }
        // The lock lasts until the part is gone. A process that has just made the part waits, and makes another.
        if let Ok(part) = File::open(&path)
            && part.try_lock().is_ok()
        {
            let _ = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        }
    }
}

/// Makes what will be `target` with `make`, in the same folder, under the name `.octobayes-TARGET-….part`, once what
/// killed processes left of the same target is gone. `lock` locks it, and returns what holds the lock.
#[cfg_attr(not(unix), expect(unused_variables, reason = "permissions are an idea of Unix"))]
pub fn beside<T: AsRef<Path>, L>(
    target: &Path,
    mode: u32,
    make: impl Fn(&Builder, &Path) -> io::Result<T>,
    lock: impl Fn(&T) -> L,
) -> io::Result<(T, L)> {
    remove_leftovers(target);
    let prefix = prefix_of(target);
    let mut builder = Builder::new();
    builder.prefix(&prefix).suffix(SUFFIX);
    // The usual permissions (the umask applies), not the private ones of a temporary file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    loop {
        let made = make(&builder, folder_of(target))?;
        let held = lock(&made);
        // Between creation and lock, another process may have removed it as a leftover.
        if made.as_ref().exists() {
            return Ok((made, held));
        }
    }
}

/// A buffered file under a temporary name beside its target. [`AtomicFile::commit`] renames it over the target
/// once its content has reached the disk. A file that is dropped before that is removed.
#[derive(Debug)]
pub struct AtomicFile {
    writer: BufWriter<NamedTempFile>,
    target: PathBuf,
}

impl AtomicFile {
    /// Starts a file that will replace `target`. If `target` is a link, the link stays and the file behind it is
    /// replaced.
    pub fn create(target: &Path) -> Result<Self> {
        check_replaceable(target)?;
        let destination = destination(target);
        // Some file systems have no locks. There, nothing is a leftover.
        let lock = |file: &NamedTempFile| _ = file.as_file().lock();
        let (file, ()) = beside(&destination, 0o666, |builder, folder| builder.tempfile_in(folder), lock)
            .map_err(Error::io(target, "cannot create a file in this folder"))?;
        Ok(Self { writer: BufWriter::with_capacity(1 << 16, file), target: destination })
    }

    /// Writes a whole file.
    pub fn write(target: &Path, content: &[u8]) -> Result<()> {
        let mut file = Self::create(target)?;
        file.write_all(content).map_err(Error::io(target, "cannot write"))?;
        file.commit()
    }

    /// Flushes the content to disk. After that, [`AtomicFile::commit`] can hardly fail: files that belong together
    /// are all flushed before the first gets its name.
    pub fn sync(&mut self) -> Result<()> {
        let written = self.writer.flush().and_then(|()| self.writer.get_ref().as_file().sync_all());
        written.map_err(Error::io(&self.target, "cannot write"))
    }

    /// Flushes the content to disk and gives the file its name. If either fails, the target stays as it was.
    pub fn commit(mut self) -> Result<()> {
        self.sync()?;
        let Self { writer, target } = self;
        let file = writer.into_inner().map_err(|e| Error::io(&target, "cannot write")(e.into_error()))?;
        file.persist(&target).map_err(|e| Error::io(&target, "cannot rename the finished file")(e.error))?;
        Ok(())
    }

    /// Returns the temporary file, read from its start, for content that is copied elsewhere instead of committed.
    pub fn into_reader(self) -> io::Result<(File, tempfile::TempPath)> {
        let (mut file, path) = self.writer.into_inner().map_err(io::IntoInnerError::into_error)?.into_parts();
        file.seek(SeekFrom::Start(0))?;
        Ok((file, path))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        self.writer.write(buf)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, pos: SeekFrom) -> io::Result<u64> {
        self.writer.seek(pos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_files_leave_nothing_and_committed_ones_replace() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("x.bin");
        std::fs::write(&target, b"old").unwrap();
        let mut file = AtomicFile::create(&target).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(std::fs::read(&target).unwrap(), b"old");
        let mut file = AtomicFile::create(&target).unwrap();
        file.write_all(b"new").unwrap();
        file.commit().unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
    }

    #[test]
    #[cfg(unix)]
    fn links_stay_and_what_they_lead_to_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [target, link] = ["elsewhere/x.bin", "link.bin"].map(|name| folder.path().join(name));
        std::fs::create_dir(folder.path().join("elsewhere")).unwrap();
        std::os::unix::fs::symlink("elsewhere/x.bin", &link).unwrap();
        for content in ["first", "second"] {
            let mut file = AtomicFile::create(&link).unwrap();
            file.write_all(content.as_bytes()).unwrap();
            file.commit().unwrap();
            assert!(link.is_symlink() && !target.is_symlink());
            assert_eq!(std::fs::read_to_string(&target).unwrap(), content);
        }
    }

    #[test]
    #[cfg(unix)]
    fn leftovers_of_one_target_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let count = || std::fs::read_dir(folder.path()).unwrap().count();
        let targets = ["x.oct".into(), "x".repeat(250), "x".repeat(251)].map(|name| folder.path().join(name));
        let held = targets.each_ref().map(|target| AtomicFile::create(target).unwrap());
        for target in &targets {
            let leave = |b: &Builder, folder: &Path| {
                b.tempfile_in(folder)?.keep()?;
                Ok(b.tempdir_in(folder)?.keep())
            };
            beside(target, 0o777, leave, |_| ()).unwrap();
        }
        assert_eq!(count(), 9);
        for (i, target) in targets.iter().enumerate() {
            drop(AtomicFile::create(target).unwrap());
            assert_eq!(count(), 7 - 2 * i);
        }
        held.into_iter().for_each(|file| file.commit().unwrap());
        assert!(count() == 3 && targets.iter().all(|target| target.exists()));
    }

    #[test]
    fn a_missing_folder_is_named() {
        let error = AtomicFile::create(Path::new("no/such/folder/x.bin")).unwrap_err();
        assert!(error.to_string().starts_with("no/such/folder/x.bin: "), "{error}");
    }

    /// A process that removes leftovers may find a part between its creation and its lock.
    #[test]
    fn writers_of_one_file_take_nothing_from_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("x.bin");
        std::thread::scope(|scope| {
            for writer in 0..4_u8 {
                let target = &target;
                scope.spawn(move || (0..300).for_each(|_| AtomicFile::write(target, &[writer; 100]).unwrap()));
            }
        });
        let content = std::fs::read(&target).unwrap();
        assert!(content.len() == 100 && content.iter().all(|byte| *byte == content[0]));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a part is left");
    }
}
