//! What a field may have beside its values, each in a file of its own: what it is, what it depends on, how it is
//! written, read, merged and reported.
//!
//! A new layer is a type that implements [`Layer`], and one line of `layers!` below.

mod conformal;
pub(super) mod error_bars;
mod error_summary;
mod limits;
mod ray_coverage;
mod ray_sets;
mod sums;
mod surface;

use serde_json::{Map, Value};

pub use self::conformal::Conformal;
pub use self::error_bars::ErrorBars;
pub use self::error_summary::ErrorSummary;
pub(super) use self::sums::each_sums;
use super::file::Source;
use crate::Result;
use crate::io::container::Section;
use crate::octree::MaxLevels;
use crate::posterior::{RayCoverage, VertexSums};
use crate::rays::RaySet;

/// What may change about a field, so that layers no longer describe it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// The covariance that σ is read by.
    Covariance,
    /// λ, and with it the scale.
    Prior,
    /// The sums are dropped, and with them the directions of covariances.
    Matrices,
    /// Values move to the vertices of another grid.
    Vertices,
}

/// The sections of a layer, by name.
pub type Sections<'a> = Vec<(&'static str, Box<dyn Section + 'a>)>;

/// How a layer is merged, if it is.
pub type Merge<L> = Option<fn(Option<L>, Option<&L>) -> Option<L>>;

/// Something that a field may have, or not.
pub trait Layer: Sized {
    /// What files and reports call it.
    const NAME: &'static str;
    /// Changes after which it no longer describes the field.
    const DEPENDS_ON: &'static [Change] = &[];
    /// Adds that of other rays to what the fields before had, if they had it. Without, a merge drops it.
    const MERGE: Merge<Self> = None;
    /// The line that `info` prints for a field without it.
    const WITHOUT: &'static str;

    /// Its entry in the file's header.
    fn head(&self) -> Value {
        Value::Null
    }

    /// Its sections in the file, exact if it is still `to_be_merged`.
    fn sections(&self, _to_be_merged: bool) -> Sections<'_> {
        Vec::new()
    }

    /// Reads and checks its header and its sections.
    fn read(head: Value, file: &mut Source) -> Result<Self>;

    /// Bytes on the heap, spare capacity included.
    fn memory(&self) -> usize {
        0
    }

    /// The line that `info` prints for it.
    fn info(&self) -> String;
}

/// Makes [`Layers`] of all layers, in the order of their sections.
macro_rules! layers {
    ($($(#[$doc:meta])* $name:ident: $layer:ty,)*) => {
        /// All that a field has beside its values.
        #[derive(Debug, Clone, Default, PartialEq)]
        pub struct Layers {
            $($(#[$doc])* pub $name: Option<$layer>,)*
        }

        /// The names of all layers.
        #[cfg(test)]
        const NAMES: [&str; [$(<$layer>::NAME),*].len()] = [$(<$layer>::NAME),*];

        impl Layers {
            /// Drops what no longer describes the field.
            pub fn drop_dependent(&mut self, change: Change) {
                $(self.$name = self.$name.take().filter(|_| !<$layer>::DEPENDS_ON.contains(&change));)*
            }

            /// Of the first field to merge.
            pub fn to_merge(&self) -> Self {
                Self { $($name: <$layer>::MERGE.and_then(|_| self.$name.clone()),)* }
            }

            /// Adds those of the next field.
            pub fn merge(&mut self, part: &Self) {
                $(self.$name = <$layer>::MERGE.and_then(|add| add(self.$name.take(), part.$name.as_ref()));)*
            }

            /// What stands in the header of a file, by name.
            pub fn heads(&self) -> Map<String, Value> {
                let heads = [$(self.$name.as_ref().map(|own| (<$layer>::NAME, own.head()))),*];
                heads.into_iter().flatten().map(|(name, head)| (name.to_string(), head)).collect()
            }

            /// All sections of a file.
            pub fn sections(&self, to_be_merged: bool) -> Sections<'_> {
                let sections = [$(self.$name.as_ref().map(|own| own.sections(to_be_merged))),*];
                sections.into_iter().flatten().flatten().collect()
            }

            /// Reads all layers. A layer may use those before it.
            pub fn read(file: &mut Source) -> Result<Self> {
                $(file.layers.$name = file.layer()?;)*
                if file.is_dense && file.layers.limits.is_some() {
                    return Err(file.malformed("header, limits", "none on a dense grid", "some"));
                }
                Ok(std::mem::take(&mut file.layers))
            }

            /// Bytes on the heap by layer.
            pub fn memory(&self) -> Vec<(&'static str, usize)> {
                let parts = [$(self.$name.as_ref().map(|own| (<$layer>::NAME, own.memory()))),*];
                parts.into_iter().flatten().filter(|(_, bytes)| *bytes > 0).collect()
            }

            /// The name of every layer and its line in `info`; the line without it as an error.
            pub fn info(&self) -> Vec<(&'static str, std::result::Result<String, &'static str>)> {
                vec![$((<$layer>::NAME, self.$name.as_ref().map(Layer::info).ok_or(<$layer>::WITHOUT))),*]
            }

            /// Names of those that the field has.
            #[cfg(test)]
            pub fn names(&self) -> Vec<&'static str> {
                self.info().into_iter().filter(|(_, found)| found.is_ok()).map(|(name, _)| name).collect()
            }

            /// Removes the layer of this name.
            #[cfg(test)]
            pub fn remove(&mut self, name: &str) {
                $(self.$name = self.$name.take().filter(|_| <$layer>::NAME != name);)*
            }

            /// Every layer, what it depends on, and whether a merge keeps it.
            #[cfg(test)]
            fn table() -> Vec<(&'static str, &'static [Change], bool)> {
                vec![$((<$layer>::NAME, <$layer>::DEPENDS_ON, <$layer>::MERGE.is_some())),*]
            }
        }
    };
}

layers! {
    /// The rays that were summed, if known; never empty.
    ray_sets: Vec<RaySet>,
    /// `[vertices]`: sums over the rays, if kept, from which other covariances can be computed.
    sums: Vec<VertexSums>,
    /// `[n]`: points on visible surfaces, scene units, for comparisons; never empty.
    surface: Vec<[f32; 3]>,
    /// Rays that reached each part of space, if known.
    ray_coverage: RayCoverage,
    /// Limits of the leaves on which rays were summed, if there were any.
    limits: MaxLevels,
    /// `[vertices]`: errors of log10 σ_v relative to its limit, if independent groups of rays were compared.
    error_bars: ErrorBars,
    /// An interval of depth that was calibrated for these deviations.
    conformal: Conformal,
}

#[cfg(test)]
pub(super) mod tests;
