//! The parts of a run, of which one at a time needs to be in memory.

use std::borrow::Cow;
use std::path::PathBuf;

use crate::Result;
use crate::geometry::Lattice;
use crate::octree::Tile;
use crate::rays::Draw;
use crate::uncertainty::{Protocol, Support, UncertaintyField};

/// What is known of a part before its sums are read.
#[derive(Debug, Clone)]
pub struct Head {
    /// What messages call it.
    pub name: String,
    pub protocol: Protocol,
    pub lattice: Lattice,
    pub draws: Vec<Draw>,
    pub tile: Option<Tile>,
    pub is_dense: bool,
    /// Whether it can be merged, and not only asked.
    pub has_sums: bool,
    pub has_error_bars: bool,
}

impl Head {
    pub fn of(name: String, field: &UncertaintyField) -> Self {
        Self {
            name,
            protocol: field.protocol.clone(),
            lattice: field.lattice,
            draws: field.draws.clone(),
            tile: field.tile,
            is_dense: matches!(field.support, Support::Dense),
            has_sums: field.sums.is_some(),
            has_error_bars: field.error_bars.is_some(),
        }
    }
}

/// Parts in memory or in files.
pub trait Parts {
    /// What is known of each of them.
    fn heads(&self) -> Result<Vec<Head>>;
    /// Part `i`, whole.
    fn part(&self, i: usize) -> Result<Cow<'_, UncertaintyField>>;
}

impl Parts for [UncertaintyField] {
    fn heads(&self) -> Result<Vec<Head>> {
        Ok((1..).zip(self).map(|(number, field)| Head::of(format!("field {number}"), field)).collect())
    }

    fn part(&self, i: usize) -> Result<Cow<'_, UncertaintyField>> {
        Ok(Cow::Borrowed(&self[i]))
    }
}

impl Parts for [PathBuf] {
    fn heads(&self) -> Result<Vec<Head>> {
        self.iter().map(|path| UncertaintyField::read_head(path)).collect()
    }

    fn part(&self, i: usize) -> Result<Cow<'_, UncertaintyField>> {
        UncertaintyField::read(&self[i]).map(Cow::Owned)
    }
}
