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

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::ZlibDecoder;

    use super::*;
    use crate::geometry::{Aabb, Domain};

    fn bytes(text: &str) -> Vec<u8> {
        let mut out = Vec::new();
        ZlibDecoder::new(&*BASE64_STANDARD.decode(text).unwrap()).read_to_end(&mut out).unwrap();
        out
    }

    fn brick(index: [u32; 3], seed: u8) -> Brick {
        let byte = |i: usize, factor: usize| (i * factor + usize::from(seed)) as u8;
        let plane = |factor: usize| (0..SAMPLES).map(|i| byte(i, factor)).collect();
        let color = (0..SAMPLES).map(|i| [byte(i, 3), byte(i, 5), byte(i, 7)]).collect();
        Brick { index, matter: plane(11), color, log10: plane(13), rays: plane(1) }
    }

    /// Four bricks along each axis, three of them with matter.
    #[test]
    fn what_is_packed_comes_out_again_and_empty_space_is_as_wide_as_said() {
        let bounds = Aabb::centered_cube(1.0);
        let grid = Grid::new(bounds, &Domain::Box(bounds), 28);
        assert_eq!(grid.bricks, [4; 3]);
        let bricks = [brick([0, 0, 0], 1), brick([3, 1, 2], 2), brick([3, 3, 3], 3)];
        let packed = Packed::new(&grid, &bricks);
        let pages = bytes(&packed.pages);
        for (i, index) in grid.all_bricks().into_iter().enumerate() {
            let page = &pages[4 * i..4 * i + 4];
            if let Some(k) = bricks.iter().position(|brick| brick.index == index) {
                let [x, y, z] = [page[0], page[1], page[2]].map(u32::from);
                assert_eq!((x + packed.atlas[0] * (y + packed.atlas[1] * z), page[3]), (k as u32, 0));
                continue;
            }
            let apart = |other: &Brick| (0..3).map(|axis| index[axis].abs_diff(other.index[axis])).max();
            assert_eq!(Some(u32::from(page[3])), bricks.iter().filter_map(apart).min(), "{index:?}");
        }
        let mut planes = bytes(&packed.planes);
        assert_eq!(planes.len(), 6 * SAMPLES * bricks.len());
        for i in (0..planes.len()).filter(|i| i % crate::viewer::grid::SIDE != 0) {
            planes[i] = planes[i].wrapping_add(planes[i - 1]);
        }
        let at = |plane: usize, brick: usize, i: usize| planes[(plane * bricks.len() + brick) * SAMPLES + i];
        for (k, brick) in bricks.iter().enumerate() {
            for i in 0..SAMPLES {
                assert_eq!([at(3, k, i), at(4, k, i), at(5, k, i)], [brick.matter[i], brick.log10[i], brick.rays[i]]);
                let green = i16::from(at(0, k, i));
                let [red, blue] = [1, 2].map(|plane| green + 4 * i16::from(at(plane, k, i) as i8));
                for (found, stored) in [(red, 0), (green, 1), (blue, 2)] {
                    // Rounded to a multiple of four.
                    assert!((found - i16::from(brick.color[i][stored])).abs() <= 2, "{found}");
                }
            }
        }
    }
}
