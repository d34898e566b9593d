//! Radiance fields: density and colour at a point, seen from a direction.
//!
//! Everything downstream sees a field only through [`RadianceField`], so any architecture can be a black box.

#[doc(hidden)]
pub mod closed_form;
#[doc(hidden)]
pub mod harmonics;
mod voxel;

pub use closed_form::ClosedForm;
pub use voxel::VoxelGrid;

use glam::Vec3;

use crate::Result;
use crate::geometry::{Aabb, Camera, Domain, NamedCamera};

/// What a field returns for one position and direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Radiance {
    /// σ ≥ 0, 1 / scene unit.
    pub density: f32,
    /// Red, green, blue in `[0, 1]`.
    pub color: Vec3,
}

impl Radiance {
    /// Checks that density and colour are finite and the density is not negative, as compositing requires.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.density >= 0.0 && self.density.is_finite() && self.color.is_finite()
    }
}

/// Density and colour with their derivatives by position: first-order jets.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RadianceJet {
    /// Density and colour.
    pub value: Radiance,
    /// ∇σ, 1 / scene unit².
    pub density_gradient: Vec3,
    /// ∂c/∂x, ∂c/∂y, ∂c/∂z, each red, green, blue; 1 / scene unit.
    pub color_gradients: [Vec3; 3],
}

/// A field that computes its own derivatives, exact up to rounding.
///
/// Where the field has a kink (a ReLU, a cell's face), any one-sided derivative will do.
pub trait Differentiable: Send + Sync {
    /// Fills `out` (`[n]`) with density, colour and their derivatives by position, at `positions` (`[n]`)
    /// seen along fixed unit `directions` (`[n]`).
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]);

    /// Fills `densities` and `gradients` (`[n]`) with σ and ∇σ alone, at `positions` (`[n]`).
    fn density_jets(&self, positions: &[Vec3], densities: &mut [f32], gradients: &mut [Vec3]) {
        let mut jets = vec![RadianceJet::default(); positions.len()];
        self.jets(positions, &vec![Vec3::Z; positions.len()], &mut jets);
        for ((density, gradient), jet) in densities.iter_mut().zip(gradients).zip(jets) {
            (*density, *gradient) = (jet.value.density, jet.density_gradient);
        }
    }
}

/// Intrinsics that the user must add to a field that stores its training poses but not the lens.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Intrinsics {
    /// Horizontal angle of view, radians.
    pub fov_x: Option<f64>,
    /// Width and height, pixels.
    pub resolution: Option<[u32; 2]>,
}

/// A trained (or closed-form) radiance field, evaluated in batches from many threads.
///
/// The value at a position and direction must not depend on the rest of the batch.
///
/// Three methods are enough for a model of your own. What is known of its training belongs to [`TrainedField`]:
/// ```
/// use octobayes::estimate::{Estimation, GridSettings, RaySettings};
/// use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField};
/// use octobayes::geometry::Aabb;
/// use octobayes::glam::Vec3;
///
/// /// A soft ball with waves of colour along every axis.
/// struct Ball;
///
/// impl RadianceField for Ball {
///     fn bounds(&self) -> Aabb {
///         Aabb::centered_cube(1.0)
///     }
///     fn evaluate(&self, positions: &[Vec3], _directions: &[Vec3], out: &mut [Radiance]) {
///         for (x, out) in positions.iter().zip(out) {
///             let density = 50.0 / (1.0 + (40.0 * (x.length() - 0.5)).exp());
///             *out = Radiance { density, color: (9.0 * *x).map(|v| 0.5 + 0.4 * v.sin()) };
///         }
///     }
///     fn suggested_step(&self) -> f64 {
///         1.0 / 64.0
///     }
/// }
///
/// impl TrainedField for Ball {}
///
/// let cameras = ClosedForm::half_circle(4, [32, 32]);
/// let rays = RaySettings::default().rays(4_000).occupancy(32);
/// let grid = GridSettings::default().level(5);
/// let field = Estimation::new(&Ball, &cameras).rays(rays).grid(grid).run()?.field;
/// // The cameras stand on the side x > 0: there the ball's surface is known better.
/// let [seen, unseen] = [0.5, -0.5].map(|x| field.query(Vec3::new(x, 0.1, 0.1)).uncertainty);
/// assert!(seen < 0.1 * unseen);
/// # Ok::<(), octobayes::Error>(())
/// ```
pub trait RadianceField: Send + Sync {
    /// The box outside which the density is zero.
    fn bounds(&self) -> Aabb;

    /// Fills `out` (`[n]`) with density and colour at `positions` (`[n]`, scene units) seen along unit
    /// `directions` (`[n]`).
    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]);

    /// Fills `out` (`[n]`) with the density alone at `positions` (`[n]`, scene units).
    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        let mut radiance = vec![Radiance::default(); positions.len()];
        self.evaluate(positions, &vec![Vec3::Z; positions.len()], &mut radiance);
        for (out, r) in out.iter_mut().zip(radiance) {
            *out = r.density;
        }
    }

    /// The field's own derivatives, if it has them. Other fields are differentiated by finite differences.
    fn differentiable(&self) -> Option<&dyn Differentiable> {
        None
    }

    /// An upper bound of the density in the box from `min` to `max`, if the field has one that is cheap to find.
    ///
    /// Empty space is then skipped with certainty; without a bound, emptiness is estimated from samples. A
    /// field may return bounds for some boxes only.
    fn density_bound(&self, _min: Vec3, _max: Vec3) -> Option<f32> {
        None
    }

    /// Distance between samples along a ray that resolves this field, scene units.
    fn suggested_step(&self) -> f64;

    /// Smallest efficient batch, in points; 0 if a few hundred are enough.
    ///
    /// A field with a high cost per call, such as one in another language or on a GPU, gets nine of ten points in
    /// batches of at least this size: thousands of rays then advance together
    /// ([`RayStream::run`](crate::rays::RayStream::run)). Results do not depend on it.
    fn batch(&self) -> usize {
        0
    }

    /// Size of parameters and tables, bytes; 0 if unknown.
    fn memory(&self) -> usize {
        0
    }
}

/// A field, and what is known of its training. Nothing needs to be: `impl TrainedField for Ball {}` will do.
pub trait TrainedField: RadianceField {
    /// The cameras that come with the field: those it was trained on, or those meant for a built-in scene.
    /// `None` if it has none.
    ///
    /// # Errors
    /// If neither the field nor `intrinsics` gives all intrinsics, or if the field cannot use those of
    /// `intrinsics`.
    fn cameras(&self, _intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        Ok(None)
    }

    /// The cameras that the field was trained on, with all intrinsics; empty if they are not known.
    fn training_cameras(&self) -> &[NamedCamera] {
        &[]
    }

    /// Root mean square error of the training pixels' colours (0..1) after training, if the model records it.
    fn training_noise(&self) -> Option<f64> {
        None
    }

    /// The space that the field covers, as its parameters divide it: its box, unless it contracts space.
    fn natural_domain(&self) -> Domain {
        Domain::Box(self.bounds())
    }

    /// Where in a pixel the training rays went: ½ for the centre, 0 for models trained on the upper left corner.
    fn pixel_offset(&self) -> f64 {
        0.5
    }

    /// One human-readable line: architecture and size.
    fn describe(&self) -> String {
        "a field of another program".into()
    }
}

/// A field behind a pointer is a field.
macro_rules! forward {
    ($($pointer:ty),*) => {$(
        impl<F: RadianceField + ?Sized> RadianceField for $pointer {
            fn bounds(&self) -> Aabb {
                (**self).bounds()
            }
            fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
                (**self).evaluate(positions, directions, out);
            }
            fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
                (**self).densities(positions, out);
            }
            fn differentiable(&self) -> Option<&dyn Differentiable> {
                (**self).differentiable()
            }
            fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
                (**self).density_bound(min, max)
            }
            fn suggested_step(&self) -> f64 {
                (**self).suggested_step()
            }
            fn batch(&self) -> usize {
                (**self).batch()
            }
            fn memory(&self) -> usize {
                (**self).memory()
            }
        }

        impl<F: TrainedField + ?Sized> TrainedField for $pointer {
            fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
                (**self).cameras(intrinsics)
            }
            fn training_cameras(&self) -> &[NamedCamera] {
                (**self).training_cameras()
            }
            fn training_noise(&self) -> Option<f64> {
                (**self).training_noise()
            }
            fn natural_domain(&self) -> Domain {
                (**self).natural_domain()
            }
            fn pixel_offset(&self) -> f64 {
                (**self).pixel_offset()
            }
            fn describe(&self) -> String {
                (**self).describe()
            }
        }
    )*};
}

forward!(&F, Box<F>, std::sync::Arc<F>);
