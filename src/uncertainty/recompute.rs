//! Other readings of the same sums: another covariance or prior.

use super::layers::Change;
use super::{Support, UncertaintyField};
use crate::posterior::{Covariance, Scale};
use crate::{Error, Result};

impl UncertaintyField {
    /// The same field with another covariance computed from its sums, without error bars, which hold for one
    /// covariance only.
    ///
    /// # Errors
    /// If the sums were not kept.
    pub fn with_covariance(mut self, covariance: Covariance) -> Result<Self> {
        if covariance != self.record.covariance {
            if self.sums().is_none() {
                let expected = format!("a field that keeps its sums, to read `{}`", covariance.name());
                return Err(Error::setting(
                    "kept sums",
                    expected,
                    format!("one of `{}` only", self.record.covariance.name()),
                ));
            }
            self.record.covariance = covariance;
            self.reread(Change::Covariance);
        }
        Ok(self)
    }

    /// The same field with another prior precision λ, 1 / scene unit², without error bars.
    ///
    /// The scale becomes the paper's.
    ///
    /// # Errors
    /// If the sums were not kept, or λ is not a finite number above 0. On an octree λ also must not fall below
    /// its present value, because what was negligible compared with that was not kept.
    pub fn with_lambda(mut self, lambda: f64) -> Result<Self> {
        let least = if self.support == Support::Dense { f64::MIN_POSITIVE } else { self.record.lambda };
        if self.sums().is_none() || !(lambda >= least && lambda.is_finite()) {
            let expected = format!("a field with its sums, and at least {least:e}");
            return Err(Error::setting("lambda", expected, format!("{lambda:e}")));
        }
        (self.record.lambda, self.record.scale) = (lambda, Scale::Paper);
        self.reread(Change::Prior);
        Ok(self)
    }

    /// Computes σ anew from the sums under a record that changed.
    fn reread(&mut self, change: Change) {
        self.layers.drop_dependent(change);
        if let Some(sums) = self.sums() {
            self.deviations = self.deviations_of(&self.record.reading(), sums);
        }
    }
}
