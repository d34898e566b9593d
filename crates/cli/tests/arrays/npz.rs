//! Archives of arrays.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::arrays::{Element, npy};

/// A `.npz` file while it is written.
pub struct NpzWriter(ZipWriter<File>);

impl NpzWriter {
    pub fn create(path: &Path) -> Self {
        Self(ZipWriter::new(File::create(path).unwrap()))
    }

    pub fn array<T: Element>(&mut self, name: &str, shape: &[u64], data: impl IntoIterator<Item = T>) {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        self.0.start_file(format!("{name}.npy"), options).unwrap();
        self.0.write_all(&npy(shape, data)).unwrap();
    }

    pub fn finish(self) {
        self.0.finish().unwrap();
    }
}
