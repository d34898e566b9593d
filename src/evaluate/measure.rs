//! Measures of uncertainty that are ranked against the error. Larger always means more uncertain.

use crate::Result;
use crate::posterior::Covariance;
use crate::render::RayAverage;
use crate::uncertainty::UncertaintyField;

/// An uncertainty field for one covariance, with the ways to average it along a ray.
#[derive(Debug, Clone)]
pub struct Reading {
    /// Name in tables.
    pub name: String,
    /// The uncertainty field U.
    pub field: UncertaintyField,
    /// How log10 U along a ray becomes the value of its pixel; at least one.
    pub averages: Vec<RayAverage>,
}

impl Reading {
    /// `field`, called `name`, read by each of these covariances, or by all that it can be read by.
    ///
    /// # Errors
    /// As [`UncertaintyField::with_covariance`].
    pub fn from_field(
        name: &str,
        field: &UncertaintyField,
        covariances: Option<&[Covariance]>,
        averages: &[RayAverage],
    ) -> Result<Vec<Self>> {
        let own = field.protocol().covariance;
        let mut wanted = covariances.map_or_else(|| vec![own], <[_]>::to_vec);
        if covariances.is_none() && field.sums().is_some() {
            wanted.extend(Covariance::ALL.into_iter().filter(|c| *c != own));
        }
        let read = |covariance: Covariance| {
            let name = format!("{name} {}", covariance.name());
            Ok(Self { name, field: field.clone().with_covariance(covariance)?, averages: averages.to_vec() })
        };
        wanted.into_iter().map(read).collect()
    }
}

/// Measures without a Hessian, which an uncertainty field has to beat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Baseline {
    /// [`crate::render::depth_variance`] of the ray's weights.
    RayVariance,
    /// [`crate::render::termination_entropy`] of the ray's weights.
    RayEntropy,
    /// 1 − opacity.
    Transparency,
    /// Minus the number of training rays that support what the pixel shows: the rays of the field's vertices,
    /// averaged along the ray like [`RayAverage::WeightedMean`].
    RayCount,
    /// A random number per pixel.
    Random,
    /// [`crate::metrics::ensemble_variance`] of the median depth. Where a member shows nothing, its depth is that
    /// at which the ray leaves the box.
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

    /// Returns true if it needs nothing but one model and its rays.
    #[must_use]
    pub fn is_single_model(self) -> bool {
        !matches!(self, Self::EnsembleVariance | Self::DensityAware)
    }
}

/// One measure of uncertainty per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Measure {
    /// Ray average of log10 U, by the index of the reading.
    Reading(usize, RayAverage),
    /// Standard deviation of depth under the posterior of a reading ([`RenderedView::depth_deviation`]), scene units,
    /// by the index of the reading. Only of fields in the scale of their data.
    ///
    /// [`RenderedView::depth_deviation`]: crate::render::RenderedView::depth_deviation
    DepthDeviation(usize),
    /// A measure without a Hessian.
    Baseline(Baseline),
}
