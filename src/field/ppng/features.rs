//! From positions to features: tables over sines and cosines (Lee et al., "Plenoptic PNG", arXiv 2409.15689).
//!
//! Letters: `F` = 4 frequencies, `C` = 4 features, `Q` grid points of a table axis, `R` rank; `slot` = 2f for sin and 2f + 1 for
//! cos of frequency f. y = freq · (q − ½) along an axis, s = sin πy or cos πy, u = (s + 1)/2 · (Q − 1) the table coordinate.
//!
//! - `Vectors` (type 1): Σ_r X[ux, r] Y[uy, r] Z[uz, r], each factor linear between grid points.
//! - `Planes` (type 2): V[z, y, x] = Σ_r YZ[z, y, r] XZ[z, x, r] XY[y, x, r] at grid points, V trilinear between them. Interpolating
//!   the planes before multiplying is another function, 16 dB worse on a trained file.

#![allow(
    clippy::needless_range_loop,
    reason = "lanes of several fixed arrays go together; plain loops over them become vector code"
)]

use crate::field::elementary::sin_cos_pi;

/// Points evaluated together: buffers of a block are 15 KB, and a slot's tables (type 1: 30 KB) are read from near memory for all of them.
pub const BLOCK: usize = 64;
/// F.
pub const FREQUENCIES: usize = 4;
/// C.
pub const FEATURES: usize = 4;
/// Slots, 2F.
pub const SLOTS: usize = 2 * FREQUENCIES;
/// Features of a point, slot-major.
pub const WIDTH: usize = SLOTS * FEATURES;
/// Two ranks times C: what is multiplied at once. An odd rank is padded with zeros.
const GROUP: usize = 8;

/// What a table holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Type 1: one vector per axis and rank.
    Vectors,
    /// Type 2: one plane per pair of axes and rank.
    Planes,
}

impl Kind {
    /// Grid points of one table.
    pub const fn points(self, quants: usize) -> usize {
        match self {
            Self::Vectors => quants,
            Self::Planes => quants * quants,
        }
    }
}

/// The tables, f32.
#[derive(Debug, Clone)]
pub struct Encoding {
    kind: Kind,
    /// freq / S, so that y = freq · (p − ½).
    frequencies: [f32; FREQUENCIES],
    quants: usize,
    /// Numbers per grid point: R padded to even, times C.
    row: usize,
    /// `[slot][x, y, z or yz, xz, xy][points][row]`.
    tables: Vec<f32>,
}

/// Table coordinates of one slot's points along one axis.
#[derive(Clone, Copy)]
struct Place {
    index: [u32; BLOCK],
    fraction: [f32; BLOCK],
}

impl Encoding {
    /// From the file's `[3][slot][points][R][C]`; `frequencies` per file unit.
    pub fn new(kind: Kind, frequencies: [f32; FREQUENCIES], quants: usize, rank: usize, values: &[f32]) -> Self {
        let (points, given) = (kind.points(quants), rank * FEATURES);
        let row = given.next_multiple_of(GROUP);
        let mut tables = vec![0.0; 3 * SLOTS * points * row];
        for (i, from) in values.chunks_exact(given).enumerate() {
            let (axis, slot, point) = (i / (SLOTS * points), i / points % SLOTS, i % points);
            let at = ((slot * 3 + axis) * points + point) * row;
            tables[at..at + given].copy_from_slice(from);
        }
        Self { kind, frequencies, quants, row, tables }
    }

    /// The features of the first `count` positions `c` (= p − ½, `[axis][point]`), `[point][slot · C + feature]`.
    #[inline(always)]
    pub fn encode(&self, c: &[[f32; BLOCK]; 3], count: usize, features: &mut [[f32; WIDTH]; BLOCK]) {
        let slot_size = 3 * self.kind.points(self.quants) * self.row;
        for (f, tables) in self.tables.chunks_exact(2 * slot_size).enumerate() {
            let places = self.places(c, self.frequencies[f]);
            for (half, (tables, place)) in tables.chunks_exact(slot_size).zip(&places).enumerate() {
                let first = (2 * f + half) * FEATURES;
                for p in 0..count {
                    let index = [0, 1, 2].map(|axis| place[axis].index[p] as usize);
                    let t = [0, 1, 2].map(|axis| place[axis].fraction[p]);
                    let sum = match self.kind {
                        Kind::Vectors => self.vectors(tables, index, t),
                        Kind::Planes => self.planes(tables, index, t),
                    };
                    for k in 0..FEATURES {
                        features[p][first + k] = sum[k] + sum[FEATURES + k];
                    }
                }
            }
        }
    }

    /// Where the points fall in the tables of sin and of cos, along each axis.
    #[inline(always)]
    fn places(&self, c: &[[f32; BLOCK]; 3], frequency: f32) -> [[Place; 3]; 2] {
        let mut places = [[Place { index: [0; BLOCK], fraction: [0.0; BLOCK] }; 3]; 2];
        let half = 0.5 * (self.quants - 1) as f32;
        let last = (self.quants - 2) as i32;
        for axis in 0..3 {
            let (mut sin, mut cos) = ([0.0; BLOCK], [0.0; BLOCK]);
            for p in 0..BLOCK {
                (sin[p], cos[p]) = sin_cos_pi(frequency * c[axis][p]);
            }
            for (s, places) in [sin, cos].iter().zip(&mut places) {
                let place = &mut places[axis];
                for p in 0..BLOCK {
                    let u = s[p].mul_add(half, half);
                    let index = (u as i32).clamp(0, last);
                    place.index[p] = index as u32;
                    place.fraction[p] = u - index as f32;
                }
            }
        }
        places
    }

    /// Sums over every second rank, type 1.
    #[inline(always)]
    fn vectors(&self, tables: &[f32], index: [usize; 3], t: [f32; 3]) -> [f32; GROUP] {
        let (q, row) = (self.quants, self.row);
        let (x0, x1) = neighbours(tables, row, index[0]);
        let (y0, y1) = neighbours(tables, row, q + index[1]);
        let (z0, z1) = neighbours(tables, row, 2 * q + index[2]);
        let mut sum = [0.0; GROUP];
        for (((((x0, x1), y0), y1), z0), z1) in x0.iter().zip(x1).zip(y0).zip(y1).zip(z0).zip(z1) {
            for i in 0..GROUP {
                let [x, y, z] = [lerp(x0[i], x1[i], t[0]), lerp(y0[i], y1[i], t[1]), lerp(z0[i], z1[i], t[2])];
                sum[i] = (x * y).mul_add(z, sum[i]);
            }
        }
        sum
    }

    /// Sums over every second rank, type 2.
    #[inline(always)]
    fn planes(&self, tables: &[f32], [x, y, z]: [usize; 3], t: [f32; 3]) -> [f32; GROUP] {
        let (row, q) = (self.row, self.quants);
        let plane = q * q;
        let (yz0, yz1) = (neighbours(tables, row, z * q + y), neighbours(tables, row, (z + 1) * q + y));
        let [xz0, xz1] = [plane + z * q + x, plane + (z + 1) * q + x];
        let (xz0, xz1) = (neighbours(tables, row, xz0), neighbours(tables, row, xz1));
        let [xy0, xy1] = [2 * plane + y * q + x, 2 * plane + (y + 1) * q + x];
        let (xy0, xy1) = (neighbours(tables, row, xy0), neighbours(tables, row, xy1));
        let mut sum = [0.0; GROUP];
        // Loops, not closures: a closure would be compiled once, without the instructions of its caller.
        for g in 0..row / GROUP {
            for i in 0..GROUP {
                let v00 = yz0.0[g][i] * lerp(xz0.0[g][i] * xy0.0[g][i], xz0.1[g][i] * xy0.1[g][i], t[0]);
                let v01 = yz0.1[g][i] * lerp(xz0.0[g][i] * xy1.0[g][i], xz0.1[g][i] * xy1.1[g][i], t[0]);
                let v10 = yz1.0[g][i] * lerp(xz1.0[g][i] * xy0.0[g][i], xz1.1[g][i] * xy0.1[g][i], t[0]);
                let v11 = yz1.1[g][i] * lerp(xz1.0[g][i] * xy1.0[g][i], xz1.1[g][i] * xy1.1[g][i], t[0]);
                sum[i] += lerp(lerp(v00, v01, t[1]), lerp(v10, v11, t[1]), t[2]);
            }
        }
        sum
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        size_of_val(self.tables.as_slice())
    }
}

/// The numbers at a grid point and at the next one along the fast axis, in groups.
#[inline(always)]
fn neighbours(tables: &[f32], row: usize, point: usize) -> (&[[f32; GROUP]], &[[f32; GROUP]]) {
    let (low, high) = tables[point * row..(point + 2) * row].split_at(row);
    (low.as_chunks::<GROUP>().0, high.as_chunks::<GROUP>().0)
}

/// a + t (b − a).
#[inline(always)]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    t.mul_add(b - a, a)
}
