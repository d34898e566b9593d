//! The parts of a run. Only one of them at a time needs to be in memory.

use std::borrow::Cow;
use std::path::PathBuf;

use crate::Result;
use crate::geometry::Lattice;
use crate::rays::RaySet;
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
}

/// A part of a run: a field in memory, or in a file.
pub trait Part {
    /// What is known before its sums are read; messages count parts from 1.
    fn head(&self, number: usize) -> Result<Head>;
    /// The whole part.
    fn field(&self) -> Result<Cow<'_, UncertaintyField>>;
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
        })
    }

    fn field(&self) -> Result<Cow<'_, UncertaintyField>> {
        Ok(Cow::Borrowed(self))
    }
}

impl Part for PathBuf {
    fn head(&self, _number: usize) -> Result<Head> {
        UncertaintyField::read_head(self)
    }

    fn field(&self) -> Result<Cow<'_, UncertaintyField>> {
        UncertaintyField::read(self).map(Cow::Owned)
    }
}

/// The heads of all parts.
pub fn heads(parts: &[impl Part]) -> Result<Vec<Head>> {
    (1..).zip(parts).map(|(number, part)| part.head(number)).collect()
}
