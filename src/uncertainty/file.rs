//! The field file, `.oct`: a [container] with the sections
//!
//! ```text
//! masks        u8         child masks of the octree, breadth first (empty for a dense grid)
//! deviations   f32        σ_v (none if `logs` holds them), by vertex id (octree: the finest first, in Morton order) or x slowest (dense)
//! evidence     64 bytes   f64 × 6 information, f32 × 3 gradient, u32 rays; or empty
//! surface      f32 × 3    points on visible surfaces
//! logs         u16        bits of f16: log10(σ_v / unit), in the same order; the header has the unit
//! limits       u64        the regions' level, then region · 256 + limit; empty if nothing is limited
//! errors       u16        number of groups, then bits of f16: errors of log10 σ_v, NaN where not known; or empty
//! draws        u64 × 4    the rays that were summed: seed, rays of the run, index and number of its parts; or empty
//! origin       u8         checksums of model and cameras, JSON
//! ```
//!
//! A file has the lowest version that holds the field: version 1 ends before `errors`, version 2 before `draws`, and
//! version 3 before `origin`. Without draws the rays are of the one sequence of pixels that the header names, or not known.
//!
//! The octree is rebuilt from its masks, so a file cannot hold an inconsistent one.

use std::path::Path;

use half::f16;

use super::{ErrorBars, Origin, Protocol, StandardDeviations, Support, UncertaintyField, vertex_count};
use crate::geometry::Lattice;
use crate::io::container::{self, Format, Reader};
use crate::octree::{MaxLevels, Octree};
use crate::posterior::VertexSums;
use crate::rays::{Draw, Shard};
use crate::{Error, Result};

/// The newest version that this crate reads and writes.
pub const FORMAT_VERSION: u32 = 4;
const FORMAT: Format = (b"OCTOBAY\n", FORMAT_VERSION);
/// Sections of version 1; each later version has one more.
const PLAIN: usize = 6;

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    protocol: Protocol,
    lattice: Lattice,
    kind: Kind,
    /// Unit of the logarithms, scene units; `None` if deviations are f32.
    unit: Option<f32>,
}

#[derive(serde::Serialize, serde::Deserialize)]
enum Kind {
    Dense,
    Octree { root_split: bool },
}

impl UncertaintyField {
    /// Writes the field; the file appears complete or not at all.
    ///
    /// # Errors
    /// If the folder cannot be written or the disk is full.
    pub fn write(&self, path: &Path) -> Result<()> {
        let (kind, masks) = match &self.support {
            Support::Dense => (Kind::Dense, Vec::new()),
            Support::Octree(octree) => {
                let (root_split, masks) = octree.cells().raw();
                (Kind::Octree { root_split }, masks)
            }
        };
        let (unit, values, logs) = match &self.deviations {
            StandardDeviations::F32(values) => (None, values.as_slice(), Vec::new()),
            StandardDeviations::F16 { unit, logs } => {
                (Some(*unit), &[][..], logs.iter().map(|v| v.to_bits()).collect())
            }
        };
        let header = Header { protocol: self.protocol.clone(), lattice: self.lattice, kind, unit };
        let sums = self.sums.as_deref().unwrap_or_default();
        let limits = self.limits.packed().unwrap_or_default();
        let errors = self.error_bars.as_ref().map(ErrorBars::words).unwrap_or_default();
        let is_implied = self.draws.iter().copied().eq(self.protocol.draw());
        let draws: Vec<[u64; 4]> = self
            .draws
            .iter()
            .filter(|_| !is_implied)
            .map(|Draw { seed, share }| [*seed, share.rays, share.index, share.of])
            .collect();
        let (masks, surface, logs) = (masks.as_slice(), self.surface.as_slice(), logs.as_slice());
        let (limits, errors, draws) = (limits.as_slice(), errors.as_slice(), draws.as_slice());
        let has_origin = self.protocol.origin != Origin::default();
        let failed = |e: serde_json::Error| Error::malformed(path, "origin", "checksums", e.to_string());
        let origin = serde_json::to_vec(&self.protocol.origin).map_err(failed)?;
        let origin = origin.as_slice();
        let mut sections: Vec<&dyn container::Section> =
            vec![&masks, &values, &sums, &surface, &logs, &limits, &errors, &draws, &origin];
        let needed = match (has_origin, draws.is_empty(), errors.is_empty()) {
            (true, ..) => PLAIN + 3,
            (_, false, _) => PLAIN + 2,
            (.., false) => PLAIN + 1,
            _ => PLAIN,
        };
        sections.truncate(needed);
        container::write(path, (FORMAT.0, (needed - PLAIN) as u32 + 1), &header, &sections)
    }

    /// Reads a field.
    ///
    /// # Errors
    /// If the file is missing, or is not a complete, unaltered field of a version that is known.
    pub fn read(path: &Path) -> Result<Self> {
        let (header, mut file) = Reader::open::<Header>(path, FORMAT, PLAIN..=PLAIN + 3)?;
        // Deserialising bypasses the constructors' checks.
        let lattice = header.lattice.domain().checked();
        let lattice = lattice
            .and_then(|domain| Lattice::of_domain(domain, header.lattice.level()))
            .map_err(|e| Error::malformed(path, "header", "a valid domain and level", e.to_string()))?;
        let mut protocol = header.protocol;
        if !protocol.is_possible() {
            let expected = "a protocol that a run can have";
            return Err(Error::malformed(path, "header", expected, format!("{protocol:?}")));
        }
        let masks = file.section::<u8>("masks")?;
        let values = file.section::<f32>("deviations")?;
        let sums = file.section::<VertexSums>("sums")?;
        let surface = file.section::<[f32; 3]>("surface")?;
        if let Some(i) = surface.iter().position(|x| !x.iter().all(|v| v.is_finite())) {
            let found = format!("{:?}", surface[i]);
            return Err(Error::malformed(path, format!("section `surface`, point {i}"), "finite coordinates", found));
        }
        let logs = file.section::<u16>("logs")?;
        let deviations = match header.unit {
            None if logs.is_empty() => StandardDeviations::F32(values),
            Some(unit) if values.is_empty() => {
                StandardDeviations::F16 { unit, logs: logs.into_iter().map(f16::from_bits).collect() }
            }
            _ => {
                let found = format!("{} and {}", values.len(), logs.len());
                return Err(Error::malformed(path, "sections `deviations` and `logs`", "one of them empty", found));
            }
        };
        let limits = match file.section::<u64>("limits")?.as_slice() {
            [] => MaxLevels::none(lattice.level()),
            packed => MaxLevels::from_packed(lattice.level(), packed)
                .ok_or_else(|| Error::malformed(path, "section `limits`", "balanced limits to refinement", "others"))?,
        };

        let support =
            match header.kind {
                Kind::Dense => Support::Dense,
                Kind::Octree { root_split } => Octree::from_raw(lattice.level(), root_split, &masks)
                    .map(Support::Octree)
                    .map_err(|problem| Error::malformed(path, "section `masks`", "a balanced octree", problem))?,
            };
        let vertices = vertex_count(&lattice, &support);
        let counts = [("deviations", deviations.len()), ("sums", sums.len())];
        for (name, count) in counts {
            if count as u64 != vertices && !(name == "sums" && count == 0) {
                let expected = format!("{vertices} entries, one per vertex");
                return Err(Error::malformed(path, format!("section `{name}`"), expected, count.to_string()));
            }
        }
        if let Some(i) = deviations.iter().position(|d| !(d > 0.0 && d.is_finite())) {
            let found = deviations.get(i).to_string();
            return Err(Error::malformed(path, format!("section `deviations`, entry {i}"), "a positive number", found));
        }
        if let Some(i) = sums.iter().position(|e| !e.is_valid()) {
            let found = format!("{:?}", sums[i]);
            return Err(Error::malformed(path, format!("section `sums`, entry {i}"), "sums that rays can give", found));
        }
        let sums = (!sums.is_empty()).then_some(sums);
        let has_origin = file.left() > 2;
        let words = if file.left() > 0 { Some(file.section::<u16>("errors")?) } else { None };
        let draws = if file.left() > 0 { Some(file.section::<[u64; 4]>("draws")?) } else { None };
        if file.left() > 0 {
            protocol.origin = serde_json::from_slice(&file.section::<u8>("origin")?).map_err(|e| {
                Error::malformed(path, "section `origin`", "checksums of model and cameras", e.to_string())
            })?;
        }
        // Only where another section follows may they be empty.
        let words = words.filter(|words| draws.is_none() || !words.is_empty());
        let draws = draws.filter(|draws| !has_origin || !draws.is_empty());
        let error_bars = words.map(|words| ErrorBars::from_words(&words, vertices)).transpose();
        let error_bars =
            error_bars.map_err(|(expected, found)| Error::malformed(path, "section `errors`", expected, found))?;
        let draws: Vec<Draw> = match draws {
            Some(draws) => draws
                .into_iter()
                .map(|[seed, rays, index, of]| Draw { seed, share: Shard { rays, index, of } })
                .collect(),
            None => protocol.draw().into_iter().collect(),
        };
        if !draws.iter().all(|draw| draw.share.is_valid()) || !Draw::are_disjoint(draws.iter().copied()) {
            let found = "an empty part, or two that may have rays in common";
            return Err(Error::malformed(path, "section `draws`", "parts of runs, each ray in one of them", found));
        }
        Ok(Self { protocol, lattice, support, limits, deviations, sums, error_bars, surface, draws })
    }
}
