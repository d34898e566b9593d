//! Files that appear complete or not at all.

use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::part;
use super::place::{check_replaceable, destination, folder_of};
use crate::{Error, Result};

/// A buffered file under a temporary name beside its target. [`AtomicFile::commit`] renames it over the target
/// once its content has reached the disk. A file that is dropped before that is removed. Files of processes that
/// were killed stay until [`part::clear_leftovers`] is called for the same target.
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
        let destination = destination(target)?;
        let folder = folder_of(&destination);
        let prefix = part::prefix(&destination);
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(part::SUFFIX);
        #[cfg(unix)]
        {
            // A new file gets the usual permissions (the umask applies), not the private ones of a temporary file.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let file = part::locked(|| builder.tempfile_in(folder), NamedTempFile::as_file)
            .map_err(Error::io(target, "cannot create a file in this folder"))?;
        Ok(Self { writer: BufWriter::with_capacity(1 << 16, file), target: destination })
    }

    /// Writes a whole file.
    #[cfg(feature = "files")]
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
    #[cfg(feature = "files")]
    pub fn into_reader(self) -> io::Result<(std::fs::File, tempfile::TempPath)> {
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
    fn a_missing_folder_is_named() {
        let error = AtomicFile::create(Path::new("no/such/folder/x.bin")).unwrap_err();
        assert!(error.to_string().starts_with("no/such/folder/x.bin: "), "{error}");
    }
}
