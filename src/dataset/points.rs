//! Lists of points at which to query a field.

use std::io::Read;
use std::path::Path;

use glam::Vec3;

use crate::io::npy;
use crate::{Error, Result};

/// Reads points from a `.npy` file: f32 or f64 `[N, 3]`, in scene units.
///
/// # Errors
/// If the file is missing or holds another array, or a coordinate is not finite as f32.
pub fn read_npy(path: &Path) -> Result<Vec<Vec3>> {
    let shape = [None, Some(3)];
    let flat: Vec<f32> = match npy::read::<f32>(path) {
        Ok(array) => {
            array.expect_shape(path, "data", &shape)?;
            array.data
        }
        Err(as_f32) => match npy::read::<f64>(path) {
            Ok(array) => {
                array.expect_shape(path, "data", &shape)?;
                array.data.iter().map(|&v| v as f32).collect()
            }
            Err(_) => return Err(as_f32),
        },
    };
    match flat.iter().position(|v| !v.is_finite()) {
        Some(i) => {
            let place = format!("array `data`, row {}, column {}", i / 3, i % 3);
            Err(Error::malformed(path, place, "a finite number (f32)", flat[i].to_string()))
        }
        None => Ok(flat.as_chunks::<3>().0.iter().map(|&x| Vec3::from_array(x)).collect()),
    }
}

/// Reads points from the first three columns of a CSV file: x,y,z in scene units.
///
/// A first line whose first three entries are not numbers is a header. `path` appears in error messages only.
///
/// # Errors
/// If reading fails, or a row is not three finite numbers.
pub fn read_csv(input: impl Read, path: &Path) -> Result<Vec<Vec3>> {
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).from_reader(input);
    let mut points = Vec::new();
    for (row, record) in reader.records().enumerate() {
        let record = record.map_err(|e| Error::malformed(path, format!("row {}", row + 1), "x,y,z", e.to_string()))?;
        let first = || record.iter().take(3).map(str::parse::<f32>);
        let numbers: Vec<f32> = first().map_while(|v| v.ok().filter(|v| v.is_finite())).collect();
        match numbers.as_slice() {
            &[x, y, z] => points.push(Vec3::new(x, y, z)),
            // Three names. Numbers with other separators are a single entry, not a header.
            _ if row == 0 && record.len() >= 3 && first().all(|v| v.is_err()) => {}
            _ => {
                let found = record.iter().collect::<Vec<_>>().join(",");
                return Err(Error::malformed(path, format!("row {}", row + 1), "three finite numbers x,y,z", found));
            }
        }
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Vec<Vec3>> {
        read_csv(text.as_bytes(), Path::new("p.csv"))
    }

    #[test]
    fn a_header_is_passed_over_and_only_a_header() {
        let points = [Vec3::new(1.0, 2.0, 3.0)];
        for text in ["1,2,3\n", "x,y,z\n1,2,3\n", "x, y, z, name\n 1 , 2 , 3 , four\n"] {
            assert_eq!(parse(text).unwrap(), points, "{text}");
        }
        assert!(parse("").unwrap().is_empty());
        let refused =
            ["1;2;3\n", "0.5 0.5 0.5\n", "x,y,z\nx,y,z\n", "x,y,3\n", "1,2\n", "nan,0,0\n", "0,1e39,0\n", "0,0,inf\n"];
        for text in refused {
            let error = parse(text).expect_err(text).to_string();
            assert!(error.starts_with("p.csv: row ") && error.contains("finite"), "{error}");
        }
    }

    #[test]
    fn coordinates_that_are_not_finite_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        npy::write(&path, &[2, 3], [0.0, 0.0, 0.0, 0.0, 1e39, 0.0_f64]).unwrap();
        let error = read_npy(&path).unwrap_err().to_string();
        assert!(error.contains("row 1, column 1") && error.contains("inf"), "{error}");
    }
}
