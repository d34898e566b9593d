//! Ellipses to pixels, and the derivatives of a loss by pixels back to ellipses.
//!
//! An image is divided into tiles of 8 × 8 pixels. A tile goes through its ellipses from front to back, and through
//! the rows that each covers, eight pixels at a time. The way back goes front to back as well: what lies behind
//! ellipse i is the pixel's colour without all up to i.

use glam::Vec3;
use multiversion::multiversion;
use rayon::prelude::*;

use super::project::{Ellipse, Moments};
use octobayes_models::elementary::exp;

/// Side of a tile, pixels.
const SIDE: usize = 8;
const FAINTEST: f32 = octobayes_splats::FAINTEST as f32;
const MOST_OPAQUE: f32 = octobayes_splats::MOST_OPAQUE as f32;
const MIN_TRANSMITTANCE: f32 = octobayes_splats::MIN_TRANSMITTANCE as f32;

/// Eight pixels of a row.
type Lanes = [f32; SIDE];

/// The ellipses of an image by tile, front to back.
pub struct Tiles {
    resolution: [u32; 2],
    columns: usize,
    /// Where the lists of tiles begin, `[tiles + 1]`.
    starts: Vec<u32>,
    /// Indices of ellipses.
    list: Vec<u32>,
}

/// What a tile shows: colours by row and channel, light that passes.
struct Shown {
    color: [[Lanes; 3]; SIDE],
    left: [Lanes; SIDE],
}

/// Tiles that an interval of pixels meets, of `count`.
fn span(middle: f32, extent: f32, count: usize) -> std::ops::Range<usize> {
    let tile = |at: f32| (at / SIDE as f32).floor();
    let bound = |at: f32| at.clamp(0.0, count as f32) as usize;
    bound(tile(middle - extent))..bound(tile(middle + extent) + 1.0)
}

impl Tiles {
    /// Lists ellipses of an image of `resolution` pixels. Those of equal depth stay in their order.
    pub fn new(ellipses: &[Ellipse], resolution: [u32; 2]) -> Self {
        let [columns, rows] = resolution.map(|pixels| (pixels as usize).div_ceil(SIDE));
        // Depths are positive: their bits have their order.
        let mut order: Vec<u64> =
            ellipses.iter().zip(0_u64..).map(|(ellipse, i)| u64::from(ellipse.depth.to_bits()) << 32 | i).collect();
        order.par_sort_unstable();
        let tiles = |ellipse: &Ellipse| {
            let across = span(ellipse.mean.x, ellipse.extent.x, columns);
            let down = span(ellipse.mean.y, ellipse.extent.y, rows);
            down.flat_map(move |row| across.clone().map(move |column| row * columns + column))
        };
        let mut starts = vec![0_u32; columns * rows + 1];
        ellipses.iter().for_each(|ellipse| tiles(ellipse).for_each(|tile| starts[tile + 1] += 1));
        for tile in 0..columns * rows {
            starts[tile + 1] += starts[tile];
        }
        let mut next = starts.clone();
        let mut list = vec![0; starts[columns * rows] as usize];
        for key in order {
            for tile in tiles(&ellipses[key as u32 as usize]) {
                list[next[tile] as usize] = key as u32;
                next[tile] += 1;
            }
        }
        Self { resolution, columns, starts, list }
    }

    fn count(&self) -> usize {
        self.starts.len() - 1
    }

    fn members(&self, tile: usize) -> &[u32] {
        &self.list[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// First column and row of a tile.
    fn corner(&self, tile: usize) -> [usize; 2] {
        [tile % self.columns * SIDE, tile / self.columns * SIDE]
    }

    /// The pixels of a tile that lie inside the image: index in the image, row and lane.
    fn pixels(&self, tile: usize) -> impl Iterator<Item = (usize, usize, usize)> {
        let ([x, y], [width, height]) = (self.corner(tile), self.resolution.map(|n| n as usize));
        let lanes = SIDE.min(width - x);
        (0..SIDE.min(height - y)).flat_map(move |r| (0..lanes).map(move |l| ((y + r) * width + x + l, r, l)))
    }

    /// The image `[height · width]` in front of a background.
    pub fn image(&self, ellipses: &[Ellipse], background: Vec3) -> Vec<Vec3> {
        let shown: Vec<Shown> = (0..self.count())
            .into_par_iter()
            .with_min_len(8)
            .map(|tile| show(ellipses, self.members(tile), self.corner(tile)))
            .collect();
        let mut image = vec![Vec3::ZERO; self.resolution[0] as usize * self.resolution[1] as usize];
        for (tile, Shown { color, left }) in shown.iter().enumerate() {
            for (i, r, l) in self.pixels(tile) {
                image[i] = Vec3::from(color[r].map(|channel| channel[l])) + left[r][l] * background;
            }
        }
        image
    }

    /// The sums of each ellipse, from the image and the derivatives of the loss by its pixels. The order in which they
    /// are summed is that of tiles and rows, whatever the number of threads.
    pub fn moments(&self, ellipses: &[Ellipse], image: &[Vec3], by_pixel: &[Vec3]) -> Vec<Moments> {
        let parts: Vec<Vec<Moments>> = (0..self.count())
            .into_par_iter()
            .with_min_len(8)
            .map(|tile| {
                let (mut by, mut total) = ([[[0.0; SIDE]; 3]; SIDE], [[0.0; SIDE]; SIDE]);
                for (i, r, l) in self.pixels(tile) {
                    (0..3).for_each(|channel| by[r][channel][l] = by_pixel[i][channel]);
                    total[r][l] = image[i].dot(by_pixel[i]);
                }
                let members = self.members(tile);
                let mut out = vec![[0.0; 9]; members.len()];
                sum(ellipses, members, self.corner(tile), &by, &total, &mut out);
                out
            })
            .collect();
        let mut moments = vec![[0.0; 9]; ellipses.len()];
        for (tile, part) in parts.iter().enumerate() {
            for (&i, part) in self.members(tile).iter().zip(part) {
                (0..9).for_each(|k| moments[i as usize][k] += part[k]);
            }
        }
        moments
    }
}

/// An ellipse as a row of a tile needs it: d₀ of its first pixel, d₁, and the ellipse.
struct Across<'a> {
    ellipse: &'a Ellipse,
    dx: f32,
    dy: f32,
}

/// α before it is limited, for each lane.
#[inline(always)]
fn free(across: &Across) -> Lanes {
    let [a, b, c] = across.ellipse.conic;
    let mut out = [0.0; SIDE];
    for (l, out) in out.iter_mut().enumerate() {
        let dx = across.dx - l as f32;
        let q = (a * dx + 2.0 * b * across.dy) * dx + c * across.dy * across.dy;
        *out = across.ellipse.opacity * exp(-0.5 * q);
    }
    out
}

/// Rows of a tile that an ellipse covers.
#[inline(always)]
fn rows(ellipse: &Ellipse, top: usize) -> std::ops::Range<usize> {
    let (low, high) = (ellipse.mean.y - ellipse.extent.y - 0.5, ellipse.mean.y + ellipse.extent.y - 0.5);
    let at = |y: f32| (y - top as f32).clamp(0.0, SIDE as f32) as usize;
    at(low.ceil())..at(high.floor() + 1.0)
}

/// α of each lane as drawn: limited, 0 where it is too faint or where the ray has ended, and ends rays.
#[inline(always)]
fn drawn(free: &Lanes, left: &Lanes, live: &mut Lanes) -> Lanes {
    let mut out = [0.0; SIDE];
    for l in 0..SIDE {
        let alpha = free[l].min(MOST_OPAQUE);
        let is_drawn = if alpha >= FAINTEST { live[l] } else { 0.0 };
        let ends = if left[l] * (1.0 - alpha) < MIN_TRANSMITTANCE { is_drawn } else { 0.0 };
        live[l] -= ends;
        out[l] = alpha * (is_drawn - ends);
    }
    out
}

fn is_over(live: &[Lanes; SIDE]) -> bool {
    live.iter().flatten().all(|lane| *lane == 0.0)
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn show(ellipses: &[Ellipse], members: &[u32], [x, y]: [usize; 2]) -> Shown {
    let mut shown = Shown { color: [[[0.0; SIDE]; 3]; SIDE], left: [[1.0; SIDE]; SIDE] };
    let mut live = [[1.0_f32; SIDE]; SIDE];
    for (n, &i) in members.iter().enumerate() {
        if n % 16 == 15 && is_over(&live) {
            break;
        }
        let ellipse = &ellipses[i as usize];
        let [red, green, blue] = ellipse.color.to_array();
        let dx = ellipse.mean.x - x as f32 - 0.5;
        for r in rows(ellipse, y) {
            let across = Across { ellipse, dx, dy: ellipse.mean.y - (y + r) as f32 - 0.5 };
            let alpha = drawn(&free(&across), &shown.left[r], &mut live[r]);
            let (left, [reds, greens, blues]) = (&mut shown.left[r], &mut shown.color[r]);
            for l in 0..SIDE {
                let weight = left[l] * alpha[l];
                left[l] -= weight;
                reds[l] += weight * red;
                greens[l] += weight * green;
                blues[l] += weight * blue;
            }
        }
    }
    shown
}

/// The sums of the ellipses of a tile, `[members]`, from the derivatives by its pixels and their products with the
/// pixels' colours.
#[multiversion(targets("x86_64+avx2+fma"))]
fn sum(
    ellipses: &[Ellipse],
    members: &[u32],
    [x, y]: [usize; 2],
    by_pixel: &[[Lanes; 3]; SIDE],
    total: &[Lanes; SIDE],
    out: &mut [Moments],
) {
    let (mut left, mut live) = ([[1.0_f32; SIDE]; SIDE], [[1.0_f32; SIDE]; SIDE]);
    // What is not yet accounted for of the total.
    let mut behind = *total;
    for (n, (&i, out)) in members.iter().zip(out).enumerate() {
        if n % 16 == 15 && is_over(&live) {
            break;
        }
        let ellipse = &ellipses[i as usize];
        let [red, green, blue] = ellipse.color.to_array();
        let dx = ellipse.mean.x - x as f32 - 0.5;
        let mut sums = [[0.0_f32; SIDE]; 9];
        for r in rows(ellipse, y) {
            let dy = ellipse.mean.y - (y + r) as f32 - 0.5;
            let free = free(&Across { ellipse, dx, dy });
            let alpha = drawn(&free, &left[r], &mut live[r]);
            let [by_red, by_green, by_blue] = &by_pixel[r];
            let (left, behind) = (&mut left[r], &mut behind[r]);
            for l in 0..SIDE {
                let before = left[l];
                let weight = before * alpha[l];
                left[l] -= weight;
                let own = red * by_red[l] + green * by_green[l] + blue * by_blue[l];
                behind[l] -= weight * own;
                let by_alpha = before * own - behind[l] / (1.0 - alpha[l]);
                let s = if free[l] < MOST_OPAQUE { by_alpha * alpha[l] } else { 0.0 };
                let dx = dx - l as f32;
                let (sx, sy) = (s * dx, s * dy);
                sums[0][l] += s;
                sums[1][l] += sx;
                sums[2][l] += sy;
                sums[3][l] += sx * dx;
                sums[4][l] += sx * dy;
                sums[5][l] += sy * dy;
                sums[6][l] += weight * by_red[l];
                sums[7][l] += weight * by_green[l];
                sums[8][l] += weight * by_blue[l];
            }
        }
        *out = sums.map(|lanes| lanes.iter().sum());
    }
}
