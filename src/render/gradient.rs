//! Derivatives of a field with respect to position: central differences, or the field's own.

use glam::{DVec3, Vec3};

use super::Question;
use crate::field::{Differentiable, Radiance, RadianceField, RadianceJet};
use crate::geometry::{Aabb, Domain};
use crate::{Error, Result};

/// Source of the derivatives of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum GradientMethod {
    /// Central differences; work for any field
    #[default]
    FiniteDifference,
    /// The field's own derivatives, exact up to rounding; an error for a field without them
    Analytic,
    /// The field's own derivatives if it has them, else central differences
    Auto,
}

impl GradientMethod {
    /// Returns the derivatives of `field` that this method uses; `None` for finite differences.
    ///
    /// # Errors
    /// If analytic derivatives are required but the field has none.
    pub fn of(self, field: &dyn RadianceField) -> Result<Option<&dyn Differentiable>> {
        match (self, field.differentiable()) {
            (Self::FiniteDifference, _) | (Self::Auto, None) => Ok(None),
            (Self::Analytic, None) => {
                let expected = "finite-difference, or a field that differentiates itself";
                Err(Error::setting(
                    "gradient",
                    expected,
                    format!("analytic, of a field that does not: {}", field.describe()),
                ))
            }
            (_, own) => Ok(own),
        }
    }
}

/// Step of the central differences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differences {
    /// Distance h to both sides along each axis, in scene units, where space is not contracted.
    pub step: DVec3,
    /// Domain of the lattice. Where space is contracted, h grows with the lattice's cells.
    pub domain: Domain,
}

impl Differences {
    /// h along each axis at `x`, in scene units.
    #[must_use]
    pub fn at(&self, x: Vec3) -> DVec3 {
        self.step * self.domain.stretch(x)
    }

    /// x ± h along each axis, in the order +x, −x, +y, −y, +z, −z. Points are clipped to `bounds`, so that
    /// differences at its border are one-sided.
    fn around(&self, x: Vec3, bounds: &Aabb) -> [Vec3; 6] {
        let step = self.at(x);
        std::array::from_fn(|i| {
            let (axis, sign) = (i / 2, if i % 2 == 0 { 1.0 } else { -1.0 });
            let mut y = x.as_dvec3();
            y[axis] += sign * step[axis];
            let mut y = y.as_vec3();
            y[axis] = bounds.clamp(y)[axis];
            y
        })
    }
}

/// Derivatives along x, y, z from values `f` at the points of [`Differences::around`]. Divides by the true distance
/// of the f32 positions.
fn differences<T>(x: &[Vec3], f: impl Fn(usize) -> T) -> [T; 3]
where
    T: std::ops::Sub<Output = T> + std::ops::Div<f64, Output = T> + Default,
{
    std::array::from_fn(|axis| {
        let (up, down) = (2 * axis, 2 * axis + 1);
        let width = f64::from(x[up][axis]) - f64::from(x[down][axis]);
        if width > 0.0 { (f(up) - f(down)) / width } else { T::default() }
    })
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
        if self.analytic.is_some() { GradientMethod::Analytic } else { GradientMethod::FiniteDifference }
    }

    /// h along x, y and z in scene units, if it affects the result.
    #[must_use]
    pub fn difference_step(&self) -> Option<[f64; 3]> {
        self.analytic.is_none().then(|| self.differences.step.to_array())
    }

    /// Prepares the question for the jets of a field at `positions` seen along `directions`.
    pub(super) fn ask_jets(
        &self,
        bounds: &Aabb,
        positions: &[Vec3],
        directions: &[Vec3],
        buffers: &mut GradientBuffers,
    ) {
        if self.analytic.is_some() {
            buffers.jets.resize(positions.len(), RadianceJet::default());
            return;
        }
        let GradientBuffers { positions: around, directions: along, radiance, .. } = buffers;
        around.clear();
        along.clear();
        for (&x, &direction) in positions.iter().zip(directions) {
            around.push(x);
            around.extend(self.differences.around(x, bounds));
            along.extend([direction; 7]);
        }
        radiance.clear();
        radiance.resize(around.len(), Radiance::default());
    }

    /// That question.
    pub(super) fn jets_question<'q>(
        &self,
        positions: &'q [Vec3],
        directions: &'q [Vec3],
        buffers: &'q mut GradientBuffers,
    ) -> Question<'q> {
        let GradientBuffers { positions: around, directions: along, radiance, jets, .. } = buffers;
        if self.analytic.is_some() {
            Question::Jets { positions, directions, out: jets }
        } else {
            Question::Radiance { positions: around, directions: along, out: radiance }
        }
    }

    /// Writes the jets to `out`, once the question is answered; `None` where the field is not finite there or nearby.
    pub(super) fn read_jets(&self, buffers: &GradientBuffers, out: &mut Vec<Option<Jet>>) {
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
        out.extend(around.as_chunks::<7>().0.iter().zip(radiance.as_chunks::<7>().0).map(|(x, r)| {
            let (x, [center, r @ ..]) = (&x[1..], r);
            let finite = center.is_valid() && r.iter().all(Radiance::is_valid);
            finite.then(|| Jet {
                color: center.color,
                density_gradient: differences(x, |i| f64::from(r[i].density)).into(),
                color_gradients: differences(x, |i| r[i].color.as_dvec3()),
            })
        }));
    }

    /// The field's own derivatives, if ∇σ is best evaluated together with σ.
    pub(super) fn along_rays(&self) -> Option<&dyn Differentiable> {
        self.analytic.filter(|field| field.is_cheap())
    }

    /// Prepares the question for ∇σ of a field at `positions`.
    pub(super) fn ask_density_gradients(&self, bounds: &Aabb, positions: &[Vec3], buffers: &mut GradientBuffers) {
        let GradientBuffers { positions: around, densities, gradients, .. } = buffers;
        around.clear();
        densities.clear();
        if self.analytic.is_some() {
            gradients.resize(positions.len(), Vec3::ZERO);
            densities.resize(positions.len(), 0.0);
        } else {
            around.extend(positions.iter().flat_map(|&x| self.differences.around(x, bounds)));
            densities.resize(around.len(), 0.0);
        }
    }

    /// That question.
    pub(super) fn density_gradients_question<'q>(
        &self,
        positions: &'q [Vec3],
        buffers: &'q mut GradientBuffers,
    ) -> Question<'q> {
        let GradientBuffers { positions: around, densities, gradients, .. } = buffers;
        if self.analytic.is_some() {
            Question::DensityJets { positions, densities, gradients }
        } else {
            Question::Densities { positions: around, out: densities }
        }
    }

    /// Writes ∇σ to `out`, once the question is answered; `None` where it is not finite.
    pub(super) fn read_density_gradients(&self, buffers: &GradientBuffers, out: &mut Vec<Option<DVec3>>) {
        let GradientBuffers { positions: around, densities, gradients, .. } = buffers;
        out.clear();
        if self.analytic.is_some() {
            out.extend(gradients.iter().map(|gradient| gradient.is_finite().then(|| gradient.as_dvec3())));
            return;
        }
        out.extend(around.as_chunks::<6>().0.iter().zip(densities.as_chunks::<6>().0).map(|(x, densities)| {
            let finite = densities.iter().all(|&density| density >= 0.0 && density.is_finite());
            finite.then(|| differences(x, |i| f64::from(densities[i])).into())
        }));
    }
}
