//! Where splats begin: near the surface of the visual hull, if images say where the object is; else anywhere in the
//! box.
//!
//! The hull (Laurentini 1994) is what every camera shows as opaque. It is found on a lattice of cells, coarsely in the
//! box of the scene and then finely in its own box. A cell counts as shown if any pixel near its centre's image is.

use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::cloud::{LOGIT, MEAN, ROTATION, Row, SCALE, SH, WIDTH};
use super::harmonics;
use crate::geometry::Aabb;
use crate::train::Shot;

/// Cells along the longest edge of the box, coarse and fine.
const CELLS: [usize; 2] = [48, 96];
/// Least alpha of an object's pixel.
const OBJECT: f64 = 0.5;
/// Opacity at the start, as in the original code.
const OPACITY: f32 = 0.1;
/// Places tried for each point that a camera has to see.
const TRIES: usize = 20;

/// The first splats and where they lie.
pub struct Start {
    pub rows: Vec<Row>,
    /// Half of the longest edge of what they fill, scene units.
    pub extent: f32,
    /// Whether images say where the object is.
    pub is_hull: bool,
}

/// The pixels near which an image shows the object, and the camera; pixels outside the image show nothing.
struct Silhouette<'a> {
    shot: &'a Shot,
    is_object: Vec<bool>,
}

impl<'a> Silhouette<'a> {
    fn new(shot: &'a Shot) -> Self {
        let [width, height] = shot.camera.resolution.map(|n| n as usize);
        let mut is_object = vec![false; width * height];
        for i in (0..width * height).filter(|&i| !shot.keeps(i) || shot.image.alpha(i) >= OBJECT) {
            let (x, y) = (i % width, i / width);
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                is_object[y * width + x.saturating_sub(1)..y * width + (x + 2).min(width)].fill(true);
            }
        }
        Self { shot, is_object }
    }

    /// Whether the image allows an object at `x`. What it does not show may be anywhere.
    fn allows(&self, x: DVec3) -> bool {
        pixel(self.shot, x).is_none_or(|i| self.is_object[i])
    }
}

/// The pixel that shows `x`.
fn pixel(shot: &Shot, x: DVec3) -> Option<usize> {
    let ([column, row], _) = shot.camera.project(x)?;
    let [width, height] = shot.camera.resolution.map(f64::from);
    let is_inside = (0.0..width).contains(&column) && (0.0..height).contains(&row);
    is_inside.then(|| row as usize * width as usize + column as usize)
}

/// Cells of equal edge that fill a box.
struct Cells {
    bounds: Aabb,
    count: [usize; 3],
    edge: f64,
}

impl Cells {
    fn new(bounds: Aabb, along: usize) -> Self {
        let edge = bounds.longest_edge() / along as f64;
        let count = bounds.size().to_array().map(|size| (size / edge).ceil().max(1.0) as usize);
        Self { bounds, count, edge }
    }

    fn len(&self) -> usize {
        self.count.iter().product()
    }

    fn place(&self, i: usize) -> [usize; 3] {
        let [x, y, _] = self.count;
        [i % x, i / x % y, i / (x * y)]
    }

    /// The point of a cell at `within`, from 0 to 1 along each axis.
    fn point(&self, i: usize, within: DVec3) -> DVec3 {
        let place = DVec3::from(self.place(i).map(|k| k as f64));
        self.bounds.min() + self.edge * (place + within)
    }

    /// Whether each cell is one that all images allow and some show.
    fn carved(&self, silhouettes: &[Silhouette]) -> Vec<bool> {
        let is_hull = |i: usize| {
            let x = self.point(i, DVec3::splat(0.5));
            silhouettes.iter().all(|s| s.allows(x)) && silhouettes.iter().any(|s| pixel(s.shot, x).is_some())
        };
        (0..self.len()).into_par_iter().with_min_len(64).map(is_hull).collect()
    }

    /// Cells of a set that have a neighbour outside it.
    fn surface(&self, is_in: &[bool]) -> Vec<usize> {
        let [x, y, _] = self.count;
        let is_outer = |i: &usize| {
            let place = self.place(*i);
            let steps = [1, x, x * y];
            (0..3).any(|axis| {
                place[axis] == 0
                    || place[axis] + 1 == self.count[axis]
                    || !is_in[i - steps[axis]]
                    || !is_in[i + steps[axis]]
            })
        };
        (0..self.len()).filter(|i| is_in[*i]).filter(is_outer).collect()
    }
}

/// The smallest box of the cells of a set, one cell wider at each side; `None` if it is empty.
fn box_of(cells: &Cells, is_in: &[bool]) -> Option<Aabb> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for i in (0..cells.len()).filter(|i| is_in[*i]) {
        low = low.min(cells.point(i, DVec3::ZERO));
        high = high.max(cells.point(i, DVec3::ONE));
    }
    Aabb::new(low - cells.edge, high + cells.edge).ok()
}

impl Start {
    /// `count` splats for these images in a box.
    pub fn new(shots: &[Shot], bounds: Aabb, count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (points, extent, is_hull) = match hull_points(shots, bounds, count, &mut rng) {
            Some((points, extent)) => (points, extent, true),
            None => (points_in(shots, bounds, count, &mut rng), 0.5 * bounds.longest_edge(), false),
        };
        // A lattice with as many points in the same volume, for the distance between neighbours.
        let spacing = spacing(&points);
        let rows = points.into_iter().map(|x| row(x, shots, spacing)).collect();
        Self { rows, extent: extent as f32, is_hull }
    }
}

fn within(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::from(std::array::from_fn(|_| rng.random()))
}

/// Points near the surface of the hull, and half of its longest edge. `None` if images do not show where the object
/// ends, or if nothing is left of the hull.
fn hull_points(shots: &[Shot], bounds: Aabb, count: usize, rng: &mut ChaCha8Rng) -> Option<(Vec<DVec3>, f64)> {
    let is_cut_out = |shot: &Shot| (0..shot.image.len()).any(|i| shot.keeps(i) && shot.image.alpha(i) < OBJECT);
    if !shots.iter().all(is_cut_out) {
        return None;
    }
    let silhouettes: Vec<Silhouette> = shots.par_iter().map(Silhouette::new).collect();
    let coarse = Cells::new(bounds, CELLS[0]);
    let hull = box_of(&coarse, &coarse.carved(&silhouettes))?;
    let low = hull.min().max(bounds.min());
    let hull = Aabb::new(low, hull.max().min(bounds.max())).ok()?;
    let cells = Cells::new(hull, CELLS[1]);
    let surface = cells.surface(&cells.carved(&silhouettes));
    if surface.is_empty() {
        return None;
    }
    let points = (0..count).map(|_| cells.point(surface[rng.random_range(0..surface.len())], within(rng))).collect();
    Some((points, 0.5 * hull.longest_edge()))
}

/// Points of a box that some camera sees, if that is not too much to ask for.
fn points_in(shots: &[Shot], bounds: Aabb, count: usize, rng: &mut ChaCha8Rng) -> Vec<DVec3> {
    let mut points = Vec::with_capacity(count);
    for _ in 0..count {
        let mut point = bounds.min();
        for _ in 0..TRIES {
            point = bounds.min() + bounds.size() * within(rng);
            if shots.iter().any(|shot| pixel(shot, point).is_some()) {
                break;
            }
        }
        points.push(point);
    }
    points
}

/// Median distance of some points to their nearest neighbour.
fn spacing(points: &[DVec3]) -> f64 {
    let some = points.iter().step_by((points.len() / 200).max(1));
    let nearest = |x: &DVec3| {
        let others = points.iter().map(|y| x.distance_squared(*y)).filter(|d| *d > 0.0);
        others.fold(f64::INFINITY, f64::min).sqrt()
    };
    let mut distances: Vec<f64> = some.map(nearest).filter(|d| d.is_finite()).collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied().unwrap_or(1.0)
}

/// A round splat with the mean colour of the pixels at its image.
fn row(x: DVec3, shots: &[Shot], spacing: f64) -> Row {
    let (mut color, mut weight) = (DVec3::ZERO, 1e-3);
    for shot in shots {
        if let Some(i) = pixel(shot, x).filter(|&i| shot.keeps(i)) {
            let alpha = shot.image.alpha(i);
            color += alpha * shot.image.over(i, DVec3::ZERO) / alpha.max(1e-3);
            weight += alpha;
        }
    }
    let color = (color / weight).as_vec3();
    let mut row = [0.0; WIDTH];
    row[MEAN..MEAN + 3].copy_from_slice(&x.as_vec3().to_array());
    row[SCALE..SCALE + 3].fill((spacing as f32).ln());
    row[ROTATION + 3] = 1.0;
    row[LOGIT] = (OPACITY / (1.0 - OPACITY)).ln();
    row[SH..SH + 3].copy_from_slice(&Vec3::map(color, harmonics::constant_of).to_array());
    row
}
