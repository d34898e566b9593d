//! Averages along a ray: from values at its samples to one number per pixel.

choices! {
    /// Ray average: how log10 U at the samples of a ray becomes one number per pixel.
    ///
    /// Letters: w weights of the samples, u = log10 U at the samples, t their distances, δ the distance between
    /// samples.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
    #[non_exhaustive]
    pub enum RayAverage {
        /// Σ w u / Σ w: the mean over what the ray hits.
        #[default]
        WeightedMean = "weighted-mean", "mean of log10 U over what the ray hits";
        /// log10 (U s): u at the expected depth Σ w t / Σ w + log10 s. s is the spread of the ray's weights:
        /// s² = Var t + δ²/12.
        ///
        /// The product of the uncertainty there and the spread of matter along the ray; scene units squared. It is
        /// meant for ranking pixels by their depth error.
        USpread = "u-spread",
        "log10 (U s) at the expected depth, where s is the spread of the ray's weights: s^2 is their variance + \
         delta^2/12 for the length delta of a sample";
        /// log10 (U s / √n): [`RayAverage::USpread`] − ½ log10 n, where n is the number of training rays of the
        /// vertices around the expected depth, at least ½. NaN if the number is not known.
        ///
        /// With few rays, U itself is noisy, and the factor 1/√n adds this noise. It ranks depth errors best
        /// (`experiments/depth.md`).
        USpreadPerRootRay = "u-spread-per-root-ray",
        "log10 (U s / sqrt(n)), where n is the number of training rays around the expected depth: for ranking \
         pixels";
    }
}

/// The points at which a ray average needs the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Asked {
    /// Every sample that counts.
    Samples,
    /// The expected depth.
    Expected,
}

impl RayAverage {
    /// The points at which it needs the field.
    pub(super) fn asks(self) -> Asked {
        match self {
            Self::WeightedMean => Asked::Samples,
            Self::USpread | Self::USpreadPerRootRay => Asked::Expected,
        }
    }
}
