//! Generators for property tests.

use super::{Cell, Octree};
use proptest::prelude::*;

/// Octrees of level 1 to 5 with a few wanted cells of any level. Lone deep cells make the balance work hardest.
pub(crate) fn octrees() -> impl Strategy<Value = Octree> {
    (1_u8..=5).prop_flat_map(|finest| {
        let cell = (0..=finest).prop_flat_map(|level| {
            let n = 1_u32 << level;
            [0..n, 0..n, 0..n].prop_map(move |index| Cell { level, index })
        });
        proptest::collection::vec(cell, 0..6).prop_map(move |wanted| Octree::refined(finest, wanted))
    })
}
