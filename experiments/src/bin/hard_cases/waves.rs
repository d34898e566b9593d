//! Fields whose derivatives are known, and fields spoilt on purpose.

use glam::{DVec3, Vec3};
use half::f16;
use octobayes::field::{Differentiable, Radiance, RadianceField, RadianceJet, TrainedField};
use octobayes::geometry::Aabb;

/// What is done to the waves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// σ = 25 (1 + s), s ∈ [−1, 1] a product of waves.
    Smooth,
    /// σ = exp(9 s): eight decades.
    Exponential,
    /// As smooth, rounded to f16.
    Half,
}

/// Waves of density and colour in [−1, 1]³, computed in f64, given in f32.
pub struct Waves(pub Kind);

/// Radians per scene unit along the axes.
const FREQUENCY: DVec3 = DVec3::new(7.0, 9.0, 5.0);

impl Waves {
    /// s and its gradient.
    fn wave(x: Vec3) -> (f64, DVec3) {
        let u = x.as_dvec3() * FREQUENCY + DVec3::new(0.3, 1.1, 2.0);
        let (s, c) = (DVec3::new(u.x.sin(), u.y.sin(), u.z.sin()), DVec3::new(u.x.cos(), u.y.cos(), u.z.cos()));
        let gradient = DVec3::new(c.x * s.y * s.z, s.x * c.y * s.z, s.x * s.y * c.z) * FREQUENCY;
        (s.x * s.y * s.z, gradient)
    }

    /// Colour and ∂c/∂x, ∂c/∂y, ∂c/∂z.
    fn colors(x: Vec3, direction: Vec3) -> (DVec3, [DVec3; 3]) {
        let waves = [DVec3::new(11.0, 2.0, 3.0), DVec3::new(-4.0, 8.0, 5.0), DVec3::new(3.0, -6.0, 10.0)];
        let phase = |k: &DVec3| k.dot(x.as_dvec3()) + 0.5 * direction.as_dvec3().x;
        let color = DVec3::from(waves.each_ref().map(|k| 0.5 + 0.4 * phase(k).sin()));
        let slope = DVec3::from(waves.each_ref().map(|k| 0.4 * phase(k).cos()));
        (color, [0, 1, 2].map(|axis| slope * DVec3::from(waves.each_ref().map(|k| k[axis]))))
    }

    /// σ and ∇σ before rounding.
    fn density(&self, x: Vec3) -> (f64, DVec3) {
        let (s, gradient) = Self::wave(x);
        match self.0 {
            Kind::Smooth | Kind::Half => (25.0 * (1.0 + s), 25.0 * gradient),
            Kind::Exponential => ((9.0 * s).exp(), 9.0 * (9.0 * s).exp() * gradient),
        }
    }
}

impl RadianceField for Waves {
    fn bounds(&self) -> Aabb {
        Aabb::centered_cube(1.0)
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        for ((&x, &d), out) in positions.iter().zip(directions).zip(out) {
            let (density, color) = (self.density(x).0, Self::colors(x, d).0);
            let round = |v: f64| if self.0 == Kind::Half { f16::from_f64(v).to_f32() } else { v as f32 };
            *out = Radiance { density: round(density), color: Vec3::from(color.to_array().map(round)) };
        }
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn suggested_step(&self) -> f64 {
        1.0 / 128.0
    }

    fn memory(&self) -> usize {
        0
    }
}

impl TrainedField for Waves {
    fn describe(&self) -> String {
        format!("{:?} waves", self.0)
    }
}

impl Differentiable for Waves {
    /// Those of the function that was rounded.
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        let mut values = vec![Radiance::default(); positions.len()];
        self.evaluate(positions, directions, &mut values);
        for (((&x, &d), value), out) in positions.iter().zip(directions).zip(values).zip(out) {
            let (gradient, colors) = (self.density(x).1, Self::colors(x, d).1);
            *out = RadianceJet {
                value,
                density_gradient: gradient.as_vec3(),
                color_gradients: [0, 1, 2].map(|axis| colors[axis].as_vec3()),
            };
        }
    }
}
