//! Other readings of the same sums: another covariance, prior, scale or pooling.
//!
//! Error bars and a calibrated interval hold for one reading only, and go. Correlations and coarser levels hold for one
//! prior and pooling, and the misfit for depths that have deviations.

use super::from_sums::deviations_from_sums;
use super::{Support, UncertaintyField};
use crate::posterior::{Covariance, DataScale, Scale};
use crate::{Error, Result};

impl UncertaintyField {
    /// The same field with another covariance computed from its sums, without error bars, which hold for one
    /// covariance only.
    ///
    /// # Errors
    /// If the sums were not kept.
    pub fn with_covariance(mut self, covariance: Covariance) -> Result<Self> {
        if covariance != self.protocol.covariance {
            let Some(sums) = &self.sums else {
                let expected = format!("a field that keeps its sums, to read `{}`", covariance.name());
                return Err(Error::setting(
                    "kept sums",
                    expected,
                    format!("one of `{}` only", self.protocol.covariance.name()),
                ));
            };
            self.protocol.covariance = covariance;
            self.deviations = deviations_from_sums(&self.protocol, &self.lattice, &self.support, &self.limits, sums);
            (self.error_bars, self.conformal) = (None, None);
            let coarser = self.coarser.into_iter().map(|field| field.with_covariance(covariance));
            self.coarser = coarser.collect::<Result<_>>()?;
        }
        Ok(self)
    }

    /// The same field with another prior precision λ, 1 / scene unit², without error bars.
    ///
    /// The scale becomes the paper's. Coarser levels go.
    ///
    /// # Errors
    /// If the sums were not kept, or λ is not a finite number above 0. On an octree λ also must not fall below
    /// its present value, because what was negligible compared with that was not kept.
    pub fn with_lambda(self, lambda: f64) -> Result<Self> {
        self.with_prior(lambda, Scale::Paper)
    }

    /// The same field in the scale of its training pixels, without error bars and coarser levels.
    ///
    /// # Errors
    /// As [`UncertaintyField::with_lambda`].
    pub fn with_data_scale(self, data: DataScale) -> Result<Self> {
        self.with_prior(data.lambda(), Scale::Data(data))
    }

    fn with_prior(mut self, lambda: f64, scale: Scale) -> Result<Self> {
        let least = if self.support == Support::Dense { f64::MIN_POSITIVE } else { self.protocol.lambda };
        let (Some(sums), true) = (&self.sums, lambda >= least && lambda.is_finite()) else {
            let expected = format!("a field with its sums, and at least {least:e}");
            return Err(Error::setting("lambda", expected, format!("{lambda:e}")));
        };
        self.protocol.lambda = lambda;
        self.protocol.scale = scale;
        (self.error_bars, self.correlations, self.conformal) = (None, None, None);
        self.coarser.clear();
        self.misfit = self.misfit.filter(|_| matches!(scale, Scale::Data(_)));
        self.deviations = deviations_from_sums(&self.protocol, &self.lattice, &self.support, &self.limits, sums);
        Ok(self)
    }

    /// The same dense field with other pooling, without error bars and coarser levels. `tolerance` determines which
    /// vertices count as moved.
    ///
    /// # Errors
    /// If the field is an octree, which holds only what its own pooling needs, or the sums were not kept.
    pub fn with_pooling(mut self, min_rays: f64, tolerance: f64) -> Result<Self> {
        match (&self.support, &self.sums) {
            (Support::Dense, Some(sums)) => {
                self.protocol.min_rays = min_rays;
                self.protocol.tolerance = tolerance;
                (self.error_bars, self.correlations, self.conformal) = (None, None, None);
                self.coarser.clear();
                self.deviations =
                    deviations_from_sums(&self.protocol, &self.lattice, &self.support, &self.limits, sums);
                Ok(self)
            }
            _ => Err(Error::setting("field to pool anew", "a dense grid with its sums", "an octree, or none")),
        }
    }
}
