//! Measures of uncertainty that are ranked against the error. Larger always means more uncertain.

use octobayes::posterior::Covariance;
use octobayes::render::RayAverage;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};

/// An uncertainty field for one covariance, with the ways to average it along a ray.
#[derive(Debug, Clone)]
pub struct Reading {
    /// Name in tables.
    pub name: String,
    /// The uncertainty field U.
    pub field: UncertaintyField,
    /// How log10 U along a ray becomes the value of its pixel; none if only the deviation of depth is wanted.
    pub averages: Vec<RayAverage>,
}

impl Reading {
    /// `field`, called `name`, read by each of these covariances, or by all that it can be read by, and averaged in
    /// each of these ways, or in the one that ranks best.
    ///
    /// # Errors
    /// As [`UncertaintyField::with_covariance`], and [`Reading::check`].
    pub fn from_field(
        name: &str,
        field: &UncertaintyField,
        covariances: Option<&[Covariance]>,
        averages: Option<&[RayAverage]>,
    ) -> Result<Vec<Self>> {
        let averages = averages.map_or_else(|| vec![Self::best_average(field)], <[_]>::to_vec);
        averages.iter().try_for_each(|&average| Self::check(field, average))?;
        let own = field.record().covariance;
        let mut wanted = covariances.map_or_else(|| vec![own], <[_]>::to_vec);
        if covariances.is_none() && field.sums().is_some() {
            wanted.extend(Covariance::ALL.into_iter().filter(|c| *c != own));
        }
        let read = |covariance: Covariance| {
            let name = format!("{name} {}", covariance.name());
            Ok(Self { name, field: field.clone().with_covariance(covariance)?, averages: averages.clone() })
        };
        wanted.into_iter().map(read).collect()
    }

    /// The average that ranks depth errors best, of those that `field` supports (`experiments/depth.md`).
    #[must_use]
    pub fn best_average(field: &UncertaintyField) -> RayAverage {
        if field.rays().is_empty() { RayAverage::USpread } else { RayAverage::USpreadPerRootRay }
    }

    /// Whether `field` can be averaged like this.
    ///
    /// # Errors
    /// If it has no ray counts, which [`RayAverage::USpreadPerRootRay`] needs.
    pub fn check(field: &UncertaintyField, average: RayAverage) -> Result<()> {
        if average == RayAverage::USpreadPerRootRay && field.rays().is_empty() {
            let expected = "`u-spread` or another that needs no ray counts, which this field does not store";
            return Err(Error::setting("ray average", expected, "`u-spread-per-root-ray`"));
        }
        Ok(())
    }
}

/// Measures without a Hessian, which an uncertainty field has to beat.
///
/// Letters: s the spread of the ray's weights, s² = their variance + δ²/12, where δ is the marching step; n number of
/// training rays of the field's vertices around the expected depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Baseline {
    /// [`octobayes::render::depth_variance`] of the ray's weights.
    RayVariance,
    /// The model's median depth itself: far surfaces are measured worse. What surveyors' rules of thumb use.
    Distance,
    /// s / √n.
    WeightsSpreadPerRootRay,
    /// s / n.
    WeightsSpreadPerRay,
    /// A random number per pixel.
    Random,
    /// [`crate::metrics::ensemble_variance`] of the median depth. Where a member shows nothing, its depth is that
    /// at which the ray leaves the box.
    EnsembleVariance,
}

impl Baseline {
    /// The name in tables and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::RayVariance => "ray-weight variance",
            Self::Distance => "distance from the camera",
            Self::WeightsSpreadPerRootRay => "weights' spread / sqrt(rays)",
            Self::WeightsSpreadPerRay => "weights' spread / rays",
            Self::Random => "random",
            Self::EnsembleVariance => "ensemble depth variance",
        }
    }
}

/// One measure of uncertainty per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Measure {
    /// Ray average of log10 U, by the index of the reading.
    Reading(usize, RayAverage),
    /// Standard deviation of depth by the field of a reading ([`DepthDeviation`]), scene units, by the index of the
    /// reading. Only of fields in the scale of their data.
    ///
    /// [`DepthDeviation`]: octobayes_depth::DepthDeviation
    DepthDeviation(usize),
    /// The same with the training images.
    DepthDeviationWithImages(usize),
    /// A measure without a Hessian.
    Baseline(Baseline),
}
