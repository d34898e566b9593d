//! NumPy `.npy` arrays, read as streams. The format is that of NEP 1.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use crate::{Dtype, Element, Real, Stored};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

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
    dtype: Dtype,
    /// Elements not read yet.
    left: u64,
    shape: Vec<u64>,
    path: PathBuf,
    name: String,
    element: PhantomData<T>,
}

impl<T: Element, R: Read> ArrayStream<T, R> {
    /// Starts reading the array `name` of the file `path`. At most `available` bytes are there, header included: a
    /// header that claims more elements is refused.
    pub fn new(mut reader: R, available: u64, path: &Path, name: &str) -> Result<Self> {
        let wrong =
            |expected: String, found: String| Error::malformed(path, format!("array `{name}`"), expected, found);
        let header = read_header(&mut reader).map_err(|found| wrong("a NumPy array header".into(), found))?;
        let Header { dtype: found, is_fortran, shape } = Header::parse(&header)
            .ok_or_else(|| wrong("a NumPy array header".into(), header.chars().take(80).collect()))?;
        if is_fortran && shape.len() > 1 {
            return Err(wrong("C order (numpy.ascontiguousarray)".into(), "Fortran order".into()));
        }
        let dtype = Dtype::parse(found.trim_matches('\'')).filter(|dtype| T::FLOATS || !dtype.is_float());
        let dtype = dtype.ok_or_else(|| wrong(format!("dtype {}", T::ACCEPTED), format!("dtype {found}")))?;
        let left = shape.iter().product::<u64>();
        if left.checked_mul(dtype.size as u64).is_none_or(|claimed| claimed > available) {
            let expected = format!("at most the {available} bytes that are stored");
            return Err(wrong(expected, format!("shape {shape:?} of {found}")));
        }
        let (path, name) = (path.to_path_buf(), name.to_string());
        Ok(Self { reader, dtype, left, shape, path, name, element: PhantomData })
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
        let reason = |e: io::Error| match e.kind() {
            io::ErrorKind::UnexpectedEof => "the end of the file".into(),
            _ => e.to_string(),
        };
        if self.left > 0 {
            self.left -= 1;
            let number = self.dtype.read(&mut self.reader).map_err(|e| wrong(reason(e)))?;
            return T::of(number).map(Some).ok_or_else(|| wrong("a number below 0".into()));
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

/// Reads the header's text. An error is what was found.
fn read_header(reader: &mut impl Read) -> std::result::Result<String, String> {
    let ended = |_| "the end of the data".to_string();
    let mut start = [0; 8];
    reader.read_exact(&mut start).map_err(ended)?;
    if !start.starts_with(b"\x93NUMPY") {
        return Err(format!("{:?}", start[..6].escape_ascii().to_string()));
    }
    // Version 1.0 has two bytes for the length, later ones have four.
    let mut length = [0; 4];
    reader.read_exact(&mut length[..if start[6] == 1 { 2 } else { 4 }]).map_err(ended)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER {
        return Err(format!("a header of {length} bytes"));
    }
    let mut text = vec![0; length];
    reader.read_exact(&mut text).map_err(ended)?;
    Ok(String::from_utf8_lossy(&text).replace('"', "'"))
}

/// What a header's text states: a dictionary of Python with three keys.
struct Header<'a> {
    /// Name of the type, in quotes, or what else stands there.
    dtype: &'a str,
    is_fortran: bool,
    shape: Vec<u64>,
}

impl<'a> Header<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let value = |key: &str| Some(text.split_once(key)?.1.trim_start().strip_prefix(':')?.trim_start());
        let until_comma = |value: &'a str| value.split([',', '}']).next().map(str::trim_end);
        let shape = value("'shape'")?.strip_prefix('(')?.split_once(')')?.0;
        // Their product stays below 2^64.
        if shape.bytes().filter(u8::is_ascii_digit).count() > 18 {
            return None;
        }
        let extents = shape.split(',').map(str::trim).filter(|extent| !extent.is_empty());
        Some(Self {
            dtype: until_comma(value("'descr'")?)?,
            is_fortran: until_comma(value("'fortran_order'")?)? == "True",
            shape: extents.map(|extent| extent.parse().ok()).collect::<Option<_>>()?,
        })
    }
}

/// Starts reading a `.npy` file.
pub fn stream<T: Element>(path: &Path) -> Result<ArrayStream<T, BufReader<File>>> {
    let file = octobayes::io::open(path)?;
    let available = file.metadata().map_err(Error::io(path, "cannot read"))?.len();
    ArrayStream::new(BufReader::new(file), available, path, "data")
}

/// Writes the header of an array.
pub fn write_header<T: Stored>(out: &mut impl Write, shape: &[u64]) -> io::Result<()> {
    let extents: String = shape.iter().map(|extent| format!("{extent}, ")).collect();
    let text = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({extents}), }}", T::DTYPE);
    // With the ten bytes before the text and the end of its line, a multiple of 64.
    let length = (text.len() + 11).next_multiple_of(64) - 10;
    out.write_all(b"\x93NUMPY\x01\0")?;
    out.write_all(&(length as u16).to_le_bytes())?;
    writeln!(out, "{text:width$}", width = length - 1)
}

/// Writes `data` as an array of `shape` to any stream.
pub fn write_to<T: Stored>(
    out: impl Write,
    path: &Path,
    shape: &[u64],
    data: impl IntoIterator<Item = T>,
) -> Result<()> {
    let mut out = BufWriter::new(out);
    let write = || {
        write_header::<T>(&mut out, shape)?;
        let (mut count, mut bytes) = (0_u64, Vec::new());
        for value in data {
            bytes.clear();
            value.put(&mut bytes);
            out.write_all(&bytes)?;
            count += 1;
        }
        out.flush()?;
        if count == shape.iter().product::<u64>() {
            Ok(())
        } else {
            Err(io::Error::other(format!("{count} for {shape:?}")))
        }
    };
    write().map_err(Error::io(path, "cannot write"))
}

/// Writes a `.npy` file.
pub fn write<T: Stored>(path: &Path, shape: &[u64], data: impl IntoIterator<Item = T>) -> Result<()> {
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
        ArrayStream::new(bytes, bytes.len() as u64, Path::new("x.npy"), "data")?.into_reals()
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
    fn headers_are_read_as_numpy_and_others_write_them() {
        let parsed = |text: &str| Header::parse(text).map(|h| (h.dtype.to_string(), h.is_fortran, h.shape));
        let of = |dtype: &str, shape: &[u64]| Some((dtype.to_string(), false, shape.to_vec()));
        assert_eq!(parsed("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }"), of("'<f4'", &[2, 3]));
        assert_eq!(parsed("{'shape':(5,),'fortran_order':False , 'descr' : '|u1'}\n"), of("'|u1'", &[5]));
        assert_eq!(parsed("{'descr': '<f4', 'fortran_order': False, 'shape': (), }"), of("'<f4'", &[]));
        assert!(parsed("{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3)}").unwrap().1);
        let records = "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,), }";
        assert_eq!(Dtype::parse(Header::parse(records).unwrap().dtype).map(|dtype| dtype.size), None);
        for shape in ["(-1,)", "(1.5,)", "(x,)", "[2]", "(2", "(1000000000, 1000000000)"] {
            assert_eq!(parsed(&format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}")), None);
        }
        assert_eq!(parsed("{'fortran_order': False, 'shape': (2,), }"), None);
    }
}
