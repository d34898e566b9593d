//! Bricks as bytes: an atlas of those with matter, and a page for every brick of the lattice that says where it is.

use std::io::Write;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::bricks::Brick;
use super::grid::{Grid, SAMPLES};

/// A volume, compressed.
pub struct Packed {
    /// Bricks along each axis of the atlas.
    pub atlas: [u32; 3],
    /// `[bricks of the lattice][4]`, x fastest: place in the atlas and 0; or three zeros and the distance to the next
    /// brick with matter, in bricks along the axis on which it is largest.
    pub pages: String,
    /// `[6][bricks of the atlas][samples]`: green, (red − green) / 4, (blue − green) / 4, matter, log10 U, rays.
    /// Colours are right within 2/255. Base 64 of zlib.
    pub planes: String,
}

impl Packed {
    /// Packs the bricks of a lattice.
    pub fn new(grid: &Grid, bricks: &[Brick]) -> Self {
        let side = (bricks.len().max(1) as f64).cbrt().ceil() as u32;
        let layers = (bricks.len() as u32).div_ceil(side * side).max(1);
        let atlas = [side, side, layers];
        let mut pages = distances(grid, bricks);
        for (i, brick) in (0_u32..).zip(bricks) {
            let [x, y, z] = [i % side, i / side % side, i / (side * side)].map(|k| k as u8);
            pages[number(grid, brick.index)] = [x, y, z, 0];
        }
        let mut planes = Vec::with_capacity(6 * SAMPLES * bricks.len());
        let beyond = |channel: u8, green: u8| ((f64::from(channel) - f64::from(green)) / 4.0).round() as i8 as u8;
        for plane in 0..3 {
            let code = |[red, green, blue]: &[u8; 3]| [*green, beyond(*red, *green), beyond(*blue, *green)][plane];
            bricks.iter().for_each(|brick| planes.extend(brick.color.iter().map(code)));
        }
        let others: [fn(&Brick) -> &[u8]; 3] = [|b| &b.matter, |b| &b.log10, |b| &b.rays];
        others.iter().for_each(|plane| bricks.iter().for_each(|brick| planes.extend_from_slice(plane(brick))));
        Self { atlas, pages: text(pages.as_flattened()), planes: text(&differences(&planes)) }
    }

    /// Length in the file, bytes.
    pub fn bytes(&self) -> usize {
        self.pages.len() + self.planes.len()
    }
}

/// Every byte minus the one before it in its row of a brick: neighbours are alike, and what is small compresses well.
fn differences(planes: &[u8]) -> Vec<u8> {
    let before = |i: usize| if i.is_multiple_of(super::grid::SIDE) { 0 } else { planes[i - 1] };
    (0..planes.len()).map(|i| planes[i].wrapping_sub(before(i))).collect()
}

/// Place of a brick in the order of the lattice's bricks.
fn number(grid: &Grid, [x, y, z]: [u32; 3]) -> usize {
    let [nx, ny, _] = grid.bricks;
    (x + nx * (y + ny * z)) as usize
}

/// For every brick without matter, the distance to the next with matter, at most 255. One pass along each axis.
fn distances(grid: &Grid, bricks: &[Brick]) -> Vec<[u8; 4]> {
    let n = grid.bricks.map(|n| n as usize);
    let mut distance = vec![255_u8; n[0] * n[1] * n[2]];
    bricks.iter().for_each(|brick| distance[number(grid, brick.index)] = 0);
    // The largest coordinate of a difference is the larger of those along the axes looked at so far and along this one.
    for (axis, stride) in [1, n[0], n[0] * n[1]].into_iter().enumerate() {
        let old = distance.clone();
        for i in 0..distance.len() {
            let k = i / stride % n[axis];
            let mut best = old[i];
            for step in 1..n[axis] {
                if step as u8 >= best || step >= 255 {
                    break;
                }
                let both = [(k >= step).then(|| i - step * stride), (k + step < n[axis]).then(|| i + step * stride)];
                for j in both.into_iter().flatten() {
                    best = best.min(old[j].max(step as u8));
                }
            }
            distance[i] = best;
        }
    }
    distance.into_iter().map(|d| [0, 0, 0, d]).collect()
}

/// Base 64 of zlib.
fn text(bytes: &[u8]) -> String {
    let mut zlib = ZlibEncoder::new(Vec::new(), Compression::best());
    let packed = zlib.write_all(bytes).and_then(|()| zlib.finish()).expect("writing to memory cannot fail");
    BASE64_STANDARD.encode(packed)
}
