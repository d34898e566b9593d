//! Where a model is: its (cascaded) occupancy grid as a continuous window that multiplies the density.
//!
//! Letters: `p` file position; `n` cells per axis (a multiple of 4); `k` cascade, the cube of side 2ᵏ around
//! p = ½ in n³ cells. A point belongs to the finest cascade that contains it.
//!
//! The trainer samples occupied cells only. Elsewhere no loss constrains the network, and it has fog and
//! floaters. A cut at the cells' faces would add jumps of density that are in no image, and finite
//! differences across a face would include them. So the window w is 1 in all occupied cells, falls linearly to 0
//! over the next cell, and is continuous everywhere inside the box. It is trilinear between cell corners, and
//! a corner is 1 if one of its cells is occupied. Where cascades meet, fine corners that hang on a coarse
//! face take the interpolated value of that face (as hanging vertices of an octree do). A coarse cell that
//! fine ones replace counts as occupied if one of them is.

use glam::{DVec3, Vec3};

/// The value 1 in quarters: a hanging corner in the middle of a face is the mean of four.
const ONE: u8 = 4;

/// One cascade.
#[derive(Debug, Clone)]
struct Cascade {
    /// 4 w at the cells' corners: `[n + 1]³`, x fastest.
    corners: Vec<u8>,
    /// Bit x is set if w > 0 somewhere in the cell: `[n, n]`, y fastest. Cells that a finer cascade replaces are clear.
    rows: Vec<u128>,
    /// Two rows of bits: bit x of the first is set if w > 0 somewhere in the cell, of the second if w = 1
    /// everywhere. `[n, n]`, y fastest.
    ///
    /// Most cells are 0 or 1 throughout, so their corners, 2 MB, need not be read.
    constant: Vec<[u128; 2]>,
}

/// The window around a point.
enum Around<'a> {
    /// w = 0, also outside the box.
    Zero,
    /// w = 1.
    One,
    /// The cell's corners from the lowest, the stride between their rows, the offset in the cell, and cells
    /// per file unit.
    Ramp(&'a [u8], usize, Vec3, f32),
}

/// The window w(p).
#[derive(Debug, Clone)]
pub struct Window {
    n: usize,
    cascades: Vec<Cascade>,
}

impl Window {
    /// Builds the window from occupied cells, `[cascades][n³]`, x fastest.
    pub fn new(n: usize, mut occupied: Vec<Vec<bool>>) -> Self {
        debug_assert!(n.is_multiple_of(4) && (4..=128).contains(&n), "{n} cells per axis");
        for k in 1..occupied.len() {
            let (fine, coarse) = occupied.split_at_mut(k);
            pool(n, &fine[k - 1], &mut coarse[0]);
        }
        let mut cascades: Vec<Cascade> = Vec::new();
        for (k, cells) in occupied.iter().enumerate().rev() {
            let mut corners = corners(n, cells);
            if let Some(coarse) = cascades.last() {
                hang(n, &coarse.corners, &mut corners);
            }
            let (rows, constant) = (rows(n, &corners, k > 0), constant(n, &corners));
            cascades.push(Cascade { corners, rows, constant });
        }
        cascades.reverse();
        Self { n, cascades }
    }

    /// Side of the outermost cube, file units.
    pub fn side(&self) -> f64 {
        (1_u64 << (self.cascades.len() - 1)) as f64
    }

    /// w at p = ½ + `c`; 0 outside the box.
    ///
    /// Inlining is forced, here and below: left to the compiler it varies from build to build and costs 4 % of a run.
    #[inline(always)]
    pub fn at(&self, c: Vec3) -> f32 {
        let (corners, m, t) = match self.around(c) {
            Around::Zero => return 0.0,
            Around::One => return 1.0,
            Around::Ramp(corners, m, t, _) => (corners, m, t),
        };
        let along_x = |i: usize| lerp(f32::from(corners[i]), f32::from(corners[i + 1]), t.x);
        let along_xy = |i: usize| lerp(along_x(i), along_x(i + m), t.y);
        lerp(along_xy(0), along_xy(m * m), t.z) / f32::from(ONE)
    }

    /// w and ∇w at p = ½ + `c`, per file unit.
    #[inline(always)]
    pub fn at_with_gradient(&self, c: Vec3) -> (f32, Vec3) {
        let (corners, m, t, per_unit) = match self.around(c) {
            Around::Zero => return (0.0, Vec3::ZERO),
            Around::One => return (1.0, Vec3::ZERO),
            Around::Ramp(corners, m, t, per_unit) => (corners, m, t, per_unit),
        };
        // (value, ∂x) along x; then ∂y is added, then ∂z.
        let along_x = |i: usize| {
            let [a, b] = [corners[i], corners[i + 1]].map(f32::from);
            (lerp(a, b, t.x), b - a)
        };
        let along_xy = |i: usize| {
            let [(a, da), (b, db)] = [along_x(i), along_x(i + m)];
            (lerp(a, b, t.y), lerp(da, db, t.y), b - a)
        };
        let [(a, ax, ay), (b, bx, by)] = [along_xy(0), along_xy(m * m)];
        let gradient = Vec3::new(lerp(ax, bx, t.z), lerp(ay, by, t.z), b - a) * per_unit;
        (lerp(a, b, t.z) / f32::from(ONE), gradient / f32::from(ONE))
    }

    /// The window around p = ½ + `c`.
    #[inline(always)]
    fn around(&self, c: Vec3) -> Around<'_> {
        let reach = 2.0 * c.abs().max_element();
        let (mut k, mut side) = (0, 1.0_f32);
        while reach > side {
            k += 1;
            side *= 2.0;
            if k == self.cascades.len() {
                return Around::Zero;
            }
        }
        let u = (c / side + 0.5) * self.n as f32;
        let low = u.to_array().map(|u| (u as usize).min(self.n - 1));
        let cascade = &self.cascades[k];
        match cascade.constant[low[2] * self.n + low[1]].map(|row| row >> low[0] & 1) {
            [0, _] => Around::Zero,
            [_, 1] => Around::One,
            _ => {
                let t = u - Vec3::from_array(low.map(|i| i as f32));
                let m = self.n + 1;
                let corners = &cascade.corners[(low[2] * m + low[1]) * m + low[0]..][..(m + 1) * m + 2];
                Around::Ramp(corners, m, t, self.n as f32 / side)
            }
        }
    }

    /// Checks whether w is 0 everywhere in the box from ½ + `min` to ½ + `max`, and at all positions that f32
    /// rounds into it.
    pub fn is_empty(&self, min: DVec3, max: DVec3) -> bool {
        // A position is rounded a few times on its way to a cell. Since w rises from 0, what is missed is of
        // the same order.
        let slack = 4.0 * f64::from(f32::EPSILON) * self.side();
        let n = self.n as f64;
        self.cascades.iter().enumerate().all(|(k, cascade)| {
            let side = (1_u64 << k) as f64;
            let [low, high] = [min - slack, max + slack].map(|c| ((c / side + 0.5) * n).floor());
            if low.max_element() >= n || high.min_element() < 0.0 {
                return true;
            }
            let [low, high] = [low, high].map(|g| g.to_array().map(|g| (g.max(0.0) as usize).min(self.n - 1)));
            let bits = (u128::MAX << low[0]) & (u128::MAX >> (127 - high[0]));
            (low[2]..=high[2]).all(|z| {
                let row = z * self.n;
                cascade.rows[row + low[1]..=row + high[1]].iter().all(|row| row & bits == 0)
            })
        })
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        let of = |c: &Cascade| {
            size_of_val(c.corners.as_slice()) + size_of_val(c.rows.as_slice()) + size_of_val(c.constant.as_slice())
        };
        self.cascades.iter().map(of).sum()
    }
}

/// a + t (b − a).
#[inline]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}

/// Sets the coarse cells of the central half from the fine cells.
fn pool(n: usize, fine: &[bool], coarse: &mut [bool]) {
    let half = n / 2;
    for (i, j, k) in triples(half) {
        let any = (0..8).any(|c| {
            let [x, y, z] = [2 * i + (c & 1), 2 * j + (c >> 1 & 1), 2 * k + (c >> 2)];
            fine[(z * n + y) * n + x]
        });
        let [x, y, z] = [i, j, k].map(|i| i + n / 4);
        coarse[(z * n + y) * n + x] = any;
    }
}

/// Corner values of a single cascade.
fn corners(n: usize, occupied: &[bool]) -> Vec<u8> {
    let m = n + 1;
    let mut corners = vec![0; m * m * m];
    for (x, y, z) in triples(n) {
        if occupied[(z * n + y) * n + x] {
            for c in 0..8 {
                corners[((z + (c >> 2)) * m + y + (c >> 1 & 1)) * m + x + (c & 1)] = ONE;
            }
        }
    }
    corners
}

/// Gives corners on the outside of a fine cascade the coarse interpolant.
fn hang(n: usize, coarse: &[u8], fine: &mut [u8]) {
    let m = n + 1;
    for (x, y, z) in triples(m) {
        if [x, y, z].iter().any(|&i| i == 0 || i == n) {
            // Along an odd index the corner is half-way between two coarse ones. The index across the face is even.
            let sum: usize = (0..8)
                .map(|c| {
                    let [x, y, z] = [(x, c & 1), (y, c >> 1 & 1), (z, c >> 2)].map(|(i, up)| n / 4 + (i + up) / 2);
                    usize::from(coarse[(z * m + y) * m + x])
                })
                .sum();
            fine[(z * m + y) * m + x] = (sum / 8) as u8;
        }
    }
}

/// Rows of the cells in which w is not 0, without the central half if a finer cascade replaces it.
fn rows(n: usize, corners: &[u8], replaced: bool) -> Vec<u128> {
    let m = n + 1;
    let mut rows = vec![0; n * n];
    let central = n / 4..3 * n / 4;
    for (x, y, z) in triples(n) {
        let any = (0..8).any(|c| corners[((z + (c >> 2)) * m + y + (c >> 1 & 1)) * m + x + (c & 1)] > 0);
        if any && !(replaced && [x, y, z].iter().all(|i| central.contains(i))) {
            rows[z * n + y] |= 1 << x;
        }
    }
    rows
}

/// Rows of the cells in which w is not 0, and of those in which it is 1.
fn constant(n: usize, corners: &[u8]) -> Vec<[u128; 2]> {
    let m = n + 1;
    let mut rows = vec![[0; 2]; n * n];
    for (x, y, z) in triples(n) {
        let around = [0, 1, 2, 3, 4, 5, 6, 7_usize];
        let values = around.map(|c| corners[((z + (c >> 2)) * m + y + (c >> 1 & 1)) * m + x + (c & 1)]);
        let [some, all] = &mut rows[z * n + y];
        *some |= u128::from(values.iter().any(|&v| v > 0)) << x;
        *all |= u128::from(values.iter().all(|&v| v == ONE)) << x;
    }
    rows
}

/// All (x, y, z) below `n`.
fn triples(n: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..n * n * n).map(move |i| (i % n, i / n % n, i / (n * n)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    const N: usize = 8;

    /// Three cascades with a few occupied cells each.
    fn random(rng: &mut ChaCha8Rng, share: f64) -> Vec<Vec<bool>> {
        (0..3).map(|_| (0..N * N * N).map(|_| rng.random_bool(share)).collect()).collect()
    }

    fn draw(rng: &mut ChaCha8Rng, half: f32) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| rng.random_range(-half..half)))
    }

    /// Checks whether the cell of p = ½ + c in its finest cascade is occupied, as the trainer looks it up.
    fn occupied_at(cells: &[Vec<bool>], c: Vec3) -> bool {
        let k = (0..3).find(|&k| c.abs().max_element() <= 0.5 * (1 << k) as f32).unwrap();
        let [x, y, z] = ((c / (1 << k) as f32 + 0.5) * N as f32).to_array().map(|g| (g as usize).min(N - 1));
        cells[k][(z * N + y) * N + x]
    }

    #[test]
    fn one_in_occupied_cells_and_continuous() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut inside, mut ramp) = (0, 0);
        for _ in 0..20 {
            let cells = random(&mut rng, 0.02);
            let window = Window::new(N, cells.clone());
            assert_eq!(window.side(), 4.0);
            for _ in 0..3000 {
                let c = draw(&mut rng, 2.0) * if rng.random_bool(0.5) { 0.5 } else { 1.0 };
                let w = window.at(c);
                assert!((0.0..=1.0).contains(&w));
                if occupied_at(&cells, c) {
                    assert_eq!(w, 1.0, "{c}");
                    inside += 1;
                }
                ramp += usize::from(w > 0.0 && w < 1.0);
                // Along each axis w changes by at most 1 per cell, here by at most N per file unit. f32 adds
                // a few ulps.
                let step = draw(&mut rng, 1e-3);
                let limit = N as f32 * (step.x.abs() + step.y.abs() + step.z.abs()) + 1e-5;
                let jump = (window.at((c + step).clamp(Vec3::splat(-2.0), Vec3::splat(2.0))) - w).abs();
                assert!(jump <= limit, "{jump} > {limit} from {c} by {step}");
            }
        }
        assert!(inside > 500 && ramp > 1000, "{inside} {ramp}");
    }

    #[test]
    fn gradients_are_differences_within_a_cell() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut steep = 0;
        for _ in 0..20 {
            let window = Window::new(N, random(&mut rng, 0.05));
            for _ in 0..200 {
                // Stays well inside a cell of the finest cascade at that place.
                let (side, half) = if rng.random_bool(0.5) { (1.0, 0.5) } else { (4.0, 2.0) };
                let edge = side / N as f32;
                let cell = ((draw(&mut rng, half) / edge).floor() + 0.5) * edge;
                if side == 4.0 && cell.abs().max_element() < 1.0 {
                    continue;
                }
                let c = cell + draw(&mut rng, 0.3) * edge;
                let (w, gradient) = window.at_with_gradient(c);
                assert_eq!(w, window.at(c));
                for axis in 0..3 {
                    let mut ends = [c; 2];
                    ends[0][axis] += 0.15 * edge;
                    ends[1][axis] -= 0.15 * edge;
                    // Linear along each axis, so the only error is rounding: 1e-7 over steps of 0.04 and more.
                    let expected = (window.at(ends[0]) - window.at(ends[1])) / (0.3 * edge);
                    assert!((expected - gradient[axis]).abs() < 1e-4, "{c}: {expected} {gradient}");
                    steep += usize::from(expected.abs() > 0.1);
                }
            }
        }
        assert!(steep > 500, "{steep}");
        let window = Window::new(N, random(&mut rng, 0.05));
        assert_eq!(window.at_with_gradient(Vec3::splat(2.1)), (0.0, Vec3::ZERO));
    }

    #[test]
    fn continuous_across_the_faces_between_cascades() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut partial = 0;
        for _ in 0..50 {
            let window = Window::new(N, random(&mut rng, 0.02));
            for _ in 0..500 {
                let half = if rng.random_bool(0.5) { 0.5 } else { 1.0 };
                let mut c = draw(&mut rng, half);
                let axis = rng.random_range(0..3);
                c[axis] = half;
                let inside = window.at(c);
                c[axis] = half.next_up();
                // The next f32 is at most 1.2e-7 away, and w changes by at most 8 per unit.
                assert!((window.at(c) - inside).abs() <= 1e-5, "{c}: {inside}, {}", window.at(c));
                partial += usize::from(inside > 0.0 && inside < 1.0);
            }
        }
        assert!(partial > 1000, "{partial}");
        assert_eq!(Window::new(N, vec![vec![true; N * N * N]]).at(Vec3::splat(0.5001)), 0.0);
    }

    #[test]
    fn empty_boxes_are_empty_and_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let [mut empty, mut full] = [0, 0];
        for _ in 0..200 {
            let window = Window::new(N, random(&mut rng, 0.002));
            for _ in 0..50 {
                let (a, size) = (draw(&mut rng, 2.2), draw(&mut rng, 0.4).abs());
                let inner: Vec<Vec3> = (0..100).map(|_| a + size * (draw(&mut rng, 0.5) + 0.5)).collect();
                let found = window.is_empty(a.as_dvec3(), (a + size).as_dvec3());
                let truth = inner.iter().all(|&c| window.at(c) == 0.0);
                assert!(truth || !found, "{a} {size}");
                empty += usize::from(found);
                full += usize::from(!found);
            }
        }
        assert!(empty > 500 && full > 500, "{empty} {full}");
        // One cell is one bit. The window reaches one cell further and no more.
        let mut cells = vec![vec![false; N * N * N]];
        cells[0][(4 * N + 2) * N + 3] = true;
        let window = Window::new(N, cells);
        let point = |x: f64, y: f64, z: f64| (DVec3::new(x, y, z) / N as f64) - 0.5;
        let is_empty = |p: DVec3| window.is_empty(p, p);
        assert!(!is_empty(point(2.1, 1.1, 3.1)) && is_empty(point(1.9, 2.5, 4.5)) && is_empty(point(3.5, 4.1, 4.5)));
        assert!(!window.is_empty(point(-9.0, -9.0, -9.0), point(90.0, 90.0, 90.0)));
    }
}
