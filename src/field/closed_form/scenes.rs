//! Small scenes around the origin.

use glam::Vec3;

use super::rig::Rig;
use super::{ClosedForm, Primitive, Shape, Texture};
use crate::geometry::{Aabb, Camera};

/// Number of cameras of a small scene.
const CAMERAS: u32 = 40;
/// Width and height of their images, pixels.
const RESOLUTION: [u32; 2] = [200, 200];

impl ClosedForm {
    /// A homogeneous grey slab |x| < ½ of the given density (1 / scene unit). Its transmittance along x is
    /// exp(−density).
    #[must_use]
    pub fn slab(density: f32) -> Self {
        let shape = Shape::Slab { center: Vec3::ZERO, normal: Vec3::X, half: 0.5 };
        let slab = Primitive { shape, peak: density, softness: 0.0, texture: Texture::Plain(Vec3::splat(0.5)) };
        Self::seen_from_one_side("slab", vec![slab], Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// A textured soft ball of radius ½.
    #[must_use]
    pub fn ball() -> Self {
        let shape = Shape::Ball { center: Vec3::ZERO, radius: 0.5 };
        let texture = Texture::Waves { base: Vec3::new(0.6, 0.5, 0.3), amplitude: 0.25, frequency: 9.0 };
        let ball = Primitive { shape, peak: 80.0, softness: 0.04, texture };
        Self::seen_from_one_side("ball", vec![ball], Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// A textured wall through the origin with its normal along `normal`.
    #[must_use]
    pub fn wall(normal: Vec3) -> Self {
        let shape = Shape::Slab { center: Vec3::ZERO, normal: normal.normalize(), half: 0.1 };
        let texture = Texture::Waves { base: Vec3::splat(0.5), amplitude: 0.3, frequency: 12.0 };
        let wall = Primitive { shape, peak: 60.0, softness: 0.04, texture };
        Self::seen_from_one_side("wall", vec![wall], Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// A faint fuzzy cloud and nothing else.
    #[must_use]
    pub fn floater() -> Self {
        let shape = Shape::Fog { center: Vec3::new(0.1, 0.0, 0.0), radius: 0.5 };
        let fog = Primitive { shape, peak: 6.0, softness: 0.0, texture: Texture::Plain(Vec3::new(0.7, 0.6, 0.8)) };
        Self::seen_from_one_side("floater", vec![fog], Aabb::centered_cube(1.0), 1.0 / 128.0)
    }

    /// A floor, four balls, a box and a fuzzy floater in `[-1, 1]`³. Surfaces are about four cells of a 128³
    /// grid thick.
    #[must_use]
    pub fn courtyard() -> Self {
        let solid = |shape, texture| Primitive { shape, peak: 120.0, softness: 0.031, texture };
        let waves = |r, g, b, frequency| Texture::Waves { base: Vec3::new(r, g, b), amplitude: 0.2, frequency };
        let ball = |x, y, texture| solid(Shape::Ball { center: Vec3::new(x, y, -0.35), radius: 0.25 }, texture);
        let slab = Shape::Slab { center: Vec3::new(0.0, 0.0, -0.7), normal: Vec3::Z, half: 0.1 };
        let block = Shape::Box { center: Vec3::new(0.0, 0.0, -0.3), half: Vec3::new(0.15, 0.15, 0.3) };
        let cloud = Shape::Fog { center: Vec3::new(0.15, -0.45, 0.45), radius: 0.25 };
        let primitives = vec![
            solid(slab, waves(0.55, 0.5, 0.42, 14.0)),
            ball(0.5, 0.5, waves(0.7, 0.3, 0.25, 18.0)),
            ball(-0.5, 0.5, waves(0.25, 0.55, 0.3, 22.0)),
            ball(0.5, -0.5, waves(0.3, 0.4, 0.7, 26.0)),
            ball(-0.5, -0.5, Texture::Plain(Vec3::new(0.75, 0.7, 0.3))),
            solid(block, waves(0.5, 0.35, 0.6, 16.0)),
            Primitive { shape: cloud, peak: 2.0, softness: 0.0, texture: Texture::Plain(Vec3::new(0.85, 0.8, 0.8)) },
        ];
        Self::seen_from_one_side("courtyard", primitives, Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// `count` cameras for a built-in scene, at two heights on a half circle on the side x > 0.
    ///
    /// The other side of every object stays unseen.
    #[must_use]
    pub fn half_circle(count: u32, resolution: [u32; 2]) -> Vec<Camera> {
        let rig = Rig::half_circle(count, resolution);
        rig.with_lens(rig.fov_x, rig.resolution)
    }

    fn seen_from_one_side(name: &str, primitives: Vec<Primitive>, bounds: Aabb, step: f64) -> Self {
        Self { rig: Some(Rig::half_circle(CAMERAS, RESOLUTION)), ..Self::new(name, primitives, bounds, step) }
    }
}
