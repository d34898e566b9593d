//! The scenes of the zoo, written again in f64 from their description, with gradients.
//!
//! Only the numbers that describe a scene are shared. Nothing of the field's own evaluation is used.

use glam::{DMat3, DVec3};
use octobayes::field::RadianceField;
use octobayes::field::closed_form::{Primitive, Shape, Texture};

use super::dual::Dual;

use crate::scenes::{Specimen, Treatment};

/// σ, ∇σ, c and ∂c/∂x at a point (row colour, column axis).
#[derive(Debug, Clone, Copy)]
pub struct Jet {
    pub density: f64,
    pub slope: DVec3,
    pub color: DVec3,
    pub color_slope: DMat3,
}

impl Jet {
    const NOTHING: Self = Self { density: 0.0, slope: DVec3::ZERO, color: DVec3::splat(0.5), color_slope: DMat3::ZERO };

    /// Returns true if compositing can use it.
    pub fn is_valid(&self) -> bool {
        self.density >= 0.0 && self.density.is_finite()
    }
}

/// A specimen in f64.
pub struct Ground {
    primitives: Vec<Primitive>,
    treatment: Treatment,
    scale: f64,
    shift: DVec3,
    pub min: DVec3,
    pub max: DVec3,
    /// Density and colour at the points of a grid, x slowest. Empty if the specimen is no grid.
    nodes: Vec<[f64; 4]>,
}

impl Ground {
    pub fn of(specimen: &Specimen) -> Self {
        let (scale, shift) = specimen.placement();
        let bounds = specimen.bounds();
        let mut ground = Self {
            primitives: specimen.shapes().primitives().to_vec(),
            treatment: specimen.treatment(),
            scale,
            shift,
            min: bounds.min(),
            max: bounds.max(),
            nodes: Vec::new(),
        };
        if let Treatment::Grid { points: n } = ground.treatment {
            let node = |i: usize| {
                let at = DVec3::new((i / (n * n)) as f64, (i / n % n) as f64, (i % n) as f64) / (n - 1) as f64;
                let (density, color) = ground.sum(Dual::position(ground.min + at * (ground.max - ground.min)));
                // A grid's values are f32. They are its definition, not its evaluation.
                [density, color[0], color[1], color[2]].map(|v| f64::from(v.value as f32))
            };
            ground.nodes = (0..n * n * n).map(node).collect();
        }
        ground
    }

    /// σ and c of the shapes, without treatment or motion.
    fn sum(&self, x: [Dual; 3]) -> (Dual, [Dual; 3]) {
        let zero = Dual::constant(0.0);
        let (mut density, mut weighted) = (zero, [zero; 3]);
        for primitive in &self.primitives {
            let share = density_of(primitive, x);
            if share.value > 0.0 {
                density = density + share;
                let color = color_of(&primitive.texture, x);
                weighted = [0, 1, 2].map(|k| weighted[k] + share * color[k]);
            }
        }
        let color = weighted.map(|w| if density.value > 0.0 { w / density } else { Dual::constant(0.5) });
        (density, color)
    }

    /// The field at a scene point, with exact derivatives. If values are rounded to f16, they are the derivatives
    /// before rounding.
    pub fn jet(&self, x: DVec3) -> Jet {
        if x.cmplt(self.min).any() || x.cmpgt(self.max).any() {
            return Jet::NOTHING;
        }
        let own = (x - self.shift) / self.scale;
        let (mut density, mut color) = match self.treatment {
            Treatment::Grid { points } => self.between_nodes(own, points),
            _ => self.sum(Dual::position(own)),
        };
        match self.treatment {
            Treatment::Exact | Treatment::Grid { .. } | Treatment::Half => {}
            Treatment::Saturated => {
                let offsets = [20.0, 20.0, -20.0];
                color =
                    [0, 1, 2].map(|k| ((color[k] - Dual::constant(0.5)) * 8.0 + Dual::constant(offsets[k])).sigmoid());
            }
            Treatment::Fault { density: instead, center, radius } => {
                if own.distance(center.as_dvec3()) < f64::from(radius) {
                    density = Dual::constant(f64::from(instead));
                }
            }
        }
        Jet {
            density: density.value / self.scale,
            slope: density.gradient / (self.scale * self.scale),
            color: DVec3::from(color.map(|c| c.value)),
            color_slope: DMat3::from_cols_array_2d(&color.map(|c| (c.gradient / self.scale).to_array())).transpose(),
        }
    }

    /// σ and c as the field returns them, rounded to f16 if it does so.
    pub fn value(&self, x: DVec3) -> (f64, DVec3) {
        let jet = self.jet(x);
        if self.treatment == Treatment::Half {
            let round = |v: f64| half::f16::from_f64(v).to_f64();
            return (round(jet.density), jet.color.map(round));
        }
        (jet.density, jet.color)
    }

    /// Trilinear interpolation in the grid's cell around x. Of two cells that share a face, the upper one counts.
    fn between_nodes(&self, x: DVec3, n: usize) -> (Dual, [Dual; 3]) {
        let cells = (n - 1) as f64;
        let mut factors = [[Dual::constant(0.0); 2]; 3];
        let mut low = [0; 3];
        for axis in 0..3 {
            let per_unit = cells / ((self.max - self.min)[axis] / self.scale);
            let u = (x[axis] - (self.min[axis] - self.shift[axis]) / self.scale) * per_unit;
            low[axis] = (u.floor().max(0.0) as usize).min(n - 2);
            let right = Dual { value: u - low[axis] as f64, gradient: per_unit * DVec3::AXES[axis] };
            factors[axis] = [Dual::constant(1.0) - right, right];
        }
        let mut sums = [Dual::constant(0.0); 4];
        for (i, (j, k)) in (0..2).flat_map(|i| (0..2).flat_map(move |j| (0..2).map(move |k| (i, (j, k))))) {
            let weight = factors[0][i] * factors[1][j] * factors[2][k];
            let node = self.nodes[((low[0] + i) * n + low[1] + j) * n + low[2] + k];
            for (sum, value) in sums.iter_mut().zip(node) {
                *sum = *sum + weight * value;
            }
        }
        (sums[0], [sums[1], sums[2], sums[3]])
    }
}

fn minus(x: [Dual; 3], center: glam::Vec3) -> [Dual; 3] {
    let c = center.as_dvec3();
    [0, 1, 2].map(|k| x[k] - Dual::constant(c[k]))
}

fn length(v: [Dual; 3]) -> Dual {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

/// The density of one shape, as its documentation states it.
fn density_of(primitive: &Primitive, x: [Dual; 3]) -> Dual {
    let distance = match primitive.shape {
        Shape::Slab { center, normal, half } => {
            let (d, n) = (minus(x, center), normal.as_dvec3());
            (d[0] * n.x + d[1] * n.y + d[2] * n.z).abs() - Dual::constant(f64::from(half))
        }
        Shape::Ball { center, radius } => length(minus(x, center)) - Dual::constant(f64::from(radius)),
        Shape::Box { center, half } => {
            let d = minus(x, center);
            let q = [0, 1, 2].map(|k| d[k].abs() - Dual::constant(f64::from(half[k])));
            let outside = length(q.map(|q| q.max(0.0)));
            let nearest = q.into_iter().reduce(|a, b| if b.value > a.value { b } else { a }).unwrap();
            outside + nearest.min(0.0)
        }
        Shape::Fog { center, radius } => {
            let d = minus(x, center);
            let r = f64::from(radius);
            let inside = (Dual::constant(1.0) - (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) * (1.0 / (r * r))).max(0.0);
            return inside * inside * inside * f64::from(primitive.peak);
        }
    };
    let (peak, softness) = (f64::from(primitive.peak), f64::from(primitive.softness));
    if softness == 0.0 {
        return Dual::constant(if distance.value < 0.0 { peak } else { 0.0 });
    }
    // The quintic smoothstep, `6t⁵ − 15t⁴ + 10t³`, from the outer to the inner end of the transition.
    let t = (Dual::constant(softness) - distance) * (0.5 / softness);
    let t = t.max(0.0).min(1.0);
    let cubed = t * t * t;
    (cubed * t * t * 6.0 - cubed * t * 15.0 + cubed * 10.0) * peak
}

fn color_of(texture: &Texture, x: [Dual; 3]) -> [Dual; 3] {
    match *texture {
        Texture::Plain(color) => color.to_array().map(|c| Dual::constant(f64::from(c))),
        Texture::Waves { base, amplitude, frequency } => {
            let omega = f64::from(frequency);
            // The documented phases of red, green and blue.
            [(0.4_f32, 0), (1.1, 1), (1.9, 2)].map(|(phase, k)| {
                let phase = Dual::constant(f64::from(phase));
                let product =
                    (x[0] * omega + phase).sin() * (x[1] * omega + phase + phase).sin() * (x[2] * omega - phase).sin();
                Dual::constant(f64::from(base[k])) + product * f64::from(amplitude)
            })
        }
        Texture::Windows { .. } => unreachable!("no scene of the zoo has windows"),
    }
}
