//! The vertices of one level in a field file: the octree that they belong to, their σ, and their sums.

use std::path::Path;

use super::Kind;
use crate::geometry::Lattice;
use crate::io::container::{Reader, Section};
use crate::octree::{MaxLevels, Octree};
use crate::posterior::{FactoredSums, VertexSums};
use crate::uncertainty::{Protocol, RayCounts, StandardDeviations, Support, UncertaintyField, vertex_count};
use crate::{Error, Result};

/// What the header says of a coarser level.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct Coarser {
    kind: Kind,
    /// Its prior precision λ, 1 / scene unit².
    pub(super) lambda: f64,
}

/// Sums, written as their factors. These are computed on the way: all of them would take half as much again as the
/// sums.
pub(super) struct Factors<'a>(pub(super) &'a [VertexSums]);

impl Section for Factors<'_> {
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        self.0.chunks(1 << 14).try_for_each(|sums| {
            let factors: Vec<FactoredSums> = sums.iter().map(Into::into).collect();
            factors.as_slice().visit(visit)
        })
    }
}

/// The sections of a coarser level while they are written.
pub(super) struct Written<'a> {
    masks: Vec<u8>,
    values: &'a [f32],
    factors: Factors<'a>,
}

impl<'a> Written<'a> {
    /// What the header says of a coarser level, and its sections.
    pub(super) fn new(field: &'a UncertaintyField) -> (Coarser, Self) {
        let (kind, masks) = Kind::and_masks(&field.support);
        let factors = Factors(field.sums.as_deref().unwrap_or_default());
        (Coarser { kind, lambda: field.protocol.lambda }, Self { masks, values: &field.deviations.0, factors })
    }

    /// The sections, as long as their `names` live.
    pub(super) fn sections<'s>(&'s self, names: &'s [String; 3]) -> [(&'s str, &'s dyn Section); 3] {
        let [masks, deviations, factors] = names;
        [(masks, &self.masks), (deviations, &self.values), (factors, &self.factors)]
    }
}

/// The sections of the level that is so many below the field's own.
pub(super) fn names(below: usize) -> [String; 3] {
    ["masks", "deviations", "factors"].map(|name| format!("{name} {below}"))
}

/// The sums in the section of factors of this name, if there is one.
pub(super) fn read_factors(path: &Path, file: &mut Reader, name: &str) -> Result<Vec<VertexSums>> {
    let factors = file.optional::<FactoredSums>(name)?;
    if let Some(i) = factors.iter().position(|factor| !factor.is_valid()) {
        let found = format!("{:?}", factors[i]);
        return Err(Error::malformed(path, format!("section `{name}`, entry {i}"), "a Cholesky factor", found));
    }
    Ok(factors.iter().map(FactoredSums::sums).collect())
}

/// The vertices of one level, before they are checked.
pub(super) struct Vertices {
    pub(super) masks: Vec<u8>,
    pub(super) deviations: Vec<f32>,
    /// Empty if they were not kept.
    pub(super) sums: Vec<VertexSums>,
}

impl Vertices {
    /// Reads the level that is so many below the field's own.
    pub(super) fn of_coarser(path: &Path, file: &mut Reader, below: usize) -> Result<Self> {
        let [masks, deviations, factors] = names(below);
        let (masks, deviations) = (file.section(&masks)?, file.section(&deviations)?);
        Ok(Self { masks, deviations, sums: read_factors(path, file, &factors)? })
    }

    /// The level that is so many below the `field`'s own, and of the same rays.
    pub(super) fn into_coarser(
        self,
        path: &Path,
        field: &UncertaintyField,
        below: u8,
        head: Coarser,
    ) -> Result<UncertaintyField> {
        let Coarser { kind, lambda } = head;
        let lattice = field.lattice.coarsened(field.lattice.level() - below);
        let (support, deviations, sums) = self.check(path, &lattice, &kind, &format!(" {below}"))?;
        if sums.is_some() != field.sums.is_some() {
            let words = |has| if has { "sums" } else { "no sums" };
            let [expected, found] = [&field.sums, &sums].map(|sums| words(sums.is_some()));
            return Err(Error::malformed(path, format!("section `factors {below}`"), expected, found));
        }
        let protocol = Protocol { lambda, ..field.protocol.clone() };
        let values = (deviations, RayCounts::default());
        let draws = field.draws.clone();
        let limits = MaxLevels::none(lattice.level());
        Ok(UncertaintyField {
            sums,
            draws,
            ..UncertaintyField::from_values(protocol, lattice, support, limits, values)
        })
    }

    /// Checks that they are vertices of a field on `lattice`. `level` is what the names of their sections end with.
    pub(super) fn check(
        self,
        path: &Path,
        lattice: &Lattice,
        kind: &Kind,
        level: &str,
    ) -> Result<(Support, StandardDeviations, Option<Vec<VertexSums>>)> {
        let Self { masks, deviations, sums } = self;
        let wrong = |section: &str, entry: Option<usize>, expected: &str, found: String| {
            let entry = entry.map_or(String::new(), |i| format!(", entry {i}"));
            Err(Error::malformed(path, format!("section `{section}{level}`{entry}"), expected, found))
        };
        let support = match kind {
            Kind::Dense => Support::Dense,
            Kind::Octree { root_split } => match Octree::from_raw(lattice.level(), *root_split, &masks) {
                Ok(octree) => Support::Octree(octree),
                Err(problem) => return wrong("masks", None, "a balanced octree", problem),
            },
        };
        let vertices = vertex_count(lattice, &support);
        for (name, count) in [("deviations", deviations.len()), ("sums", sums.len())] {
            if count as u64 != vertices && (name == "deviations" || count != 0) {
                return wrong(name, None, &format!("{vertices} entries, one per vertex"), count.to_string());
            }
        }
        if let Some(i) = deviations.iter().position(|d| !(*d > 0.0 && d.is_finite())) {
            return wrong("deviations", Some(i), "a positive number", deviations[i].to_string());
        }
        if let Some(i) = sums.iter().position(|e| !e.is_valid()) {
            return wrong("sums", Some(i), "sums that rays can give", format!("{:?}", sums[i]));
        }
        Ok((support, StandardDeviations(deviations), (!sums.is_empty()).then_some(sums)))
    }
}
