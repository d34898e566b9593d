//! Which pixels of an image count.

use std::sync::Arc;

use super::Camera;
use crate::{Error, Result};

/// The pixel of `from` along an axis that has the centre of pixel `i` of `to`.
#[must_use]
pub fn nearest(i: u32, from: u32, to: u32) -> u32 {
    ((2 * u64::from(i) + 1) * u64::from(from) / (2 * u64::from(to))) as u32
}

/// The pixels of `from` along an axis that pixel `i` of `to` covers, each with its share, which are `from` together.
pub fn covered(i: u32, from: u32, to: u32) -> impl Iterator<Item = (u32, u64)> {
    // A pixel of `from` is `to` units long, and a pixel of `to` is `from` units long.
    let [i, from, to] = [i, from, to].map(u64::from);
    let [start, end] = [i * from, (i + 1) * from];
    (start / to..end.div_ceil(to)).map(move |k| (k as u32, end.min((k + 1) * to) - start.max(k * to)))
}

/// The pixels of an image that a model was trained on; the others are masked.
///
/// A copy shares its pixels with the original.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask(Arc<Pixels>);

#[derive(Debug, PartialEq, Eq)]
struct Pixels {
    /// Width and height, pixels.
    resolution: [u32; 2],
    /// One bit for each pixel, row by row; every row begins with a word of its own.
    bits: Vec<u64>,
    /// `[height + 1]`: number of kept pixels above each row.
    above: Vec<u64>,
}

impl Mask {
    /// The mask of an image of `[width, height]` pixels that keeps those for which `keep(column, row)` holds.
    #[must_use]
    pub fn new(resolution: [u32; 2], keep: impl Fn(u32, u32) -> bool) -> Self {
        let [width, height] = resolution;
        let words = width.div_ceil(64) as usize;
        let (mut bits, mut above) = (vec![0_u64; words * height as usize], vec![0]);
        for row in 0..height {
            let start = words * row as usize;
            for column in (0..width).filter(|&column| keep(column, row)) {
                bits[start + column as usize / 64] |= 1 << (column % 64);
            }
            let kept: u64 = bits[start..start + words].iter().map(|word| u64::from(word.count_ones())).sum();
            above.push(above[row as usize] + kept);
        }
        Self(Arc::new(Pixels { resolution, bits, above }))
    }

    /// Width and height of the image, pixels.
    #[must_use]
    pub fn resolution(&self) -> [u32; 2] {
        self.0.resolution
    }

    /// Number of kept pixels.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        self.0.above[self.0.resolution[1] as usize]
    }

    /// Returns true if the pixel counts.
    ///
    /// # Panics
    /// If the image has no such pixel.
    #[must_use]
    pub fn keeps(&self, column: u32, row: u32) -> bool {
        assert!(column < self.0.resolution[0], "column {column} of {:?}", self.0.resolution);
        self.row(row)[column as usize / 64] >> (column % 64) & 1 == 1
    }

    /// The mask of the same view in an image of another size: a pixel counts if the one at its centre does.
    #[must_use]
    pub fn resized(&self, resolution: [u32; 2]) -> Self {
        if resolution == self.0.resolution {
            return self.clone();
        }
        let ([width, height], [w, h]) = (self.0.resolution, resolution);
        Self::new(resolution, |column, row| self.keeps(nearest(column, width, w), nearest(row, height, h)))
    }

    /// The mask of a smaller picture whose pixels are means: a pixel counts if all that it covers counts.
    #[must_use]
    pub fn shrunk(&self, resolution: [u32; 2]) -> Self {
        let ([width, height], [w, h]) = (self.0.resolution, resolution);
        Self::new(resolution, |column, row| {
            covered(row, height, h).all(|(y, _)| covered(column, width, w).all(|(x, _)| self.keeps(x, y)))
        })
    }

    /// The kept pixel at a point of the unit square: equal areas hold equal numbers of kept pixels.
    ///
    /// y chooses the row by the number of pixels that it keeps, x one of these. Without masked pixels it is the pixel
    /// that contains the point.
    ///
    /// # Panics
    /// If the mask keeps no pixel.
    #[must_use]
    pub fn at(&self, [x, y]: [f64; 2]) -> [u32; 2] {
        let all = self.pixels();
        assert!(all > 0, "a mask that keeps no pixel");
        let n = ((y * all as f64) as u64).min(all - 1);
        let row = self.0.above.partition_point(|&above| above <= n) - 1;
        let kept = self.0.above[row + 1] - self.0.above[row];
        let n = ((x * kept as f64) as u64).min(kept - 1);
        [self.column(row as u32, n), row as u32]
    }

    /// Kept pixel `n` in the order of rows and columns.
    ///
    /// # Panics
    /// If there are not that many.
    #[must_use]
    pub fn nth(&self, n: u64) -> [u32; 2] {
        assert!(n < self.pixels(), "pixel {n} of {}", self.pixels());
        let row = self.0.above.partition_point(|&above| above <= n) - 1;
        [self.column(row as u32, n - self.0.above[row]), row as u32]
    }

    /// Checksum of size and pixels.
    #[must_use]
    pub fn checksum(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        self.0.resolution.iter().for_each(|side| hasher.update(&side.to_le_bytes()));
        self.0.bits.iter().for_each(|word| hasher.update(&word.to_le_bytes()));
        hasher.finalize()
    }

    fn row(&self, row: u32) -> &[u64] {
        let words = self.0.resolution[0].div_ceil(64) as usize;
        &self.0.bits[words * row as usize..words * (row as usize + 1)]
    }

    /// The column of kept pixel `n` of a row.
    fn column(&self, row: u32, mut n: u64) -> u32 {
        let mut first = 0;
        for &word in self.row(row) {
            let kept = u64::from(word.count_ones());
            if n < kept {
                let without = (0..n).fold(word, |word, _| word & (word - 1));
                return first + without.trailing_zeros();
            }
            n -= kept;
            first += 64;
        }
        unreachable!("row {row} keeps fewer pixels than were counted")
    }
}

/// Refuses masks that are not one or none for each camera, of its size; an empty list is none for all.
///
/// # Errors
/// If the number or a size differs.
#[doc(hidden)]
pub fn check_sizes(cameras: &[Camera], masks: &[Option<Mask>]) -> Result<()> {
    let resolutions: Vec<[u32; 2]> = cameras.iter().map(|camera| camera.resolution).collect();
    let sizes: Vec<Option<[u32; 2]>> = masks.iter().map(|mask| mask.as_ref().map(Mask::resolution)).collect();
    let fits = |(size, of): (&Option<[u32; 2]>, &[u32; 2])| size.is_none_or(|size| size == *of);
    if sizes.is_empty() || sizes.len() == resolutions.len() && sizes.iter().zip(&resolutions).all(fits) {
        return Ok(());
    }
    let expected = format!("a mask or none for each camera, of its size: {resolutions:?}");
    Err(Error::setting("masks", expected, format!("{sizes:?}")))
}

/// The number of pixels of cameras that their masks keep; `masks` has one or none for each, or is empty.
#[must_use]
pub fn kept_pixels(cameras: &[Camera], masks: &[Option<Mask>]) -> u64 {
    let kept = |(i, camera): (usize, &Camera)| {
        masks.get(i).and_then(Option::as_ref).map_or_else(|| camera.pixels(), Mask::pixels)
    };
    cameras.iter().enumerate().map(kept).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn kept_pixels_are_listed_in_order(
            [width, height] in [1_u32..150, 1_u32..12],
            seed in any::<u64>(),
            to in [1_u32..200, 1_u32..20],
        ) {
            let keep = |column: u32, row: u32| {
                let place = u64::from(column) << 32 | u64::from(row);
                (place ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 61 < 3
            };
            let mask = Mask::new([width, height], keep);
            let all = (0..height).flat_map(|row| (0..width).map(move |column| [column, row]));
            let kept: Vec<[u32; 2]> = all.clone().filter(|&[column, row]| keep(column, row)).collect();
            prop_assert_eq!(mask.pixels(), kept.len() as u64);
            prop_assert!(all.into_iter().all(|[column, row]| mask.keeps(column, row) == keep(column, row)));
            prop_assert_eq!((0..mask.pixels()).map(|n| mask.nth(n)).collect::<Vec<_>>(), kept);
            // Whole pixels of the smaller mask, cut at the edges of the larger one's.
            let fewer = [to[0].min(width), to[1].min(height)];
            let shrunk = mask.shrunk(fewer);
            for (column, row) in (0..fewer[0]).flat_map(|column| (0..fewer[1]).map(move |row| (column, row))) {
                let touched = |i: u32, k: u32, from: u32, to: u32| k * to < (i + 1) * from && (k + 1) * to > i * from;
                let all = (0..width).filter(|&x| touched(column, x, width, fewer[0]));
                let keeps = all.flat_map(|x| (0..height).map(move |y| (x, y)))
                    .filter(|&(_, y)| touched(row, y, height, fewer[1]))
                    .all(|(x, y)| keep(x, y));
                prop_assert_eq!(shrunk.keeps(column, row), keeps);
            }
            // The pixel that holds the centre, in floating point; ties between two pixels are left out.
            let resized = mask.resized(to);
            for (column, row) in (0..to[0]).flat_map(|column| (0..to[1]).map(move |row| (column, row))) {
                let [x, y] = [(column, width, to[0]), (row, height, to[1])]
                    .map(|(i, from, to)| (f64::from(i) + 0.5) * f64::from(from) / f64::from(to));
                if (x - x.round()).abs() > 1e-9 && (y - y.round()).abs() > 1e-9 {
                    prop_assert_eq!(resized.keeps(column, row), keep(x as u32, y as u32));
                }
            }
        }
    }

    #[test]
    fn pixels_that_count_are_those_that_masks_keep() {
        let cameras = [[4, 2], [3, 3]].map(|size| Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, size));
        let half = Mask::new([4, 2], |column, _| column < 2);
        assert_eq!(kept_pixels(&cameras, &[]), 17);
        assert_eq!(kept_pixels(&cameras, &[Some(half.clone()), None]), 13);
        assert_eq!(kept_pixels(&cameras[..1], &[Some(half)]), 4);
    }

    #[test]
    fn equal_areas_of_the_square_hold_equal_numbers_of_kept_pixels() {
        // A triangle, with an empty row between.
        let mask = Mask::new([8, 9], |column, row| row != 4 && column < row);
        let kept = mask.pixels();
        assert_eq!(kept, (0..9).filter(|row| *row != 4).sum::<u64>());
        // A grid fine enough that every row and every pixel of a row covers whole cells of it.
        let (rows, columns) = (kept, 840);
        let mut counts = std::collections::HashMap::new();
        for (i, j) in (0..columns).flat_map(|i| (0..rows).map(move |j| (i, j))) {
            let [x, y] = [(i, columns), (j, rows)].map(|(i, n)| (i as f64 + 0.5) / n as f64);
            let [column, row] = mask.at([x, y]);
            assert!(mask.keeps(column, row), "{column}, {row}");
            *counts.entry([column, row]).or_insert(0_u64) += 1;
        }
        assert_eq!(counts.len() as u64, kept);
        assert!(counts.values().all(|&n| n == columns), "{counts:?}");
    }

    #[test]
    fn without_masked_pixels_a_point_chooses_the_pixel_around_it() {
        let mask = Mask::new([130, 7], |_, _| true);
        for n in 0..1000_u32 {
            // Points as the low-discrepancy generator makes them: of 24 bits.
            let [x, y] = [n * 40_503 % 65_536, n * 30_011 % 65_536].map(|v| f64::from(v) / 65_536.0);
            assert_eq!(mask.at([x, y]), [(x * 130.0) as u32, (y * 7.0) as u32]);
        }
    }
}
