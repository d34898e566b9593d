//! Bricks as bytes: an atlas of those with matter, and a page table with the position of every brick of the lattice.

use std::io::Write;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::bricks::Brick;
use super::grid::{COARSE, Grid, SAMPLES};

/// Effort of zlib. The highest, 9, takes a second more for a file of 6 MB, and saves less than 1 %.
const EFFORT: Compression = Compression::new(7);
/// Step of the differences of red and blue to green.
const CHROMA: f64 = 8.0;

/// Where the bricks of the lattice are.
pub struct Pages {
    /// Bricks of the lattice along each axis.
    lattice: [u32; 3],
    /// Bricks along each axis of the atlas.
    pub atlas: [u32; 3],
    /// `[bricks of the lattice][4]`, x fastest: place in the atlas and 0; or three zeros and the distance to the next
    /// brick with matter, in bricks along the axis on which it is largest.
    pages: Vec<[u8; 4]>,
}

impl Pages {
    /// Puts bricks with these places in the lattice into an atlas.
    pub fn new(grid: &Grid, bricks: &[[u32; 3]]) -> Self {
        let side = (bricks.len().max(1) as f64).cbrt().ceil() as u32;
        let layers = (bricks.len() as u32).div_ceil(side * side).max(1);
        let mut pages = distances(grid, bricks);
        for (i, index) in (0_u32..).zip(bricks) {
            let [x, y, z] = [i % side, i / side % side, i / (side * side)].map(|k| k as u8);
            pages[number(grid.bricks, *index)] = [x, y, z, 0];
        }
        Self { lattice: grid.bricks, atlas: [side, side, layers], pages }
    }

    /// Which of the atlas's bricks is at a place in the lattice; or how far the next one is, in bricks.
    pub fn find(&self, index: [u32; 3]) -> Result<usize, u8> {
        let [x, y, z, distance] = self.pages[number(self.lattice, index)];
        let [width, height, _] = self.atlas.map(|n| n as usize);
        if distance > 0 {
            Err(distance)
        } else {
            Ok(usize::from(x) + width * (usize::from(y) + height * usize::from(z)))
        }
    }
}

/// A volume, compressed.
pub struct Packed {
    /// Where the bricks are, as in [`Pages`]. Base 64 of zlib.
    pub pages: String,
    /// `[6][bricks of the atlas][SAMPLES]`: green, (red − green) / 8, (blue − green) / 8, matter, log10 U as it is
    /// seen, log10 U; then `[bricks of the atlas][COARSE]` rays. Red and blue are right within 4/255. Base 64 of zlib.
    pub planes: String,
}

impl Packed {
    /// Packs the bricks of an atlas.
    pub fn new(pages: &Pages, bricks: &[Brick]) -> Self {
        let mut planes = Vec::with_capacity((6 * SAMPLES + COARSE) * bricks.len());
        let beyond = |channel: u8, green: u8| ((f64::from(channel) - f64::from(green)) / CHROMA).round() as i8 as u8;
        for plane in 0..3 {
            let code = |[red, green, blue]: &[u8; 3]| [*green, beyond(*red, *green), beyond(*blue, *green)][plane];
            bricks.iter().for_each(|brick| planes.extend(brick.color.iter().map(code)));
        }
        let others: [fn(&Brick) -> &[u8]; 4] = [|b| &b.matter, |b| &b.seen, |b| &b.log10, |b| &b.rays];
        others.iter().for_each(|plane| bricks.iter().for_each(|brick| planes.extend_from_slice(plane(brick))));
        Self { pages: text(pages.pages.as_flattened()), planes: text(&differences(&planes)) }
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
fn number([nx, ny, _]: [u32; 3], [x, y, z]: [u32; 3]) -> usize {
    (x + nx * (y + ny * z)) as usize
}

/// For every brick without matter, the distance to the next with matter, at most 255. One pass along each axis.
fn distances(grid: &Grid, bricks: &[[u32; 3]]) -> Vec<[u8; 4]> {
    let n = grid.bricks.map(|n| n as usize);
    let mut distance = vec![255_u8; n[0] * n[1] * n[2]];
    bricks.iter().for_each(|index| distance[number(grid.bricks, *index)] = 0);
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
pub fn text(bytes: &[u8]) -> String {
    let mut zlib = ZlibEncoder::new(Vec::new(), EFFORT);
    let packed = zlib.write_all(bytes).and_then(|()| zlib.finish()).expect("writing to memory cannot fail");
    BASE64_STANDARD.encode(packed)
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::ZlibDecoder;

    use super::*;
    use octobayes::geometry::{Aabb, Domain};

    fn bytes(text: &str) -> Vec<u8> {
        let mut out = Vec::new();
        ZlibDecoder::new(&*BASE64_STANDARD.decode(text).unwrap()).read_to_end(&mut out).unwrap();
        out
    }

    fn brick(seed: u8) -> Brick {
        let byte = |i: usize, factor: usize| (i * factor + usize::from(seed)) as u8;
        let plane = |factor: usize| (0..SAMPLES).map(|i| byte(i, factor)).collect();
        let color = (0..SAMPLES).map(|i| [byte(i, 3), byte(i, 5), byte(i, 7)]).collect();
        let rays = (0..COARSE).map(|i| byte(i, 1)).collect();
        Brick { matter: plane(11), color, seen: plane(17), log10: plane(13), rays }
    }

    /// Four bricks along each axis, three of them with matter.
    #[test]
    fn what_is_packed_comes_out_again_and_empty_space_is_as_wide_as_said() {
        let bounds = Aabb::centered_cube(1.0);
        let grid = Grid::new(bounds, &Domain::Box(bounds), 28);
        assert_eq!(grid.bricks, [4; 3]);
        let places = [[0, 0, 0], [3, 1, 2], [3, 3, 3]];
        let bricks = [brick(1), brick(2), brick(3)];
        let placed = Pages::new(&grid, &places);
        let packed = Packed::new(&placed, &bricks);
        let pages = bytes(&packed.pages);
        for (i, index) in grid.all_bricks().into_iter().enumerate() {
            let page = &pages[4 * i..4 * i + 4];
            if let Some(k) = places.iter().position(|place| *place == index) {
                assert_eq!(placed.find(index), Ok(k));
                let [x, y, z] = [page[0], page[1], page[2]].map(u32::from);
                assert_eq!((x + placed.atlas[0] * (y + placed.atlas[1] * z), page[3]), (k as u32, 0));
                continue;
            }
            let apart = |other: &[u32; 3]| (0..3).map(|axis| index[axis].abs_diff(other[axis])).max();
            assert_eq!(placed.find(index), Err(page[3]));
            assert_eq!(Some(u32::from(page[3])), places.iter().filter_map(apart).min(), "{index:?}");
        }
        let mut planes = bytes(&packed.planes);
        assert_eq!(planes.len(), (6 * SAMPLES + COARSE) * bricks.len());
        for i in (0..planes.len()).filter(|i| i % crate::viewer::grid::SIDE != 0) {
            planes[i] = planes[i].wrapping_add(planes[i - 1]);
        }
        let at = |plane: usize, brick: usize, i: usize| planes[(plane * bricks.len() + brick) * SAMPLES + i];
        for (k, brick) in bricks.iter().enumerate() {
            assert_eq!(planes[6 * SAMPLES * bricks.len() + k * COARSE..][..COARSE], brick.rays);
            for i in 0..SAMPLES {
                assert_eq!([at(3, k, i), at(4, k, i), at(5, k, i)], [brick.matter[i], brick.seen[i], brick.log10[i]]);
                let green = i16::from(at(0, k, i));
                let [red, blue] = [1, 2].map(|plane| green + 8 * i16::from(at(plane, k, i) as i8));
                for (found, stored) in [(red, 0), (green, 1), (blue, 2)] {
                    // Rounded to a multiple of eight.
                    assert!((found - i16::from(brick.color[i][stored])).abs() <= 4, "{found}");
                }
            }
        }
    }
}
