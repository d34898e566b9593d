//! NumPy `.npz` archives: a zip file with `.npy` members.

use std::fs::File;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};

use npyz::{AutoSerialize, Serialize};
use zip::read::ZipFile;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::npy::{self, Array, ArrayStream};
use super::{AtomicFile, Element};
use crate::{Error, Result};

/// An archive opened for reading. To stream several members at the same time, open it once for each.
pub struct NpzReader {
    archive: ZipArchive<BufReader<File>>,
    path: PathBuf,
}

impl NpzReader {
    /// Opens an archive.
    ///
    /// # Errors
    /// If the file is missing or is no zip archive.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "cannot open"))?;
        let archive = ZipArchive::new(BufReader::new(file))
            .map_err(|e| Error::malformed(path, "archive", "an `.npz` (zip) file", e.to_string()))?;
        Ok(Self { archive, path: path.to_path_buf() })
    }

    /// True if the archive has the member `NAME.npy`.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.archive.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// Starts reading the member `NAME.npy`.
    ///
    /// # Errors
    /// If there is no such member or it is not a C-order array of `T`.
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

    /// Reads the whole member `NAME.npy`.
    ///
    /// # Errors
    /// As [`NpzReader::stream`], and if the member ends early.
    pub fn array<T: Element>(&mut self, name: &str) -> Result<Array<T>> {
        self.stream(name)?.into_array()
    }

    /// Reads the whole member `NAME.npy`, real numbers of any type.
    ///
    /// # Errors
    /// As [`NpzReader::stream`], and if the member ends early.
    pub fn reals(&mut self, name: &str) -> Result<Array<f32>> {
        self.stream(name)?.into_reals()
    }
}

/// An archive being written. It appears under its name with [`NpzWriter::finish`].
pub struct NpzWriter {
    zip: ZipWriter<AtomicFile>,
    path: PathBuf,
}

impl NpzWriter {
    /// Starts an archive.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        Ok(Self { zip: ZipWriter::new(AtomicFile::create(path)?), path: path.to_path_buf() })
    }

    /// Starts the member `NAME.npy`, stored uncompressed as `numpy.savez` does, and returns the stream for its bytes.
    ///
    /// # Errors
    /// If writing fails.
    pub fn member(&mut self, name: &str) -> Result<&mut impl Write> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        self.zip
            .start_file(format!("{name}.npy"), options)
            .map_err(|e| Error::io(&self.path, "cannot write")(e.into()))?;
        Ok(&mut self.zip)
    }

    /// Writes an array of `shape` as member `NAME.npy`.
    ///
    /// # Errors
    /// If writing fails or the number of elements is not the product of the shape.
    pub fn array<T: AutoSerialize + Serialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        data: impl IntoIterator<Item = T>,
    ) -> Result<()> {
        let path = self.path.clone();
        npy::write_to(self.member(name)?, &path, shape, data)
    }

    /// Completes the archive and gives the file its name.
    ///
    /// # Errors
    /// If writing fails.
    pub fn finish(self) -> Result<()> {
        let Self { zip, path } = self;
        zip.finish().map_err(|e| Error::io(&path, "cannot write")(e.into()))?.commit()
    }
}
