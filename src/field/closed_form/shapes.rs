//! Shapes with closed-form density and colour.
//!
//! Letters: `d` signed distance to a shape's surface (negative inside), `s` softness (scene units), `peak`
//! the density deep inside (1 / scene unit), `a` the offset of a point from a shape's centre, folded into the
//! first octant. For a slab, a is |normal · (x − center)| along x; for the others it is |x − center| along
//! each axis. Density does not rise with any component of a, which makes bounds over boxes exact.

use std::f32::consts::TAU;

use glam::Vec3;

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
    /// A cloud of density peak · (1 − |x − center|² / radius²)³ inside the radius; softness is not used.
    Fog {
        /// Centre.
        center: Vec3,
        /// Radius at which the cloud ends.
        radius: f32,
    },
}

/// Colour of a shape as a function of position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Texture {
    /// One colour. Sliding along the surface changes nothing.
    Plain(Vec3),
    /// base + amplitude · sin(ωx) sin(ωy) sin(ωz), smooth, with a phase shift per channel;
    /// ω in radians / scene unit.
    Waves {
        /// Mean colour.
        base: Vec3,
        /// Largest deviation per channel. base ± amplitude must stay in `[0, 1]`.
        amplitude: f32,
        /// Angular frequency, radians / scene unit.
        frequency: f32,
    },
    /// Rows of windows on upright walls along x or y, twice differentiable. The rows run along x + y, so that
    /// both kinds of wall show them.
    Windows {
        /// Colour between the windows.
        wall: Vec3,
        /// Colour of a window.
        glass: Vec3,
        /// Distance from window to window along the wall and upwards, scene units.
        pitch: [f32; 2],
    },
}

/// One shape of a closed-form scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primitive {
    /// Where the density is.
    pub shape: Shape,
    /// Density deep inside, 1 / scene unit.
    pub peak: f32,
    /// Half the width of the transition from inside to outside, scene units. 0 is a step.
    pub softness: f32,
    /// Colour.
    pub texture: Texture,
}

/// The quintic from 0 at t = 0 to `top` at t = 1, flat to second order at both ends.
fn quintic(top: f32, t: f32) -> f32 {
    top * t * t * t * (t * (6.0 * t - 15.0) + 10.0)
}

impl Primitive {
    /// Density at `x`.
    pub(super) fn density(&self, x: Vec3) -> f32 {
        self.density_at_offset(match self.shape {
            Shape::Slab { center, normal, .. } => Vec3::X * normal.dot(x - center).abs(),
            Shape::Ball { center, .. } | Shape::Box { center, .. } | Shape::Fog { center, .. } => (x - center).abs(),
        })
    }

    /// Least upper bound of [`Primitive::density`] in the box from `min` to `max`, up to rounding.
    ///
    /// It is never below the density, and 0 where no point of the box has density.
    pub(super) fn density_bound(&self, min: Vec3, max: Vec3) -> f32 {
        let nearest = match self.shape {
            Shape::Slab { center, normal, .. } => {
                // Interval arithmetic adds in the order of `dot`.
                let (a, b) = (normal * (min - center), normal * (max - center));
                let sum = |v: Vec3| v.x + v.y + v.z;
                Vec3::X * sum(a.min(b)).max(-sum(a.max(b))).max(0.0)
            }
            Shape::Ball { center, .. } | Shape::Box { center, .. } | Shape::Fog { center, .. } => {
                (min - center).max(center - max).max(Vec3::ZERO)
            }
        };
        // Rounding is monotone, so evaluating the density at the nearest offset needs no margin. The
        // exception is the quintic, whose terms 6t, 15 and 10 cancel down to 1: fewer than 50 roundings of
        // 2^-24 relative, in both density and bound.
        self.density_at_offset(nearest) * (1.0 + 1e-5)
    }

    fn density_at_offset(&self, a: Vec3) -> f32 {
        let d = match self.shape {
            Shape::Slab { half, .. } => a.x - half,
            Shape::Ball { radius, .. } => a.length() - radius,
            Shape::Box { half, .. } => {
                let q = a - half;
                q.max(Vec3::ZERO).length() + q.max_element().min(0.0)
            }
            Shape::Fog { radius, .. } => {
                return self.peak * (1.0 - a.length_squared() / (radius * radius)).max(0.0).powi(3);
            }
        };
        if self.softness > 0.0 {
            quintic(self.peak, (0.5 - 0.5 * d / self.softness).clamp(0.0, 1.0))
        } else if d < 0.0 {
            self.peak
        } else {
            0.0
        }
    }

    /// Colour at `x`.
    pub(super) fn color(&self, x: Vec3) -> Vec3 {
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
            Texture::Windows { wall, glass, pitch: [along, up] } => {
                // Half of each pitch is window. Its edges blend over an eighth of a period to either side.
                let pane = |x: f32| quintic(1.0, (0.5 + 0.7 * (TAU * x).sin()).clamp(0.0, 1.0));
                wall.lerp(glass, pane((x.x + x.y) / along) * pane(x.z / up))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(low: f32, high: f32) -> impl Strategy<Value = Vec3> {
        [low..high, low..high, low..high].prop_map(Vec3::from_array)
    }

    fn shape() -> impl Strategy<Value = Shape> {
        let normal = prop_oneof![Just(Vec3::X), Just(Vec3::Z), vector(0.1, 1.0).prop_map(Vec3::normalize)];
        prop_oneof![
            (vector(-300.0, 300.0), normal, 0.1..50.0_f32).prop_map(|(center, normal, half)| Shape::Slab {
                center,
                normal,
                half
            }),
            (vector(-300.0, 300.0), 0.1..50.0_f32).prop_map(|(center, radius)| Shape::Ball { center, radius }),
            (vector(-300.0, 300.0), vector(0.1, 50.0)).prop_map(|(center, half)| Shape::Box { center, half }),
            (vector(-300.0, 300.0), 0.1..50.0_f32).prop_map(|(center, radius)| Shape::Fog { center, radius }),
        ]
    }

    fn primitive() -> impl Strategy<Value = Primitive> {
        (shape(), 0.1..100.0_f32, prop_oneof![Just(0.0_f32), 0.01..3.0_f32]).prop_map(|(shape, peak, softness)| {
            Primitive { shape, peak, softness, texture: Texture::Plain(Vec3::ZERO) }
        })
    }

    /// A point in the transition of the shape's surface, where density varies.
    fn near_surface(p: &Primitive, toward: Vec3, depth: f32) -> Vec3 {
        let toward = toward.try_normalize().unwrap_or(Vec3::X);
        match p.shape {
            Shape::Slab { center, normal, half } => center + normal * (half + depth * p.softness),
            Shape::Ball { center, radius } => center + toward * (radius + depth * p.softness),
            Shape::Box { center, half } => center + toward * (half + depth * p.softness),
            Shape::Fog { center, radius } => center + toward * radius * depth.abs(),
        }
    }

    proptest! {
        #[test]
        fn bound_is_never_below_the_density(
            p in primitive(),
            toward in vector(-1.0, 1.0),
            depth in -1.0..1.0_f32,
            low in vector(0.0, 1.0),
            size in prop_oneof![Just(0.0_f32), 1e-3..0.1_f32, 0.1..100.0_f32],
            inside in vector(0.0, 1.0),
        ) {
            // A box around a point of the transition, and a second point of that box.
            let x = near_surface(&p, toward, depth);
            let (min, max) = (x - low * size, x + (Vec3::ONE - low) * size);
            for y in [x, (min + inside * (max - min)).clamp(min, max)] {
                let (density, bound) = (p.density(y), p.density_bound(min, max));
                prop_assert!(density <= bound, "{} above {}", density, bound);
            }
        }

        #[test]
        fn bound_is_reached(p in primitive(), toward in vector(-1.0, 1.0), depth in -1.0..1.0_f32) {
            // Over a box of no size, the bound is the density up to its own margin.
            let x = near_surface(&p, toward, depth);
            let (density, bound) = (p.density(x), p.density_bound(x, x));
            prop_assert!(bound <= density * (1.0 + 2e-5), "{} for {}", bound, density);
        }

        #[test]
        fn bound_is_zero_farther_than_softness(p in primitive(), toward in vector(-1.0, 1.0), size in 0.0..10.0_f32) {
            // Signed distances are 1-Lipschitz. The box is half a diagonal plus the softness away, plus
            // rounding of coordinates below 1000.
            let toward = toward.try_normalize().unwrap_or(Vec3::X);
            let away = 3.0_f32.sqrt() * size + p.softness + 1e-3;
            let x = match p.shape {
                Shape::Slab { center, normal, half } => center + normal * (half + away),
                Shape::Ball { center, radius } | Shape::Fog { center, radius } => center + toward * (radius + away),
                Shape::Box { center, half } => center + toward.signum() * (half + away),
            };
            prop_assert_eq!(p.density_bound(x - size, x + size), 0.0);
        }
    }

    #[test]
    fn windows_show_on_walls_along_both_axes() {
        let texture = Texture::Windows { wall: Vec3::ONE, glass: Vec3::ZERO, pitch: [4.0, 3.0] };
        let shape = Shape::Box { center: Vec3::ZERO, half: Vec3::ONE };
        let tower = Primitive { shape, peak: 1.0, softness: 0.1, texture };
        // The middle of a window is at a quarter of a pitch, the middle of a pillar at three quarters.
        for along in [Vec3::X, Vec3::Y] {
            assert_eq!(tower.color(along + 0.75 * Vec3::Z), Vec3::ZERO);
            assert_eq!(tower.color(3.0 * along + 0.75 * Vec3::Z), Vec3::ONE);
        }
    }
}
