//! Reports: words written by hand, and blocks that a program writes.
//!
//! A block lies between two lines of its own:
//!
//! ```text
//! <!-- begin generated: NAME -->
//! *octobayes 0.1.0, 2026-11-22, 2 threads on 2 cores, 0.4 min of time, 0.7 min of processors.* Settings.
//!
//! a table
//! <!-- end generated: NAME -->
//! ```
//!
//! A name occurs once in a report, and blocks do not contain each other.

use std::path::Path;

use octobayes::{Error, Result};

use super::work::write_whole;

const BEGIN: &str = "<!-- begin generated: ";
const END: &str = "<!-- end generated: ";
const CLOSE: &str = " -->";

/// What is wrong with a report's markers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Line of the report, from 1; `None` if something is missing.
    pub line: Option<usize>,
    pub expected: String,
    pub found: String,
}

impl Fault {
    fn at(line: usize, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { line: Some(line), expected: expected.into(), found: found.into() }
    }

    /// The fault as an error of the report `path`.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Error {
        let place = self.line.map_or("markers".into(), |line| format!("line {line}"));
        Error::malformed(path, place, self.expected, self.found)
    }
}

/// A block of a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block<'a> {
    pub name: &'a str,
    /// Everything between the markers.
    pub body: &'a str,
    /// Bytes of the report that hold the body.
    range: std::ops::Range<usize>,
}

/// The name in a marker line that starts with `start`.
fn marker<'a>(line: &'a str, start: &str) -> Option<&'a str> {
    line.trim().strip_prefix(start)?.strip_suffix(CLOSE)
}

/// All blocks of a report, in order.
///
/// # Errors
/// If a block is not closed, not opened, inside another, or if two have the same name.
pub fn blocks(text: &str) -> std::result::Result<Vec<Block<'_>>, Fault> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut open: Option<(&str, usize, usize)> = None;
    let mut at = 0;
    for (number, line) in (1..).zip(text.split_inclusive('\n')) {
        let next = at + line.len();
        if let Some(name) = marker(line, BEGIN) {
            if let Some((outer, ..)) = open {
                return Err(Fault::at(number, format!("the end of block `{outer}`"), format!("block `{name}`")));
            }
            if blocks.iter().any(|block| block.name == name) {
                return Err(Fault::at(number, "names that occur once", format!("a second block `{name}`")));
            }
            open = Some((name, next, number));
        } else if let Some(name) = marker(line, END) {
            match open.take() {
                Some((begun, start, _)) if begun == name => {
                    blocks.push(Block { name, body: &text[start..at], range: start..at });
                }
                Some((begun, ..)) => {
                    return Err(Fault::at(number, format!("the end of block `{begun}`"), format!("that of `{name}`")));
                }
                None => return Err(Fault::at(number, "no open block", format!("the end of `{name}`"))),
            }
        }
        at = next;
    }
    match open {
        Some((name, _, number)) => Err(Fault::at(number, format!("an end of block `{name}`"), "none")),
        None => Ok(blocks),
    }
}

/// The report with another body in the block `name`; everything else stays as it is.
///
/// # Errors
/// As [`blocks`], or if there is no such block, or if the body itself has markers.
pub fn replaced(text: &str, name: &str, body: &str) -> std::result::Result<String, Fault> {
    let blocks = blocks(text)?;
    let is_marker = |line: &str| marker(line, BEGIN).or(marker(line, END)).is_some();
    if let Some(line) = body.lines().find(|line| is_marker(line)) {
        return Err(Fault { line: None, expected: "a body without markers".into(), found: format!("`{line}`") });
    }
    let Some(block) = blocks.iter().find(|block| block.name == name) else {
        let expected = format!("`{BEGIN}{name}{CLOSE}` and `{END}{name}{CLOSE}`");
        return Err(Fault { line: None, expected, found: "no such lines".into() });
    };
    let body = format!("{}\n", body.trim_matches('\n'));
    Ok(format!("{}{body}{}", &text[..block.range.start], &text[block.range.end..]))
}

/// Whether a block of the report `path` has its first line alone.
///
/// # Errors
/// As [`blocks`], or if the file cannot be read.
pub fn is_one_line(path: &Path, name: &str) -> Result<bool> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "cannot read"))?;
    let blocks = blocks(&text).map_err(|fault| fault.in_file(path))?;
    Ok(blocks.iter().any(|block| block.name == name && block.body.lines().count() == 1))
}

/// Rewrites one block of the report `path`. The file is replaced as a whole, or not at all.
///
/// # Errors
/// As [`replaced`], or if the file cannot be read or written.
pub fn rewrite(path: &Path, name: &str, body: &str) -> Result<()> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "cannot read"))?;
    let new = replaced(&text, name, body).map_err(|fault| fault.in_file(path))?;
    write_whole(path, new.as_bytes())
}

/// When, with what and how long a block was made: the start of its first line.
#[derive(Debug, Clone, PartialEq)]
pub struct Stamp {
    /// Of the package.
    pub version: String,
    /// Days on which rows were measured, as `2026-11-22`: the first and the last.
    pub dates: [String; 2],
    pub threads: usize,
    pub cores: usize,
    /// Minutes of wall time, and of all threads together.
    pub minutes: [f64; 2],
}

impl std::fmt::Display for Stamp {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Self { version, dates: [first, last], threads, cores, minutes: [wall, cpu] } = self;
        let to = if first == last { String::new() } else { format!(" to {last}") };
        let machine = format!("{threads} threads on {cores} cores");
        write!(f, "*octobayes {version}, {first}{to}, {machine}, {wall:.1} min of time, {cpu:.1} min of processors.*")
    }
}

impl Stamp {
    /// Reads the stamp at the start of a block's body; `None` if there is none.
    pub fn read(body: &str) -> Option<Self> {
        let (stamp, _) = body.trim_start().strip_prefix("*octobayes ")?.split_once(".*")?;
        let parts: Vec<&str> = stamp.split(", ").collect();
        let [version, dates, machine, wall, cpu] = parts[..] else { return None };
        let (first, last) = dates.split_once(" to ").unwrap_or((dates, dates));
        let (threads, cores) = machine.strip_suffix(" cores")?.split_once(" threads on ")?;
        let minutes = |text: &str, of: &str| text.strip_suffix(of)?.parse().ok();
        Some(Self {
            version: version.into(),
            dates: [first, last].map(String::from),
            threads: threads.parse().ok()?,
            cores: cores.parse().ok()?,
            minutes: [minutes(wall, " min of time")?, minutes(cpu, " min of processors")?],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# Title\n\nwords\n<!-- begin generated: a -->\nold\n<!-- end generated: a -->\nmore\n\
                        <!-- begin generated: b -->\n<!-- end generated: b -->\n";

    fn names(text: &str) -> Vec<&str> {
        blocks(text).unwrap().into_iter().map(|block| block.name).collect()
    }

    #[test]
    fn blocks_are_found_with_their_bodies() {
        let found = blocks(TEXT).unwrap();
        assert_eq!(found.iter().map(|b| (b.name, b.body)).collect::<Vec<_>>(), [("a", "old\n"), ("b", "")]);
    }

    #[test]
    fn only_the_body_of_the_block_changes() {
        let new = replaced(TEXT, "a", "\n| x |\n|---|\n").unwrap();
        assert_eq!(new, TEXT.replace("old\n", "| x |\n|---|\n"));
        assert_eq!(names(&new), ["a", "b"]);
        let both = replaced(&new, "b", "second").unwrap();
        assert_eq!(blocks(&both).unwrap()[0].body, "| x |\n|---|\n", "the other block stays as it was");
    }

    #[test]
    fn replacing_twice_is_replacing_once() {
        let once = replaced(TEXT, "a", "one\n\ntwo").unwrap();
        assert_eq!(replaced(&once, "a", "one\n\ntwo").unwrap(), once);
        let body = blocks(&once).unwrap()[0].body;
        assert_eq!(replaced(&once, "a", body).unwrap(), once, "a body that was read is written back as it was");
    }

    #[test]
    fn a_missing_block_is_named() {
        let fault = replaced(TEXT, "c", "x").unwrap_err();
        assert_eq!(fault.line, None);
        assert!(fault.expected.contains("<!-- begin generated: c -->"), "{fault:?}");
    }

    #[test]
    fn faulty_markers_are_told_by_their_line() {
        let cases = [
            ("<!-- begin generated: a -->\n", 1, "not closed"),
            ("x\n<!-- end generated: a -->\n", 2, "not opened"),
            ("<!-- begin generated: a -->\n<!-- end generated: b -->\n", 2, "closed by another"),
            ("<!-- begin generated: a -->\n<!-- begin generated: b -->\n<!-- end generated: b -->\n", 2, "nested"),
            (
                "<!-- begin generated: a -->\n<!-- end generated: a -->\n<!-- begin generated: a -->\n",
                3,
                "the same name twice",
            ),
        ];
        for (text, line, what) in cases {
            assert_eq!(blocks(text).unwrap_err().line, Some(line), "{what}");
            assert_eq!(replaced(text, "a", "x").unwrap_err().line, Some(line), "{what}: nothing is written");
        }
    }

    #[test]
    fn a_body_with_markers_is_refused() {
        let body = "x\n<!-- end generated: a -->\n<!-- begin generated: c -->";
        assert!(replaced(TEXT, "a", body).unwrap_err().found.contains("end generated: a"));
    }

    #[test]
    fn markers_inside_a_line_are_words() {
        let text = format!("see `<!-- begin generated: z -->` here\n{TEXT}");
        assert_eq!(names(&text), ["a", "b"]);
    }

    #[test]
    fn a_file_with_a_faulty_report_stays_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.md");
        std::fs::write(&path, TEXT).unwrap();
        let error = rewrite(&path, "c", "x").unwrap_err().to_string();
        assert!(error.contains("report.md") && error.contains("generated: c"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), TEXT);
        rewrite(&path, "a", "new").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), TEXT.replace("old", "new"));
        assert!(is_one_line(&path, "a").unwrap() && !is_one_line(&path, "b").unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
    }

    #[test]
    fn stamps_are_read_as_they_are_written() {
        for dates in [["2026-11-22", "2026-11-22"], ["2026-11-22", "2026-11-24"]] {
            let dates = dates.map(String::from);
            let stamp = Stamp { version: "0.1.0".into(), dates, threads: 2, cores: 4, minutes: [0.5, 12.3] };
            assert_eq!(Stamp::read(&format!("\n{stamp} Level 8, seeds 0, 1.\n\n| table |")), Some(stamp));
        }
        assert_eq!(Stamp::read("| no stamp |"), None);
    }
}
