//! Scenes with known answers: sums of simple shapes with closed-form density and colour.
//!
//! Letters: `d` signed distance to a shape's surface (negative inside), `s` softness (scene units), `peak` the density deep
//! inside (1 / scene unit). A shape's density rises from 0 at d = s to peak at d = −s along a smooth ramp (quintic, twice
//! differentiable), for s = 0 as a step. Like in a trained field, empty space is exactly empty. Densities of shapes add;
//! colours mix in proportion to them.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::{Radiance, RadianceField};
use crate::geometry::{Aabb, Camera};
use crate::{Error, Result};

/// Geometry of a shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Between two planes: |normal · (x − center)| < half, unit `normal`.
    Slab {
        /// A point in the middle plane.
        center: Vec3,
        /// Unit normal.
        normal: Vec3,
        /// Half the thickness.
        half: f32,
    },
    /// |x − center| < radius.
    Ball {
        /// Centre.
        center: Vec3,
        /// Radius.
        radius: f32,
    },
    /// An axis-aligned box.
    Box {
        /// Centre.
        center: Vec3,
        /// Half edges.
        half: Vec3,
    },
    /// A cloud: density peak · (1 − |x − center|² / radius²)³ inside the radius; softness is not used.
    Fog {
        /// Centre.
        center: Vec3,
        /// Where the cloud ends.
        radius: f32,
    },
}

/// Colour of a shape as a function of position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Texture {
    /// One colour: sliding along the surface changes nothing.
    Plain(Vec3),
    /// base + amplitude · sin(ωx) sin(ωy) sin(ωz), phase-shifted per channel; smooth, ω in radians / scene unit.
    Waves {
        /// Mean colour.
        base: Vec3,
        /// Largest deviation, per channel; base ± amplitude must stay in `[0, 1]`.
        amplitude: f32,
        /// Angular frequency, radians / scene unit.
        frequency: f32,
    },
}

/// One shape of a closed-form scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primitive {
    /// Where density is.
    pub shape: Shape,
    /// Density deep inside, 1 / scene unit.
    pub peak: f32,
    /// Half the width of the transition from inside to outside, scene units; 0 is a step.
    pub softness: f32,
    /// Colour.
    pub texture: Texture,
}

impl Primitive {
    fn density(&self, x: Vec3) -> f32 {
        let d = match self.shape {
            Shape::Slab { center, normal, half } => normal.dot(x - center).abs() - half,
            Shape::Ball { center, radius } => x.distance(center) - radius,
            Shape::Box { center, half } => {
                let q = (x - center).abs() - half;
                q.max(Vec3::ZERO).length() + q.max_element().min(0.0)
            }
            Shape::Fog { center, radius } => {
                return self.peak * (1.0 - x.distance_squared(center) / (radius * radius)).max(0.0).powi(3);
            }
        };
        if self.softness > 0.0 {
            let t = (0.5 - 0.5 * d / self.softness).clamp(0.0, 1.0);
            self.peak * t * t * t * (t * (6.0 * t - 15.0) + 10.0)
        } else if d < 0.0 {
            self.peak
        } else {
            0.0
        }
    }

    fn color(&self, x: Vec3) -> Vec3 {
        match self.texture {
            Texture::Plain(color) => color,
            Texture::Waves { base, amplitude, frequency } => {
                let wave = |phase: f32| {
                    (frequency * x.x + phase).sin()
                        * (frequency * x.y + 2.0 * phase).sin()
                        * (frequency * x.z - phase).sin()
                };
                base + amplitude * Vec3::new(wave(0.4), wave(1.1), wave(1.9))
            }
        }
    }
}

/// A sum of primitives inside a box.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedForm {
    name: &'static str,
    primitives: Vec<Primitive>,
    bounds: Aabb,
    step: f64,
}

impl ClosedForm {
    /// A scene of `primitives`; density outside `bounds` counts as zero, `step` is the sample distance that resolves it.
    #[must_use]
    pub fn new(name: &'static str, primitives: Vec<Primitive>, bounds: Aabb, step: f64) -> Self {
        Self { name, primitives, bounds, step }
    }

    /// Names accepted by [`ClosedForm::named`].
    pub const NAMES: [&'static str; 5] = ["courtyard", "ball", "slab", "wall", "floater"];

    /// The built-in scene of that name.
    ///
    /// # Errors
    /// If there is none.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "courtyard" => Ok(Self::courtyard()),
            "ball" => Ok(Self::ball()),
            "slab" => Ok(Self::slab(4.0)),
            "wall" => Ok(Self::wall(Vec3::X)),
            "floater" => Ok(Self::floater()),
            other => Err(Error::setting("scene", Self::NAMES.join(", "), other)),
        }
    }

    /// A homogeneous grey slab |x| < ½ of the given density: transmittance through it is exp(−density).
    #[must_use]
    pub fn slab(density: f32) -> Self {
        let shape = Shape::Slab { center: Vec3::ZERO, normal: Vec3::X, half: 0.5 };
        let slab = Primitive { shape, peak: density, softness: 0.0, texture: Texture::Plain(Vec3::splat(0.5)) };
        Self::new("slab", vec![slab], Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// A textured soft ball of radius ½.
    #[must_use]
    pub fn ball() -> Self {
        let shape = Shape::Ball { center: Vec3::ZERO, radius: 0.5 };
        let texture = Texture::Waves { base: Vec3::new(0.6, 0.5, 0.3), amplitude: 0.25, frequency: 9.0 };
        let ball = Primitive { shape, peak: 80.0, softness: 0.04, texture };
        Self::new("ball", vec![ball], Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// A textured wall through the origin with unit normal along `normal`.
    #[must_use]
    pub fn wall(normal: Vec3) -> Self {
        let shape = Shape::Slab { center: Vec3::ZERO, normal: normal.normalize(), half: 0.1 };
        let texture = Texture::Waves { base: Vec3::splat(0.5), amplitude: 0.3, frequency: 12.0 };
        let wall = Primitive { shape, peak: 60.0, softness: 0.04, texture };
        Self::new("wall", vec![wall], Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// A faint fuzzy cloud, nothing else.
    #[must_use]
    pub fn floater() -> Self {
        let shape = Shape::Fog { center: Vec3::new(0.1, 0.0, 0.0), radius: 0.5 };
        let fog = Primitive { shape, peak: 6.0, softness: 0.0, texture: Texture::Plain(Vec3::new(0.7, 0.6, 0.8)) };
        Self::new("floater", vec![fog], Aabb::centered_cube(1.0), 1.0 / 128.0)
    }

    /// Floor, four balls, a box and a fuzzy floater in `[-1, 1]`³; surfaces are about four cells of a 128³ grid thick.
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
        Self::new("courtyard", primitives, Aabb::centered_cube(1.0), 1.0 / 256.0)
    }

    /// Cameras for a built-in scene: `count` on a half circle at two heights on the side x > 0, so that the other side of
    /// every object stays unseen.
    #[must_use]
    pub fn half_circle(count: u32, resolution: [u32; 2]) -> Vec<Camera> {
        (0..count)
            .map(|i| {
                let azimuth = PI * ((f64::from(i) + 0.5) / f64::from(count) - 0.5);
                let height = if i % 2 == 0 { 0.9 } else { 1.7 };
                let eye = DVec3::new(2.8 * azimuth.cos(), 2.8 * azimuth.sin(), height);
                Camera::look_at(eye, DVec3::new(0.0, 0.0, -0.25), DVec3::Z, 0.8, resolution)
            })
            .collect()
    }
}

impl RadianceField for ClosedForm {
    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn evaluate(&self, positions: &[Vec3], _directions: &[Vec3], out: &mut [Radiance]) {
        for (out, &x) in out.iter_mut().zip(positions) {
            *out = Radiance::default();
            if !self.bounds.contains(x) {
                continue;
            }
            let mut weighted = Vec3::ZERO;
            for primitive in &self.primitives {
                let density = primitive.density(x);
                out.density += density;
                weighted += density * primitive.color(x);
            }
            // Where there is no density the colour has no weight either; a denormal divisor would make it noise.
            out.color = if out.density > f32::MIN_POSITIVE { weighted / out.density } else { Vec3::splat(0.5) };
        }
    }

    fn suggested_step(&self) -> f64 {
        self.step
    }

    fn memory(&self) -> usize {
        size_of_val(self.primitives.as_slice())
    }

    fn describe(&self) -> String {
        format!("closed-form scene `{}` of {} shapes", self.name, self.primitives.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(field: &ClosedForm, x: Vec3) -> Radiance {
        let mut out = [Radiance::default()];
        field.evaluate(&[x], &[Vec3::Z], &mut out);
        out[0]
    }

    #[test]
    fn slab_is_homogeneous_inside_and_empty_outside() {
        let slab = ClosedForm::slab(4.0);
        assert_eq!(at(&slab, Vec3::new(0.49, 0.9, 0.0)).density, 4.0);
        assert_eq!(at(&slab, Vec3::new(0.51, 0.9, 0.0)).density, 0.0);
        assert_eq!(at(&slab, Vec3::new(0.0, 1.1, 0.0)).density, 0.0, "outside the box");
    }

    #[test]
    fn all_scenes_are_valid_everywhere_and_not_empty() {
        for name in ClosedForm::NAMES {
            let field = ClosedForm::named(name).unwrap();
            let mut largest = 0.0_f32;
            for i in 0..17 * 17 * 17 {
                let x = Vec3::new((i % 17) as f32, (i / 17 % 17) as f32, (i / 289) as f32) / 8.0 - Vec3::ONE;
                let value = at(&field, x);
                assert!(value.is_valid() && value.color.min_element() >= 0.0 && value.color.max_element() <= 1.0);
                largest = largest.max(value.density);
            }
            assert!(largest > 1.0, "{name} has density");
        }
        assert!(ClosedForm::named("teapot").is_err());
    }
}
