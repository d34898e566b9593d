//! The field file, `.oct`.
//!
//! It is a [container] whose header holds protocol, lattice and draws, with the sections
//!
//! ```text
//! masks        u8         child masks of the octree, breadth first (empty for a dense grid)
//! deviations   f32        σ_v, by vertex (octree: finest first, in Morton order; dense: x slowest); or empty
//! sums         64 bytes   f64 × 6 information, f32 × 3 gradient, u32 rays; or empty
//! surface      f32 × 3    points on visible surfaces
//! logs         u16        instead of `deviations`: bits of f16, log10(σ_v / unit); the header has the unit
//! limits       u64        the regions' level, then region · 256 + limit; empty if nothing is limited
//! errors       u16        number of groups, then bits of f16: errors of log10 σ_v, NaN where not known; or empty
//! ```
//!
//! The octree is rebuilt from its masks, so a file cannot hold an inconsistent one. Versions 1 and 2 can be
//! [read](legacy) too.

mod legacy;

use std::path::Path;

use half::f16;

use super::{ErrorBars, Protocol, StandardDeviations, Support, UncertaintyField, vertex_count};
use crate::geometry::Lattice;
use crate::io::container::{self, Format, Reader};
use crate::octree::{MaxLevels, Octree};
use crate::posterior::VertexSums;
use crate::rays::Draw;
use crate::{Error, Result};

/// The newest version that this crate reads, and the one that it writes.
pub const FORMAT_VERSION: u32 = 3;
const FORMAT: Format = (b"OCTOBAY\n", FORMAT_VERSION);

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    protocol: Protocol,
    lattice: Lattice,
    kind: Kind,
    /// Unit of the logarithms, scene units; `None` if deviations are f32.
    unit: Option<f32>,
    /// The rays that were summed, by sequence of pixels; empty if unknown.
    draws: Vec<Draw>,
}

#[derive(serde::Serialize, serde::Deserialize)]
enum Kind {
    Dense,
    Octree { root_split: bool },
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
        let (unit, values, logs) = match &self.deviations {
            StandardDeviations::F32(values) => (None, values.as_slice(), Vec::new()),
            StandardDeviations::F16 { unit, logs } => {
                (Some(*unit), &[][..], logs.iter().map(|v| v.to_bits()).collect())
            }
        };
        let (protocol, draws) = (self.protocol.clone(), self.draws.clone());
        let header = Header { protocol, lattice: self.lattice, kind, unit, draws };
        let sums = self.sums.as_deref().unwrap_or_default();
        let limits = self.limits.packed().unwrap_or_default();
        let errors = self.error_bars.as_ref().map(ErrorBars::words).unwrap_or_default();
        let (masks, surface, logs) = (masks.as_slice(), self.surface.as_slice(), logs.as_slice());
        let (limits, errors) = (limits.as_slice(), errors.as_slice());
        container::write(
            path,
            FORMAT,
            &header,
            &[
                ("masks", &masks),
                ("deviations", &values),
                ("sums", &sums),
                ("surface", &surface),
                ("logs", &logs),
                ("limits", &limits),
                ("errors", &errors),
            ],
        )
    }

    /// Reads a field.
    ///
    /// # Errors
    /// If the file is missing, or is not a complete, unaltered field of a known version.
    pub fn read(path: &Path) -> Result<Self> {
        let is_old = container::version(path, FORMAT)? < FORMAT_VERSION;
        let (header, mut file) = if is_old { legacy::open(path)? } else { Reader::open::<Header>(path, FORMAT)? };
        // Deserialisation bypasses the checks of the constructors.
        let lattice = header.lattice.domain().checked();
        let lattice = lattice
            .and_then(|domain| Lattice::of_domain(domain, header.lattice.level()))
            .map_err(|e| Error::malformed(path, "header", "a valid domain and level", e.to_string()))?;
        let protocol = header.protocol;
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
        let words = file.section::<u16>("errors")?;
        let error_bars = (!words.is_empty()).then(|| ErrorBars::from_words(&words, vertices)).transpose();
        let error_bars =
            error_bars.map_err(|(expected, found)| Error::malformed(path, "section `errors`", expected, found))?;
        let draws = header.draws;
        if !draws.iter().all(|draw| draw.shard.is_valid()) || !Draw::are_disjoint(draws.iter().copied()) {
            let found = "an empty part, or two that may have rays in common";
            return Err(Error::malformed(path, "header, draws", "parts of runs, each ray in one of them", found));
        }
        Ok(Self { protocol, lattice, support, limits, deviations, sums, error_bars, surface, draws })
    }
}
