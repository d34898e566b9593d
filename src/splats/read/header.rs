//! The header of a PLY file, and where its elements lie.

use std::collections::BTreeSet;
use std::path::Path;

use super::super::columns::Scalar;
use crate::{Error, Result};

/// Longest header, bytes. One of the original code has 1,500.
const LONGEST: usize = 128 << 10;
/// What every header ends with.
const END: &[u8] = b"end_header";

/// Rows of numbers.
#[derive(Debug)]
pub(super) struct Element<'a> {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
    /// Size of a row, bytes.
    pub stride: usize,
    /// All rows, `count` times `stride` bytes.
    pub rows: &'a [u8],
}

/// A number of every row.
#[derive(Debug)]
pub(super) struct Property {
    pub name: String,
    pub kind: Scalar,
    /// Bytes before it in a row.
    pub offset: usize,
}

impl Element<'_> {
    /// The property of a name.
    pub fn property(&self, name: &str) -> Option<&Property> {
        self.properties.iter().find(|property| property.name == name)
    }
}

impl Property {
    /// The bytes of this number in a row.
    pub fn of<'a>(&self, row: &'a [u8]) -> &'a [u8] {
        &row[self.offset..self.offset + self.kind.size()]
    }

    /// This number in a row.
    pub fn number(&self, row: &[u8]) -> f64 {
        self.kind.decode(self.of(row))
    }
}

/// A whole file.
#[derive(Debug)]
pub(super) struct Ply<'a> {
    pub elements: Vec<Element<'a>>,
    pub comments: Vec<String>,
}

/// Takes apart the bytes of a PLY file.
///
/// # Errors
/// If the header is none, if the file is not binary and little-endian, if a row has a list, or if the file's length is
/// not that of its elements.
pub(super) fn parse<'a>(path: &Path, bytes: &'a [u8]) -> Result<Ply<'a>> {
    let (header, mut body) = split(path, bytes)?;
    let mut ply = Ply { elements: Vec::new(), comments: Vec::new() };
    let mut has_format = false;
    for (i, line) in header.lines().enumerate().skip(1) {
        let line = line.trim_end_matches('\r');
        let wrong =
            |expected: &str| Error::malformed(path, format!("header, line {}", i + 1), expected, format!("`{line}`"));
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", "binary_little_endian", "1.0"] => has_format = true,
            ["format", ..] => return Err(wrong("`format binary_little_endian 1.0` (save the file as binary)")),
            ["comment", ..] => ply.comments.push(line.strip_prefix("comment ").unwrap_or_default().to_string()),
            ["obj_info", ..] | [] => {}
            ["element", name, count] => {
                let count = count.parse().map_err(|_| wrong("`element NAME COUNT`"))?;
                let (name, properties) = (name.to_string(), Vec::new());
                ply.elements.push(Element { name, count, properties, stride: 0, rows: &[] });
            }
            ["property", kind, name] => {
                let kind = Scalar::named(kind).ok_or_else(|| wrong("`property TYPE NAME` of a type of PLY"))?;
                let element = ply.elements.last_mut().ok_or_else(|| wrong("an element before its properties"))?;
                let (name, offset) = (name.to_string(), element.stride);
                element.properties.push(Property { name, kind, offset });
                element.stride += kind.size();
            }
            ["property", "list", ..] => return Err(wrong("properties of one number (a mesh is no file of splats)")),
            _ => return Err(wrong("a line of a PLY header")),
        }
    }
    if !has_format {
        return Err(Error::malformed(path, "header", "`format binary_little_endian 1.0`", "no format"));
    }
    let wanted = ply.elements.iter().try_fold(0_usize, |sum, e| sum.checked_add(e.count.checked_mul(e.stride)?));
    if wanted != Some(body.len()) {
        let rows: Vec<String> = ply
            .elements
            .iter()
            .map(|e| format!("{} rows of {} bytes of element `{}`", e.count, e.stride, e.name))
            .collect();
        let expected = format!("{} after the header", rows.join(" and "));
        let found = format!("{} bytes (truncated or altered)", body.len());
        return Err(Error::malformed(path, "length", expected, found));
    }
    for element in &mut ply.elements {
        let mut names = BTreeSet::new();
        if let Some(twice) = element.properties.iter().find(|property| !names.insert(&property.name)) {
            let place = format!("header, element `{}`", element.name);
            return Err(Error::malformed(path, place, "names once each", format!("`{}` twice", twice.name)));
        }
        (element.rows, body) = body.split_at(element.count * element.stride);
    }
    Ok(ply)
}

/// The header up to the line `end_header`, and what follows that line.
fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a str, &'a [u8])> {
    let start = &bytes[..bytes.len().min(LONGEST)];
    let mut at = 0;
    while let Some(length) = start[at..].iter().position(|&b| b == b'\n') {
        let line = start[at..at + length].trim_ascii_end();
        if line == END {
            let text = std::str::from_utf8(&start[..at]).map_err(|e| {
                let found = format!("{:#04x}", start[e.valid_up_to()]);
                Error::malformed(path, format!("header, byte {}", e.valid_up_to()), "text in UTF-8", found)
            })?;
            return Ok((text, &bytes[at + length + 1..]));
        }
        at += length + 1;
    }
    let found = format!("none in the first {} bytes", start.len());
    Err(Error::malformed(path, "header", "a line `end_header`", found))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        parse(Path::new("s.ply"), text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn elements_lie_one_after_the_other() {
        let text = "ply\r\nformat binary_little_endian 1.0\r\ncomment  a b\r\nelement chunk 2\r\nproperty uchar a\r\n\
                    element vertex 1\r\nproperty  short  b \r\nproperty double c\r\nobj_info x\r\nend_header\r\n";
        let body = [1, 2, 3, 1, 0, 0, 0, 0, 0, 0, 0, 64];
        let bytes = [text.as_bytes(), &body].concat();
        let ply = parse(Path::new("s.ply"), &bytes).unwrap();
        assert_eq!(ply.comments, [" a b"]);
        let [chunk, vertex] = &ply.elements[..] else { panic!("{:?}", ply.elements) };
        assert_eq!((chunk.rows, vertex.stride), (&[1, 2][..], 10));
        let numbers = ["b", "c"].map(|name| vertex.property(name).unwrap().number(vertex.rows));
        assert_eq!(numbers, [259.0, 2.0]);
    }

    #[test]
    fn headers_are_refused_with_their_line() {
        let start = "ply\nformat binary_little_endian 1.0\n";
        for (text, expected) in [
            (
                "ply\nformat ascii 1.0\nend_header\n".into(),
                "header, line 2: expected `format binary_little_endian 1.0`",
            ),
            ("ply\nend_header\n".into(), "found no format"),
            (format!("{start}element vertex -1\nend_header\n"), "line 3: expected `element NAME COUNT`"),
            (format!("{start}property float x\nend_header\n"), "line 3: expected an element before its properties"),
            (format!("{start}element v 1\nproperty half x\nend_header\n"), "line 4: expected `property TYPE NAME`"),
            (format!("{start}element f 1\nproperty list uchar int i\nend_header\n"), "a mesh is no file of splats"),
            (format!("{start}elephant\nend_header\n"), "found `elephant`"),
            (format!("{start}element v 1\nproperty char x\nproperty int x\nend_header\n12345"), "found `x` twice"),
            (format!("{start}element v 2\nproperty int x\nend_header\n1234567"), "2 rows of 4 bytes of element `v`"),
            (format!("{start}element v 18446744073709551615\nproperty int x\nend_header\n"), "found 0 bytes"),
            (format!("{start}end_headers\n"), "expected a line `end_header`, found none in the first"),
        ] {
            let error = refused(&text);
            assert!(error.contains(expected), "{text}: {error}");
        }
        let error = parse(Path::new("s.ply"), b"ply\ncomment \xff\nend_header\n").unwrap_err().to_string();
        assert!(error.contains("header, byte 12: expected text in UTF-8, found 0xff"), "{error}");
    }
}
