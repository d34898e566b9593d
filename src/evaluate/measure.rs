//! What is asked whether it ranks the error. Larger is more uncertain, always.

use crate::render::RayAverage;
use crate::uncertainty::UncertaintyField;

/// A field read through one covariance, blended along rays in some ways.
#[derive(Debug, Clone)]
pub struct Reading {
    /// For tables.
    pub name: String,
    /// U.
    pub field: UncertaintyField,
    /// How log10 U becomes a pixel's, at least one.
    pub blends: Vec<RayAverage>,
}

/// What an uncertainty field has to beat: measures without a Hessian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Baseline {
    /// [`crate::render::depth_variance`] of the ray's weights.
    RayVariance,
    /// [`crate::render::termination_entropy`] of the ray's weights.
    RayEntropy,
    /// 1 − opacity.
    Transparency,
    /// Minus the number of training rays that support what the pixel shows: that of the field's vertices, blended like [`RayAverage::WeightedMean`].
    RayCount,
    /// A random number per pixel.
    Random,
    /// [`crate::metrics::ensemble_variance`] of the median depth; a member that shows nothing has the depth at which the ray leaves the box.
    EnsembleVariance,
    /// [`crate::metrics::density_aware`].
    DensityAware,
}

impl Baseline {
    /// The name in tables and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::RayVariance => "ray-weight variance",
            Self::RayEntropy => "ray entropy",
            Self::Transparency => "1 - opacity",
            Self::RayCount => "ray count",
            Self::Random => "random",
            Self::EnsembleVariance => "ensemble depth variance",
            Self::DensityAware => "density-aware ensemble",
        }
    }

    /// Whether it asks for nothing but one model and its rays.
    #[must_use]
    pub fn is_single_model(self) -> bool {
        !matches!(self, Self::EnsembleVariance | Self::DensityAware)
    }
}

/// One measure of uncertainty per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Measure {
    /// Blended log10 U of the reading of this index.
    Reading(usize, RayAverage),
    /// One of the others.
    Baseline(Baseline),
}
