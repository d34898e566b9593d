//! How fine each part of space may become: a complete, 2:1 balanced set of leaves that is never stored.
//!
//! The cube is cut into *regions*, the cells of one coarse level. All leaves inside a region have the same
//! level, its limit. Limits of touching regions differ by at most one, so the leaves are balanced. Where rays
//! are too few to support the finest level, vertex sums are gathered on these leaves.

use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::{Cell, Leaves, morton};

/// Levels between a region and the finest cells in it.
pub const DEPTH: u8 = 5;

/// The level of leaves in every region.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MaxLevels {
    finest: u8,
    /// Level of the regions.
    region: u8,
    /// Limits by region; a region without an entry keeps its own level. `None`: the finest level everywhere.
    /// Copies share them: at level 12 they are hundreds of thousands.
    levels: Option<Arc<FxHashMap<u64, u8>>>,
}

impl MaxLevels {
    /// The finest level everywhere: the lattice itself.
    #[must_use]
    pub fn none(finest: u8) -> Self {
        Self { finest, region: finest.saturating_sub(DEPTH), levels: None }
    }

    /// The coarsest balanced limits that admit `wanted`, pairs of region and level.
    #[must_use]
    pub fn balanced(finest: u8, wanted: impl IntoIterator<Item = (u64, u8)>) -> Self {
        let region = finest.saturating_sub(DEPTH);
        let mut levels: FxHashMap<u64, u8> = FxHashMap::default();
        let mut of_level: Vec<Vec<u64>> = vec![Vec::new(); usize::from(finest) + 1];
        for (code, level) in wanted {
            let level = level.clamp(region, finest);
            let entry = levels.entry(code).or_insert(region);
            *entry = (*entry).max(level);
        }
        for (&code, &level) in &levels {
            of_level[usize::from(level)].push(code);
        }
        // From the finest level down: a neighbour may be at most one level coarser.
        for level in (usize::from(region) + 1..of_level.len()).rev() {
            for at in 0..of_level[level].len() {
                let code = of_level[level][at];
                if usize::from(levels[&code]) != level {
                    continue;
                }
                for neighbor in neighbors(code, region) {
                    let limit = levels.entry(neighbor).or_insert(region);
                    if usize::from(*limit) + 1 < level {
                        *limit = level as u8 - 1;
                        of_level[level - 1].push(neighbor);
                    }
                }
            }
        }
        levels.retain(|_, level| *level > region);
        levels.shrink_to_fit();
        Self { finest, region, levels: Some(Arc::new(levels)) }
    }

    /// Level of the regions.
    #[must_use]
    pub fn region_level(&self) -> u8 {
        self.region
    }

    /// Whether every leaf is of the finest level.
    #[must_use]
    pub fn is_unlimited(&self) -> bool {
        self.levels.is_none()
    }

    /// Bytes on the heap, shared by all copies.
    #[must_use]
    pub fn heap_bytes(&self) -> usize {
        // hashbrown: one control byte and one pair per bucket; one bucket in eight stays empty.
        self.levels.as_ref().map_or(0, |levels| levels.capacity() * 8 / 7 * (1 + size_of::<(u64, u8)>()))
    }

    /// The limit of a region.
    #[must_use]
    pub fn level(&self, region: u64) -> u8 {
        self.levels.as_ref().map_or(self.finest, |levels| levels.get(&region).copied().unwrap_or(self.region))
    }

    /// The level of the regions, then sorted pairs as region · 256 + limit; `None` if unlimited.
    #[must_use]
    pub fn packed(&self) -> Option<Vec<u64>> {
        let levels = self.levels.as_ref()?;
        let mut packed: Vec<u64> = levels.iter().map(|(&code, &level)| code << 8 | u64::from(level)).collect();
        packed.sort_unstable();
        packed.insert(0, u64::from(self.region));
        Some(packed)
    }

    /// Restores the limits that [`MaxLevels::packed`] wrote, which may come from an untrusted file; `None` if
    /// they are not balanced limits.
    ///
    /// Balance is checked, not made: to balance a fine limit that stands alone takes a thousand others.
    #[must_use]
    pub fn from_packed(finest: u8, packed: &[u64]) -> Option<Self> {
        let region = finest.saturating_sub(DEPTH);
        let (&first, packed_pairs) = packed.split_first()?;
        let pairs = || packed_pairs.iter().map(|&p| (p >> 8, (p & 255) as u8));
        let are_limits = first == u64::from(region)
            && packed_pairs.is_sorted_by(|a, b| a >> 8 < b >> 8)
            && pairs().all(|(code, level)| code >> (3 * region) == 0 && level > region && level <= finest);
        let limits = are_limits.then(|| Self { finest, region, levels: Some(Arc::new(pairs().collect())) })?;
        let are_balanced =
            pairs().all(|(code, level)| neighbors(code, region).all(|neighbor| limits.level(neighbor) + 1 >= level));
        are_balanced.then_some(limits)
    }

    /// The region that contains a finest cell.
    #[must_use]
    pub fn region_of(&self, cell: [u32; 3]) -> u64 {
        morton::encode(cell.map(|i| i >> (self.finest - self.region)))
    }
}

impl Leaves for MaxLevels {
    fn finest(&self) -> u8 {
        self.finest
    }

    fn leaf(&self, cell: [u32; 3]) -> Cell {
        let level = if self.is_unlimited() { self.finest } else { self.level(self.region_of(cell)) };
        Cell { level, index: cell.map(|i| i >> (self.finest - level)) }
    }
}

/// The up to 26 regions that touch a region.
fn neighbors(code: u64, level: u8) -> impl Iterator<Item = u64> {
    let last = (1_u32 << level) - 1;
    crate::octree::around(morton::decode(code), last)
        .map(|(region, _)| morton::encode(region))
        .filter(move |&c| c != code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::cells_around;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn limits_are_balanced_admit_what_is_wanted_and_survive_packing(
            finest in 6_u8..=8, wanted in proptest::collection::vec((0_u64..64, 0_u8..=8), 0..12),
        ) {
            let regions = 1_u64 << (3 * (finest - DEPTH));
            let wanted: Vec<(u64, u8)> = wanted.into_iter().map(|(c, l)| (c % regions, l)).collect();
            let limits = MaxLevels::balanced(finest, wanted.iter().copied());
            for &(code, level) in &wanted {
                prop_assert!(limits.level(code) >= level.min(finest));
            }
            for code in 0..regions {
                for neighbor in neighbors(code, limits.region_level()) {
                    prop_assert!(limits.level(code).abs_diff(limits.level(neighbor)) <= 1);
                }
                // Least: a limit is either wanted here or forced by a finer neighbour.
                let level = limits.level(code);
                let forced = neighbors(code, limits.region_level()).any(|n| limits.level(n) > level);
                let is_wanted = wanted.iter().any(|&(c, l)| c == code && l.min(finest) == level);
                prop_assert!(level == limits.region_level() || forced || is_wanted);
            }
            prop_assert_eq!(MaxLevels::from_packed(finest, &limits.packed().unwrap()), Some(limits));
        }

        #[test]
        fn leaves_tile_the_cube(
            wanted in proptest::collection::vec((0_u64..8, 1_u8..=6), 0..6),
            cell in proptest::array::uniform3(0_u32..64),
        ) {
            let limits = MaxLevels::balanced(6, wanted);
            let leaf = limits.leaf(cell);
            let (origin, edge) = leaf.extent(6);
            let in_leaf = |c: &[u32; 3]| (0..3).all(|a| (origin[a]..origin[a] + edge).contains(&c[a]));
            prop_assert!(in_leaf(&cell));
            // Every cell of the leaf finds the same leaf.
            for corner in cells_around(origin.map(|i| i + 1), 6).filter(in_leaf) {
                prop_assert_eq!(limits.leaf(corner), leaf);
            }
        }
    }

    #[test]
    fn altered_packings_are_refused() {
        let limits = MaxLevels::balanced(8, [(5, 8)]);
        let packed = limits.packed().unwrap();
        assert!(packed.len() > 20);
        assert_eq!(MaxLevels::from_packed(8, &[&packed[..1], &packed[2..]].concat()), None, "unbalanced");
        assert_eq!(MaxLevels::from_packed(8, &[3, 1 << 60]), None, "outside");
        assert_eq!(MaxLevels::from_packed(8, &[3, 5 << 8 | 200]), None, "too fine");
        assert_eq!(MaxLevels::from_packed(8, &[3, 5 << 8 | 3]), None, "no finer than without an entry");
        let swapped = [&packed[..1], &[packed[2], packed[1]], &packed[3..]].concat();
        assert_eq!(MaxLevels::from_packed(8, &swapped), None, "in another order");
        let twice = [&packed[..2], &packed[1..]].concat();
        assert_eq!(MaxLevels::from_packed(8, &twice), None, "twice");
    }
}
