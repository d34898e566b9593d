//! Limits of the leaves on which rays were summed.

use serde_json::Value;

use super::super::file::Source;
use super::{Layer, Layers, Merge, Sections};
use crate::Result;
use crate::geometry::Lattice;
use crate::octree::MaxLevels;
use crate::uncertainty::UncertaintyField;

impl Layer for MaxLevels {
    const NAME: &'static str = "limits";
    /// Only fields of the same limits are added.
    const MERGE: Merge<Self> = Some(|sum, _| sum);
    const WITHOUT: &'static str = "leaves may be as fine as the finest level";

    fn sections(&self, _to_be_merged: bool) -> Sections<'_> {
        vec![("limits", Box::new(self.packed().unwrap_or_default()))]
    }

    fn read(_head: Value, file: &mut Source) -> Result<Self> {
        let packed = file.section("limits")?;
        Self::from_packed(file.lattice.level(), &packed)
            .ok_or_else(|| file.malformed("section `limits`", "balanced limits to refinement", "others"))
    }

    fn memory(&self) -> usize {
        self.heap_bytes()
    }

    fn info(&self) -> String {
        "leaves were kept coarse where rays were few".into()
    }
}

impl Layers {
    /// Limits of the leaves on which rays were summed.
    #[must_use]
    pub fn limits(&self, lattice: &Lattice) -> MaxLevels {
        self.limits.clone().unwrap_or_else(|| MaxLevels::none(lattice.level()))
    }
}

impl UncertaintyField {
    /// Limits of the leaves on which rays were summed.
    #[must_use]
    pub fn limits(&self) -> MaxLevels {
        self.layers.limits(&self.lattice)
    }
}
