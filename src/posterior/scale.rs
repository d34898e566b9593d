//! What the numbers are a deviation of: the paper's loss, or the posterior of all training pixels.

use std::ops::RangeInclusive;

use glam::DVec3;

use super::{Covariance, Information};
use crate::geometry::{Camera, Domain};
use crate::{Error, Result};

/// The scale of U.
///
/// The paper's H is the expectation over *one* ray of a pixel with noise ½. It ranks, and compares with the official
/// code, but its numbers are no lengths to rely on: the prior alone is 10⁴·⁴ in a box of edge 2 at level 8.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// The paper's.
    #[default]
    Paper,
    /// A standard deviation in scene units.
    Data(DataScale),
}

/// The posterior of all training pixels: C = (k S + I / τ²)⁻¹ with k = N / (R s²).
///
/// Letters: `N` = number of training pixels, `s` = root mean square error of their colours that training left, `τ` =
/// prior deviation along each axis.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct DataScale {
    /// N.
    pub pixels: u64,
    /// s, colours in 0..1.
    pub noise: f64,
    /// τ, scene units.
    pub prior_deviation: f64,
}

impl DataScale {
    /// Noise that training may leave. A plain grey picture is off by at most ½, and colours of 8 bits are rounded by
    /// 10⁻³.
    pub const NOISE: RangeInclusive<f64> = 1e-6..=0.5;

    /// Default of τ, as a fraction of the longest edge of the part of space that is not contracted.
    pub const PRIOR_SHARE: f64 = 0.02;

    /// The scale of `pixels` training pixels with this noise and prior deviation.
    ///
    /// # Errors
    /// If one of them is not above 0, if the noise is not in [`DataScale::NOISE`], or if the prior precision is not a
    /// normal number.
    pub fn new(pixels: u64, noise: f64, prior_deviation: f64) -> Result<Self> {
        let scale = Self { pixels, noise, prior_deviation };
        if scale.is_possible() {
            return Ok(scale);
        }
        let found = format!("{pixels} pixels, noise {noise:e}, prior deviation {prior_deviation:e}");
        let expected = "pixels and prior deviation above 0, and noise of colours in 0..1 of at most 0.5, which a plain \
                        grey picture keeps";
        Err(Error::setting("scale", expected, found))
    }

    /// The scale of all pixels of `cameras`, with the default prior deviation over `domain`.
    ///
    /// # Errors
    /// As [`DataScale::new`].
    pub fn from_cameras(cameras: &[Camera], noise: f64, domain: &Domain) -> Result<Self> {
        Self::new(cameras.iter().map(Camera::pixels).sum(), noise, Self::default_prior_deviation(domain))
    }

    /// The default of τ over `domain`, scene units.
    #[must_use]
    pub fn default_prior_deviation(domain: &Domain) -> f64 {
        Self::PRIOR_SHARE * Self::longest_edge(domain)
    }

    /// Longest edge of the part of space that is not contracted, scene units.
    #[must_use]
    pub fn longest_edge(domain: &Domain) -> f64 {
        let size = match domain {
            Domain::Box(bounds) => bounds.size(),
            Domain::Contracted { radius, .. } => DVec3::splat(2.0 * radius),
        };
        size.max_element()
    }

    /// The noise that belongs to a PSNR in dB.
    #[must_use]
    pub fn noise_of(psnr: f64) -> f64 {
        10_f64.powf(-psnr / 20.0)
    }

    /// The prior precision λ that C has in the paper's H, 1 / scene unit²: C = (2 s² / N) ((2/R) S + 2 λ I)⁻¹ with
    /// λ = s² / (N τ²).
    #[must_use]
    pub fn lambda(&self) -> f64 {
        (self.noise / self.prior_deviation).powi(2) / self.pixels as f64
    }

    /// k = N / (R s²): what S of `rays` rays is multiplied by, 1 / squared colour.
    #[must_use]
    pub fn weight(&self, rays: u64) -> f64 {
        self.pixels as f64 / (rays.max(1) as f64 * self.noise * self.noise)
    }

    /// P = k S + I / τ², the precision of a vertex's displacement after `rays` rays, 1 / scene unit²: xx, xy, xz, yy,
    /// yz, zz.
    #[must_use]
    pub fn precision(&self, s: &Information, rays: u64) -> Information {
        let (k, prior) = (self.weight(rays), self.prior_deviation.powi(-2));
        let [xx, xy, xz, yy, yz, zz] = s.map(|s| k * s);
        [xx + prior, xy, xz, yy + prior, yz, zz + prior]
    }

    /// Whether these are numbers that a run can have, for scales read from files.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        let lambda = self.lambda();
        self.pixels > 0 && Self::NOISE.contains(&self.noise) && self.prior_deviation > 0.0 && lambda.is_normal()
    }
}

impl Scale {
    /// What pictures and tables call the numbers.
    #[must_use]
    pub fn quantity(&self) -> &'static str {
        match self {
            Self::Paper => "log10 U",
            Self::Data(_) => "log10 U in scene units",
        }
    }

    /// The factor from [`Covariance::deviation`] to this scale.
    #[must_use]
    pub fn factor(&self, covariance: Covariance) -> f64 {
        let Self::Data(DataScale { pixels, noise, .. }) = self else { return 1.0 };
        let share = noise / (*pixels as f64).sqrt();
        match covariance {
            Covariance::Diagonal | Covariance::Block => std::f64::consts::SQRT_2 * share,
            // Without the factor 2 of H.
            Covariance::Trace => share,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::posterior::VertexSums;
    use approx::assert_relative_eq;

    /// C from its definition, by an inverse of its own, against the paper's σ of λ, scaled.
    #[test]
    fn the_scale_is_the_posterior_of_all_pixels() {
        let data = DataScale::new(1_000_000, 0.03, 0.05).unwrap();
        let (rays, information) = (2_000_u64, [7.0, 1.0, -2.0, 5.0, 0.5, 9.0]);
        let k = data.pixels as f64 / (rays as f64 * data.noise * data.noise);
        assert_relative_eq!(data.weight(rays), k, max_relative = 1e-15);
        let [xx, xy, xz, yy, yz, zz] = information.map(|s| k * s);
        let prior = data.prior_deviation.powi(-2);
        let precision = glam::DMat3::from_cols_array(&[xx + prior, xy, xz, xy, yy + prior, yz, xz, yz, zz + prior]);
        let stated = data.precision(&information, rays);
        let columns = precision.to_cols_array();
        let defined = [0, 1, 2, 4, 5, 8].map(|k| columns[k]);
        stated.iter().zip(defined).for_each(|(a, b)| assert_relative_eq!(*a, b, max_relative = 1e-14));
        let covariance = precision.inverse();
        let trace = (0..3).map(|i| covariance.col(i)[i]).sum::<f64>();
        let diagonal = (0..3).map(|i| 1.0 / precision.col(i)[i]).sum::<f64>();
        let of = |covariance: Covariance| {
            let sums = VertexSums::new(information, 7);
            Scale::Data(data).factor(covariance) * covariance.deviation(&sums, rays, data.lambda())
        };
        assert_relative_eq!(of(Covariance::Block), trace.sqrt(), max_relative = 1e-12);
        assert_relative_eq!(of(Covariance::Diagonal), diagonal.sqrt(), max_relative = 1e-12);
        assert_relative_eq!(of(Covariance::Trace), (xx + yy + zz + prior).powf(-0.5), max_relative = 1e-12);
        // Where nothing was seen: τ along each of three axes.
        let prior = |covariance: Covariance| Scale::Data(data).factor(covariance) * covariance.prior(data.lambda());
        assert_relative_eq!(prior(Covariance::Block), 3_f64.sqrt() * 0.05, max_relative = 1e-12);
        assert_relative_eq!(prior(Covariance::Trace), 0.05, max_relative = 1e-12);
        assert_eq!(Scale::Paper.factor(Covariance::Block), 1.0);
    }

    #[test]
    fn impossible_scales_are_refused() {
        assert!(
            [(0, 0.1, 0.1), (1, 0.0, 0.1), (1, 0.7, 0.1), (1, 1e-9, 0.1), (1, 0.1, f64::NAN), (1, 1e-200, 1e200)]
                .iter()
                .all(|&(n, s, t)| DataScale::new(n, s, t).is_err())
        );
        assert_relative_eq!(DataScale::noise_of(30.0).powi(2), 1e-3, max_relative = 1e-12);
    }
}
