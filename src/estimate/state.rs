//! The state of a posterior in a file, so that a run survives Ctrl-C, `kill -9` and power cuts.
//!
//! A container file with the sections `keys` (u64, of vertices; empty for a dense grid), `sums` ([`VertexSums`], one
//! per key, or per lattice point of a dense grid), `surface` and `visits`. Sums are kept bit for bit, and the run
//! continues after the last counted ray. A resumed run therefore ends with the bits of an uninterrupted one. A
//! run accepts only a state with its own description.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::geometry::Lattice;
use crate::io::container::{self, Format, Reader, Section};
use crate::octree::{MaxLevels, Tile};
use crate::posterior::{DensePosterior, OctreePosterior, VertexSums, Visits};
use crate::rays::{Pixels, RunProgress, Shard};
use crate::render::GradientMethod;
use crate::{Error, Result};

const FORMAT: Format = (b"OCTOCHK\n", 5);

/// A posterior of either kind.
pub enum AnyPosterior {
    /// The paper's grid.
    Dense(DensePosterior),
    /// The octree's sums.
    Octree(OctreePosterior),
}

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
    /// Number of points on visible surfaces to keep.
    pub surface_points: u64,
    /// Rays per vertex for which the refinement limits were made; 0 for no limits.
    pub rays_per_vertex: f64,
    /// Checksum of these limits.
    pub limits: u32,
    /// The part of space whose sums are kept, if not all.
    #[serde(default)]
    pub tile: Option<Tile>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    key: RunKey,
    progress: RunProgress,
    dense: bool,
}

/// The state of a run that can be resumed.
pub struct State {
    /// The sums so far.
    pub posterior: AnyPosterior,
    /// Progress so far.
    pub progress: RunProgress,
    /// Points on visible surfaces so far, scene units.
    pub surface: Vec<[f32; 3]>,
    /// Rays seen passing so far, if known.
    pub visits: Option<Visits>,
}

/// The sums of all partitions as one section.
struct Sums<'a>(&'a OctreePosterior);

impl Section for Sums<'_> {
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        self.0.slices().try_for_each(|sums| sums.visit(visit))
    }
}

/// Writes a state. An older one under the same name is replaced only when the new one is complete.
///
/// # Errors
/// If the folder is not writable or the disk is full.
pub fn save(
    path: &Path,
    key: &RunKey,
    progress: RunProgress,
    posterior: &AnyPosterior,
    surface: &[[f32; 3]],
    visits: Option<&Visits>,
) -> Result<()> {
    let header = |dense| Header { key: key.clone(), progress, dense };
    let visits = visits.map_or(&[][..], Visits::counts);
    let write = |dense, keys: &[u64], sums: &dyn Section| {
        let sections: [(&str, &dyn Section); 4] =
            [("keys", &keys), ("sums", sums), ("surface", &surface), ("visits", &visits)];
        container::write(path, FORMAT, &header(dense), &sections)
    };
    match posterior {
        AnyPosterior::Dense(posterior) => write(true, &[], &posterior.sums()),
        AnyPosterior::Octree(posterior) => {
            let keys: Vec<u64> = posterior.keys().collect();
            write(false, &keys, &Sums(posterior))
        }
    }
}

/// The number of rays per vertex to which the saved run was limited. A memory budget may have increased it during
/// the run.
///
/// # Errors
/// If the file is missing or its header is damaged.
pub fn rays_per_vertex(path: &Path) -> Result<f64> {
    let (header, _) = Reader::open::<Header>(path, FORMAT)?;
    Ok(header.key.rays_per_vertex)
}

/// The progress of the saved run.
///
/// # Errors
/// If the file is missing or its header is damaged.
pub fn progress(path: &Path) -> Result<RunProgress> {
    let (header, _) = Reader::open::<Header>(path, FORMAT)?;
    Ok(header.progress)
}

/// Reads the state of a run with the description `key`, gathered on the leaves of `limits`.
///
/// # Errors
/// If the file is missing, truncated, altered, or belongs to a run with another description.
pub fn load(path: &Path, key: &RunKey, limits: &MaxLevels, dense: bool) -> Result<State> {
    let (header, mut file) = Reader::open::<Header>(path, FORMAT)?;
    if let Some((what, expected, found)) = first_difference(key, &header.key) {
        return Err(Error::malformed(path, format!("run, {what}"), expected, found));
    }
    if header.dense != dense {
        let name = |dense| if dense { "dense" } else { "octree" };
        return Err(Error::malformed(path, "run, grid", name(dense), name(header.dense)));
    }
    let keys = file.section::<u64>("keys")?;
    let posterior = if dense {
        DensePosterior::from_sums(key.lattice, file.section::<VertexSums>("sums")?).map(AnyPosterior::Dense)
    } else {
        let sums = file.section::<VertexSums>("sums")?;
        let same = keys.len() == sums.len();
        same.then(|| OctreePosterior::restore(key.lattice, limits.clone(), &keys, sums))
            .flatten()
            .map(AnyPosterior::Octree)
    };
    let sums_are_finite = match &posterior {
        Some(AnyPosterior::Dense(posterior)) => posterior.sums().iter().all(VertexSums::is_valid),
        Some(AnyPosterior::Octree(posterior)) => posterior.slices().flatten().all(VertexSums::is_valid),
        None => false,
    };
    let posterior = posterior.filter(|_| sums_are_finite && key.shard.admits(&header.progress));
    let posterior = posterior.ok_or_else(|| {
        Error::malformed(
            path,
            "section `sums`",
            "the sums of an unfinished run",
            "keys, counts or sums that no such run gives",
        )
    })?;
    let surface = file.section::<[f32; 3]>("surface")?;
    if surface.len() as u64 > key.surface_points || !surface.iter().flatten().all(|v| v.is_finite()) {
        let found = format!("{} points", surface.len());
        let expected = format!("at most {} points with finite coordinates", key.surface_points);
        return Err(Error::malformed(path, "section `surface`", expected, found));
    }
    let visits = match file.section::<u32>("visits")? {
        counts if counts.is_empty() => None,
        counts => Some(Visits::from_counts(&key.lattice, counts).ok_or_else(|| {
            Error::malformed(path, "section `visits`", "a count for every cell of the coarse grid", "another number")
        })?),
    };
    Ok(State { posterior, progress: header.progress, surface, visits })
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
