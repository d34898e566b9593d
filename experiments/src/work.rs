//! Rows that are finished, kept until their block is written.

use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};

use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::clock::{Clock, Time, today};

/// Something kept in a file beside what it was made for.
#[derive(Serialize, Deserialize)]
struct Kept<T> {
    key: serde_json::Value,
    value: T,
}

/// The value kept in `path`, if it was made for `key`.
#[must_use]
pub fn kept<T: DeserializeOwned>(path: &Path, key: &serde_json::Value) -> Option<T> {
    let kept: Kept<T> = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    (kept.key == *key).then_some(kept.value)
}

/// Keeps a value, atomically.
pub fn keep<T: Serialize>(path: &Path, key: &serde_json::Value, value: T) -> Result<()> {
    let text = serde_json::to_vec_pretty(&Kept { key: key.clone(), value })
        .map_err(|e| Error::malformed(path, "value", "one that JSON can hold", e.to_string()))?;
    write_whole(path, &text)
}

/// Writes a file that appears as a whole, or not at all.
pub fn write_whole(path: &Path, content: &[u8]) -> Result<()> {
    let part = path.with_extension("part");
    let written = std::fs::write(&part, content).and_then(|()| std::fs::rename(&part, path));
    written.map_err(Error::io(path, "cannot write"))
}

/// A row with its date and time, so that a block that is written later states them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Dated<T> {
    pub date: String,
    pub time: Time,
    pub value: T,
}

impl<T> Dated<T> {
    /// Makes a row today.
    pub fn make(make: impl FnOnce() -> Result<T>) -> Result<Self> {
        let clock = Clock::start();
        let value = make()?;
        Ok(Self { date: today(), time: clock.elapsed(), value })
    }
}

/// The work folder of a part.
pub struct Work {
    folder: PathBuf,
    dates: RefCell<Vec<String>>,
    /// Of all rows, whether they were made now or earlier.
    rows: Cell<Time>,
    /// Of the rows made now.
    now: Cell<Time>,
    clock: Clock,
}

impl Work {
    /// Opens the folder, empty if `fresh`.
    pub fn open(folder: PathBuf, fresh: bool) -> Result<Self> {
        if fresh && folder.exists() {
            std::fs::remove_dir_all(&folder).map_err(Error::io(&folder, "cannot remove"))?;
        }
        std::fs::create_dir_all(&folder).map_err(Error::io(&folder, "cannot create the folder"))?;
        let (rows, now) = (Cell::default(), Cell::default());
        Ok(Self { folder, dates: RefCell::new(vec![today()]), rows, now, clock: Clock::start() })
    }

    /// Where a part keeps what its rows are made from.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The row that was kept under these settings by this version of the program, or a new one.
    pub fn row<T: Serialize + DeserializeOwned>(
        &self,
        settings: impl Serialize,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let (path, key) = self.place(settings, "json");
        if let Some(Dated { date, time, value }) = kept(&path, &key) {
            self.dates.borrow_mut().push(date);
            self.rows.set(self.rows.get() + time);
            return Ok(value);
        }
        let row = Dated::make(make)?;
        keep(&path, &key, &row)?;
        self.count(row.time);
        eprintln!("{key}: {:.1} s", row.time.wall);
        Ok(row.value)
    }

    /// The same for a field, which has a file of its own.
    pub fn field(
        &self,
        settings: impl Serialize,
        make: impl FnOnce() -> Result<UncertaintyField>,
    ) -> Result<UncertaintyField> {
        let (file, _) = self.place(&settings, "oct");
        self.row(&settings, || make()?.write(&file))?;
        UncertaintyField::read(&file)
    }

    fn count(&self, time: Time) {
        self.rows.set(self.rows.get() + time);
        self.now.set(self.now.get() + time);
    }

    /// File and key of a row.
    fn place(&self, settings: impl Serialize, extension: &str) -> (PathBuf, serde_json::Value) {
        let key = serde_json::json!([env!("CARGO_PKG_VERSION"), settings]);
        let name = format!("{:08x}.{extension}", crc32fast::hash(key.to_string().as_bytes()));
        (self.folder.join(name), key)
    }

    /// First and last day on which rows were made.
    pub fn dates(&self) -> [String; 2] {
        let dates = self.dates.borrow();
        [dates.iter().min(), dates.iter().max()].map(|date| date.cloned().unwrap_or_default())
    }

    /// Time that all rows took, and what was done beside them.
    pub fn time(&self) -> Time {
        let (all, rows, now) = (self.clock.elapsed(), self.rows.get(), self.now.get());
        Time { cpu: all.cpu + rows.cpu - now.cpu, wall: all.wall + rows.wall - now.wall }
    }

    /// Forgets the rows: their block is written.
    pub fn done(self) -> Result<()> {
        std::fs::remove_dir_all(&self.folder).map_err(Error::io(&self.folder, "cannot remove"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kept_row_is_not_made_again_unless_its_settings_change() {
        let folder = tempfile::tempdir().unwrap();
        let open = |fresh| Work::open(folder.path().join("part"), fresh).unwrap();
        let made = Cell::new(0);
        let make = || {
            made.set(made.get() + 1);
            Ok(vec![0.1, f64::from(made.get())])
        };
        assert_eq!(open(false).row(("rays", 5), make).unwrap(), [0.1, 1.0]);
        // A killed run that starts again finds it.
        let again = open(false);
        assert_eq!(again.row(("rays", 5), make).unwrap(), [0.1, 1.0]);
        assert_eq!(again.row(("rays", 6), make).unwrap(), [0.1, 2.0]);
        assert_eq!(open(true).row(("rays", 5), make).unwrap(), [0.1, 3.0], "a fresh run keeps nothing");
        // Neither does the run after one that wrote its block.
        open(false).done().unwrap();
        assert_eq!(open(false).row(("rays", 5), make).unwrap(), [0.1, 4.0]);
    }

    #[test]
    fn a_row_that_fails_is_not_kept() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(folder.path().join("part"), false).unwrap();
        let fail = || -> Result<f64> { Err(Error::setting("rays", "some", "none")) };
        assert!(work.row("a", fail).is_err());
        assert_eq!(work.row("a", || Ok(2.0)).unwrap(), 2.0);
    }

    #[test]
    fn a_damaged_row_is_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(folder.path().join("part"), false).unwrap();
        work.row("a", || Ok(1)).unwrap();
        let (path, _) = work.place("a", "json");
        std::fs::write(&path, "{").unwrap();
        assert_eq!(work.row("a", || Ok(2)).unwrap(), 2);
    }
}
