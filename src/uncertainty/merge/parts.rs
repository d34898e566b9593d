//! The parts of a run. The sums of a file are read vertex by vertex.

use std::borrow::Cow;
use std::path::PathBuf;

use crate::Result;
use crate::geometry::Lattice;
use crate::posterior::VertexSums;
use crate::rays::RaySet;
use crate::uncertainty::layers::Layers;
use crate::uncertainty::{RunRecord, Support, UncertaintyField};

/// What is known of a part before its sums are read.
#[derive(Debug, Clone)]
pub struct Head {
    /// What messages call it.
    pub name: String,
    pub record: RunRecord,
    pub lattice: Lattice,
    pub ray_sets: Vec<RaySet>,
    pub is_dense: bool,
    pub has_error_bars: bool,
    pub has_sums: bool,
}

/// A part of a run: a field in memory, or in a file, which must not change after its head was read.
pub trait Part {
    /// What is known before its sums are read; messages count parts from 1.
    fn head(&self, number: usize) -> Result<Head>;
    /// Where its vertices are, and its layers; they may lack the sums.
    fn without_sums(&self, head: &Head) -> Result<(Cow<'_, Support>, Cow<'_, Layers>)>;
    /// Calls `visit` with the sums at each of its `vertices`, in their order.
    fn each_sums(&self, head: &Head, vertices: u64, visit: &mut dyn FnMut(VertexSums) -> Result<()>) -> Result<()>;
}

impl Part for UncertaintyField {
    fn head(&self, number: usize) -> Result<Head> {
        Ok(Head {
            name: format!("field {number}"),
            record: self.record.clone(),
            lattice: self.lattice,
            ray_sets: self.ray_sets().to_vec(),
            is_dense: matches!(self.support, Support::Dense),
            has_error_bars: self.error_bars().is_some(),
            has_sums: self.sums().is_some(),
        })
    }

    fn without_sums(&self, _head: &Head) -> Result<(Cow<'_, Support>, Cow<'_, Layers>)> {
        Ok((Cow::Borrowed(&self.support), Cow::Borrowed(&self.layers)))
    }

    fn each_sums(&self, _head: &Head, _vertices: u64, visit: &mut dyn FnMut(VertexSums) -> Result<()>) -> Result<()> {
        self.sums().into_iter().flatten().copied().try_for_each(visit)
    }
}

impl<P: Part> Part for &P {
    fn head(&self, number: usize) -> Result<Head> {
        (*self).head(number)
    }

    fn without_sums(&self, head: &Head) -> Result<(Cow<'_, Support>, Cow<'_, Layers>)> {
        (*self).without_sums(head)
    }

    fn each_sums(&self, head: &Head, vertices: u64, visit: &mut dyn FnMut(VertexSums) -> Result<()>) -> Result<()> {
        (*self).each_sums(head, vertices, visit)
    }
}

impl Part for PathBuf {
    fn head(&self, _number: usize) -> Result<Head> {
        UncertaintyField::read_head(self)
    }

    fn without_sums(&self, head: &Head) -> Result<(Cow<'_, Support>, Cow<'_, Layers>)> {
        let (support, layers) = UncertaintyField::read_without_sums(self, head)?;
        Ok((Cow::Owned(support), Cow::Owned(layers)))
    }

    fn each_sums(&self, head: &Head, vertices: u64, visit: &mut dyn FnMut(VertexSums) -> Result<()>) -> Result<()> {
        UncertaintyField::each_sums(self, head, vertices, visit)
    }
}

/// The heads of all parts.
pub fn heads(parts: &[impl Part]) -> Result<Vec<Head>> {
    (1..).zip(parts).map(|(number, part)| part.head(number)).collect()
}
