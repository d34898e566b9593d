//! The field file, `.oct`.
//!
//! It is a [`container`] whose header holds record, lattice, and what the field's
//! [layers](super::layers) store in JSON, each under its name. A layer that a field does not have is not named.
//! Sections are
//!
//! ```text
//! masks        u8         child masks of the octree, breadth first (empty for a dense grid)
//! deviations   f32        σ_v, by vertex (octree: finest first, in Morton order; dense: x slowest)
//! rays         u8         codes of ray counts, by vertex; or empty if unknown
//! ```
//!
//! and then those of the layers:
//!
//! ```text
//! factors      28 bytes   sums: Cholesky factors of the sums, by vertex: f32 × 6, u32 rays
//! exact        52 bytes   instead of `factors`, the sums themselves: f64 × 6 information, u32 rays
//! surface      f32 × 3    surface points
//! ray_coverage u8         ray coverage: codes of ray counts by cell of the coarse grid, x slowest
//! counted      u32        instead of `ray_coverage`: the counts themselves
//! limits       u64        the regions' level, then region · 256 + limit
//! errors       u16        error bars: number of groups, then bits of f16, errors of log10 σ_v, NaN where not known
//! ```
//!
//! A shard keeps exact sums and counts, so that shards merge to the sums of one run.
//!
//! The octree is rebuilt from its masks, so a file cannot hold an inconsistent one.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::by_vertex::encode;
use super::layers::{ErrorBars, Layer, Layers, each_sums};
use super::merge::Head;
use super::{RunRecord, Support, UncertaintyField};
use crate::geometry::Lattice;
use crate::io::container::{self, Format, Item, Reader, Section};
use crate::octree::Octree;
use crate::posterior::VertexSums;
use crate::rays::RaySet;
use crate::{Error, Result};

/// The version that this crate reads and writes.
pub const FORMAT_VERSION: u32 = 1;
const FORMAT: Format = (b"OCTOBAY\n", FORMAT_VERSION);

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    record: RunRecord,
    lattice: Lattice,
    kind: Kind,
    /// Those that the field has, by name.
    layers: Map<String, Value>,
}

#[derive(serde::Serialize, serde::Deserialize)]
enum Kind {
    Dense,
    Octree { root_split: bool },
}

/// A file that is being read.
pub struct Source {
    pub path: PathBuf,
    file: Reader,
    kind: Kind,
    /// Layers that are still to be read.
    heads: Map<String, Value>,
    pub record: RunRecord,
    pub lattice: Lattice,
    pub is_dense: bool,
    /// Number of vertices, once it is known.
    pub vertices: u64,
    /// Those that have been read.
    pub layers: Layers,
}

impl Source {
    /// Opens a file, and checks what constructors would: deserialisation bypasses them.
    fn open(path: &Path) -> Result<Self> {
        let (header, file) = Reader::open::<Header>(path, FORMAT)?;
        let Header { record, lattice, kind, layers: heads } = header;
        let lattice = lattice.domain().checked().and_then(|domain| Lattice::from_domain(domain, lattice.level()));
        let lattice = lattice
            .map_err(|e| Error::malformed(path, "header, lattice", "a valid domain and level", e.to_string()))?;
        let of_points = |axes: DVec3| lattice.domain().to_scene(axes).as_vec3().is_finite();
        if !(of_points(DVec3::ZERO) && of_points(DVec3::ONE) && lattice.edge().as_vec3().cmpgt(Vec3::ZERO).all()) {
            let expected = "a domain whose points and cells f32 can hold";
            return Err(Error::malformed(path, "header, lattice", expected, lattice.domain().to_string()));
        }
        if let Some((name, expected, found)) = record.impossible() {
            return Err(Error::malformed(path, format!("header, {name}"), expected, found));
        }
        if heads.contains_key("tile") {
            // Earlier programs wrote fields of a part of their box only; elsewhere these are as if nothing was seen.
            return Err(Error::malformed(path, "header, layer `tile`", "a field of all of its box", "a tile of it"));
        }
        let (is_dense, layers) = (matches!(kind, Kind::Dense), Layers::default());
        Ok(Self { path: path.to_path_buf(), file, kind, heads, record, lattice, is_dense, vertices: 0, layers })
    }

    /// Opens a file whose head was read before.
    fn open_again(path: &Path, head: &Head) -> Result<Self> {
        let mut file = Self::open(path)?;
        // All layers are still to be read.
        let heads = file.heads.clone();
        let ray_sets: Vec<RaySet> = file.layer()?.unwrap_or_default();
        file.heads = heads;
        let is_same = (&file.record, file.lattice, file.is_dense) == (&head.record, head.lattice, head.is_dense);
        if is_same && ray_sets == head.ray_sets {
            return Ok(file);
        }
        Err(file.malformed("header", "that of the file as it was opened before", "another, which replaced it"))
    }

    /// The vertices, which are all of a dense grid or those of an octree.
    fn support(&mut self) -> Result<Support> {
        let masks: Vec<u8> = self.section("masks")?;
        let support = match self.kind {
            Kind::Dense => Support::Dense,
            Kind::Octree { root_split } => Octree::from_raw(self.lattice.level(), root_split, &masks)
                .map(Support::Octree)
                .map_err(|problem| self.malformed("section `masks`", "a balanced octree", problem))?,
        };
        self.vertices = support.vertices(&self.lattice);
        Ok(support)
    }

    /// A layer, if the header names it.
    pub fn layer<L: Layer>(&mut self) -> Result<Option<L>> {
        let Some(head) = self.heads.remove(L::NAME) else { return Ok(None) };
        L::read(head, self).map(Some)
    }

    /// What the header holds of a layer.
    pub fn head<T: DeserializeOwned>(&self, layer: &str, head: Value) -> Result<T> {
        let wrong = |e: serde_json::Error| {
            self.malformed(format!("header, {layer}"), "a description of the layer", e.to_string())
        };
        serde_json::from_value(head).map_err(wrong)
    }

    /// Bytes of the next section of this name; 0 if none follows.
    pub fn bytes(&self, section: &str) -> u64 {
        self.file.bytes(section)
    }

    /// Reads and checks the next section of this name.
    pub fn section<T: Item>(&mut self, name: &str) -> Result<Vec<T>> {
        self.file.section(name)
    }

    /// Calls `visit` with every entry of the next section of this name, and its number, and checks the section.
    pub fn each<T: Item>(&mut self, name: &str, mut visit: impl FnMut(usize, T) -> Result<()>) -> Result<()> {
        let mut count = 0;
        self.file.pieces::<T>(name, |bytes, _| {
            for item in bytes.chunks_exact(T::SIZE).map(T::take) {
                visit(count, item)?;
                count += 1;
            }
            Ok(())
        })
    }

    /// Refuses a section with another number of entries than vertices.
    pub fn expect_one_per_vertex(&self, section: &str, entries: usize) -> Result<()> {
        if entries as u64 == self.vertices {
            return Ok(());
        }
        let expected = format!("{} entries, one per vertex", self.vertices);
        Err(self.malformed(format!("section `{section}`"), expected, entries.to_string()))
    }

    /// Refuses codes that no count of rays has.
    pub fn expect_counts(&self, section: &str, codes: &[u8]) -> Result<()> {
        let most = encode(u32::MAX);
        match codes.iter().position(|code| *code > most) {
            None => Ok(()),
            Some(i) => {
                let place = format!("section `{section}`, entry {i}");
                Err(self.malformed(place, format!("the code of a count, at most {most}"), codes[i].to_string()))
            }
        }
    }

    /// What is wrong at a place of the file.
    pub fn malformed(&self, place: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Error {
        Error::malformed(&self.path, place, expected, found)
    }
}

impl UncertaintyField {
    /// Writes the field. The file appears either complete or not at all.
    ///
    /// # Errors
    /// If the folder is not writable or the disk is full.
    pub fn write(&self, path: &Path) -> Result<()> {
        let (kind, masks) = match &self.support {
            Support::Dense => (Kind::Dense, Vec::new()),
            Support::Octree(octree) => {
                let (root_split, masks) = octree.cells().raw();
                (Kind::Octree { root_split }, masks)
            }
        };
        let (record, layers) = (self.record.clone(), self.layers.heads());
        let header = Header { record, lattice: self.lattice, kind, layers };
        let of_layers = self.layers.sections(self.is_to_be_merged());
        let mut sections: Vec<(&str, &dyn Section)> =
            vec![("masks", &masks), ("deviations", &self.deviations.0), ("rays", &self.rays.0)];
        sections.extend(of_layers.iter().map(|(name, section)| (*name, &**section)));
        container::write(path, FORMAT, &header, &sections)
    }

    /// Reads and checks the header of a file.
    ///
    /// # Errors
    /// If the file is missing, or is not complete, or not a field of this version.
    pub(super) fn read_head(path: &Path) -> Result<Head> {
        let mut file = Source::open(path)?;
        let [has_error_bars, has_sums] =
            [ErrorBars::NAME, <Vec<VertexSums>>::NAME].map(|layer| file.heads.contains_key(layer));
        let ray_sets = file.layer()?.unwrap_or_default();
        let Source { record, lattice, is_dense, .. } = file;
        let name = path.display().to_string();
        Ok(Head { name, record, lattice, ray_sets, is_dense, has_error_bars, has_sums })
    }

    /// Reads what a merge needs of a file beside its sums: where its vertices are, and its layers.
    ///
    /// # Errors
    /// If the file is missing, or is not complete, or not the field of this head.
    pub(super) fn read_without_sums(path: &Path, head: &Head) -> Result<(Support, Layers)> {
        let mut file = Source::open_again(path, head)?;
        let support = file.support()?;
        // So that no grid is made that is larger than the file.
        file.expect_one_per_vertex("deviations", file.bytes("deviations") as usize / f32::SIZE)?;
        file.heads.remove(<Vec<VertexSums>>::NAME);
        Ok((support, Layers::read(&mut file)?))
    }

    /// Calls `visit` with the sums at each of so many `vertices`, in their order.
    ///
    /// # Errors
    /// If the file is missing, or is not complete, or not the field of this head, or what `visit` returns.
    pub(super) fn each_sums(
        path: &Path,
        head: &Head,
        vertices: u64,
        visit: impl FnMut(VertexSums) -> Result<()>,
    ) -> Result<()> {
        let mut file = Source::open_again(path, head)?;
        file.vertices = vertices;
        // What was altered anywhere is no part of a run.
        file.file.pieces::<f32>("deviations", |_, _| Ok(()))?;
        file.file.pieces::<u8>("rays", |_, _| Ok(()))?;
        each_sums(&mut file, visit)
    }

    /// Whether a file holds error bars, by its header.
    ///
    /// # Errors
    /// If the file is missing, or is not complete, or not a field of this version.
    pub fn has_error_bars(path: &Path) -> Result<bool> {
        Self::read_head(path).map(|head| head.has_error_bars)
    }

    /// Reads a field.
    ///
    /// # Errors
    /// If the file is missing, or is not a complete, unaltered field of this version.
    pub fn read(path: &Path) -> Result<Self> {
        let mut file = Source::open(path)?;
        let support = file.support()?;
        let deviations: Vec<f32> = file.section("deviations")?;
        file.expect_one_per_vertex("deviations", deviations.len())?;
        // Rounding may exceed the prior's deviation by a few units in the last place.
        let most = file.record.reading().prior() as f32 * (1.0 + 8.0 * f32::EPSILON);
        if let Some(i) = deviations.iter().position(|d| !(d.is_normal() && *d > 0.0 && *d <= most)) {
            let place = format!("section `deviations`, entry {i}");
            let expected = format!("a positive number, at most the prior's {most:e}");
            return Err(file.malformed(place, expected, deviations[i].to_string()));
        }
        let rays: Vec<u8> = file.section("rays")?;
        if !rays.is_empty() {
            file.expect_one_per_vertex("rays", rays.len())?;
        }
        file.expect_counts("rays", &rays)?;
        let layers = Layers::read(&mut file)?;
        let Source { record, lattice, .. } = file;
        Ok(Self { record, lattice, support, deviations: deviations.into(), rays: rays.into(), layers })
    }
}
