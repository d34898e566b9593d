//! The header of a PLY file, and where its elements lie.

use std::collections::BTreeSet;
use std::path::Path;

use super::super::columns::Scalar;
use octobayes::{Error, Result};

/// Longest header, bytes. One of the original code has 1,500.
const LONGEST: usize = 128 << 10;
/// Elements of splats, compressed or not.
pub(super) const OF_SPLATS: [&str; 3] = ["vertex", "chunk", "sh"];
/// Elements that make points a mesh.
const MESHES: [&str; 2] = ["face", "tristrips"];
/// What every header ends with.
const END: &[u8] = b"end_header";

/// Rows of numbers.
#[derive(Debug)]
pub(super) struct Element<'a> {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
    /// Size of a row, bytes; of an element with lists, the least.
    pub stride: usize,
    /// All rows, `count` times `stride` bytes, or more with lists.
    pub rows: &'a [u8],
}

/// A number, or a list of numbers, of every row.
#[derive(Debug)]
pub(super) struct Property {
    pub name: String,
    pub kind: Scalar,
    /// Bytes before it in a row without lists.
    pub offset: usize,
    /// The type of the list's length, if it is one.
    pub length: Option<Scalar>,
}

impl Element<'_> {
    /// Whether rows differ in size.
    pub fn has_lists(&self) -> bool {
        self.properties.iter().any(|property| property.length.is_some())
    }

    /// The number of bytes of all rows, which `bytes` begins with; `None` if it has fewer.
    fn size(&self, bytes: &[u8]) -> Option<usize> {
        if !self.has_lists() {
            return self.count.checked_mul(self.stride).filter(|size| *size <= bytes.len());
        }
        let mut at = 0_usize;
        // A row with a list has at least the byte of its length, so that rows are no more than bytes.
        for property in (0..self.count).flat_map(|_| &self.properties) {
            let numbers = match property.length {
                None => 1.0,
                Some(kind) => {
                    let length = kind.decode(bytes.get(at..)?.get(..kind.size())?);
                    at += kind.size();
                    length
                }
            };
            if !(numbers >= 0.0 && numbers <= bytes.len() as f64) {
                return None;
            }
            at = at.checked_add(numbers as usize * property.kind.size()).filter(|at| *at <= bytes.len())?;
        }
        Some(at)
    }

    fn describe(&self) -> String {
        let Self { name, count, stride, .. } = self;
        let more = if self.has_lists() { " or more" } else { "" };
        format!("{count} rows of {stride}{more} bytes of element `{name}`")
    }

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
/// If the header is none, if the file is not binary and little-endian, if it has faces or lists of splats, if a name
/// appears twice, or if the file's length is not that of its elements.
pub(super) fn parse<'a>(path: &Path, bytes: &'a [u8]) -> Result<Ply<'a>> {
    let (header, mut body) = split(path, bytes)?;
    let mut ply = Ply { elements: Vec::new(), comments: Vec::new() };
    let (mut has_format, mut other_format) = (false, None);
    for (i, line) in header.lines().enumerate().skip(1) {
        let line = line.trim_end_matches('\r');
        let wrong =
            |expected: &str| Error::malformed(path, format!("header, line {}", i + 1), expected, format!("`{line}`"));
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", "binary_little_endian", "1.0"] => has_format = true,
            ["format", ..] => other_format = Some(wrong("`format binary_little_endian 1.0` (save the file as binary)")),
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
                element.properties.push(Property { name, kind, offset, length: None });
                element.stride += kind.size();
            }
            ["property", "list", length, kind, name] => {
                let types = Scalar::named(length).zip(Scalar::named(kind));
                let (length, kind) = types.ok_or_else(|| wrong("`property list TYPE TYPE NAME` of types of PLY"))?;
                let element = ply.elements.last_mut().ok_or_else(|| wrong("an element before its properties"))?;
                if OF_SPLATS.contains(&&*element.name) {
                    return Err(wrong("properties of one number in elements of splats"));
                }
                let (name, offset) = (name.to_string(), element.stride);
                element.properties.push(Property { name, kind, offset, length: Some(length) });
                element.stride += length.size();
            }
            _ => return Err(wrong("a line of a PLY header")),
        }
    }
    // A mesh is none of splats in any format.
    if let Some(faces) = ply.elements.iter().find(|e| MESHES.contains(&&*e.name) && e.count > 0) {
        let found = format!("{} of element `{}`", faces.count, faces.name);
        return Err(Error::malformed(path, "header", "no faces (a mesh is no file of splats)", found));
    }
    other_format.map_or(Ok(()), Err)?;
    if !has_format {
        return Err(Error::malformed(path, "header", "`format binary_little_endian 1.0`", "no format"));
    }
    once(path, "header, elements", ply.elements.iter().map(|element| &element.name))?;
    let bytes = body.len();
    let mut is_whole = true;
    for element in &mut ply.elements {
        let place = format!("header, element `{}`", element.name);
        once(path, &place, element.properties.iter().map(|property| &property.name))?;
        let size = element.size(body);
        is_whole &= size.is_some();
        (element.rows, body) = body.split_at(size.unwrap_or(0));
    }
    if !is_whole || !body.is_empty() {
        let rows: Vec<String> = ply.elements.iter().map(Element::describe).collect();
        let expected = format!("{} after the header", rows.join(" and "));
        return Err(Error::malformed(path, "length", expected, format!("{bytes} bytes (truncated or altered)")));
    }
    Ok(ply)
}

/// Refuses names that appear twice.
fn once<'a>(path: &Path, place: &str, mut names: impl Iterator<Item = &'a String>) -> Result<()> {
    let mut seen = BTreeSet::new();
    match names.find(|name| !seen.insert(*name)) {
        None => Ok(()),
        Some(twice) => Err(Error::malformed(path, place, "names once each", format!("`{twice}` twice"))),
    }
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
    fn lists_are_passed_over() {
        let text = "ply\nformat binary_little_endian 1.0\nelement edge 2\nproperty uchar a\nproperty list uchar short \
                    b\nproperty list int double c\nelement none 1000000000000\nelement vertex 1\nproperty uchar x\n\
                    element faces 1\nproperty list char uchar i\nend_header\n";
        let first = [&[7, 2, 1, 0, 2, 0][..], &1_i32.to_le_bytes(), &0.5_f64.to_le_bytes()].concat();
        let second = [&[8, 0][..], &0_i32.to_le_bytes()].concat();
        let bytes = [text.as_bytes(), &first, &second, &[9], &[3, 1, 2, 3]].concat();
        let ply = parse(Path::new("s.ply"), &bytes).unwrap();
        assert_eq!(ply.elements[2].rows, [9]);
        for end in text.len()..bytes.len() {
            assert!(parse(Path::new("s.ply"), &bytes[..end]).is_err(), "{end}");
        }
        // A negative length, one beyond the file, and bytes behind the last element.
        for (at, byte) in [(bytes.len() - 4, 0xff), (text.len() + 9, 0x7f), (bytes.len() - 4, 2)] {
            let mut altered = bytes.clone();
            altered[at] = byte;
            let error = parse(Path::new("s.ply"), &altered).unwrap_err().to_string();
            assert!(error.contains("length: expected 2 rows of 6 or more bytes of element `edge`"), "{error}");
        }
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
            ("ply\nformat ascii 1.0\nelement face 1\nend_header\n".into(), "no faces (a mesh is no file of splats)"),
            (format!("{start}element vertex -1\nend_header\n"), "line 3: expected `element NAME COUNT`"),
            (format!("{start}property float x\nend_header\n"), "line 3: expected an element before its properties"),
            (format!("{start}element v 1\nproperty half x\nend_header\n"), "line 4: expected `property TYPE NAME`"),
            (format!("{start}element face 1\nproperty list uchar int i\nend_header\n"), "found 1 of element `face`"),
            (format!("{start}element sh 1\nproperty list uchar int i\nend_header\n"), "properties of one number"),
            (format!("{start}element f 1\nproperty list half int i\nend_header\n"), "`property list TYPE TYPE NAME`"),
            (format!("{start}element v 0\nelement v 0\nend_header\n"), "header, elements: expected names once each"),
            (format!("{start}element f 9\nproperty list int int i\nend_header\n1234"), "9 rows of 4 or more bytes"),
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
