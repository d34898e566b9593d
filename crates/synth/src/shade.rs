//! Light from a point-like sun and a sky. Surfaces are Lambertian, so colour depends only on position (and side).
//!
//! The sun's shadows are traced per sample. The light of the sky is traced beforehand, with [`SKY_RAYS`]
//! cosine-weighted rays from both sides of each vertex and from a grid on the ground, and then interpolated. It is
//! smooth, without noise, and the same from every view. A ray that leaves upwards brings 1; one that leaves below
//! the horizon or meets a surface brings [`BOUNCE`].

use std::f64::consts::TAU;

use glam::{DMat3, DVec3};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::mesh::{HALF_HEIGHT, flat_normal};
use super::texture::Texture;
use super::trace::{GROUND_RADIUS, Hit, MeshScene, Surface};
use octobayes::Result;
use octobayes::geometry::Ray;
use octobayes::monitor::{Monitor, check};

/// Direction to the sun, not normalised: from the front right, 47° above the horizon.
pub const SUN: DVec3 = DVec3::new(0.6, -0.7, 1.0);
/// Linear colour of a white surface that faces the sun, from the sun alone.
pub const SUN_COLOR: DVec3 = DVec3::new(0.72, 0.67, 0.58);
/// Linear colour of a white surface under the open sky, from the sky alone.
pub const SKY_COLOR: DVec3 = DVec3::new(0.38, 0.43, 0.50);
/// Light from surfaces and from below the horizon, relative to that of the sky.
pub const BOUNCE: f64 = 0.3;
/// Rays into the sky per point: `STRATA`².
pub const SKY_RAYS: u32 = STRATA * STRATA;
const STRATA: u32 = 12;
/// Points per axis of the grid of sky light on the ground; their spacing is 0.015.
const GROUND_GRID: usize = 128;
/// Distance of secondary rays from the surface they leave: far above the error of a hit, 1e-15,
/// far below any triangle.
const LIFT: f64 = 1e-7;
/// The same for sky rays at vertices, where the surrounding faces meet at an angle.
const VERTEX_LIFT: f64 = 1e-4;
/// Points per unit of progress.
const CHUNK: usize = 256;

/// A scene and its light.
pub struct LitScene {
    scene: MeshScene,
    texture: Texture,
    sun: DVec3,
    /// `[vertices]`: sky light on the side of the normal and on the other side, 0 to 1.
    sky: Vec<[f32; 2]>,
    /// `[GROUND_GRID · GROUND_GRID]`, y fastest: sky light over the square around the disc, 0 to 1.
    ground_sky: Vec<f32>,
}

/// The side of a face that is seen.
#[derive(Debug, Clone, Copy)]
enum Side {
    Normal,
    Other,
}

impl LitScene {
    /// Traces the light of the sky.
    ///
    /// # Errors
    /// [`octobayes::Error::Interrupted`] only.
    pub fn new(scene: MeshScene, monitor: &dyn Monitor) -> Result<Self> {
        let mesh = scene.mesh();
        let vertices: Vec<(DVec3, DVec3)> =
            mesh.vertices().iter().copied().zip(mesh.normals().iter().copied()).collect();
        let at = |i: usize| GROUND_RADIUS * (2.0 * i as f64 / (GROUND_GRID - 1) as f64 - 1.0);
        let ground: Vec<DVec3> = (0..GROUND_GRID * GROUND_GRID)
            .map(|i| DVec3::new(at(i / GROUND_GRID), at(i % GROUND_GRID), -HALF_HEIGHT + LIFT))
            .collect();

        monitor.begin("sky light", (vertices.len() + ground.len()) as u64);
        let sky = in_chunks(&vertices, monitor, |i, &(x, normal)| {
            // Without a normal there is no side for light to reach.
            [normal, -normal].map(|n| n.try_normalize().map_or(0.0, |n| sky_light(&scene, x + VERTEX_LIFT * n, n, i)))
        })?;
        let ground_sky = in_chunks(&ground, monitor, |i, &x| sky_light(&scene, x, DVec3::Z, i))?;
        monitor.end();
        Ok(Self { texture: Texture::default(), sun: SUN.normalize(), scene, sky, ground_sky })
    }

    /// The geometry of the scene.
    #[must_use]
    pub fn scene(&self) -> &MeshScene {
        &self.scene
    }

    /// sRGB-encoded colour, 0 to 1 per channel, of a hit for the ray that found it.
    #[must_use]
    pub fn color(&self, ray: &Ray, hit: &Hit) -> DVec3 {
        let x = ray.at(hit.t);
        let (albedo, normal, origin, sky) = match hit.surface {
            Surface::Ground => (self.texture.ground(x), DVec3::Z, x + LIFT * DVec3::Z, bilinear(&self.ground_sky, x)),
            Surface::Face { face, barycentric } => {
                let (side, flat) = self.side(ray, face);
                let (normal, origin) = self.smooth(x, face, barycentric, side);
                let corners = self.scene.mesh().faces()[face as usize];
                let sky: f64 =
                    (0..3).map(|k| barycentric[k] * f64::from(self.sky[corners[k] as usize][side as usize])).sum();
                (self.texture.mesh(x), normal, origin + LIFT * flat, sky)
            }
        };
        let facing = normal.dot(self.sun);
        let lit = facing > 0.0 && !self.scene.is_blocked(&Ray::new(origin, self.sun));
        let sun = if lit { facing } else { 0.0 };
        (albedo * (sun * SUN_COLOR + sky * SKY_COLOR)).to_array().map(srgb).into()
    }

    /// The side of a face that a ray sees, and the unit normal of the face on that side.
    fn side(&self, ray: &Ray, face: u32) -> (Side, DVec3) {
        let flat = flat_normal(self.scene.mesh().corners(face)).unwrap_or(-ray.direction);
        if flat.dot(ray.direction) <= 0.0 { (Side::Normal, flat) } else { (Side::Other, -flat) }
    }

    /// Interpolated normal, and the origin of shadow rays.
    ///
    /// The origin is the point raised to the vertices' tangent planes (Hanika, Ray Tracing Gems II, chapter 4). A
    /// coarse triangle then does not shadow itself where the smooth surface would be lit.
    fn smooth(&self, x: DVec3, face: u32, weights: [f64; 3], side: Side) -> (DVec3, DVec3) {
        let mesh = self.scene.mesh();
        let corners = mesh.faces()[face as usize].map(|i| (mesh.vertices()[i as usize], mesh.normals()[i as usize]));
        let sign = match side {
            Side::Normal => 1.0,
            Side::Other => -1.0,
        };
        let (mut normal, mut raised) = (DVec3::ZERO, x);
        for ((vertex, vertex_normal), weight) in corners.into_iter().zip(weights) {
            let n = sign * vertex_normal;
            normal += weight * n;
            raised -= weight * (x - vertex).dot(n).min(0.0) * n;
        }
        (normal.normalize_or_zero(), raised)
    }
}

/// Maps points to values in parallel, in order.
fn in_chunks<T: Sync, V: Send>(
    points: &[T],
    monitor: &dyn Monitor,
    value: impl Fn(usize, &T) -> V + Sync,
) -> Result<Vec<V>> {
    let chunks: Vec<Vec<V>> = points
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, points)| {
            check(monitor)?;
            let values = points.iter().enumerate().map(|(i, point)| value(chunk * CHUNK + i, point)).collect();
            monitor.advance(points.len() as u64);
            Ok(values)
        })
        .collect::<Result<_>>()?;
    Ok(chunks.into_iter().flatten().collect())
}

/// Sky light at a point just above a surface of unit `normal`; `index` decides the jitter.
fn sky_light(scene: &MeshScene, x: DVec3, normal: DVec3, index: usize) -> f32 {
    let mut rng = ChaCha8Rng::seed_from_u64(0x5c1);
    rng.set_stream(index as u64);
    let (right, up) = normal.any_orthonormal_pair();
    let frame = DMat3::from_cols(right, up, normal);
    let mut sum = 0.0;
    for cell in 0..SKY_RAYS {
        let [a, b] = [cell / STRATA, cell % STRATA].map(|k| (f64::from(k) + rng.random::<f64>()) / f64::from(STRATA));
        // Uniform on the disc below the hemisphere is cosine-weighted on the hemisphere (Malley).
        let (level, angle) = (a.sqrt(), TAU * b);
        let direction = frame * DVec3::new(level * angle.cos(), level * angle.sin(), (1.0 - a).sqrt());
        let free = direction.z > 0.0 && !scene.is_blocked(&Ray::new(x, direction));
        sum += if free { 1.0 } else { BOUNCE };
    }
    (sum / f64::from(SKY_RAYS)) as f32
}

/// Sky light on the ground, interpolated between the grid points.
fn bilinear(grid: &[f32], x: DVec3) -> f64 {
    let last = (GROUND_GRID - 1) as f64;
    let place = |v: f64| {
        let u = (0.5 * (v / GROUND_RADIUS + 1.0) * last).clamp(0.0, last);
        let low = (u as usize).min(GROUND_GRID - 2);
        (low, u - low as f64)
    };
    let ((i, s), (j, t)) = (place(x.x), place(x.y));
    let at = |i: usize, j: usize| f64::from(grid[i * GROUND_GRID + j]);
    let row = |i: usize| at(i, j) * (1.0 - t) + at(i, j + 1) * t;
    row(i) * (1.0 - s) + row(i + 1) * s
}

/// The sRGB curve (IEC 61966-2-1), clipped to [0, 1].
fn srgb(linear: f64) -> f64 {
    let v = linear.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Mesh;
    use crate::testing::icosphere;
    use octobayes::monitor::Silent;

    fn seen(lit: &LitScene, eye: DVec3, at: DVec3) -> DVec3 {
        let ray = Ray::new(eye, at - eye);
        lit.color(&ray, &lit.scene().nearest(&ray).unwrap())
    }

    /// Colour of the ground under a share of the sun and a share of the sky.
    fn ground_with(sun: f64, sky: f64, x: DVec3) -> DVec3 {
        let light = sun * SUN.normalize().z * SUN_COLOR + sky * SKY_COLOR;
        (Texture::default().ground(x) * light).to_array().map(srgb).into()
    }

    #[test]
    fn ground_in_sun_and_shadow_and_colour_does_not_depend_on_the_view() {
        let lit = LitScene::new(MeshScene::new(icosphere(0.3, 2)), &Silent).unwrap();
        let along = SUN / SUN.z * HALF_HEIGHT;
        // Along the sun's direction through the ball's centre the ground is in its shadow, on the
        // other side in the sun.
        let [shadow, open] = [-along, along].map(|d| d.with_z(-HALF_HEIGHT));
        for (x, sun) in [(shadow, 0.0), (open, 1.0)] {
            let [a, b] = [DVec3::new(0.1, 2.0, 2.0), DVec3::new(0.2, -2.5, 2.5)].map(|eye| seen(&lit, eye, x));
            assert!((a - b).abs().max_element() < 1e-9, "{a} from one side, {b} from the other");
            // The ball's form factor is cos θ (r/d)² < (0.3 / 0.75)² = 0.16. The loss is
            // 1 − BOUNCE of that, at most 0.112.
            let [low, high] = [0.888, 1.0].map(|sky| ground_with(sun, sky, x));
            assert!(a.cmpge(low - 1e-6).all() && a.cmple(high + 1e-6).all(), "{a}, expected {low} to {high}");
        }
    }

    #[test]
    fn sky_light_of_a_vertical_wall_is_half_open() {
        // A wall far above the ground sees half of the cosine-weighted sky. The other half brings the bounce.
        let corners = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.0, 0.01]].map(DVec3::from);
        let scene = MeshScene::new(Mesh::new(corners.to_vec(), vec![[0, 1, 2]]).unwrap());
        let found = f64::from(sky_light(&scene, corners[0] + 0.01 * DVec3::Y, DVec3::Y, 3));
        // Only strata cut by the horizon are random: 2·12 of 144, each off by at most half,
        // so σ < sqrt(24)/2 / 144 = 0.017.
        assert!((found - 0.5 * (1.0 + BOUNCE)).abs() < 4.0 * 0.017, "{found}");
    }

    #[test]
    fn the_grid_is_interpolated_exactly_where_linear() {
        let at = |i: usize| GROUND_RADIUS * (2.0 * i as f64 / (GROUND_GRID - 1) as f64 - 1.0);
        let grid: Vec<f32> =
            (0..GROUND_GRID * GROUND_GRID).map(|i| (3.0 * at(i / GROUND_GRID) - at(i % GROUND_GRID)) as f32).collect();
        for (x, y) in [(0.0, 0.0), (0.94, -0.3), (-0.95, 0.95), (0.123, 0.456)] {
            // Values are f32 below 4: 4 ulps of 2⁻²³.
            assert!((bilinear(&grid, DVec3::new(x, y, 0.0)) - (3.0 * x - y)).abs() < 1e-6);
        }
    }
}
