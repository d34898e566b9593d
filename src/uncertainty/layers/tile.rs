//! The part of space that a field is of, if not all.

use serde_json::{Value, json};

use super::super::file::Source;
use super::{Layer, Merge};
use crate::Result;
use crate::octree::Tile;
use crate::uncertainty::UncertaintyField;

impl Layer for Tile {
    const NAME: &'static str = "tile";
    /// Only shards of one tile are added.
    const MERGE: Merge<Self> = Some(|sum, _| sum);
    const WITHOUT: &'static str = "all of space";

    fn head(&self) -> Value {
        json!(self)
    }

    fn read(head: Value, file: &mut Source) -> Result<Self> {
        let head: Self = file.head(Self::NAME, head)?;
        if file.is_dense || !head.fits(file.lattice.level()) {
            return Err(file.malformed("header, tile", "a part of an octree's box", format!("{head:?}")));
        }
        Ok(head)
    }

    fn info(&self) -> String {
        format!("{} of {}: all else is as if never seen", self.index, self.of)
    }
}

impl UncertaintyField {
    /// The part of space that the sums are of, or that a finished tile answers for; `None` if all.
    #[must_use]
    pub fn tile(&self) -> Option<Tile> {
        self.layers.tile
    }
}
