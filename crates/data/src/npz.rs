//! NumPy `.npz` archives: a zip file with `.npy` members.

use std::fs::File;
use std::io::{self, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use zip::read::ZipFile;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::npy;
use crate::npy::{Array, ArrayStream};
use crate::{Element, Stored};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// An archive opened for reading. To stream several members at the same time, open it once for each.
pub struct NpzReader {
    archive: ZipArchive<BufReader<File>>,
    path: PathBuf,
}

impl NpzReader {
    /// Opens an archive.
    pub fn open(path: &Path) -> Result<Self> {
        let file = octobayes::io::open(path)?;
        let archive = ZipArchive::new(BufReader::new(file))
            .map_err(|e| Error::malformed(path, "archive", "an `.npz` (zip) file", e.to_string()))?;
        if archive.has_duplicate_names() {
            return Err(Error::malformed(path, "archive", "names once each", "an array twice"));
        }
        Ok(Self { archive, path: path.to_path_buf() })
    }

    /// True if the archive has the member `NAME.npy`.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.archive.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// Starts reading the member `NAME.npy`.
    pub fn stream<T: Element>(&mut self, name: &str) -> Result<ArrayStream<T, ZipFile<'_, BufReader<File>>>> {
        let Self { archive, path } = self;
        let names: Vec<String> =
            archive.file_names().flatten().map(|n| n.trim_end_matches(".npy").to_string()).collect();
        let keys = names.join(", ");
        let member = archive.by_name(&format!("{name}.npy")).map_err(|e| match e {
            zip::result::ZipError::FileNotFound => {
                Error::malformed(path, "archive", format!("an array `{name}`"), format!("arrays: {keys}"))
            }
            e => Error::malformed(path, format!("array `{name}`"), "a readable zip member", e.to_string()),
        })?;
        let available = member.size();
        ArrayStream::new(member, available, path, name)
    }

    /// Reads the whole member `NAME.npy`, real numbers of any type.
    pub fn reals(&mut self, name: &str) -> Result<Array<f32>> {
        self.stream(name)?.into_reals()
    }
}

/// The file of an archive. Once a write has failed it takes all others without keeping them: a [`ZipWriter`] that is
/// dropped completes its archive, and prints to stderr if it cannot.
struct Target {
    file: AtomicFile,
    /// The first failure, and how far writing would have come.
    failed: Option<(io::ErrorKind, u64)>,
}

impl Target {
    /// Notes a failure.
    fn noted<T>(&mut self, written: io::Result<T>) -> io::Result<T> {
        written.inspect_err(|error| match error.kind() {
            // The caller's writer tries again.
            io::ErrorKind::Interrupted => {}
            kind => self.failed = Some((kind, 0)),
        })
    }
}

impl Write for Target {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some((_, position)) = &mut self.failed {
            *position += bytes.len() as u64;
            return Ok(bytes.len());
        }
        let written = self.file.write(bytes);
        self.noted(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.failed.is_some() {
            return Ok(());
        }
        let written = self.file.flush();
        self.noted(written)
    }
}

impl Seek for Target {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        if let Some((_, position)) = &mut self.failed {
            if let SeekFrom::Start(start) = to {
                *position = start;
            }
            return Ok(*position);
        }
        let found = self.file.seek(to);
        self.noted(found)
    }
}

/// An archive being written. It appears under its name with [`NpzWriter::finish`].
pub struct NpzWriter {
    zip: ZipWriter<Target>,
    path: PathBuf,
}

impl NpzWriter {
    /// Starts an archive.
    pub fn create(path: &Path) -> Result<Self> {
        let target = Target { file: AtomicFile::create(path)?, failed: None };
        Ok(Self { zip: ZipWriter::new(target), path: path.to_path_buf() })
    }

    /// Starts the member `NAME.npy`, stored uncompressed as `numpy.savez` does, and returns the stream for its bytes.
    pub fn member(&mut self, name: &str) -> Result<&mut impl Write> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        self.zip
            .start_file(format!("{name}.npy"), options)
            .map_err(|e| Error::io(&self.path, "cannot write")(e.into()))?;
        Ok(&mut self.zip)
    }

    /// Writes an array of `shape` as member `NAME.npy`.
    pub fn array<T: Stored>(&mut self, name: &str, shape: &[u64], data: impl IntoIterator<Item = T>) -> Result<()> {
        let path = self.path.clone();
        npy::write_to(self.member(name)?, &path, shape, data)
    }

    /// Completes the archive and gives the file its name.
    pub fn finish(self) -> Result<()> {
        let Self { zip, path } = self;
        let Target { file, failed } = zip.finish().map_err(|e| Error::io(&path, "cannot write")(e.into()))?;
        match failed {
            Some((kind, _)) => Err(Error::io(&path, "cannot write")(kind.into())),
            None => file.commit(),
        }
    }
}
