//! The checkpoint of a long run, so that it survives Ctrl-C, `kill -9` and power cuts: where its state is saved, how
//! often, and what the file holds.
//!
//! A container file with the sections `run` (the run and its progress, in bincode: only this program reads it), `keys`
//! (u64, of vertices; empty for a dense grid), `sums` ([`Posterior::Sums`], one per key, or per lattice point of a
//! dense grid), `surface` and `ray_coverage`. Sums that left memory are in files beside it, `FILE.run0`, `FILE.run1`
//! and so on, which `run` names by their checksums. Sums are kept bit for bit, and the run continues after the last
//! counted ray. A resumed run therefore ends with the bits of an uninterrupted one. A run accepts only a state with its
//! own description.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::SURFACE_POINTS;
use super::builder::Builder;
use crate::geometry::Lattice;
use crate::io::container::{self, Format, Reader, Section};
use crate::octree::MaxLevels;
use crate::posterior::overflow::{self, Overflow, remove_others};
use crate::posterior::{Posterior, RayCoverage, Sums};
use crate::rays::{Pixels, RaySet, RunProgress, Shard};
use crate::render::GradientMethod;
use crate::uncertainty::{Finish, UncertaintyField};
use crate::{Error, Result};

/// A file that lets a run survive Ctrl-C, `kill -9` and power cuts.
///
/// A run goes on from the file if it is there, and then ends with the same bits as without interruption. It refuses the
/// state of another run.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    path: PathBuf,
    every: Duration,
    restart: bool,
}

impl Checkpoint {
    /// Time between two writes, unless [`Checkpoint::every`] sets another.
    pub const EVERY: Duration = Duration::from_secs(60);

    /// Creates a checkpoint at `path`, written once a minute. A run in groups appends `.0`, `.1`, … for its groups.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), every: Self::EVERY, restart: false }
    }

    /// Sets the time between two writes.
    #[must_use]
    pub fn every(self, every: Duration) -> Self {
        Self { every, ..self }
    }

    /// Starts over: a state that is there is not read, whatever run it is of, but removed.
    #[must_use]
    pub fn restart(self, restart: bool) -> Self {
        Self { restart, ..self }
    }

    /// Where the state is saved.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the run starts over.
    #[must_use]
    pub fn is_restart(&self) -> bool {
        self.restart
    }

    /// The files of a run in `groups` groups, or of a run without groups.
    #[must_use]
    pub fn files(&self, groups: Option<u16>) -> Vec<PathBuf> {
        let file = |g| {
            let mut path = self.path.clone();
            path.as_mut_os_string().push(format!(".{g}"));
            path
        };
        groups.map_or_else(|| vec![self.path.clone()], |n| (0..n).map(file).collect())
    }

    /// Returns an error if a restart would replace a file that is no checkpoint.
    pub(super) fn check(&self, groups: Option<u16>) -> Result<()> {
        let files = if self.restart { self.files(groups) } else { Vec::new() };
        files.iter().filter(|file| file.exists()).try_for_each(|file| progress(file).map(|_| ()))
    }

    /// Returns true if the run goes on from `file`.
    pub(super) fn has(&self, file: &Path) -> bool {
        !self.restart && file.exists()
    }

    /// Total number of rays in those files that exist and hold a complete state.
    #[must_use]
    pub fn rays(&self, groups: Option<u16>) -> u64 {
        self.files(groups).iter().filter_map(|file| progress(file).ok()).map(|progress| progress.rays).sum()
    }

    /// Removes the files of a run whose result, this field, is saved, and their runs of sums. A file that another run
    /// has put there meanwhile stays.
    ///
    /// # Errors
    /// If a file exists and cannot be removed.
    pub fn remove(&self, groups: Option<u16>, field: &UncertaintyField) -> Result<()> {
        let files = self.files(groups);
        let is_own = |file: &&PathBuf| Head::read(file).is_ok_and(|(head, _)| head.key.is_of(field));
        let mut own = files.iter().filter(is_own);
        own.try_for_each(|file| {
            std::fs::remove_file(file).map_err(Error::io(file, "cannot remove"))?;
            remove_others(file, &[])
        })
    }
}

/// Saves one builder's state at intervals; does nothing without a file.
pub(super) struct Saver<'a> {
    file: Option<&'a Path>,
    checkpoint: Option<&'a Checkpoint>,
    saved: Instant,
}

impl<'a> Saver<'a> {
    /// Creates a saver for `file` with the interval of `checkpoint`.
    pub fn new(checkpoint: Option<&'a Checkpoint>, file: Option<&'a Path>) -> Self {
        Self { file, checkpoint, saved: Instant::now() }
    }

    /// Restores the state in the file, if there is one, and returns its progress.
    pub fn restore(&self, builder: &mut Builder<impl Finish>, key: &RunKey) -> Result<RunProgress> {
        match self.file.filter(|file| self.checkpoint.is_some_and(|checkpoint| checkpoint.has(file))) {
            Some(file) => builder.restore(file, key),
            None => {
                // What a run left that was killed before it saved its state, or while its files were removed. The state
                // that a restart discards goes first, since it names runs.
                if let Some(file) = self.file {
                    if file.exists() {
                        std::fs::remove_file(file).map_err(Error::io(file, "cannot remove"))?;
                    }
                    remove_others(file, &[])?;
                }
                Ok(RunProgress::default())
            }
        }
    }

    /// Saves if the interval has passed.
    pub fn save_if_due(
        &mut self,
        builder: &Builder<impl Finish>,
        key: impl FnOnce() -> RunKey,
        progress: RunProgress,
    ) -> Result<()> {
        if self.checkpoint.is_some_and(|checkpoint| self.saved.elapsed() >= checkpoint.every) {
            self.save(builder, key, progress)
        } else {
            Ok(())
        }
    }

    /// Saves now.
    pub fn save(
        &mut self,
        builder: &Builder<impl Finish>,
        key: impl FnOnce() -> RunKey,
        progress: RunProgress,
    ) -> Result<()> {
        let Some(file) = self.file else { return Ok(()) };
        builder.save(file, &key(), progress)?;
        self.saved = Instant::now();
        Ok(())
    }
}

/// Fields of [`RunKey`] have no names in the file: a change there is a new version.
const FORMAT: Format = (b"OCTOCHK\n", 3);
/// Most bytes that the section `run` may claim. It takes some two hundred; only the source's name varies.
const MAX_RUN_BYTES: usize = 1 << 20;

/// Everything that a sum depends on; a resumed run must match it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunKey {
    /// Version of this crate. Other versions may round or draw differently.
    pub version: String,
    /// The model, by its checksum.
    pub source: String,
    /// Checksum of the cameras in use. Their image size may come from a source other than the file.
    pub cameras: u32,
    /// Box and finest level.
    pub lattice: Lattice,
    /// The rays.
    pub shard: Shard,
    /// The method of choosing pixels.
    pub pixels: Pixels,
    /// Seed of pixels and jitter.
    pub seed: u64,
    /// Distance between samples, scene units.
    pub march_step: f64,
    /// Source of the field's derivatives.
    pub gradient: GradientMethod,
    /// Finite-difference step, scene units. Samples within this distance of matter are differentiated.
    pub difference_step: [f64; 3],
    /// Samples below this are left out.
    pub cutoff: f64,
    /// Cells per axis of the occupancy grid.
    pub occupancy: u64,
    /// Colour behind the scene.
    pub background: [f32; 3],
    /// Position of rays within their pixel.
    pub pixel_offset: f64,
    /// Rays per vertex for which the refinement limits were made; 0 for no limits.
    pub rays_per_vertex: f64,
    /// Checksum of these limits.
    pub limits: u32,
}

impl RunKey {
    /// Whether a field can be of this run.
    fn is_of(&self, field: &UncertaintyField) -> bool {
        let record = field.record();
        // All parts of a run are one set.
        let is_drawn = |RaySet { seed, shard }: &RaySet| {
            (*seed, shard.rays) == (self.seed, self.shard.rays) && [1, self.shard.of].contains(&shard.of)
        };
        field.ray_sets().iter().any(is_drawn)
            && (record.cameras_checksum, record.pixel_offset) == (Some(self.cameras), Some(self.pixel_offset))
            && (record.gradient, record.background) == (Some(self.gradient), Some(self.background))
            && record.march_step.unwrap_or(0.0) == self.march_step
            && *field.lattice() == self.lattice
    }
}

/// The section `run`.
#[derive(Serialize, Deserialize)]
struct Head {
    key: RunKey,
    progress: RunProgress,
    /// [`Posterior::NAME`].
    grid: [String; 2],
    /// Numbers and checksums of the runs that hold sums, the oldest first.
    runs: Vec<[u32; 2]>,
}

impl Head {
    fn read(path: &Path) -> Result<(Self, Reader)> {
        let ((), mut file) = Reader::open(path, FORMAT)?;
        let bytes = file.section::<u8>("run")?;
        let config = bincode::config::standard().with_limit::<MAX_RUN_BYTES>();
        match bincode::serde::decode_from_slice(&bytes, config) {
            Ok((head, read)) if read == bytes.len() => Ok((head, file)),
            decoded => {
                let found =
                    decoded.map_or_else(|e| e.to_string(), |(_, read)| format!("{read} of {} bytes", bytes.len()));
                Err(Error::malformed(path, "section `run`", "the description of a run", found))
            }
        }
    }
}

/// The state of a run that can be resumed.
pub(super) struct State<P> {
    /// The sums so far.
    pub posterior: P,
    /// Progress so far.
    pub progress: RunProgress,
    /// Points on visible surfaces so far, scene units.
    pub surface: Vec<[f32; 3]>,
    /// Rays seen passing so far, if known.
    pub ray_coverage: Option<RayCoverage>,
}

/// The sums as one section.
struct AllSums<'a, P>(&'a P);

impl<P: Posterior> Section for AllSums<'_, P> {
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        self.0.slices().try_for_each(|sums| sums.visit(visit))
    }
}

/// Writes a state. An older one under the same name is replaced only when the new one is complete.
///
/// # Errors
/// If the folder is not writable or the disk is full.
pub(super) fn save<P: Posterior>(
    path: &Path,
    key: &RunKey,
    progress: RunProgress,
    posterior: &P,
    surface: &[[f32; 3]],
    ray_coverage: Option<&RayCoverage>,
) -> Result<()> {
    let runs = overflow::names(posterior);
    let head = Head { key: key.clone(), progress, grid: P::NAME.map(String::from), runs: runs.clone() };
    let head = bincode::serde::encode_to_vec(head, bincode::config::standard())
        .map_err(|e| Error::malformed(path, "section `run`", "an encodable description", e.to_string()))?;
    let (keys, ray_coverage) = (posterior.keys(), ray_coverage.map_or(&[][..], RayCoverage::counts));
    let sections: [(&str, &dyn Section); 5] = [
        ("run", &head),
        ("keys", &keys),
        ("sums", &AllSums(posterior)),
        ("surface", &surface),
        ("ray_coverage", &ray_coverage),
    ];
    container::write(path, FORMAT, &(), &sections)?;
    // The state before this one may have named others.
    remove_others(path, &runs)
}

/// The progress of the saved run.
///
/// # Errors
/// If the file is missing or damaged.
fn progress(path: &Path) -> Result<RunProgress> {
    Head::read(path).map(|(head, _)| head.progress)
}

/// Reads the state of a run with the description `key`, gathered on the leaves of `limits`.
///
/// # Errors
/// If the file is missing, truncated, altered, or belongs to a run with another description.
pub(super) fn load<P: Posterior>(
    path: &Path,
    key: &RunKey,
    limits: &MaxLevels,
    overflow: Option<&Overflow>,
) -> Result<State<P>> {
    let (head, mut file) = Head::read(path)?;
    if let Some((what, expected, found)) = first_difference(key, &head.key) {
        let found = format!("{found}, of another run (a restart discards it)");
        return Err(Error::malformed(path, format!("run, {what}"), expected, found));
    }
    if let Some(k) = (0..2).find(|k| head.grid[*k] != P::NAME[*k]) {
        let found = format!("{}, of another run (a restart discards it)", head.grid[k]);
        return Err(Error::malformed(path, ["run, grid", "run, what is summed"][k], P::NAME[k], found));
    }
    if !head.runs.is_empty() && overflow.is_none() {
        let found = "none, and a checkpoint with sums on disk (a restart discards it)";
        return Err(Error::setting("memory budget", "one, as before", found));
    }
    let keys = file.section::<u64>("keys")?;
    let posterior = P::restore(key.lattice, limits, &keys, file.section::<P::Sums>("sums")?);
    let is_valid = |posterior: &P| posterior.slices().flatten().all(|sums| sums.widened().is_valid());
    let posterior = posterior.filter(|posterior| is_valid(posterior) && key.shard.admits(&head.progress));
    let other = |place: &str| {
        let found = "keys, counts or sums that no such run gives";
        Error::malformed(path, place, "the sums of an unfinished run", found)
    };
    let mut posterior = posterior.ok_or_else(|| other("section `sums`"))?;
    for (&name, overflow) in head.runs.iter().flat_map(|name| overflow.map(|overflow| (name, overflow))) {
        if !posterior.add_run(overflow.reopen(name)?)? {
            return Err(other(&format!("run of sums {}", name[0])));
        }
    }
    let surface = file.section::<[f32; 3]>("surface")?;
    if surface.len() > SURFACE_POINTS || !surface.iter().flatten().all(|v| v.is_finite()) {
        let found = format!("{} points", surface.len());
        let expected = format!("at most {SURFACE_POINTS} points with finite coordinates");
        return Err(Error::malformed(path, "section `surface`", expected, found));
    }
    let ray_coverage = match file.section::<u32>("ray_coverage")? {
        counts if counts.is_empty() => None,
        counts => {
            let found = counts.len();
            Some(RayCoverage::from_counts(&key.lattice, counts).ok_or_else(|| {
                let expected = "a count for every cell of the coarse grid";
                Error::malformed(path, "section `ray_coverage`", expected, found.to_string())
            })?)
        }
    };
    Ok(State { posterior, progress: head.progress, surface, ray_coverage })
}

/// Name and values of the first setting that differs.
fn first_difference(expected: &RunKey, found: &RunKey) -> Option<(String, String, String)> {
    let fields = |key: &RunKey| match serde_json::to_value(key) {
        Ok(serde_json::Value::Object(map)) => map,
        _ => serde_json::Map::new(),
    };
    let (expected_fields, found_fields) = (fields(expected), fields(found));
    let differing = expected_fields.iter().find(|(name, value)| found_fields.get(*name) != Some(value));
    differing.map(|(name, value)| {
        let other = found_fields.get(name).map_or("nothing".into(), ToString::to_string);
        (name.clone(), value.to_string(), other)
    })
}
