//! Which splats a pixel may show: lists by tile, front to back.

use glam::DVec2;
use multiversion::multiversion;
use rayon::prelude::*;

use super::project::Footprint;

/// Side of a tile, pixels. Tiles of 16 px, the original's, have twice as many candidates per pixel.
pub const TILE: u32 = 8;
/// Most candidates of an image, 235 MB. Where splats that fill the image would make more of them, tiles are larger.
const MAX_CANDIDATES: u64 = 1 << 23;
/// Longest side of a tile, pixels.
const LARGEST: u32 = 256;
/// Candidates that are tested together.
pub const CANDIDATES_AT_ONCE: usize = 16;

/// f32 rounds the terms of q by this part at most, with all that enters them.
const ROUNDING: f64 = 1e-6;
/// Least slack of the test, for q near 0.
const SLACK: f64 = 1e-4;

/// Footprints in f32, one list after the other; each list is padded to a multiple of [`CANDIDATES_AT_ONCE`].
///
/// f32 only sorts out: what passes is tested again in f64.
#[derive(Debug, Default)]
struct Candidates {
    /// m, relative to the middle of the tile.
    x: Vec<f32>,
    y: Vec<f32>,
    /// A₀₀, 2 A₀₁, A₁₁.
    xx: Vec<f32>,
    xy: Vec<f32>,
    yy: Vec<f32>,
    /// What q is at most where the splat is drawn, rounding included.
    reach: Vec<f32>,
    /// Number of the footprint.
    footprint: Vec<u32>,
}

/// Lists of one row of tiles.
#[derive(Debug, Default)]
struct Row {
    candidates: Candidates,
    /// `[columns + 1]`: where the lists of tiles begin.
    starts: Vec<u32>,
}

/// The footprints of an image, by tile and from front to back.
#[derive(Debug)]
pub struct Tiles {
    /// Side of a tile, pixels.
    side: u32,
    columns: u32,
    rows: Vec<Row>,
}

/// The tile, eight pixels wide and high, that an image point is in.
#[must_use]
pub fn tile_of(at: [f64; 2]) -> [u32; 2] {
    at.map(|x| (x.max(0.0) as u32) / TILE)
}

/// Range of tiles that an interval of pixels meets, of `count` with sides of `side` pixels.
fn span(middle: f64, extent: f64, count: u32, side: u32) -> std::ops::Range<u32> {
    let side = f64::from(side);
    // Casts cut off, and saturate.
    let [low, high] = [(middle - extent) / side, (middle + extent) / side];
    let end = if high < 0.0 { 0 } else { (high as u32).saturating_add(1) };
    (low as u32).min(count)..end.min(count)
}

/// The numbers of footprints from front to back. Those of equal depth stay in the order of their splats.
pub fn front_to_back(footprints: &[Footprint]) -> Vec<u32> {
    // Depths are positive: their bits have their order.
    let mut order: Vec<(u64, u32)> =
        footprints.iter().zip(0..).map(|(footprint, i)| (footprint.depth.to_bits(), i)).collect();
    order.par_sort_unstable();
    order.into_iter().map(|(_, i)| i).collect()
}

impl Tiles {
    /// Lists footprints of an image of `resolution` pixels, which come from front to back: lists are then made in the
    /// order of memory.
    pub fn new(footprints: &[Footprint], resolution: [u32; 2]) -> Self {
        let candidates = |side: u32| -> u64 {
            let [columns, rows] = resolution.map(|pixels| pixels.div_ceil(side));
            let of = |footprint: &Footprint| {
                let Footprint { mean, extent, .. } = footprint;
                span(mean.x, extent.x, columns, side).len() * span(mean.y, extent.y, rows, side).len()
            };
            footprints.par_iter().with_min_len(4096).map(|footprint| of(footprint) as u64).sum()
        };
        let mut side = TILE;
        while side < LARGEST && candidates(side) > MAX_CANDIDATES {
            side *= 2;
        }
        let [columns, rows] = resolution.map(|pixels| pixels.div_ceil(side));
        let mut of_row: Vec<Vec<u32>> = vec![Vec::new(); rows as usize];
        for (footprint, i) in footprints.iter().zip(0..) {
            let Footprint { mean, extent, .. } = footprint;
            span(mean.y, extent.y, rows, side).for_each(|row| of_row[row as usize].push(i));
        }
        let row = |(row, members): (usize, Vec<u32>)| Row::new(footprints, &members, row as u32, columns, side);
        Self { side, columns, rows: of_row.into_par_iter().enumerate().map(row).collect() }
    }

    /// Calls `visit` with the numbers of the footprints that may be drawn at an image point, from front to back, until
    /// it returns false.
    pub fn visit(&self, at: [f64; 2], mut visit: impl FnMut(u32) -> bool) {
        let [column, row] = at.map(|x| x.max(0.0) as u32 / self.side);
        let (column, row) = (column.min(self.columns - 1), row.min(self.rows.len() as u32 - 1));
        let Row { candidates: all, starts } = &self.rows[row as usize];
        let middle = [column, row].map(|tile| (f64::from(tile) + 0.5) * f64::from(self.side));
        let at = [(at[0] - middle[0]) as f32, (at[1] - middle[1]) as f32];
        let list = starts[column as usize] as usize..starts[column as usize + 1] as usize;
        for first in list.step_by(CANDIDATES_AT_ONCE) {
            let mut hit =
                passing(at, [&all.x, &all.y, &all.xx, &all.xy, &all.yy, &all.reach].map(|list| some(list, first)));
            while hit != 0 {
                let lane = hit.trailing_zeros() as usize;
                hit &= hit - 1;
                if !visit(all.footprint[first + lane]) {
                    return;
                }
            }
        }
    }
}

/// Those that are tested together, from the first on.
fn some(list: &[f32], first: usize) -> &[f32; CANDIDATES_AT_ONCE] {
    list[first..first + CANDIDATES_AT_ONCE].try_into().expect("lists are padded")
}

/// A bit for each candidate that may be drawn at a point.
#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.1"))]
fn passing(at: [f32; 2], [x, y, xx, xy, yy, reach]: [&[f32; CANDIDATES_AT_ONCE]; 6]) -> u32 {
    let mut beyond = [0.0_f32; CANDIDATES_AT_ONCE];
    for k in 0..CANDIDATES_AT_ONCE {
        let (dx, dy) = (x[k] - at[0], y[k] - at[1]);
        beyond[k] = (xx[k] * dx + xy[k] * dy) * dx + yy[k] * dy * dy - reach[k];
    }
    // Sign bits: negative is within reach.
    (0..CANDIDATES_AT_ONCE).fold(0, |hit, k| hit | (beyond[k].to_bits() >> 31) << k)
}

impl Row {
    fn new(footprints: &[Footprint], members: &[u32], row: u32, columns: u32, side: u32) -> Self {
        let of = |i: u32| &footprints[i as usize];
        let columns_of = |footprint: &Footprint| span(footprint.mean.x, footprint.extent.x, columns, side);
        let mut counts = vec![0_u32; columns as usize];
        for &i in members {
            columns_of(of(i)).for_each(|column| counts[column as usize] += 1);
        }
        let mut starts = vec![0];
        for count in counts {
            starts.push(starts[starts.len() - 1] + count.next_multiple_of(CANDIDATES_AT_ONCE as u32));
        }
        let len = starts[columns as usize] as usize;
        let zeros = || vec![0.0; len];
        let mut all = Candidates {
            x: zeros(),
            y: zeros(),
            xx: zeros(),
            xy: zeros(),
            yy: zeros(),
            // What pads lists is never within reach.
            reach: vec![-1.0; len],
            footprint: vec![0; len],
        };
        let mut next = starts.clone();
        for &i in members {
            let footprint = of(i);
            let [a, b, c] = footprint.conic;
            let wide = footprint.extent + DVec2::splat(f64::from(side));
            let terms = a * wide.x * wide.x + 2.0 * b.abs() * wide.x * wide.y + c * wide.y * wide.y;
            let reach = (footprint.reach + ROUNDING * terms + SLACK) as f32;
            for column in columns_of(footprint) {
                let middle = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5) * f64::from(side);
                let relative = (footprint.mean - middle).as_vec2();
                let at = next[column as usize] as usize;
                next[column as usize] += 1;
                (all.x[at], all.y[at], all.reach[at], all.footprint[at]) = (relative.x, relative.y, reach, i);
                (all.xx[at], all.xy[at], all.yy[at]) = (a as f32, (2.0 * b) as f32, c as f32);
            }
        }
        Self { candidates: all, starts }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::render::project::FAINTEST;

    /// A footprint that is round and has the given standard deviation.
    fn round(mean: DVec2, deviation: f64, depth: f64) -> Footprint {
        let reach = 2.0 * (0.9 / FAINTEST).ln();
        let a = deviation.powi(-2);
        Footprint {
            splat: 0,
            mean,
            conic: [a, 0.0, a],
            extent: DVec2::splat(deviation * reach.sqrt()),
            reach,
            opacity: 0.9,
            depth,
            thickness: 0.0,
            color: DVec3::ONE,
        }
    }

    #[test]
    fn all_that_is_drawn_at_a_point_is_found_in_the_order_of_depths() {
        let footprints: Vec<Footprint> = (0..300)
            .map(|i| {
                let [x, y, depth] = [f64::from(i * 37 % 101), f64::from(i * 53 % 67), f64::from(i * 29 % 17)];
                round(DVec2::new(x, y), 0.6 + f64::from(i % 7), 1.0 + depth)
            })
            .collect();
        let footprints: Vec<Footprint> =
            front_to_back(&footprints).into_iter().map(|i| footprints[i as usize]).collect();
        let tiles = Tiles::new(&footprints, [100, 66]);
        for at in [[0.5, 0.5], [50.3, 17.9], [99.5, 65.5], [8.0, 16.0]] {
            let mut found = Vec::new();
            tiles.visit(at, |i| {
                found.push(i);
                true
            });
            let is_drawn = |i: &u32| {
                let Footprint { mean, conic, opacity, .. } = footprints[*i as usize];
                opacity * (-0.5 * conic[0] * mean.distance_squared(DVec2::from(at))).exp() >= FAINTEST
            };
            let mut drawn: Vec<u32> = (0..300).filter(is_drawn).collect();
            drawn.sort_by(|a, b| footprints[*a as usize].depth.total_cmp(&footprints[*b as usize].depth));
            let kept: Vec<u32> = found.iter().copied().filter(is_drawn).collect();
            assert_eq!(kept, drawn, "{at:?}");
            // Few others pass the test in f32.
            assert!(found.len() <= drawn.len() + 1 && !drawn.is_empty(), "{at:?}: {found:?}");
        }
        // Some stop early.
        let mut count = 0;
        tiles.visit([50.3, 17.9], |_| {
            count += 1;
            count < 2
        });
        assert_eq!(count, 2);
    }

    #[test]
    fn splats_that_fill_a_large_image_make_tiles_larger() {
        // 250,000 tiles of 8 px each, times 100.
        let footprints: Vec<Footprint> =
            (0..100).map(|i| round(DVec2::splat(2000.0), 3000.0, 1.0 + f64::from(i))).collect();
        let tiles = Tiles::new(&footprints, [4000, 4000]);
        assert_eq!(tiles.side, 16);
        let mut found = Vec::new();
        tiles.visit([3999.5, 0.5], |i| {
            found.push(i);
            true
        });
        assert_eq!(found, (0..100).collect::<Vec<u32>>());
    }
}
