//! NumPy `.npy` arrays, read as streams.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use npyz::{AutoSerialize, NpyHeader, Order, Serialize, TypeRead, WriteOptions, WriterBuilder};

use super::{AtomicFile, Element, Real};
use crate::{Error, Result};

/// Longest accepted header, bytes. NumPy's own headers stay below 128 bytes for plain arrays.
const MAX_HEADER: usize = 4096;

/// An array in memory, C order.
#[derive(Debug, Clone, PartialEq)]
pub struct Array<T> {
    /// Extent along each axis.
    pub shape: Vec<usize>,
    /// Elements, last axis fastest.
    pub data: Vec<T>,
}

/// An array read element by element.
pub struct ArrayStream<T: Element, R: Read> {
    reader: R,
    element: T::TypeReader,
    /// Elements not read yet.
    left: u64,
    shape: Vec<u64>,
    path: PathBuf,
    name: String,
}

impl<T: Element, R: Read> ArrayStream<T, R> {
    /// Starts reading the array `name` of the file `path`. At most `available` bytes are there, header included: a
    /// header that claims more elements is refused.
    pub fn new(mut reader: R, available: u64, path: &Path, name: &str) -> Result<Self> {
        let place = || format!("array `{name}`");
        let header = read_header(&mut reader, path, name)?;
        let header = NpyHeader::from_reader(header.as_slice())
            .map_err(|e| Error::malformed(path, place(), "a NumPy array", e.to_string()))?;
        if header.order() != Order::C && header.shape().len() > 1 {
            return Err(Error::malformed(path, place(), "C order (numpy.ascontiguousarray)", "Fortran order"));
        }
        let shape = header.shape().to_vec();
        let found = header.dtype().descr();
        let bytes = header.dtype().num_bytes().unwrap_or(0) as u64;
        let claimed = header.len().checked_mul(bytes);
        if claimed.is_none_or(|c| c > available) {
            let expected = format!("at most the {available} bytes that are stored");
            return Err(Error::malformed(path, place(), expected, format!("shape {shape:?} of {found}")));
        }
        let element = T::reader(&header.dtype())
            .map_err(|_| Error::malformed(path, place(), format!("dtype {}", T::ACCEPTED), format!("dtype {found}")))?;
        Ok(Self { reader, element, left: header.len(), shape, path: path.to_path_buf(), name: name.to_string() })
    }

    /// Extent along each axis.
    pub fn shape(&self) -> &[u64] {
        &self.shape
    }

    /// The file's path and the array's name, for messages.
    pub fn origin(&self) -> (&Path, &str) {
        (&self.path, &self.name)
    }

    /// Checks the extents; `None` accepts any.
    pub fn expect_shape(&self, expected: &[Option<u64>]) -> Result<()> {
        check_shape(&self.path, &self.name, &self.shape, expected)
    }

    /// The next element, or `None` after the last. There it checks that nothing follows, and an archive's
    /// checksum.
    pub fn next_element(&mut self) -> Result<Option<T>> {
        let wrong = |found: String| {
            let expected = format!("data of shape {:?}", self.shape);
            Error::malformed(&self.path, format!("array `{}`", self.name), expected, found)
        };
        let reason = |e: std::io::Error| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => "the end of the file".into(),
            _ => e.to_string(),
        };
        if self.left > 0 {
            self.left -= 1;
            return self.element.read_one(&mut self.reader).map(Some).map_err(|e| wrong(reason(e)));
        }
        // An archive's reader checks the checksum only when it reaches the end.
        match self.reader.read(&mut [0]) {
            Ok(0) => Ok(None),
            Ok(_) => Err(wrong("more data behind it".into())),
            Err(e) => Err(wrong(reason(e))),
        }
    }

    /// The remaining elements.
    pub fn into_array(mut self) -> Result<Array<T>> {
        let mut data = Vec::new();
        while let Some(value) = self.next_element()? {
            data.push(value);
        }
        Ok(Array { shape: self.shape.iter().map(|&n| n as usize).collect(), data })
    }
}

impl<R: Read> ArrayStream<Real, R> {
    /// The remaining elements as f32.
    pub fn into_reals(self) -> Result<Array<f32>> {
        let Array { shape, data } = self.into_array()?;
        Ok(Array { shape, data: data.into_iter().map(|Real(value)| value).collect() })
    }
}

fn check_shape(path: &Path, name: &str, shape: &[u64], expected: &[Option<u64>]) -> Result<()> {
    let fits = shape.len() == expected.len() && shape.iter().zip(expected).all(|(n, e)| e.is_none_or(|e| e == *n));
    if fits {
        return Ok(());
    }
    let expected: Vec<String> = expected.iter().map(|e| e.map_or("any".into(), |n| n.to_string())).collect();
    let expected = format!("shape [{}]", expected.join(", "));
    Err(Error::malformed(path, format!("array `{name}`"), expected, format!("shape {shape:?}")))
}

/// Reads the header's bytes, and refuses those on which the parser could overflow or recurse deeply.
fn read_header(reader: &mut impl Read, path: &Path, name: &str) -> Result<Vec<u8>> {
    let bad = |found: &str| Error::malformed(path, format!("array `{name}`"), "a NumPy array header", found);
    let mut header = vec![0; 10];
    reader.read_exact(&mut header).map_err(|_| bad("the end of the data"))?;
    if !header.starts_with(b"\x93NUMPY") {
        return Err(bad(&format!("{:?}", header[..6].escape_ascii().to_string())));
    }
    let length = if header[6] == 1 {
        usize::from(u16::from_le_bytes([header[8], header[9]]))
    } else {
        header.resize(12, 0);
        reader.read_exact(&mut header[10..]).map_err(|_| bad("the end of the data"))?;
        u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize
    };
    if length > MAX_HEADER {
        return Err(bad(&format!("a header of {length} bytes")));
    }
    let start = header.len();
    header.resize(start + length, 0);
    reader.read_exact(&mut header[start..]).map_err(|_| bad("the end of the data"))?;
    let text = &header[start..];
    let brackets = text.iter().filter(|b| b"([{".contains(b)).count();
    let shape_at = text.iter().position(|&b| b == b'(').unwrap_or(0);
    let digits = text[shape_at..].iter().filter(|b| b.is_ascii_digit()).count();
    // A dictionary with one tuple has two brackets. With at most 18 digits, a shape's product stays below 2^64.
    if brackets > 2 || digits > 18 {
        return Err(bad("a nested or oversized header"));
    }
    Ok(header)
}

/// Starts reading a `.npy` file.
pub fn stream<T: Element>(path: &Path) -> Result<ArrayStream<T, BufReader<File>>> {
    let file = super::open(path)?;
    let available = file.metadata().map_err(Error::io(path, "cannot read"))?.len();
    ArrayStream::new(BufReader::new(file), available, path, "data")
}

/// Writes `data` as an array of `shape` to any stream.
pub fn write_to<T: AutoSerialize + Serialize>(
    out: impl Write,
    path: &Path,
    shape: &[u64],
    data: impl IntoIterator<Item = T>,
) -> Result<()> {
    let failed = || Error::io(path, "cannot write");
    let mut writer =
        WriteOptions::new().default_dtype().shape(shape).writer(BufWriter::new(out)).begin_nd().map_err(failed())?;
    writer.extend(data).map_err(failed())?;
    writer.finish().map_err(failed())
}

/// Writes a `.npy` file.
pub fn write<T: AutoSerialize + Serialize>(
    path: &Path,
    shape: &[u64],
    data: impl IntoIterator<Item = T>,
) -> Result<()> {
    let mut file = AtomicFile::create(path)?;
    write_to(&mut file, path, shape, data)?;
    file.commit()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Vec<u8> {
        let mut bytes = Vec::new();
        write_to(&mut bytes, Path::new("memory"), &[2, 3], (0..6).map(|i| i as f32)).unwrap();
        bytes
    }

    fn parse(bytes: &[u8]) -> Result<Array<f32>> {
        ArrayStream::new(bytes, bytes.len() as u64, Path::new("x.npy"), "data")?.into_array()
    }

    #[test]
    fn arrays_survive() {
        assert_eq!(parse(&sample()).unwrap(), Array { shape: vec![2, 3], data: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0] });
    }

    #[test]
    fn a_tiny_file_that_claims_a_trillion_points_is_refused() {
        let mut bytes = sample();
        let data = bytes.split_off(bytes.len() - 24);
        let text = String::from_utf8_lossy(&bytes[10..]).replace("2, 3", "1000000, 1000000");
        bytes.truncate(8);
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(data);
        let error = parse(&bytes).unwrap_err().to_string();
        assert!(error.contains("[1000000, 1000000]"), "{error}");
    }

    #[test]
    fn data_behind_the_last_element_is_refused() {
        let mut bytes = sample();
        bytes.push(0);
        let error = parse(&bytes).unwrap_err().to_string();
        assert!(error.contains("[2, 3]") && error.contains("more data"), "{error}");
    }

    #[test]
    fn another_dtype_is_named() {
        let mut bytes = Vec::new();
        write_to(&mut bytes, Path::new("memory"), &[1], [1_i64]).unwrap();
        let error = parse(&bytes).unwrap_err().to_string();
        assert!(error.contains("f32") && error.contains("i8"), "{error}");
    }
}
