//! Tiles: boxes along a binary tree of cuts. Each tile owns the lattice points in it.

use super::morton;

/// One of 2ᵏ parts of a lattice's cube.
///
/// The cube is cut in two, then each half, and so on. A tile owns the points of its half-open box; the upper faces of
/// the cube belong to the last tiles along their axes. So every point has one owner.
///
/// A tile by [`Tile::new`] is of equal boxes: the cube is halved along z, then y, then x, and so on. A run replaces it
/// by one [of its own cuts](Tile::within), so that all of its tiles have about as many vertices.
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
    /// Position along the tree of cuts, from 0.
    pub index: u32,
    /// Number of tiles, a power of two.
    pub of: u32,
    /// Lower and upper corner on the finest lattice, if cuts are not halves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cut: Option<([u32; 3], [u32; 3])>,
}

impl Tile {
    /// Largest number of tiles: cells of level 4.
    pub const MAX_TILES: u32 = 1 << 12;

    /// Tile `index` of `of`; `None` unless `of` is a power of two from 2 to [`Tile::MAX_TILES`] and `index` below it.
    #[must_use]
    pub fn new(index: u32, of: u32) -> Option<Self> {
        Some(Self { index, of, cut: None }).filter(|tile| tile.is_valid())
    }

    /// The same tile with the box from `low` to `high` on the finest lattice.
    #[must_use]
    pub fn within(self, low: [u32; 3], high: [u32; 3]) -> Self {
        Self { cut: Some((low, high)), ..self }
    }

    /// Whether its box is known, and not one of equal ones.
    #[must_use]
    pub fn is_cut(self) -> bool {
        self.cut.is_some()
    }

    /// Checks what [`Tile::new`] does.
    #[must_use]
    pub fn is_valid(self) -> bool {
        self.of.is_power_of_two() && (2..=Self::MAX_TILES).contains(&self.of) && self.index < self.of
    }

    /// Checks that it is a valid part of the lattice with 2^`finest` cells per axis, for tiles read from files.
    #[must_use]
    pub fn fits(self, finest: u8) -> bool {
        let is_box = |(low, high): ([u32; 3], [u32; 3])| (0..3).all(|axis| low[axis] < high[axis]);
        let is_inside = |(_, high): ([u32; 3], [u32; 3])| high.iter().all(|&i| i <= 1 << finest);
        self.is_valid() && finest >= self.least_level() && self.cut.is_none_or(|cut| is_box(cut) && is_inside(cut))
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
        let ((low, high), last) = (self.extent(finest), 1 << finest);
        (0..3).all(|axis| {
            let i = point[axis];
            low[axis] <= i && (i < high[axis] || (i == last && high[axis] == last))
        })
    }

    /// Lower and upper corner on the lattice with 2^`finest` cells per axis.
    #[must_use]
    #[inline]
    pub fn extent(self, finest: u8) -> ([u32; 3], [u32; 3]) {
        self.cut.unwrap_or_else(|| {
            let depth = 3 * u32::from(finest) - self.of.ilog2();
            let first = u64::from(self.index) << depth;
            let last = first | ((1 << depth) - 1);
            (morton::decode(first), morton::decode(last).map(|i| i + 1))
        })
    }
}

impl std::fmt::Display for Tile {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

/// All tiles of a run, which together are the cube, and the tree of cuts that finds the owner of a point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tiling {
    /// Axis and plane of every cut, in the order of a heap, from index 1 on.
    cuts: Vec<(usize, u32)>,
}

impl Tiling {
    /// Finds the cuts between tiles of the lattice with 2^`finest` cells per axis. `None` unless these are, in their
    /// order, all tiles of one tree of cuts: they leave no gaps and do not overlap.
    #[must_use]
    pub fn new(finest: u8, tiles: &[Tile]) -> Option<Self> {
        let of = tiles.len();
        let is_numbered =
            (0..).zip(tiles).all(|(i, tile)| tile.fits(finest) && (tile.index, tile.of) == (i, of as u32));
        if !of.is_power_of_two() || !is_numbered {
            return None;
        }
        // The boxes of the nodes, from the leaves up.
        let mut cuts = vec![(0, 0); of];
        let mut boxes: Vec<_> = tiles.iter().map(|tile| tile.extent(finest)).collect();
        let mut node = of;
        while boxes.len() > 1 {
            node /= 2;
            let halves = boxes.chunks_exact(2).map(|pair| {
                let ((low, middle), (start, high)) = (pair[0], pair[1]);
                let touches = |&axis: &usize| {
                    let others = || (0..3).filter(move |&other| other != axis);
                    middle[axis] == start[axis] && others().all(|o| (low[o], middle[o]) == (start[o], high[o]))
                };
                (0..3).find(touches).map(|axis| ((axis, start[axis]), (low, high)))
            });
            let halves = halves.collect::<Option<Vec<_>>>()?;
            for (i, (cut, _)) in halves.iter().enumerate() {
                cuts[node + i] = *cut;
            }
            boxes = halves.into_iter().map(|(_, whole)| whole).collect();
        }
        (boxes[0] == ([0; 3], [1 << finest; 3])).then_some(Self { cuts })
    }

    /// The index of the tile that owns a point.
    #[must_use]
    pub fn owner(&self, point: [u32; 3]) -> usize {
        let mut node = 1;
        while node < self.cuts.len() {
            let (axis, plane) = self.cuts[node];
            node = 2 * node + usize::from(point[axis] >= plane);
        }
        node - self.cuts.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn every_point_has_one_owner_whose_box_it_is_in() {
        let finest = 4;
        for of in (1..=9).map(|bits| 1 << bits) {
            let tiles: Vec<Tile> = (0..of).map(|index| Tile::new(index, of).unwrap()).collect();
            let cells = |(low, high): ([u32; 3], [u32; 3])| (0..3).map(|axis| high[axis] - low[axis]).product::<u32>();
            assert!(tiles.iter().all(|tile| cells(tile.extent(finest)) == 4096 / of), "equal boxes of {of} tiles");
            check_owners(finest, &tiles);
        }
    }

    fn check_owners(finest: u8, tiles: &[Tile]) {
        let tiling = Tiling::new(finest, tiles).expect("all tiles of one run");
        let (n, last) = ((1 << finest) + 1_u32, 1 << finest);
        for i in 0..n.pow(3) {
            let point = [i % n, i / n % n, i / (n * n)];
            let owners: Vec<&Tile> = tiles.iter().filter(|tile| tile.owns(finest, point)).collect();
            assert!(owners.len() == 1, "{point:?} of {}: {owners:?}", tiles.len());
            assert_eq!(tiling.owner(point), owners[0].index as usize, "{point:?}");
            let (low, high) = owners[0].extent(finest);
            assert!((0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis])), "{point:?}");
            assert!((0..3).all(|axis| point[axis] < high[axis] || point[axis] == last), "{point:?}");
        }
    }

    /// Boxes by cuts anywhere.
    fn cut(finest: u8, bits: u32, seed: u64) -> Vec<Tile> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut boxes = vec![([0; 3], [1 << finest; 3])];
        for _ in 0..bits {
            let mut halves = Vec::new();
            for (low, high) in boxes {
                let choice: u64 = rng.random();
                let start = (choice >> 33) as usize;
                let axis = (0..3).map(|i| (start + i) % 3).find(|&axis| high[axis] > low[axis] + 1).unwrap();
                let plane = low[axis] + 1 + (choice >> 40) as u32 % (high[axis] - low[axis] - 1);
                let (mut middle, mut begin) = (high, low);
                (middle[axis], begin[axis]) = (plane, plane);
                halves.extend([(low, middle), (begin, high)]);
            }
            boxes = halves;
        }
        let of = boxes.len() as u32;
        (0..).zip(boxes).map(|(index, (low, high))| Tile::new(index, of).unwrap().within(low, high)).collect()
    }

    proptest! {
        #[test]
        fn cuts_anywhere_leave_every_point_one_owner(bits in 1_u32..4, choice: u64, moved: usize, axis in 0_usize..3) {
            let tiles = cut(4, bits, choice);
            check_owners(4, &tiles);
            // Tiles with one missing, too large or too small do not cover the whole.
            prop_assert_eq!(Tiling::new(4, &tiles[1..]), None);
            for by in [-1, 1] {
                let mut tiles = tiles.clone();
                let tile = &mut tiles[moved % (1 << bits)];
                let (low, mut high) = tile.extent(4);
                high[axis] = high[axis].wrapping_add_signed(by);
                *tile = tile.within(low, high);
                prop_assert_eq!(Tiling::new(4, &tiles), None);
            }
        }
    }

    #[test]
    fn only_powers_of_two_cut_a_cube() {
        for (index, of) in [(0, 0), (0, 1), (0, 3), (2, 2), (0, 2 * Tile::MAX_TILES)] {
            assert!(Tile::new(index, of).is_none(), "{index}/{of}");
        }
        assert_eq!([2, 8, 16, 4096].map(|of| Tile::new(1, of).unwrap().least_level()), [1, 1, 2, 4]);
    }

    #[test]
    fn boxes_of_files_are_not_believed() {
        let tile = Tile::new(1, 2).unwrap();
        for (low, high, fits) in [
            ([0, 0, 3], [8, 8, 8], true),
            ([0, 0, 8], [8, 8, 8], false),
            ([0, 5, 0], [8, 4, 8], false),
            ([0, 0, 3], [8, 9, 8], false),
        ] {
            assert_eq!(tile.within(low, high).fits(3), fits, "{low:?} {high:?}");
        }
        assert!(tile.fits(1) && !Tile::new(1, 16).unwrap().fits(1));
        // Files of equal boxes have no cut.
        assert_eq!(serde_json::from_str::<Tile>(r#"{"index":1,"of":2}"#).unwrap(), tile);
        let cut = tile.within([0, 0, 3], [8, 8, 8]);
        assert_eq!(serde_json::from_str::<Tile>(&serde_json::to_string(&cut).unwrap()).unwrap(), cut);
    }
}
