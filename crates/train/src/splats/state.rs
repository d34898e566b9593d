//! The state of a run that trains splats in a file, from which it can be resumed bit for bit.
//!
//! It is a [container] with the sections `rows`, their `means` and `squares` (f32 [splats, 59] each), and `asked` (f32
//! [splats, 2]). A run resumes only from a state whose description equals its own.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::SplatTrainer;
use super::cloud::{Row, rotation};
use super::growth::Asked;
use octobayes::io::container;
use octobayes::io::container::{Format, Reader};
use octobayes::{Error, Result};

const FORMAT: Format = (b"OCTOTSP\n", 1);
/// Largest difference of a rotation's squared length from 1.
const UNIT: f32 = 1e-4;

#[derive(Serialize, Deserialize)]
struct Header {
    /// Description that a resumed run must share.
    key: String,
    steps: u64,
    /// Time of training so far, in seconds.
    elapsed: f64,
}

impl SplatTrainer<'_> {
    /// Checks that a file is the state of a run of this kind, whatever run it is.
    ///
    /// # Errors
    /// If it is missing, damaged or another file.
    pub fn check_state(path: &Path) -> Result<()> {
        Reader::open::<Header>(path, FORMAT).map(|_| ())
    }

    pub(super) fn save_state(&self, path: &Path, key: &str, elapsed: f64) -> Result<()> {
        let header = Header { key: key.into(), steps: self.steps, elapsed };
        container::write(
            path,
            FORMAT,
            &header,
            &[
                ("rows", &self.rows.as_slice()),
                ("means", &self.means.as_slice()),
                ("squares", &self.squares.as_slice()),
                ("asked", &self.asked.as_slice()),
            ],
        )
    }

    /// Resumes a saved run with the same description; returns its time so far in seconds.
    ///
    /// # Errors
    /// If the file is missing or damaged, or belongs to a run with another description.
    pub fn restore(&mut self, path: &Path, key: &str) -> Result<f64> {
        let (header, mut file) = Reader::open::<Header>(path, FORMAT)?;
        if header.key != key {
            let expected = format!("a run with the same settings and data, {key}");
            let found = format!("another, which a restart discards, {}", header.key);
            return Err(Error::malformed(path, "run", expected, found));
        }
        let rows: Vec<Row> = file.section("rows")?;
        let means: Vec<Row> = file.section("means")?;
        let squares: Vec<Row> = file.section("squares")?;
        let asked: Vec<Asked> = file.section("asked")?;
        let lengths = [rows.len(), means.len(), squares.len(), asked.len()];
        let numbers = rows.iter().chain(&means).chain(&squares).flatten().chain(asked.iter().flatten());
        let is_finite = numbers.into_iter().all(|v| v.is_finite()) && header.elapsed.is_finite();
        let is_positive = squares.iter().flatten().all(|v| *v >= 0.0) && header.elapsed >= 0.0;
        let are_rotations = rows.iter().all(|row| (rotation(row).length_squared() - 1.0).abs() < UNIT);
        let most = self.settings.most.max(self.rows.len());
        let fits = lengths.iter().all(|n| *n == lengths[0]) && (1..=most).contains(&lengths[0]);
        if !(is_finite && is_positive && are_rotations && fits) {
            let expected = format!("as many rows of each, up to {most}, of finite numbers and unit rotations");
            let found = format!("{lengths:?} rows, or other numbers");
            return Err(Error::malformed(path, "sections", expected, found));
        }
        (self.rows, self.means, self.squares, self.asked) = (rows, means, squares, asked);
        self.steps = header.steps;
        Ok(header.elapsed)
    }
}
