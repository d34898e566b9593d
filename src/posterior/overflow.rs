//! Where sums go that a budget of memory has no room for.

use std::path::{Path, PathBuf};

use super::{Fill, Posterior, Sums};
use crate::io::place::folder_of;
use crate::io::remove_leftovers;
use crate::io::sorted::SortedFile;
use crate::render::RaySamples;
use crate::{Error, Result};

/// Bytes of every process beside its model: program, cameras, occupancy grid.
const PROGRAM: u64 = 48_000_000;
/// The part of the rest that sums may take. What remains is for rays under way and their contributions, and for sorting
/// the sums when they leave. The field is made after the last of them have left.
const SHARE_OF_SUMS: f64 = 0.7;
/// Least bytes for sums, and for rays under way.
const MIN_BYTES: u64 = 16_000_000;
/// Runs that are read side by side: files that are open, and pages of each in every thread. If there are as many, they
/// are merged into one.
pub const MOST_RUNS: usize = 64;
/// What the extension of a run's file begins with.
const RUN: &str = "run";
/// Samples that are summed before the room is looked at.
pub const SAMPLES: usize = 1 << 16;

/// Bytes of a budget that sums may take, beside a model of so many bytes. They depend on nothing else, so that runs of
/// sums end after the same rays on every machine.
pub fn room_for_sums(budget: u64, model: usize) -> usize {
    (budget.saturating_sub(model as u64 + PROGRAM) as f64 * SHARE_OF_SUMS) as usize
}

/// The smallest budget of a process that already takes so many bytes, with its model: it has room for some sums, and
/// for rays under way.
pub fn least_budget(taken: u64, model: usize) -> u64 {
    let fixed = model as u64 + PROGRAM;
    // budget - room >= taken + MIN_BYTES
    let beside = (taken + MIN_BYTES) as f64 - SHARE_OF_SUMS * fixed as f64;
    let beside = (beside / (1.0 - SHARE_OF_SUMS)).max(0.0) as u64;
    beside.max(fixed + (MIN_BYTES as f64 / SHARE_OF_SUMS) as u64)
}

/// The batches in portions of some [`SAMPLES`] each, whatever the number of threads.
pub fn portions(batches: &[RaySamples]) -> impl Iterator<Item = &[RaySamples]> {
    let mut rest = batches;
    std::iter::from_fn(move || {
        let mut samples = 0;
        let portion = rest.iter().take_while(|batch| {
            let has_room = samples < SAMPLES;
            samples += batch.positions.len();
            has_room
        });
        let (portion, others) = rest.split_at(portion.count());
        rest = others;
        (!portion.is_empty()).then_some(portion)
    })
}

/// Where the sums of a run go when they have taken all their room.
#[derive(Debug, Clone)]
pub struct Overflow {
    /// Bytes that sums may take in memory.
    room: usize,
    /// Runs before they are merged into one.
    most_runs: usize,
    place: Place,
}

/// Where runs of sums are.
#[derive(Debug, Clone)]
enum Place {
    /// In files without names, in this folder.
    Temporary(PathBuf),
    /// Beside this file, a checkpoint that they belong to.
    Beside(PathBuf),
}

impl Overflow {
    /// Of sums that may take `room` bytes. With a checkpoint, runs lie beside it, otherwise in `folder`.
    pub fn new(room: usize, folder: &Path, checkpoint: Option<&Path>) -> Self {
        let beside = checkpoint.map(|file| Place::Beside(file.into()));
        Self { room, most_runs: MOST_RUNS, place: beside.unwrap_or_else(|| Place::Temporary(folder.into())) }
    }

    /// Of one of two sets of sums that are in memory at once, and whose runs are read side by side.
    pub fn halved(self) -> Self {
        Self { room: self.room / 2, most_runs: self.most_runs / 2, ..self }
    }

    /// Refuses, before the first ray, a folder in which no file can be made.
    pub fn check(&self) -> Result<()> {
        match &self.place {
            Place::Temporary(folder) => SortedFile::<u8>::temporary(folder, |_| Ok(())).map(|_| ()),
            // The checkpoint is saved there, too.
            Place::Beside(_) => Ok(()),
        }
    }

    /// The folder of its files.
    pub fn folder(&self) -> &Path {
        match &self.place {
            Place::Temporary(folder) => folder,
            Place::Beside(checkpoint) => folder_of(checkpoint),
        }
    }

    /// Writes the sums to a run if they take all their room. Returns whether they did.
    pub fn spill_if_full(&self, posterior: &mut impl Posterior) -> Result<bool> {
        let is_full = posterior.memory() >= self.room;
        if is_full {
            self.spill(posterior)?;
        }
        Ok(is_full)
    }

    /// Writes what is left in memory to a run, if there are others.
    pub fn spill_rest(&self, posterior: &mut impl Posterior) -> Result<()> {
        if posterior.runs().is_empty() { Ok(()) } else { self.spill(posterior) }
    }

    /// Writes what is in memory to a run.
    pub fn spill(&self, posterior: &mut impl Posterior) -> Result<()> {
        if posterior.memory() == 0 {
            return Ok(());
        }
        if posterior.runs().len() >= self.most_runs {
            self.merge(posterior)?;
        }
        let number = next_number(posterior);
        posterior.spill(|fill| self.write(number, fill))
    }

    /// Writes all sums to one run, so that those of many groups of rays can be read side by side.
    pub fn spill_to_one(&self, posterior: &mut impl Posterior) -> Result<()> {
        self.spill(posterior)?;
        if posterior.runs().len() > 1 { self.merge(posterior) } else { Ok(()) }
    }

    fn merge(&self, posterior: &mut impl Posterior) -> Result<()> {
        let number = next_number(posterior);
        posterior.merge_runs(|fill| self.write(number, fill))
    }

    fn write<S: Sums>(&self, number: u32, fill: Fill<'_, S>) -> Result<SortedFile<S>> {
        match &self.place {
            Place::Temporary(folder) => SortedFile::temporary(folder, fill),
            Place::Beside(checkpoint) => {
                let path = run_path(checkpoint, number);
                if path.exists() && !SortedFile::<u8>::is_sorted_file(&path) {
                    return Err(Error::malformed(&path, "name of a run of sums", "no other file here", "one"));
                }
                SortedFile::kept(&path, fill)
            }
        }
    }

    /// The run that a checkpoint names by its number and checksum.
    pub fn reopen<S: Sums>(&self, [number, checksum]: [u32; 2]) -> Result<SortedFile<S>> {
        let (Place::Temporary(beside) | Place::Beside(beside)) = &self.place;
        SortedFile::open(&run_path(beside, number), checksum)
    }
}

/// What a checkpoint names runs by: number and checksum.
pub fn names(posterior: &impl Posterior) -> Vec<[u32; 2]> {
    posterior.runs().iter().map(|run| [number_of(run.path()).unwrap_or(0), run.checksum()]).collect()
}

fn next_number(posterior: &impl Posterior) -> u32 {
    names(posterior).last().map_or(0, |[number, _]| number.saturating_add(1))
}

/// The file of a run that belongs to a checkpoint.
fn run_path(checkpoint: &Path, number: u32) -> PathBuf {
    let mut path = checkpoint.to_path_buf();
    path.as_mut_os_string().push(format!(".{RUN}{number}"));
    path
}

/// The number in the name of such a file.
fn number_of(path: &Path) -> Option<u32> {
    path.extension()?.to_str()?.strip_prefix(RUN)?.parse().ok()
}

/// What may be runs beside a checkpoint: numbers and paths.
fn runs_beside(checkpoint: &Path) -> impl Iterator<Item = (u32, PathBuf)> {
    let files = std::fs::read_dir(folder_of(checkpoint)).into_iter().flatten().flatten().map(|entry| entry.path());
    let of_checkpoint = files.filter(|path| path.with_extension("").file_name() == checkpoint.file_name());
    of_checkpoint.filter_map(|path| Some((number_of(&path)?, path)))
}

/// Removes the runs beside a checkpoint that are not among those that it `names`: those of a run that is over or was
/// killed before it saved its state, and those that were merged. Removes what is left of one that was being written,
/// too.
///
/// # Errors
/// If a file cannot be removed.
pub fn remove_others(checkpoint: &Path, names: &[[u32; 2]]) -> Result<()> {
    let runs: Vec<(u32, PathBuf)> = runs_beside(checkpoint).collect();
    let is_named = |number: u32| names.iter().any(|name| name[0] == number);
    let mut others = runs.iter().filter(|(number, path)| !is_named(*number) && SortedFile::<u8>::is_sorted_file(path));
    others.try_for_each(|(_, path)| std::fs::remove_file(path).map_err(Error::io(path, "cannot remove")))?;
    // Runs are written one after the other, and before the 65th that of their sums.
    let last = runs.iter().map(|(number, _)| *number).chain(names.iter().map(|name| name[0])).max();
    let next = last.map_or(0, |number| number.saturating_add(1));
    [next, next.saturating_add(1)].into_iter().for_each(|number| remove_leftovers(&run_path(checkpoint, number)));
    Ok(())
}
