//! The multiresolution hash encoding (Müller et al. 2022, Sec. 3): trilinear interpolation of trained
//! features on nested grids.
//!
//! Letters: `u` position in the unit cube, `N` a level's cells per axis, `F` features per level, `T` entries
//! of the table, `t` place within a cell in [0, 1]³. Corner c of a cell is at (c & 1, c >> 1 & 1, c >> 2)
//! along x, y, z. A level whose corners fit into the table has one entry per corner. The corners of a finer
//! level share entries by spatial hashing (Eq. 4), and training sorts out the collisions.

use super::config::{HashGridConfig, N_FEATURES_PER_LEVEL, N_LEVELS};

/// One entry of a table.
pub type Entry = [f32; N_FEATURES_PER_LEVEL];
/// Features of a point, level by level.
pub const WIDTH: usize = N_LEVELS * N_FEATURES_PER_LEVEL;

/// Primes of Eq. 4. Along x the hash is the index itself, so that neighbours share cache lines.
const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

/// The grid of one level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// N.
    pub resolution: u32,
    /// Number of entries.
    pub size: usize,
    hashed: bool,
}

/// The cell of a point: its corners' entries, and the place within it.
#[derive(Clone, Copy)]
struct CellEntries {
    index: [u32; 8],
    t: [f32; 3],
}

impl Level {
    fn new(resolution: u32, log2_hashmap_size: u32) -> Self {
        let corners = (u64::from(resolution) + 1).pow(3);
        let table = 1_u64 << log2_hashmap_size;
        Self { resolution, size: corners.min(table) as usize, hashed: corners > table }
    }

    #[inline(always)]
    fn place(&self, u: [f32; 3]) -> CellEntries {
        let mut cell = [0_u32; 3];
        let mut t = [0.0; 3];
        for axis in 0..3 {
            let x = u[axis] * self.resolution as f32;
            // The upper face belongs to the last cell.
            let i = (x as i32).clamp(0, self.resolution as i32 - 1);
            cell[axis] = i as u32;
            t[axis] = x - i as f32;
        }
        let mut index = [0; 8];
        if self.hashed {
            let mask = self.size as u32 - 1;
            let y = [cell[1].wrapping_mul(PRIMES[0]), (cell[1] + 1).wrapping_mul(PRIMES[0])];
            let z = [cell[2].wrapping_mul(PRIMES[1]), (cell[2] + 1).wrapping_mul(PRIMES[1])];
            for c in 0..8 {
                index[c] = ((cell[0] + (c as u32 & 1)) ^ y[c >> 1 & 1] ^ z[c >> 2]) & mask;
            }
        } else {
            let m = self.resolution + 1;
            for c in 0..8_u32 {
                index[c as usize] = ((cell[2] + (c >> 2)) * m + cell[1] + (c >> 1 & 1)) * m + cell[0] + (c & 1);
            }
        }
        CellEntries { index, t }
    }
}

/// Trilinear weights of the eight corners.
#[inline(always)]
fn weights(t: [f32; 3]) -> [f32; 8] {
    let [x, y, z] = t;
    let (a, b, c, d) = ((1.0 - y) * (1.0 - z), y * (1.0 - z), (1.0 - y) * z, y * z);
    [(1.0 - x) * a, x * a, (1.0 - x) * b, x * b, (1.0 - x) * c, x * c, (1.0 - x) * d, x * d]
}

/// The grids of all levels and their features.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoding {
    levels: [Level; N_LEVELS],
    /// Entries of all levels, one level after the other.
    pub table: Vec<Entry>,
}

impl Encoding {
    /// The grids of a configuration.
    #[must_use]
    pub fn levels_of(config: &HashGridConfig) -> [Level; N_LEVELS] {
        config.resolutions().map(|n| Level::new(n, config.log2_hashmap_size))
    }

    /// Builds the encoding from the entries of all levels.
    #[must_use]
    pub fn new(config: &HashGridConfig, table: Vec<Entry>) -> Self {
        let levels = Self::levels_of(config);
        assert_eq!(table.len(), Self::entries(&levels), "entries of the grids");
        Self { levels, table }
    }

    /// Number of entries of all levels together.
    #[must_use]
    pub fn entries(levels: &[Level; N_LEVELS]) -> usize {
        levels.iter().map(|level| level.size).sum()
    }

    /// The grids, coarsest first.
    #[must_use]
    pub fn levels(&self) -> &[Level; N_LEVELS] {
        &self.levels
    }

    /// Splits an array with one element per entry into one slice per level.
    pub fn split<'a, T>(levels: &[Level; N_LEVELS], mut entries: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut parts = Vec::with_capacity(N_LEVELS);
        for level in levels {
            let (part, rest) = entries.split_at_mut(level.size);
            parts.push(part);
            entries = rest;
        }
        parts
    }

    /// Fills `features` (`[n]`) with the features of positions `u` in the unit cube (`[n]`).
    #[inline(always)]
    pub fn encode(&self, u: &[[f32; 3]], features: &mut [[f32; WIDTH]]) {
        let mut first = 0;
        for (l, level) in self.levels.iter().enumerate() {
            let table = &self.table[first..first + level.size];
            for (u, features) in u.iter().zip(features.iter_mut()) {
                let place = level.place(*u);
                let weights = weights(place.t);
                let mut sum = [0.0; N_FEATURES_PER_LEVEL];
                for c in 0..8 {
                    let entry = &table[place.index[c] as usize];
                    for k in 0..N_FEATURES_PER_LEVEL {
                        sum[k] = weights[c].mul_add(entry[k], sum[k]);
                    }
                }
                features[l * N_FEATURES_PER_LEVEL..][..N_FEATURES_PER_LEVEL].copy_from_slice(&sum);
            }
            first += level.size;
        }
    }

    /// Adds to `gradient` (the entries of one level) the derivatives by these entries, given those by the
    /// features of points `u`.
    pub fn add_gradient(level: usize, grid: &Level, u: &[[f32; 3]], features: &[[f32; WIDTH]], gradient: &mut [Entry]) {
        for (u, features) in u.iter().zip(features) {
            let own = &features.as_chunks::<N_FEATURES_PER_LEVEL>().0[level];
            // Samples behind a surface have no derivatives.
            if own.iter().all(|d| *d == 0.0) {
                continue;
            }
            let place = grid.place(*u);
            let weights = weights(place.t);
            for c in 0..8 {
                let entry = &mut gradient[place.index[c] as usize];
                for k in 0..N_FEATURES_PER_LEVEL {
                    entry[k] += weights[c] * own[k];
                }
            }
        }
    }

    /// The entries that the features of a point are made of, as indices in the table of all levels, with their weights:
    /// `[levels][corners]`.
    #[must_use]
    pub fn entries_of(&self, u: [f32; 3]) -> [[(u32, f32); 8]; N_LEVELS] {
        let mut first = 0;
        self.levels.map(|level| {
            let place = level.place(u);
            let weights = weights(place.t);
            let entries = std::array::from_fn(|c| (first + place.index[c], weights[c]));
            first += level.size as u32;
            entries
        })
    }

    /// Fills `slopes` with ∂f/∂u at positions `u`, `[n][axis]`. Cells are held fixed, because trilinear
    /// features have kinks at faces.
    #[inline(always)]
    pub fn slopes(&self, u: &[[f32; 3]], slopes: &mut [[[f32; WIDTH]; 3]]) {
        let mut first = 0;
        for (l, level) in self.levels.iter().enumerate() {
            let table = &self.table[first..first + level.size];
            let resolution = level.resolution as f32;
            for (u, slopes) in u.iter().zip(slopes.iter_mut()) {
                let CellEntries { index, t } = level.place(*u);
                let corners = index.map(|i| table[i as usize]);
                for axis in 0..3 {
                    // Differences between opposite corners, bilinear over the other two axes.
                    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                    let mut sum = [0.0; N_FEATURES_PER_LEVEL];
                    for side in 0..4 {
                        let (on_b, on_c) = (side & 1, side >> 1);
                        let low = on_b << b | on_c << c;
                        let weight = [1.0 - t[b], t[b]][on_b] * [1.0 - t[c], t[c]][on_c] * resolution;
                        for k in 0..N_FEATURES_PER_LEVEL {
                            sum[k] = weight.mul_add(corners[low | 1 << axis][k] - corners[low][k], sum[k]);
                        }
                    }
                    slopes[axis][l * N_FEATURES_PER_LEVEL..][..N_FEATURES_PER_LEVEL].copy_from_slice(&sum);
                }
            }
            first += level.size;
        }
    }
}
