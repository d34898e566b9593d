//! From positions to features: tables over sines and cosines (Lee et al., "Plenoptic PNG", arXiv 2409.15689).
//!
//! Letters: `F` = 4 frequencies, `C` = 4 features, `Q` grid points of a table axis, `R` rank; `slot` = 2f for sin
//! and 2f + 1 for cos of frequency f. y = freq · (q − ½) along an axis, s = sin πy or cos πy, and
//! u = (s + 1)/2 · (Q − 1) the table coordinate.
//!
//! - `Vectors` (type 1): Σ_r X[ux, r] Y[uy, r] Z[uz, r], each factor linear between grid points.
//! - `Planes` (type 2): V[z, y, x] = Σ_r YZ[z, y, r] XZ[z, x, r] XY[y, x, r] at grid points, V trilinear
//!   between them. Interpolating the planes before multiplying gives another function, 16 dB worse on a
//!   trained file.

#![allow(
    clippy::needless_range_loop,
    reason = "lanes of several fixed arrays go together; plain loops over them become vector code"
)]

use std::f32::consts::PI;
use std::hint::black_box;

use crate::elementary::sin_cos_pi;

/// Number of rows evaluated together. The buffers of a block take 16 KB, and a slot's tables (type 1: 30 KB)
/// are read from near memory for all rows.
///
/// A row is a point, or one of the [`JET`] rows of a point that is differentiated.
pub const BLOCK: usize = 64;
/// Rows of a point with its derivatives: value, ∂x, ∂y, ∂z.
pub const JET: usize = 4;
/// F, the number of frequencies.
pub const FREQUENCIES: usize = 4;
/// C, the number of features per slot.
pub const FEATURES: usize = 4;
/// Number of slots, 2F.
pub const SLOTS: usize = 2 * FREQUENCIES;
/// Features of a point, slot-major.
pub const WIDTH: usize = SLOTS * FEATURES;
/// Numbers multiplied at once: two ranks times C. An odd rank is padded with zeros.
const GROUP: usize = 8;

/// One group of numbers.
type Lanes = [f32; GROUP];

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

/// The tables in f32.
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

/// Table coordinates u of the points of one slot along one axis.
#[derive(Clone, Copy)]
struct TablePoints<const N: usize> {
    index: [u32; N],
    fraction: [f32; N],
    /// du/dc.
    slope: [f32; N],
}

impl Encoding {
    /// Builds the encoding from the file's `[3][slot][points][R][C]`; `frequencies` are per file unit.
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

    /// Fills the features of the first `count` of N positions `c` (= p − ½, `[axis][point]`).
    ///
    /// The shape is `[point · ROWS + row][slot · C + feature]`. Row 0 is the value. With [`JET`] rows, the
    /// others are its derivatives by c.
    #[inline(always)]
    pub fn encode<const N: usize, const ROWS: usize>(
        &self,
        c: &[[f32; N]; 3],
        count: usize,
        features: &mut [[f32; WIDTH]; BLOCK],
    ) {
        const { assert!(N * ROWS == BLOCK && (ROWS == 1 || ROWS == JET)) };
        let slot_size = 3 * self.kind.points(self.quants) * self.row;
        for (f, tables) in self.tables.chunks_exact(2 * slot_size).enumerate() {
            let places = self.places::<N, ROWS>(c, self.frequencies[f]);
            for (half, (tables, place)) in tables.chunks_exact(slot_size).zip(&places).enumerate() {
                let first = (2 * f + half) * FEATURES;
                for p in 0..count {
                    let index = [0, 1, 2].map(|axis| place[axis].index[p] as usize);
                    let t = [0, 1, 2].map(|axis| place[axis].fraction[p]);
                    let sums = match self.kind {
                        // Otherwise the compiler sees that the halves are added, and uses vectors of half the width.
                        Kind::Vectors if ROWS == 1 => black_box(self.vectors::<ROWS>(tables, index, t)),
                        Kind::Vectors => self.vectors::<ROWS>(tables, index, t),
                        Kind::Planes => self.planes::<ROWS>(tables, index, t),
                    };
                    for row in 0..ROWS {
                        let slope = if row == 0 { 1.0 } else { place[row - 1].slope[p] };
                        for k in 0..FEATURES {
                            features[ROWS * p + row][first + k] = (sums[row][k] + sums[row][FEATURES + k]) * slope;
                        }
                    }
                }
            }
        }
    }

    /// Places of the points in the tables of sin and of cos along each axis, with slopes only if there are
    /// rows for them.
    #[inline(always)]
    fn places<const N: usize, const ROWS: usize>(&self, c: &[[f32; N]; 3], frequency: f32) -> [[TablePoints<N>; 3]; 2] {
        let mut places = [[TablePoints { index: [0; N], fraction: [0.0; N], slope: [0.0; N] }; 3]; 2];
        let half = 0.5 * (self.quants - 1) as f32;
        let last = (self.quants - 2) as i32;
        let speed = half * PI * frequency;
        for axis in 0..3 {
            let (mut sin, mut cos) = ([0.0; N], [0.0; N]);
            for p in 0..N {
                (sin[p], cos[p]) = sin_cos_pi(frequency * c[axis][p]);
            }
            for (s, places) in [sin, cos].iter().zip(&mut places) {
                let place = &mut places[axis];
                for p in 0..N {
                    let u = s[p].mul_add(half, half);
                    let index = (u as i32).clamp(0, last);
                    place.index[p] = index as u32;
                    place.fraction[p] = u - index as f32;
                }
            }
            if ROWS == JET {
                for p in 0..N {
                    places[0][axis].slope[p] = speed * cos[p];
                    places[1][axis].slope[p] = -speed * sin[p];
                }
            }
        }
        places
    }

    /// Type 1: sums over even and over odd ranks, and their derivatives by u.
    #[inline(always)]
    fn vectors<const ROWS: usize>(&self, tables: &[f32], index: [usize; 3], t: [f32; 3]) -> [Lanes; ROWS] {
        let (q, row) = (self.quants, self.row);
        let x = neighbours(tables, row, index[0]);
        let y = neighbours(tables, row, q + index[1]);
        let z = neighbours(tables, row, 2 * q + index[2]);
        let mut sums = [[0.0; GROUP]; ROWS];
        // Loops, because a closure would be compiled once, without its caller's instructions. Whole groups
        // are copied out of the tables first, so that they stay in registers.
        for g in 0..row / GROUP {
            let (x0, x1, y0, y1, z0, z1) = (x.0[g], x.1[g], y.0[g], y.1[g], z.0[g], z.1[g]);
            for i in 0..GROUP {
                let [dx, dy, dz] = [x1[i] - x0[i], y1[i] - y0[i], z1[i] - z0[i]];
                let [x, y, z] = [t[0].mul_add(dx, x0[i]), t[1].mul_add(dy, y0[i]), t[2].mul_add(dz, z0[i])];
                let xy = x * y;
                sums[0][i] = xy.mul_add(z, sums[0][i]);
                if ROWS == JET {
                    sums[1][i] = (y * z).mul_add(dx, sums[1][i]);
                    sums[2][i] = (x * z).mul_add(dy, sums[2][i]);
                    sums[3][i] = xy.mul_add(dz, sums[3][i]);
                }
            }
        }
        sums
    }

    /// Type 2: sums over even and over odd ranks, and their derivatives by u.
    #[inline(always)]
    fn planes<const ROWS: usize>(&self, tables: &[f32], [x, y, z]: [usize; 3], t: [f32; 3]) -> [Lanes; ROWS] {
        let (row, q) = (self.row, self.quants);
        let plane = q * q;
        let (yz0, yz1) = (neighbours(tables, row, z * q + y), neighbours(tables, row, (z + 1) * q + y));
        let [xz0, xz1] = [plane + z * q + x, plane + (z + 1) * q + x];
        let (xz0, xz1) = (neighbours(tables, row, xz0), neighbours(tables, row, xz1));
        let [xy0, xy1] = [2 * plane + y * q + x, 2 * plane + (y + 1) * q + x];
        let (xy0, xy1) = (neighbours(tables, row, xy0), neighbours(tables, row, xy1));
        let mut sums = [[0.0; GROUP]; ROWS];
        for g in 0..row / GROUP {
            for i in 0..GROUP {
                // V at the corners of the cell, interpolated along x first.
                let along_x = |yz: f32, xz: [f32; 2], xy: [f32; 2]| {
                    let [a, b] = [xz[0] * xy[0], xz[1] * xy[1]];
                    (yz * lerp(a, b, t[0]), yz * (b - a))
                };
                let (below, above) = ([xz0.0[g][i], xz0.1[g][i]], [xz1.0[g][i], xz1.1[g][i]]);
                let (near, far) = ([xy0.0[g][i], xy0.1[g][i]], [xy1.0[g][i], xy1.1[g][i]]);
                let (v00, d00) = along_x(yz0.0[g][i], below, near);
                let (v01, d01) = along_x(yz0.1[g][i], below, far);
                let (v10, d10) = along_x(yz1.0[g][i], above, near);
                let (v11, d11) = along_x(yz1.1[g][i], above, far);
                let (v0, v1) = (lerp(v00, v01, t[1]), lerp(v10, v11, t[1]));
                sums[0][i] += lerp(v0, v1, t[2]);
                if ROWS == JET {
                    sums[1][i] += lerp(lerp(d00, d01, t[1]), lerp(d10, d11, t[1]), t[2]);
                    sums[2][i] += lerp(v01 - v00, v11 - v10, t[2]);
                    sums[3][i] += v1 - v0;
                }
            }
        }
        sums
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        size_of_val(self.tables.as_slice())
    }
}

/// The numbers at a grid point and at the next one along the fast axis, in groups.
#[inline(always)]
fn neighbours(tables: &[f32], row: usize, point: usize) -> (&[Lanes], &[Lanes]) {
    let (low, high) = tables[point * row..(point + 2) * row].split_at(row);
    (low.as_chunks::<GROUP>().0, high.as_chunks::<GROUP>().0)
}

/// a + t (b − a).
#[inline(always)]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    t.mul_add(b - a, a)
}
