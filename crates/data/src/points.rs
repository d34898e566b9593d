//! Lists of points at which to query a field, read a batch at a time.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use csv::StringRecord;
use glam::Vec3;

use crate::Real;
use crate::npy;
use crate::npy::ArrayStream;
use octobayes::{Error, Result};

/// Names of the columns that hold a point.
const AXES: [&str; 3] = ["x", "y", "z"];

/// A list of points in scene units that may be longer than memory.
pub struct PointReader<'a> {
    source: Source<'a>,
    path: PathBuf,
    /// Number of points or rows read, the header included.
    read: u64,
}

enum Source<'a> {
    Npy(ArrayStream<Real, BufReader<File>>),
    Csv(Csv<'a>),
}

struct Csv<'a> {
    reader: csv::Reader<Box<dyn Read + 'a>>,
    columns: Columns,
    /// The first row, if it is a point and has not been returned.
    first: Option<StringRecord>,
}

/// Which columns of a row are a point.
struct Columns {
    /// Indices of x, y and z.
    axes: [usize; 3],
    /// Number of entries in a row.
    count: usize,
    /// Names of the other columns.
    ignored: Vec<String>,
}

impl<'a> PointReader<'a> {
    /// Starts reading a `.npy` file: numbers of any type, `[N, 3]`.
    ///
    /// # Errors
    /// If the file is missing or holds another array.
    pub fn npy(path: &Path) -> Result<Self> {
        let stream = npy::stream::<Real>(path)?;
        stream.expect_shape(&[None, Some(3)])?;
        Ok(Self { source: Source::Npy(stream), path: path.to_path_buf(), read: 0 })
    }

    /// Starts reading CSV.
    ///
    /// If the first row names its columns, those named x, y and z count, in any order and either case. Without
    /// names there are exactly three columns. `path` appears in error messages only.
    ///
    /// # Errors
    /// If reading fails, if names are there but not x, y and z, or if there are no names and not three columns.
    pub fn csv(input: impl Read + 'a, path: &Path) -> Result<Self> {
        let mut builder = csv::ReaderBuilder::new();
        builder.has_headers(false).flexible(true).trim(csv::Trim::All);
        let mut reader = builder.from_reader(Box::new(input) as Box<dyn Read + 'a>);
        let mut first = StringRecord::new();
        let is_there = reader.read_record(&mut first).map_err(|e| unreadable(path, 1, &e))?;
        let (columns, is_header) =
            if is_there { Columns::from_record(&first, path)? } else { (Columns::plain(), true) };
        let source = Source::Csv(Csv { reader, columns, first: (!is_header).then_some(first) });
        Ok(Self { source, path: path.to_path_buf(), read: u64::from(is_there && is_header) })
    }

    /// Names of columns that are not read.
    #[must_use]
    pub fn ignored(&self) -> &[String] {
        match &self.source {
            Source::Npy(_) => &[],
            Source::Csv(csv) => &csv.columns.ignored,
        }
    }

    /// The next points, at most `most`. None are left if there are fewer.
    ///
    /// # Errors
    /// If the file ends early, or a row is not three numbers that f32 can hold.
    pub fn batch(&mut self, most: usize) -> Result<Vec<Vec3>> {
        let mut points = Vec::new();
        while points.len() < most
            && let Some(point) = self.point()?
        {
            points.push(point);
        }
        Ok(points)
    }

    /// All points that are left.
    ///
    /// # Errors
    /// As [`PointReader::batch`].
    pub fn rest(&mut self) -> Result<Vec<Vec3>> {
        self.batch(usize::MAX)
    }

    fn point(&mut self) -> Result<Option<Vec3>> {
        let row = self.read;
        self.read += 1;
        match &mut self.source {
            Source::Npy(stream) => {
                let mut point = [0.0; 3];
                for (column, value) in point.iter_mut().enumerate() {
                    let Some(Real(found)) = stream.next_element()? else { return Ok(None) };
                    if !found.is_finite() {
                        let place = format!("array `data`, row {row}, column {column}");
                        return Err(Error::malformed(&self.path, place, "a finite number (f32)", found.to_string()));
                    }
                    *value = found;
                }
                Ok(Some(Vec3::from_array(point)))
            }
            Source::Csv(csv) => csv.point(row + 1, &self.path),
        }
    }
}

impl Csv<'_> {
    fn point(&mut self, row: u64, path: &Path) -> Result<Option<Vec3>> {
        let record = match self.first.take() {
            Some(first) => first,
            None => {
                let mut record = StringRecord::new();
                if !self.reader.read_record(&mut record).map_err(|e| unreadable(path, row, &e))? {
                    return Ok(None);
                }
                record
            }
        };
        let number = |column: usize| record.get(column)?.parse::<f32>().ok().filter(|v| v.is_finite());
        match self.columns.axes.map(number) {
            [Some(x), Some(y), Some(z)] if record.len() == self.columns.count => Ok(Some(Vec3::new(x, y, z))),
            numbers => {
                let count = self.columns.count;
                let expected = match numbers {
                    [Some(_), Some(_), Some(_)] => format!("{count} columns, as in the first row"),
                    _ => "three finite numbers x,y,z".into(),
                };
                Err(Error::malformed(path, format!("row {row}"), expected, text(&record)))
            }
        }
    }
}

impl Columns {
    /// x,y,z and nothing else.
    fn plain() -> Self {
        Self { axes: [0, 1, 2], count: 3, ignored: Vec::new() }
    }

    /// The columns of a file that begins with `first`, and whether that is a row of names.
    fn from_record(first: &StringRecord, path: &Path) -> Result<(Self, bool)> {
        let place = "row 1";
        // A table with numbered rows has a column without a name.
        let is_header = first.iter().any(is_name) && first.iter().all(|entry| entry.is_empty() || is_name(entry));
        if !is_header {
            let is_number = |entry: &str| entry.parse::<f64>().is_ok();
            if first.len() > 3 && first.iter().all(is_number) {
                let expected = "three columns x,y,z, or a first row that names its columns, among them x, y and z";
                return Err(Error::malformed(path, place, expected, format!("{} columns without names", first.len())));
            }
            return Ok((Self::plain(), false));
        }
        // As numpy.savetxt writes them, `# x,y,z`.
        let names: Vec<&str> = first.iter().map(|name| name.trim_start_matches(['#', ' '])).collect();
        let columns_of =
            |axis: &str| -> Vec<usize> { (0..names.len()).filter(|&i| names[i].eq_ignore_ascii_case(axis)).collect() };
        match AXES.map(columns_of).each_ref().map(Vec::as_slice) {
            [&[x], &[y], &[z]] => {
                let others = (0..names.len()).filter(|i| ![x, y, z].contains(i));
                let name = |i: usize| if names[i].is_empty() { "one without a name" } else { names[i] };
                let ignored = others.map(|i| name(i).to_string()).collect();
                Ok((Self { axes: [x, y, z], count: names.len(), ignored }, true))
            }
            _ => {
                let expected =
                    "names of columns, among them x, y and z once each; or three columns x,y,z without names";
                Err(Error::malformed(path, place, expected, text(first)))
            }
        }
    }
}

/// True for an entry that can only be the name of a column: it begins like a word and is no number.
fn is_name(entry: &str) -> bool {
    let start = entry.trim_start_matches(['#', ' ']).chars().next();
    start.is_some_and(|c| c.is_alphabetic() || c == '_') && entry.parse::<f64>().is_err()
}

fn text(record: &StringRecord) -> String {
    record.iter().collect::<Vec<_>>().join(",")
}

fn unreadable(path: &Path, row: u64, error: &csv::Error) -> Error {
    Error::malformed(path, format!("row {row}"), "x,y,z", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Vec<Vec3>> {
        PointReader::csv(text.as_bytes(), Path::new("p.csv"))?.rest()
    }

    #[test]
    fn columns_are_found_by_their_names() {
        let points = [Vec3::new(1.0, 2.0, 3.0)];
        let texts = [
            "1,2,3\n",
            "x,y,z\n1,2,3\n",
            "x, y, z, name\n 1 , 2 , 3 , four\n",
            "Z,Y,X\n3,2,1\n",
            "id,x,y,z\n9,1,2,3\n",
            ",x,y,z\n0,1,2,3\n",
            "\"y\",\"name\",\"x\",\"z\"\n2,\"a,b\",1,3\n",
            "# x,y,z\n1,2,3\n",
            "#x,y,z\n1,2,3",
            "\u{feff}x,y,z\r\n1,2,3\r\n",
            "\u{feff}1,2,3\n",
        ];
        for text in texts {
            assert_eq!(parse(text).unwrap_or_else(|e| panic!("{text}: {e}")), points, "{text}");
        }
        assert!(parse("").unwrap().is_empty() && parse("x,y,z\n").unwrap().is_empty());
        let ignored = |text: &str| PointReader::csv(text.as_bytes(), Path::new("p.csv")).unwrap().ignored().to_vec();
        assert_eq!(ignored("id,z,x,Y,#rays\n"), ["id", "rays"]);
        assert_eq!(ignored(",x,y,z\n"), ["one without a name"]);
        assert!(ignored("x,y,z\n").is_empty() && ignored("1,2,3\n").is_empty());
    }

    #[test]
    fn what_is_no_point_is_refused() {
        let refused = [
            ("1;2;3\n", "row 1: expected three finite numbers"),
            ("0.5 0.5 0.5\n", "row 1: expected three finite numbers"),
            ("x,y,z\nx,y,z\n", "row 2: expected three finite numbers"),
            ("x,y,3\n", "row 1: expected three finite numbers"),
            ("1,2\n", "row 1: expected three finite numbers"),
            ("nan,0,0\n", "finite"),
            ("0,1e39,0\n", "finite"),
            ("0,0,inf\n", "finite"),
            ("1,2,3\n1,2,3,4\n", "row 2: expected 3 columns, as in the first row, found 1,2,3,4"),
            ("x,y,z,u\n1,2,3\n", "row 2: expected 4 columns"),
            ("7,1,2,3\n", "row 1: expected three columns x,y,z, or a first row that names its columns"),
            ("a,b,c\n1,2,3\n", "row 1: expected names of columns, among them x, y and z once each"),
            ("x,y\n1,2\n", "names of columns"),
            (",,\n1,2,3\n", "row 1: expected three finite numbers"),
            ("x,X,y,z\n1,2,3,4\n", "names of columns"),
            ("x;y;z\n1;2;3\n", "names of columns"),
        ];
        for (text, expected) in refused {
            let error = parse(text).expect_err(text).to_string();
            assert!(error.starts_with("p.csv: row ") && error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn batches_are_the_list_in_pieces() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        npy::write(&path, &[5, 3], (0..15).map(f64::from)).unwrap();
        let csv: String = (0..5).map(|i| format!("{},{},{}\n", 3 * i, 3 * i + 1, 3 * i + 2)).collect();
        let headed = format!("x,y,z\n{csv}");
        let whole = PointReader::npy(&path).unwrap().rest().unwrap();
        assert_eq!((whole.len(), whole[4]), (5, Vec3::new(12.0, 13.0, 14.0)));
        for most in [1, 2, 3, 5, 7] {
            let readers = [
                PointReader::npy(&path).unwrap(),
                PointReader::csv(csv.as_bytes(), &path).unwrap(),
                PointReader::csv(headed.as_bytes(), &path).unwrap(),
            ];
            for mut reader in readers {
                let batches: Vec<Vec<Vec3>> = std::iter::repeat_with(|| reader.batch(most).unwrap())
                    .take_while(|batch| !batch.is_empty())
                    .collect();
                assert_eq!((batches.concat(), batches.len()), (whole.clone(), 5_usize.div_ceil(most)));
            }
        }
    }

    #[test]
    fn coordinates_that_are_not_finite_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        npy::write(&path, &[2, 3], [0.0, 0.0, 0.0, 0.0, 1e39, 0.0_f64]).unwrap();
        let error = PointReader::npy(&path).unwrap().rest().unwrap_err().to_string();
        assert!(error.contains("row 1, column 1") && error.contains("inf"), "{error}");
    }
}
