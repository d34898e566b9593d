//! Sums over the rays, from which every covariance can be computed, and which other rays can be added to.

use serde_json::Value;

use super::super::file::Source;
use super::{Change, Layer, Sections};
use crate::io::container::{Item, Section};
use crate::posterior::{FactoredSums, VertexSums};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

impl Layer for Vec<VertexSums> {
    const NAME: &'static str = "sums";
    const DEPENDS_ON: &'static [Change] = &[Change::Matrices, Change::Vertices];
    const WITHOUT: &'static str = "one covariance, and no merging; uncertainty --keep-sums keeps what both need";

    /// Exact sums of shards add up to those of one run. Their factors take half as much, and answer for every
    /// covariance to within 1e-6 decades.
    fn sections(&self, to_be_merged: bool) -> Sections<'_> {
        match to_be_merged {
            true => vec![("exact", Box::new(self.as_slice()))],
            false => vec![("factors", Box::new(Factors(self)))],
        }
    }

    fn read(_head: Value, file: &mut Source) -> Result<Self> {
        let (mut all, vertices) = (Self::new(), file.vertices as usize);
        each_sums(file, |sums| {
            // The file has as many, or this is not called.
            all.reserve_exact(vertices - all.len());
            all.push(sums);
            Ok(())
        })?;
        Ok(all)
    }

    // A merge adds them at the vertices of another octree, which it finds by them.

    fn memory(&self) -> usize {
        self.capacity() * size_of::<VertexSums>()
    }

    fn info(&self) -> String {
        "every covariance, and merging with fields of other rays".into()
    }
}

/// Reads sums and checks them: calls `visit` with those of each vertex, in their order.
pub fn each_sums(file: &mut Source, mut visit: impl FnMut(VertexSums) -> Result<()>) -> Result<()> {
    let (name, path) = (if file.bytes("exact") > 0 { "exact" } else { "factors" }, file.path.clone());
    let wrong = |section: &str, i: usize, expected: &str, found: String| {
        Error::malformed(&path, format!("section `{section}`, entry {i}"), expected, found)
    };
    let mut visit = |i: usize, sums: VertexSums| {
        if sums.is_valid() {
            visit(sums)
        } else {
            Err(wrong("sums", i, "sums that rays can give", format!("{sums:?}")))
        }
    };
    let size = if name == "exact" { VertexSums::SIZE } else { FactoredSums::SIZE };
    file.expect_one_per_vertex("sums", file.bytes(name) as usize / size)?;
    if name == "exact" {
        file.each(name, visit)
    } else {
        file.each(name, |i, factor: FactoredSums| {
            if !factor.is_valid() {
                return Err(wrong(name, i, "a Cholesky factor", format!("{factor:?}")));
            }
            visit(i, factor.sums())
        })
    }
}

/// Sums, written as their factors. These are computed on the way: all of them would take half as much again as the
/// sums.
struct Factors<'a>(&'a [VertexSums]);

impl Section for Factors<'_> {
    fn visit(&self, visit: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        self.0.chunks(1 << 14).try_for_each(|sums| {
            let factors: Vec<FactoredSums> = sums.iter().map(Into::into).collect();
            factors.as_slice().visit(visit)
        })
    }
}

impl UncertaintyField {
    /// `[vertices]`: sums over the rays, if kept.
    #[must_use]
    pub fn sums(&self) -> Option<&[VertexSums]> {
        self.layers.sums.as_deref()
    }

    /// The same field without its sums: a tenth of the memory, but the covariance is fixed.
    #[must_use]
    pub fn without_sums(mut self) -> Self {
        if self.layers.sums.is_some() {
            self.layers.drop_dependent(Change::Matrices);
        }
        self
    }

    /// The same field without what queries do not need. A part of a run keeps its sums: it is of no use without
    /// the other parts.
    #[must_use]
    pub fn for_queries(self) -> Self {
        if self.is_part() { self } else { self.without_sums() }
    }
}
