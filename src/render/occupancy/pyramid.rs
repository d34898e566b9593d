//! A sparse grid of values with the maxima of its blocks.
//!
//! A block of level l is 2^l cells wide and aligned to multiples of its width; level 0 is the cells. Blocks of
//! level 3 are bricks. A brick with a single value stores it once. Any other stores its cells and the maxima of its
//! blocks of levels 1 and 2.

/// Level of bricks.
pub const BRICK: usize = 3;
/// Cells along the edge of a brick.
pub const EDGE: usize = 1 << BRICK;
/// Cells of a brick.
pub const CELLS: usize = EDGE * EDGE * EDGE;
/// Offsets of the blocks of levels 0, 1 and 2 among the values of a brick, and their end.
const OFFSETS: [usize; BRICK + 1] = [0, CELLS, CELLS + CELLS / 8, CELLS + CELLS / 8 + CELLS / 64];

/// Values ≥ 0 of `[cells³]` cells.
#[derive(Debug, Clone)]
pub struct Pyramid {
    cells: usize,
    /// `[bricks³]`, x slowest: position in `detail` of a brick with several values, in bricks.
    detail_of: Vec<Option<u32>>,
    /// Values of levels 0, 1 and 2, brick by brick; x slowest in each level.
    detail: Vec<f32>,
    /// Maxima of levels 3, 4, … up to the level with a single block, x slowest.
    tops: Vec<Vec<f32>>,
}

/// The cells whose value exceeds a density: 64 bytes for a brick, one line of the cache.
#[derive(Debug, Clone)]
pub struct Above {
    density: f32,
    /// Of the bricks with several values: a word for each x, with bit 8 y + z.
    bricks: Vec<[u64; EDGE]>,
}

impl Above {
    /// The density.
    pub fn density(&self) -> f32 {
        self.density
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        size_of_val(self.bricks.as_slice())
    }

    /// The level of the largest block around a cell of a brick without a marked cell; `None` if it is marked itself.
    #[inline]
    fn largest_low(&self, brick: usize, [x, y, z]: [usize; 3]) -> Option<usize> {
        let rows = &self.bricks[brick];
        if rows[x] >> (EDGE * y + z) & 1 == 1 {
            return None;
        }
        let pair = rows[x & !1] | rows[x | 1];
        if pair & 0x0303 << (EDGE * (y & !1) + (z & !1)) != 0 {
            return Some(0);
        }
        let four = pair | rows[(x & !1) ^ 2] | rows[(x | 1) ^ 2];
        if four & 0x0f0f_0f0f << (EDGE * (y & 4) + (z & 4)) != 0 {
            return Some(1);
        }
        let all = rows.iter().fold(0, |any, row| any | row);
        Some(if all == 0 { BRICK } else { 2 })
    }
}

/// Number of blocks of `level` along an axis of `cells` cells.
pub fn blocks(cells: usize, level: usize) -> usize {
    cells.div_ceil(1 << level)
}

impl Pyramid {
    /// Builds a pyramid over `cells`³ zeros with `bricks` put in: the index of each (x
    /// slowest) and its cells, x slowest.
    ///
    /// Bricks stick out of the grid if `cells` is not a multiple of 8. Values outside are never read as cells, but
    /// must not exceed those inside.
    pub fn new(cells: usize, bricks: impl IntoIterator<Item = (usize, [f32; CELLS])>) -> Self {
        let n = blocks(cells, BRICK);
        let mut pyramid =
            Self { cells, detail_of: vec![None; n * n * n], detail: Vec::new(), tops: vec![vec![0.0; n * n * n]] };
        for (index, values) in bricks {
            pyramid.tops[0][index] = values.into_iter().fold(0.0, f32::max);
            if values.iter().any(|&v| v != values[0]) {
                pyramid.detail_of[index] = Some((pyramid.detail.len() / OFFSETS[BRICK]) as u32);
                let halves = halve(&values, EDGE);
                let quarters = halve(&halves, EDGE / 2);
                for level in [values.as_slice(), &halves, &quarters] {
                    pyramid.detail.extend(level);
                }
            }
        }
        while let Some(top) = pyramid.tops.last().filter(|top| top.len() > 1) {
            let above = halve(top, blocks(cells, BRICK + pyramid.tops.len() - 1));
            pyramid.tops.push(above);
        }
        pyramid
    }

    /// Number of levels; the last has a single block.
    pub fn levels(&self) -> usize {
        BRICK + self.tops.len()
    }

    /// Largest value in the block of `level` around a cell of the grid.
    pub fn value(&self, level: usize, cell: [usize; 3]) -> f32 {
        let brick_level = level.max(BRICK);
        let [x, y, z] = cell.map(|i| i >> brick_level);
        let n = blocks(self.cells, brick_level);
        let block = (x * n + y) * n + z;
        let detail = if level < BRICK { self.detail_of[block] } else { None };
        match detail {
            None => self.tops[brick_level - BRICK][block],
            Some(brick) => {
                let [x, y, z] = cell.map(|i| (i & (EDGE - 1)) >> level);
                let shift = BRICK - level;
                self.detail[brick as usize * OFFSETS[BRICK] + OFFSETS[level] + (((x << shift) + y) << shift) + z]
            }
        }
    }

    /// Marks the cells whose value exceeds `density`.
    pub fn above(&self, density: f32) -> Above {
        let brick = |values: &[f32]| {
            let row = |x: usize| {
                let cells = &values[x * EDGE * EDGE..][..EDGE * EDGE];
                cells.iter().enumerate().fold(0, |row, (i, &value)| row | u64::from(value > density) << i)
            };
            std::array::from_fn(row)
        };
        Above { density, bricks: self.detail.chunks_exact(OFFSETS[BRICK]).map(brick).collect() }
    }

    /// The level of the largest block around a cell in which no value exceeds the density of `above`; `Err` if the
    /// cell's does, with the level of a block in which all do.
    #[inline]
    pub fn largest_low(&self, above: &Above, cell: [usize; 3]) -> Result<usize, usize> {
        let [x, y, z] = cell.map(|i| i >> BRICK);
        let n = blocks(self.cells, BRICK);
        let block = (x * n + y) * n + z;
        if let Some(brick) = self.detail_of[block] {
            let level = above.largest_low(brick as usize, cell.map(|i| i & (EDGE - 1))).ok_or(0_usize)?;
            if level < BRICK {
                return Ok(level);
            }
        } else if self.tops[0][block] > above.density {
            return Err(BRICK);
        }
        Ok(self.largest_low_from(BRICK, above.density, cell))
    }

    /// The same as [`Pyramid::largest_low`] from the values, for any density.
    pub fn largest_low_by_values(&self, density: f32, cell: [usize; 3]) -> Result<usize, usize> {
        if self.value(0, cell) > density {
            return Err(if self.is_uniform(cell) { BRICK } else { 0 });
        }
        Ok(self.largest_low_from(0, density, cell))
    }

    /// The level of the largest block around a cell without a value above `density`, given that the block of `level` is
    /// one.
    fn largest_low_from(&self, level: usize, density: f32, cell: [usize; 3]) -> usize {
        let low = |level: usize| level < self.levels() && self.value(level, cell) <= density;
        (level..).find(|level| !low(level + 1)).unwrap_or(level)
    }

    /// Returns true if all cells of the brick around a cell share one value.
    fn is_uniform(&self, cell: [usize; 3]) -> bool {
        let [x, y, z] = cell.map(|i| i >> BRICK);
        let n = blocks(self.cells, BRICK);
        self.detail_of[(x * n + y) * n + z].is_none()
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        size_of_val(self.detail_of.as_slice())
            + size_of_val(self.detail.as_slice())
            + self.tops.iter().map(|top| size_of_val(top.as_slice())).sum::<usize>()
    }
}

/// Maxima over aligned blocks of 2³ values of an `[n³]` grid.
fn halve(values: &[f32], n: usize) -> Vec<f32> {
    let half = n.div_ceil(2);
    let mut maxima = vec![0.0_f32; half * half * half];
    for (i, &value) in values.iter().enumerate() {
        let (x, y, z) = (i / (n * n), i / n % n, i % n);
        let maximum = &mut maxima[(x / 2 * half + y / 2) * half + z / 2];
        *maximum = maximum.max(value);
    }
    maxima
}

#[cfg(test)]
mod tests {
    use super::super::sampled::brick;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn every_level_is_the_maximum_of_its_cells(n in 1usize..21, seed in 0usize..1000, solid in 0usize..3) {
            // Values in clusters: some bricks are empty, some full, some mixed.
            let of = |x: usize, y: usize, z: usize| {
                if (x / 8 + y / 8 + z / 8 + seed) % 3 <= solid { 5.0 } else { ((x * 7 + y * 3 + z + seed) % 11) as f32 }
            };
            let values: Vec<f32> = (0..n * n * n).map(|i| of(i / (n * n), i / n % n, i % n)).collect();
            let bricks = (0..blocks(n, BRICK).pow(3)).map(|i| (i, brick(&values, n, i)));
            let pyramid = Pyramid::new(n, bricks);
            for level in 0..pyramid.levels() {
                for i in 0..n * n * n {
                    let cell = [i / (n * n), i / n % n, i % n];
                    let range = cell.map(|at| ((at >> level) << level)..(((at >> level) + 1) << level).min(n));
                    let [xs, ys, zs] = range;
                    let mut maximum = 0.0_f32;
                    for x in xs {
                        for y in ys.clone() {
                            for z in zs.clone() {
                                maximum = maximum.max(values[(x * n + y) * n + z]);
                            }
                        }
                    }
                    prop_assert_eq!(pyramid.value(level, cell), maximum, "level {} at {:?}", level, cell);
                }
            }
            for density in [0.0, 4.0, 5.0, 10.0] {
                let above = pyramid.above(density);
                for i in 0..n * n * n {
                    let cell = [i / (n * n), i / n % n, i % n];
                    let expected = pyramid.largest_low_by_values(density, cell);
                    prop_assert_eq!(pyramid.largest_low(&above, cell), expected, "{} at {:?}", density, cell);
                }
            }
        }
    }

    #[test]
    fn empty_and_uniform_bricks_take_no_room() {
        let empty = Pyramid::new(64, []).memory();
        let uniform = Pyramid::new(64, [(77, [3.0; CELLS])]);
        assert_eq!(uniform.memory(), empty);
        let mut values = [3.0; CELLS];
        values[5] = 4.0;
        let mixed = Pyramid::new(64, [(77, values)]);
        // 8³ + 4³ + 2³ numbers of four bytes.
        assert_eq!(mixed.memory(), empty + 4 * 584);
        assert_eq!((mixed.value(0, [8, 8, 45]), mixed.value(0, [8, 8, 46])), (4.0, 3.0));
    }
}
