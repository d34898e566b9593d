//! Tiles: equal boxes along the Z-curve, each of which owns the lattice points in it.

use super::morton;

/// One of 2ᵏ equal parts of a lattice's cube.
///
/// The cube is halved along z, then y, then x, and so on. A tile owns the points of its half-open box; the upper faces
/// of the cube belong to the last tiles along their axes. So every point has one owner.
///
/// ```
/// use octobayes::octree::Tile;
///
/// let tile = Tile::new(1, 2).unwrap();
/// // The upper half of {0..8}³.
/// assert_eq!(tile.extent(3), ([0, 0, 4], [8, 8, 8]));
/// assert!(tile.owns(3, [0, 0, 4]) && tile.owns(3, [8, 8, 8]) && !tile.owns(3, [8, 8, 3]));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct Tile {
    /// Position along the Z-curve, from 0.
    pub index: u32,
    /// Number of tiles, a power of two.
    pub of: u32,
}

impl Tile {
    /// Largest number of tiles: cells of level 4.
    pub const MOST: u32 = 1 << 12;

    /// Tile `index` of `of`; `None` unless `of` is a power of two from 2 to [`Tile::MOST`] and `index` below it.
    #[must_use]
    pub fn new(index: u32, of: u32) -> Option<Self> {
        Some(Self { index, of }).filter(|tile| tile.is_valid())
    }

    /// Checks what [`Tile::new`] does.
    #[must_use]
    pub fn is_valid(self) -> bool {
        self.of.is_power_of_two() && (2..=Self::MOST).contains(&self.of) && self.index < self.of
    }

    /// Smallest level of a lattice that can be cut into so many tiles.
    #[must_use]
    pub fn least_level(self) -> u8 {
        self.of.ilog2().div_ceil(3) as u8
    }

    /// Whether it owns a point of the lattice with 2^`finest` cells per axis.
    #[must_use]
    #[inline]
    pub fn owns(self, finest: u8, point: [u32; 3]) -> bool {
        Self::owner(self.of, finest, point) == self.index
    }

    /// The index of the one of `of` tiles that owns a point of the lattice with 2^`finest` cells per axis.
    #[must_use]
    #[inline]
    pub fn owner(of: u32, finest: u8, point: [u32; 3]) -> u32 {
        let last = (1 << finest) - 1;
        (morton::encode(point.map(|i| i.min(last))) >> depth(of, finest)) as u32
    }

    /// Lower and upper corner on the lattice with 2^`finest` cells per axis.
    #[must_use]
    pub fn extent(self, finest: u8) -> ([u32; 3], [u32; 3]) {
        let depth = depth(self.of, finest);
        let first = u64::from(self.index) << depth;
        let last = first | ((1 << depth) - 1);
        (morton::decode(first), morton::decode(last).map(|i| i + 1))
    }
}

/// Bits of a Morton code that tell the cells of one of `of` tiles apart.
fn depth(of: u32, finest: u8) -> u32 {
    3 * u32::from(finest) - of.ilog2()
}

impl std::fmt::Display for Tile {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_has_one_owner_whose_box_it_is_in() {
        let finest = 4;
        for of in (1..=9).map(|bits| 1 << bits) {
            let tiles: Vec<Tile> = (0..of).map(|index| Tile::new(index, of).unwrap()).collect();
            let cells = |(low, high): ([u32; 3], [u32; 3])| (0..3).map(|axis| high[axis] - low[axis]).product::<u32>();
            assert!(tiles.iter().all(|tile| cells(tile.extent(finest)) == 4096 / of), "equal boxes of {of} tiles");
            for i in 0..17_u32.pow(3) {
                let point = [i % 17, i / 17 % 17, i / 289];
                let owners: Vec<&Tile> = tiles.iter().filter(|tile| tile.owns(finest, point)).collect();
                assert!(owners.len() == 1, "{point:?} of {of}: {owners:?}");
                let (low, high) = owners[0].extent(finest);
                assert!((0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis])), "{point:?} of {of}");
                assert!((0..3).all(|axis| point[axis] < high[axis] || point[axis] == 16), "{point:?} of {of}");
            }
        }
    }

    #[test]
    fn only_powers_of_two_cut_a_cube() {
        for (index, of) in [(0, 0), (0, 1), (0, 3), (2, 2), (0, 2 * Tile::MOST)] {
            assert!(Tile::new(index, of).is_none(), "{index}/{of}");
        }
        assert_eq!([2, 8, 16, 4096].map(|of| Tile::new(1, of).unwrap().least_level()), [1, 1, 2, 4]);
    }
}
