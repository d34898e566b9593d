//! A city drawn from a seed: streets, buildings, trees and lamps in a cube of 512 m.
//!
//! Lengths are metres; z is up and the streets lie at z = 0. The scene is too large for a dense grid that
//! resolves its surfaces: at 4096 cells per axis their ramps are four cells wide.

use std::f32::consts::TAU;

use glam::{DVec3, Vec2, Vec3};
use rand::rngs::ChaCha8Rng;
use rand::{Rng, RngExt, SeedableRng};

use super::columns::Columns;
use super::rig::Rig;
use super::{ClosedForm, Primitive, Shape, Texture};
use crate::Result;
use crate::geometry::Aabb;

/// Edge of the cube, m.
const EDGE: f32 = 512.0;
/// Height of the cube's lower face, m.
const FLOOR: f32 = -16.0;
/// Number of blocks along each axis.
const BLOCKS: usize = 6;
/// Average edge of a block, m.
const BLOCK: f32 = 64.0;
/// Distance from block to block, m.
const STREET: f32 = 16.0;
/// Distance from a block's edge to its buildings, m.
const SIDEWALK: f32 = 4.5;
/// Peak density, 1/m. It makes surfaces opaque within their ramp: optical depth 10 over 2 · softness.
const PEAK: f32 = 40.0;
/// Half the width of a surface's ramp, m.
const SOFTNESS: f32 = 0.25;
/// Edge of the columns that sort the primitives, m. Each column holds a few of them.
const COLUMN: f32 = 8.0;

/// Positions along the drive, with four views from each.
const STOPS: u32 = 200;
/// Crossings at which the drive turns, as indices of the streets along y and x.
const ROUTE: [[usize; 2]; 7] = [[1, 0], [1, 3], [3, 3], [3, 1], [5, 1], [5, 5], [2, 5]];

impl ClosedForm {
    /// The city of a seed: some 2,500 shapes, seen on a drive through its streets.
    pub(super) fn city(seed: u64) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let plan = Plan::draw(&mut rng);
        let mut primitives = vec![ground()];
        plan.markings(&mut primitives);
        for &[x0, x1] in &plan.blocks[0] {
            for &[y0, y1] in &plan.blocks[1] {
                let block = Plot { min: Vec2::new(x0, y0), max: Vec2::new(x1, y1) };
                block.furnish(&mut rng, &mut primitives);
            }
        }
        let low = DVec3::new(0.0, 0.0, f64::from(FLOOR));
        let bounds = Aabb::new(low, low + f64::from(EDGE))?;
        let columns = Some(Columns::new(&primitives, &bounds, COLUMN));
        Ok(Self { name: format!("city-{seed}"), primitives, columns, bounds, step: 0.125, rig: Some(plan.drive()) })
    }
}

/// Draws a number between two others.
fn between(rng: &mut impl Rng, low: f32, high: f32) -> f32 {
    rng.random_range(low..high)
}

/// Draws true with the given probability.
fn chance(rng: &mut impl Rng, probability: f32) -> bool {
    between(rng, 0.0, 1.0) < probability
}

/// An axis-aligned box with a soft surface.
fn solid(min: Vec3, max: Vec3, texture: Texture) -> Primitive {
    let shape = Shape::Box { center: 0.5 * (min + max), half: 0.5 * (max - min) };
    Primitive { shape, peak: PEAK, softness: SOFTNESS, texture }
}

/// A texture of waves with period `wavelength`.
fn waves(base: Vec3, amplitude: f32, wavelength: f32) -> Texture {
    Texture::Waves { base, amplitude, frequency: TAU / wavelength }
}

/// Asphalt everywhere, reaching below the cube.
fn ground() -> Primitive {
    let shape = Shape::Slab { center: Vec3::new(0.0, 0.0, FLOOR), normal: Vec3::Z, half: -FLOOR };
    let texture = waves(Vec3::new(0.36, 0.36, 0.38), 0.09, 5.0);
    Primitive { shape, peak: PEAK, softness: SOFTNESS, texture }
}

/// Where blocks begin and end along x and y, and the centre lines of the streets between them.
struct Plan {
    blocks: [Vec<[f32; 2]>; 2],
    streets: [Vec<f32>; 2],
}

impl Plan {
    /// Draws blocks of different widths that fit between two outer streets.
    fn draw(rng: &mut impl Rng) -> Self {
        let mut plan = Self { blocks: [Vec::new(), Vec::new()], streets: [Vec::new(), Vec::new()] };
        let margin = 0.5 * (EDGE - BLOCKS as f32 * BLOCK - (BLOCKS - 1) as f32 * STREET);
        for (blocks, streets) in plan.blocks.iter_mut().zip(&mut plan.streets) {
            let widths: Vec<f32> = (0..BLOCKS).map(|_| between(rng, 0.85, 1.15)).collect();
            let scale = BLOCK * BLOCKS as f32 / widths.iter().sum::<f32>();
            let mut at = margin;
            streets.push(at - 0.5 * STREET);
            for width in widths {
                blocks.push([at, at + scale * width]);
                at += scale * width + STREET;
                streets.push(at - 0.5 * STREET);
            }
        }
        plan
    }

    /// Adds dashes along the centre line of every street between crossings. They are colour in the surface,
    /// not a step.
    fn markings(&self, primitives: &mut Vec<Primitive>) {
        let white = Texture::Plain(Vec3::splat(0.92));
        for axis in 0..2 {
            for &[start, end] in &self.blocks[axis] {
                let dashes = ((end - start) / 8.0) as usize;
                for (i, &across) in (0..dashes).flat_map(|i| self.streets[1 - axis].iter().map(move |s| (i, s))) {
                    let along = start + (i as f32 + 0.5) * (end - start) / dashes as f32;
                    let center =
                        if axis == 0 { Vec3::new(along, across, -0.2) } else { Vec3::new(across, along, -0.2) };
                    let half = if axis == 0 { Vec3::new(1.6, 0.2, 0.2) } else { Vec3::new(0.2, 1.6, 0.2) };
                    // With twice the ground's density, a dash has two thirds of the colour.
                    primitives.push(Primitive { peak: 2.0 * PEAK, ..solid(center - half, center + half, white) });
                }
            }
        }
    }

    /// A drive along [`ROUTE`] in the middle of the streets, at the height of a roof rack.
    ///
    /// Every stop has a view ahead, to the left, to the right and back.
    fn drive(&self) -> Rig {
        let crossings = ROUTE.map(|[i, j]| DVec3::new(self.streets[0][i].into(), self.streets[1][j].into(), 1.8));
        let length: f64 = crossings.windows(2).map(|leg| leg[0].distance(leg[1])).sum();
        let mut viewpoints = Vec::new();
        for stop in 0..STOPS {
            let mut left = (f64::from(stop) + 0.5) / f64::from(STOPS) * length;
            for leg in crossings.windows(2) {
                let ahead = (leg[1] - leg[0]).normalize();
                let leg_length = leg[0].distance(leg[1]);
                if (0.0..leg_length).contains(&left) {
                    let eye = leg[0] + left * ahead;
                    let side = DVec3::Z.cross(ahead);
                    viewpoints.extend([ahead, side, -side, -ahead].map(|view| (eye, eye + view)));
                }
                left -= leg_length;
            }
        }
        Rig { viewpoints, fov_x: 0.5 * std::f64::consts::PI, resolution: [400, 300] }
    }
}

/// A rectangle of ground.
#[derive(Clone, Copy)]
struct Plot {
    min: Vec2,
    max: Vec2,
}

impl Plot {
    fn inset(self, by: f32) -> Self {
        Self { min: self.min + by, max: self.max - by }
    }

    /// The two plots on either side of a cut across the longer edge.
    fn split(self, rng: &mut impl Rng) -> [Self; 2] {
        let axis = usize::from(self.max.y - self.min.y > self.max.x - self.min.x);
        let cut = self.min[axis] + between(rng, 0.4, 0.6) * (self.max[axis] - self.min[axis]);
        let (mut low, mut high) = (self, self);
        low.max[axis] = cut;
        high.min[axis] = cut;
        [low, high]
    }

    /// Adds a block: pavement, one to four buildings, trees and lamps along the kerb.
    fn furnish(self, rng: &mut impl Rng, primitives: &mut Vec<Primitive>) {
        let pavement = waves(Vec3::new(0.66, 0.62, 0.56), 0.12, 2.5);
        primitives.push(solid(self.min.extend(-1.0), self.max.extend(0.2), pavement));
        let mut lots = vec![self.inset(SIDEWALK)];
        for _ in 0..rng.random_range(0_u32..4) {
            // Taking the first lot splits the whole block before its halves.
            let halves = lots.remove(0).split(rng);
            lots.extend(halves);
        }
        for lot in lots {
            let setback = between(rng, 0.0, 1.5);
            lot.inset(setback).build(rng, primitives);
        }
        let Self { min, max } = self.inset(1.5);
        let corners = [min, Vec2::new(max.x, min.y), max, Vec2::new(min.x, max.y)];
        for side in 0..4 {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            let places = (from.distance(to) / 9.0) as usize;
            for place in 0..places {
                let at = from.lerp(to, (place as f32 + 0.5) / places as f32);
                if place % 3 == 1 {
                    lamp(at, primitives);
                } else if chance(rng, 0.6) {
                    tree(at, rng, primitives);
                }
            }
        }
    }

    /// Adds a building; a high one may have a set-back.
    fn build(self, rng: &mut impl Rng, primitives: &mut Vec<Primitive>) {
        let wall = WALLS[rng.random_range(0..WALLS.len() as u32) as usize] * between(rng, 0.85, 1.1);
        let glass = if chance(rng, 0.7) { Vec3::new(0.13, 0.18, 0.27) } else { Vec3::new(0.85, 0.88, 0.8) };
        let storey = between(rng, 3.2, 4.2);
        let texture = match between(rng, 0.0, 1.0) {
            0.0..0.15 => Texture::Plain(wall),
            0.15..0.3 => waves(0.8 * wall + 0.05, 0.16, between(rng, 3.0, 6.0)),
            _ => Texture::Windows { wall, glass, pitch: [between(rng, 3.0, 5.5), storey] },
        };
        let height = 6.0 + 54.0 * between(rng, 0.0, 1.0).powf(1.5);
        let size = self.max - self.min;
        let mut tiers = vec![(self, height)];
        if height > 16.0 && chance(rng, 0.5) {
            tiers[0].1 = between(rng, 0.45, 0.75) * height;
            tiers.push((self.inset(between(rng, 0.12, 0.25) * size.min_element()), height));
        }
        for (plot, height) in tiers {
            // Roofs lie between two rows of windows.
            let roof = ((height / storey).floor() - 0.25) * storey;
            primitives.push(solid(plot.min.extend(-1.0), plot.max.extend(roof), texture));
        }
    }
}

/// Facade colours.
const WALLS: [Vec3; 7] = [
    Vec3::new(0.72, 0.42, 0.33),
    Vec3::new(0.82, 0.74, 0.58),
    Vec3::new(0.62, 0.66, 0.70),
    Vec3::new(0.86, 0.84, 0.80),
    Vec3::new(0.58, 0.50, 0.42),
    Vec3::new(0.80, 0.62, 0.40),
    Vec3::new(0.52, 0.60, 0.52),
];

/// Adds a trunk and a crown of fog: fuzzy density without a surface.
fn tree(at: Vec2, rng: &mut impl Rng, primitives: &mut Vec<Primitive>) {
    let trunk = between(rng, 3.5, 5.0);
    let bark = Texture::Plain(Vec3::new(0.35, 0.25, 0.17));
    primitives.push(solid((at - 0.15).extend(0.0), (at + 0.15).extend(trunk), bark));
    let leaves = waves(Vec3::new(0.27, between(rng, 0.42, 0.52), 0.18), 0.1, 1.5);
    for rise in [0.0, 1.6] {
        let sway = Vec2::new(between(rng, -0.5, 0.5), between(rng, -0.5, 0.5));
        let shape =
            Shape::Fog { center: (at + sway).extend(trunk + rise), radius: between(rng, 2.0, 3.0) - 0.3 * rise };
        primitives.push(Primitive { shape, peak: 2.5, softness: 0.0, texture: leaves });
    }
}

/// Adds a square post, 20 cm wide, with a globe.
fn lamp(at: Vec2, primitives: &mut Vec<Primitive>) {
    let steel = Texture::Plain(Vec3::new(0.2, 0.2, 0.22));
    let post = solid((at - 0.1).extend(0.0), (at + 0.1).extend(5.0), steel);
    primitives.push(Primitive { softness: 0.1, ..post });
    let globe = Shape::Ball { center: at.extend(5.3), radius: 0.35 };
    let light = Texture::Plain(Vec3::new(0.97, 0.95, 0.82));
    primitives.push(Primitive { shape: globe, peak: PEAK, softness: 0.15, texture: light });
}
