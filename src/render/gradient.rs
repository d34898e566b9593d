//! Derivatives of a field with respect to position: differences, central or forward, or the field's own.

use glam::{DVec3, Vec3};

use super::jacobian::Chosen;
use super::trace::{Points, ask_together};
use crate::field::{Differentiable, Radiance, RadianceField, RadianceJet};
use crate::geometry::{Aabb, Domain};
use crate::{Error, Result};

choices! {
    /// Source of the derivatives of a field.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    #[non_exhaustive]
    pub enum GradientMethod {
        #[default]
        FiniteDifference = "finite-difference", "Central differences; work for any field";
        Analytic = "analytic", "The field's own derivatives, exact up to rounding; an error for a field without them";
        Auto = "auto", "The field's own derivatives if it has them, else central differences";
        ForwardDifference = "forward-difference",
        "Forward differences: four points for a sample instead of seven, over a quarter of the distance";
    }
}

impl GradientMethod {
    /// Returns the derivatives of `field` that this method uses; `None` for finite differences.
    ///
    /// # Errors
    /// If analytic derivatives are required but the field has none.
    pub fn of(self, field: &dyn RadianceField) -> Result<Option<&dyn Differentiable>> {
        match (self, field.differentiable()) {
            (Self::FiniteDifference | Self::ForwardDifference, _) | (Self::Auto, None) => Ok(None),
            (Self::Analytic, None) => {
                let expected = "finite-difference, or a field that differentiates itself";
                Err(Error::setting("gradient", expected, "analytic, of a field that does not"))
            }
            (_, own) => Ok(own),
        }
    }
}

/// Where differences look, h being their step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stencil {
    /// At x ± h along each axis.
    Central,
    /// At x and x + 2h along each axis. These are central differences at x + h: noise and truncation are the same, the
    /// place is off by h. All axes share the point at x.
    Forward,
}

impl Stencil {
    /// That of a method; analytic derivatives have none, and count as central differences.
    #[must_use]
    pub fn of(method: GradientMethod) -> Self {
        if method == GradientMethod::ForwardDifference { Self::Forward } else { Self::Central }
    }

    /// How far it reaches along an axis, in steps.
    #[must_use]
    pub fn reach(self) -> f64 {
        match self {
            Self::Central => 1.0,
            Self::Forward => 2.0,
        }
    }

    /// Number of points without the sample itself.
    fn others(self) -> usize {
        match self {
            Self::Central => 6,
            Self::Forward => 3,
        }
    }
}

/// Step of the differences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differences {
    /// h along each axis, in scene units, where space is not contracted.
    pub step: DVec3,
    /// Domain of the lattice. Where space is contracted, h grows with the lattice's cells.
    pub domain: Domain,
    /// Where they look.
    pub stencil: Stencil,
}

impl Differences {
    /// h along each axis at `x`, in scene units.
    #[must_use]
    pub fn at(&self, x: Vec3) -> DVec3 {
        self.step * self.domain.stretch(x)
    }

    /// How far they reach along each axis at `x`, in scene units.
    #[must_use]
    pub fn reach(&self, x: Vec3) -> DVec3 {
        self.stencil.reach() * self.at(x)
    }

    /// The points beside x, axis by axis; for central differences x + h, then x − h. Points are clipped to `bounds`, so
    /// that central differences at its border are one-sided; forward ones look back there.
    fn around(&self, x: Vec3, bounds: &Aabb) -> impl Iterator<Item = Vec3> + use<> {
        let (stencil, bounds, step) = (self.stencil, *bounds, self.at(x));
        (0..stencil.others()).map(move |i| {
            let moved = |axis: usize, by: f64| {
                let mut y = x.as_dvec3();
                y[axis] += by * step[axis];
                y.as_vec3()
            };
            let clipped = |axis: usize, y: Vec3| {
                let mut clipped = y;
                clipped[axis] = bounds.clamp(y)[axis];
                clipped
            };
            match stencil {
                Stencil::Central => clipped(i / 2, moved(i / 2, if i % 2 == 0 { 1.0 } else { -1.0 })),
                Stencil::Forward => {
                    let ahead = moved(i, 2.0);
                    if clipped(i, ahead) == ahead { ahead } else { clipped(i, moved(i, -2.0)) }
                }
            }
        })
    }

    /// Derivatives along x, y, z from values `f` at points `x`: those of [`Differences::around`], before them the
    /// sample's own if differences are forward. Divides by the true distance of the f32 positions.
    fn derivatives<T>(&self, x: &[Vec3], f: impl Fn(usize) -> T) -> [T; 3]
    where
        T: std::ops::Sub<Output = T> + std::ops::Div<f64, Output = T> + Default,
    {
        std::array::from_fn(|axis| {
            let (up, down) = match self.stencil {
                Stencil::Central => (2 * axis, 2 * axis + 1),
                Stencil::Forward => (axis + 1, 0),
            };
            let width = f64::from(x[up][axis]) - f64::from(x[down][axis]);
            if width == 0.0 { T::default() } else { (f(up) - f(down)) / width }
        })
    }
}

/// A method of differentiation with what it needs.
#[derive(Clone, Copy)]
pub struct Differentiation<'a> {
    /// Step of the finite differences. It matters even where the field's own derivatives are used: matter within this
    /// distance of a sample counts as being there.
    pub differences: Differences,
    /// The field's own derivatives, if they are to be used.
    pub analytic: Option<&'a dyn Differentiable>,
}

/// Value and derivatives of a field at a sample.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Jet {
    /// Colour c.
    pub color: Vec3,
    /// ∇σ.
    pub density_gradient: DVec3,
    /// ∂c/∂x, ∂c/∂y, ∂c/∂z.
    pub color_gradients: [DVec3; 3],
}

/// Reusable buffers.
#[derive(Default)]
pub(super) struct GradientBuffers {
    positions: Vec<Vec3>,
    directions: Vec<Vec3>,
    radiance: Vec<Radiance>,
    densities: Vec<f32>,
    jets: Vec<RadianceJet>,
    gradients: Vec<Vec3>,
}

impl Differentiation<'_> {
    /// Finite differences or analytic.
    #[must_use]
    pub fn method(&self) -> GradientMethod {
        match (self.analytic, self.differences.stencil) {
            (Some(_), _) => GradientMethod::Analytic,
            (None, Stencil::Central) => GradientMethod::FiniteDifference,
            (None, Stencil::Forward) => GradientMethod::ForwardDifference,
        }
    }

    /// h along x, y and z in scene units, if derivatives are differences.
    #[must_use]
    pub fn difference_step(&self) -> Option<[f64; 3]> {
        self.analytic.is_none().then(|| self.differences.step.to_array())
    }

    /// Number of points to evaluate for the jets at `samples` samples.
    pub(super) fn jet_points(&self, samples: usize) -> usize {
        samples * if self.analytic.is_some() { 1 } else { 1 + self.differences.stencil.others() }
    }

    /// Number of points to evaluate for ∇σ at `samples` samples.
    pub(super) fn gradient_points(&self, samples: usize) -> usize {
        let Differences { stencil, .. } = self.differences;
        let of_differences = stencil.others() + usize::from(stencil == Stencil::Forward);
        samples * if self.analytic.is_some() { 1 } else { of_differences }
    }

    /// Places the points at which the field is evaluated for its jets at `samples`.
    pub(super) fn place_jets(&self, bounds: &Aabb, samples: &Chosen, buffers: &mut GradientBuffers) {
        if self.analytic.is_some() {
            buffers.jets.resize(samples.positions.len(), RadianceJet::default());
            return;
        }
        let GradientBuffers { positions: around, directions: along, radiance, .. } = buffers;
        around.clear();
        along.clear();
        for (&x, &direction) in samples.positions.iter().zip(&samples.directions) {
            around.push(x);
            around.extend(self.differences.around(x, bounds));
            along.extend(std::iter::repeat_n(direction, 1 + self.differences.stencil.others()));
        }
        radiance.clear();
        radiance.resize(around.len(), Radiance::default());
    }

    /// Evaluates the field at the points that were placed for its jets, in one call.
    pub(super) fn ask_jets<'q>(
        &self,
        field: &dyn RadianceField,
        parts: impl Iterator<Item = (&'q Chosen, &'q mut GradientBuffers)>,
    ) {
        if let Some(analytic) = self.analytic {
            let parts = parts.map(|(samples, buffers)| Points {
                positions: &samples.positions,
                directions: &samples.directions,
                out: &mut buffers.jets[..],
            });
            ask_together(parts.collect(), |positions, directions, out| analytic.jets(positions, directions, out));
        } else {
            let parts = parts.map(|(_, buffers)| Points {
                positions: &buffers.positions,
                directions: &buffers.directions,
                out: &mut buffers.radiance[..],
            });
            ask_together(parts.collect(), |positions, directions, out| field.evaluate(positions, directions, out));
        }
    }

    /// Writes the jets to `out`, once the field is evaluated; `None` where it is not finite there or nearby.
    pub(super) fn take_jets(&self, buffers: &GradientBuffers, out: &mut Vec<Option<Jet>>) {
        out.clear();
        if self.analytic.is_some() {
            out.extend(buffers.jets.iter().map(|jet| {
                let finite = jet.value.is_valid()
                    && jet.density_gradient.is_finite()
                    && jet.color_gradients.iter().all(|g| g.is_finite());
                finite.then(|| Jet {
                    color: jet.value.color,
                    density_gradient: jet.density_gradient.as_dvec3(),
                    color_gradients: jet.color_gradients.map(Vec3::as_dvec3),
                })
            }));
            return;
        }
        let GradientBuffers { positions: around, radiance, .. } = buffers;
        let Differences { stencil, .. } = self.differences;
        let (together, skipped) = (1 + stencil.others(), usize::from(stencil == Stencil::Central));
        out.extend(around.chunks_exact(together).zip(radiance.chunks_exact(together)).map(|(x, r)| {
            let (color, finite) = (r[0].color, r.iter().all(Radiance::is_valid));
            let (x, r) = (&x[skipped..], &r[skipped..]);
            finite.then(|| Jet {
                color,
                density_gradient: self.differences.derivatives(x, |i| f64::from(r[i].density)).into(),
                color_gradients: self.differences.derivatives(x, |i| r[i].color.as_dvec3()),
            })
        }));
    }

    /// Places the points at which the field is evaluated for ∇σ at `positions`.
    pub(super) fn place_density_gradients(&self, bounds: &Aabb, positions: &[Vec3], buffers: &mut GradientBuffers) {
        let GradientBuffers { positions: around, densities, gradients, .. } = buffers;
        around.clear();
        densities.clear();
        if self.analytic.is_some() {
            gradients.resize(positions.len(), Vec3::ZERO);
        } else {
            for &x in positions {
                around.extend((self.differences.stencil == Stencil::Forward).then_some(x));
                around.extend(self.differences.around(x, bounds));
            }
            densities.resize(around.len(), 0.0);
        }
    }

    /// Evaluates the field at the points that were placed for ∇σ, in one call.
    pub(super) fn ask_density_gradients<'q>(
        &self,
        field: &dyn RadianceField,
        parts: impl Iterator<Item = (&'q [Vec3], &'q mut GradientBuffers)>,
    ) {
        if let Some(analytic) = self.analytic {
            let points = |positions, out| Points { positions, directions: &[], out };
            let parts = parts.map(|(positions, buffers)| points(positions, &mut buffers.gradients[..]));
            ask_together(parts.collect(), |positions, _, gradients| {
                analytic.density_jets(positions, &mut vec![0.0; positions.len()], gradients);
            });
        } else {
            let parts = parts.map(|(_, GradientBuffers { positions, densities, .. })| Points {
                positions,
                directions: &[],
                out: &mut densities[..],
            });
            ask_together(parts.collect(), |positions, _, densities| field.densities(positions, densities));
        }
    }

    /// Writes ∇σ to `out`, once the field is evaluated; `None` where it is not finite.
    pub(super) fn take_density_gradients(&self, buffers: &GradientBuffers, out: &mut Vec<Option<DVec3>>) {
        let GradientBuffers { positions: around, densities, gradients, .. } = buffers;
        out.clear();
        if self.analytic.is_some() {
            out.extend(gradients.iter().map(|gradient| gradient.is_finite().then(|| gradient.as_dvec3())));
            return;
        }
        let Differences { stencil, .. } = self.differences;
        let together = stencil.others() + usize::from(stencil == Stencil::Forward);
        out.extend(around.chunks_exact(together).zip(densities.chunks_exact(together)).map(|(x, densities)| {
            let finite = densities.iter().all(|&density| density >= 0.0 && density.is_finite());
            finite.then(|| self.differences.derivatives(x, |i| f64::from(densities[i])).into())
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(stencil: Stencil) -> Differences {
        let bounds = Aabb::centered_cube(1.0);
        Differences { step: DVec3::new(0.01, 0.02, 0.03), domain: Domain::Box(bounds), stencil }
    }

    /// x, where forward differences begin, and the points beside it.
    fn points(differences: &Differences, x: Vec3) -> Vec<Vec3> {
        let first = (differences.stencil == Stencil::Forward).then_some(x);
        first.into_iter().chain(differences.around(x, &Aabb::centered_cube(1.0))).collect()
    }

    #[test]
    fn both_stencils_are_exact_for_quadratic_functions_at_their_middle() {
        // f = g · x + ½ Σ q x²: its central difference is f′ at x, its forward one f′ at x + h.
        let (g, q) = (DVec3::new(1.5, -2.0, 0.5), DVec3::new(3.0, 1.0, -4.0));
        let f = |x: Vec3| g.dot(x.as_dvec3()) + 0.5 * q.dot(x.as_dvec3().powf(2.0));
        // Inside; where forward differences look back; at a corner.
        for x in [Vec3::new(0.2, -0.3, 0.1), Vec3::new(0.99, 0.0, 0.5), Vec3::ONE] {
            for stencil in [Stencil::Central, Stencil::Forward] {
                let differences = of(stencil);
                let points = points(&differences, x);
                let found = DVec3::from(differences.derivatives(&points, |i| f(points[i])));
                let middle = DVec3::from(std::array::from_fn(|axis| {
                    let (up, down) = match stencil {
                        Stencil::Central => (2 * axis, 2 * axis + 1),
                        Stencil::Forward => (axis + 1, 0),
                    };
                    0.5 * (f64::from(points[up][axis]) + f64::from(points[down][axis]))
                }));
                // Points are rounded to f32, and distances are the rounded ones: what is left is rounding in f64.
                assert!((found - (g + q * middle)).abs().max_element() < 1e-12, "{stencil:?} at {x}: {found}");
                let off = (middle - x.as_dvec3()).abs() / differences.step;
                let expected = if stencil == Stencil::Forward { 1.0 } else { 0.0 };
                assert!(x == Vec3::ONE || (off.y - expected).abs() < 1e-4, "{stencil:?}: {off}");
                let reach = (points.iter().map(|y| (*y - x).abs()).fold(Vec3::ZERO, Vec3::max)).as_dvec3();
                assert!((reach - differences.reach(x)).max_element() < 1e-6, "{stencil:?}: {reach}");
                assert!(points.iter().all(|y| Aabb::centered_cube(1.0).contains(*y)));
            }
        }
    }

    #[test]
    fn forward_differences_need_fewer_points() {
        let (bounds, positions) = (Aabb::centered_cube(1.0), [Vec3::ZERO, Vec3::splat(0.5)]);
        let placed = |stencil| {
            let how = Differentiation { differences: of(stencil), analytic: None };
            let (mut samples, mut buffers) = (Chosen::default(), GradientBuffers::default());
            positions.iter().enumerate().for_each(|(i, &x)| samples.push(i, 0, x, Vec3::Z));
            how.place_jets(&bounds, &samples, &mut buffers);
            assert_eq!(buffers.positions.len(), how.jet_points(2));
            how.place_density_gradients(&bounds, &positions, &mut buffers);
            assert_eq!(buffers.positions.len(), how.gradient_points(2));
            [how.jet_points(2), how.gradient_points(2)]
        };
        assert_eq!((placed(Stencil::Central), placed(Stencil::Forward)), ([14, 12], [8, 8]));
    }
}
