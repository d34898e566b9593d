//! Where splats begin: near the surface of the visual hull, if images have masks of the object; else at the points of a
//! reconstruction, if there is one; else anywhere in the box.
//!
//! The hull (Laurentini 1994) is what every camera shows as opaque. It is found on a lattice of cells, coarsely in the
//! box of the scene and then finely in its own box. A cell counts as shown if any pixel near its centre's image is.
//!
//! At points, splats begin as in the original code (Kerbl et al. 2023): round, with the point's colour, as large as the
//! distance to the three nearest others.

use glam::{DVec3, Vec3};
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;
use rstar::RTree;

use super::cloud::{LOGIT, MEAN, ROTATION, Row, SCALE, SH, WIDTH, constant_of};
use crate::Shot;
use octobayes::geometry::Aabb;
use octobayes::metrics::median;
use octobayes_data::ScenePoint;
use octobayes_splats::{boxed, middle};

/// Cells along the longest edge of the box, coarse and fine.
const CELLS: [usize; 2] = [48, 96];
/// Least alpha of an object's pixel.
const OBJECT: f64 = 0.5;
/// Opacity at the start, as in the original code.
const OPACITY: f32 = 0.1;
/// Places tried for each point that a camera has to see.
const TRIES_PER_POINT: usize = 20;
/// Fewest points of a reconstruction that locate a scene.
const FEWEST_POINTS: usize = 100;
/// Points around a point whose distances make its splat's size, as in the original code.
const NEIGHBORS: usize = 3;
/// Share of the points at either end of an axis that do not count for their extent: some are far away.
const FAR_SHARE: f64 = 0.1;
/// The same for the box of a scene.
const OUTLIERS: f64 = 0.01;
/// Least distance between points, in parts of their extent; some coincide.
const LEAST_DISTANCE: f64 = 1e-5;

/// The first splats and where they lie.
pub struct Start {
    pub rows: Vec<Row>,
    /// Half of the longest edge of what they fill, scene units.
    pub extent: f32,
    pub origin: SplatOrigin,
}

/// Where the first splats lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplatOrigin {
    /// Near the surface of the visual hull: images have masks of the object.
    Hull,
    /// At the points of a reconstruction.
    Points,
    /// Anywhere in the box that a camera sees.
    Box,
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
    let ([column, row], _) = shot.camera.project_inside(x)?;
    Some(row as usize * shot.camera.resolution[0] as usize + column as usize)
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
    /// At most `count` splats for these images: in a box, or at some of the points of a reconstruction.
    pub fn new(shots: &[Shot], bounds: Aabb, known: &[ScenePoint], count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (points, extent, origin) = match hull_points(shots, bounds, count, &mut rng) {
            Some((points, extent)) => (points, extent, SplatOrigin::Hull),
            None if box_of_points(known).is_some() => return Self::at(known, count, &mut rng),
            None => (points_in(shots, bounds, count, &mut rng), 0.5 * bounds.longest_edge(), SplatOrigin::Box),
        };
        // A lattice with as many points in the same volume, for the distance between neighbours.
        let spacing = spacing(&points);
        let rows = points.into_iter().map(|x| row(x, color_at(x, shots), spacing)).collect();
        Self { rows, extent: extent as f32, origin }
    }

    /// Puts a splat at each point, or at `count` of them by chance.
    fn at(known: &[ScenePoint], count: usize, rng: &mut ChaCha8Rng) -> Self {
        let mut points = known.to_vec();
        let (points, _) = points.partial_shuffle(rng, count);
        let extent = extent_of(points);
        let tree = RTree::bulk_load(points.iter().map(|point| point.position.to_array()).collect());
        let splat = |point: &ScenePoint| {
            let at = point.position.to_array();
            // The nearest is the point itself.
            let others = tree.nearest_neighbor_iter_with_distance_2(at).skip(1).take(NEIGHBORS);
            let squares: Vec<f64> = others.map(|(_, square)| square).collect();
            let size = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            let color = DVec3::from(point.color.map(f64::from)) / 255.0;
            row(point.position, color.as_vec3(), size.max(LEAST_DISTANCE * extent))
        };
        Self { rows: points.par_iter().map(splat).collect(), extent: extent as f32, origin: SplatOrigin::Points }
    }
}

fn positions(points: &[ScenePoint]) -> Vec<(DVec3, f64)> {
    points.iter().map(|point| (point.position, 1.0)).collect()
}

/// Half of the longest edge of the box around most points.
fn extent_of(points: &[ScenePoint]) -> f64 {
    let [low, high] = middle(&positions(points), FAR_SHARE);
    0.5 * (high - low).max_element()
}

/// The box in which a scene lies, by points of it: without the outermost hundredth at either end of each axis, then a
/// tenth longer there. `None` if there are too few points, or if they have no volume.
#[must_use]
pub fn box_of_points(points: &[ScenePoint]) -> Option<Aabb> {
    if points.len() < FEWEST_POINTS { None } else { boxed(&positions(points), OUTLIERS) }
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
        for _ in 0..TRIES_PER_POINT {
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
    let found = median(some.map(nearest).filter(|d| d.is_finite()));
    if found.is_nan() { 1.0 } else { found }
}

/// The mean colour of the pixels that show `x`.
fn color_at(x: DVec3, shots: &[Shot]) -> Vec3 {
    let (mut color, mut weight) = (DVec3::ZERO, 1e-3);
    for shot in shots {
        if let Some(i) = pixel(shot, x).filter(|&i| shot.keeps(i)) {
            let alpha = shot.image.alpha(i);
            color += alpha * shot.image.over(i, DVec3::ZERO) / alpha.max(1e-3);
            weight += alpha;
        }
    }
    (color / weight).as_vec3()
}

/// A round splat.
fn row(x: DVec3, color: Vec3, size: f64) -> Row {
    let mut row = [0.0; WIDTH];
    row[MEAN..MEAN + 3].copy_from_slice(&x.as_vec3().to_array());
    row[SCALE..SCALE + 3].fill((size as f32).ln());
    row[ROTATION + 3] = 1.0;
    row[LOGIT] = (OPACITY / (1.0 - OPACITY)).ln();
    row[SH..SH + 3].copy_from_slice(&constant_of(color).to_array());
    row
}
