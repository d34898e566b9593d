//! What the numbers in a field depend on.

use crate::posterior::{Covariance, Criteria, Pooling, Prior, negligible_information};
use crate::rays::{Draw, Pixels, Shard};
use crate::render::GradientMethod;

/// The share of the tolerance that is for samples whose Jacobian is negligible; the others are for refinement.
pub const SAMPLES_SHARE: f64 = 0.1;

/// Checksums of what a field was computed from, `None` where not known: contents, not paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct Origin {
    /// Of the model ([`crate::open::checksum`]).
    pub model: Option<u32>,
    /// Of its cameras ([`crate::geometry::Camera::checksum`]).
    pub cameras: Option<u32>,
}

/// Everything that the numbers in a field depend on. `None` where the field came from elsewhere and does not say.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Protocol {
    /// Version of this crate.
    pub version: String,
    /// Model and cameras, or samples file.
    pub source: String,
    /// Which model and cameras these are.
    #[serde(default)]
    pub origin: Origin,
    /// R: rays drawn, those that hit nothing included.
    pub rays: u64,
    /// Rays dropped because the field was not finite.
    pub dropped: u64,
    /// How pixels were chosen.
    pub pixels: Option<Pixels>,
    /// Seed of the run's pixels and jitter; [`super::UncertaintyField::draws`] has those of all its sequences.
    pub seed: Option<u64>,
    /// Which part of a run these rays are.
    pub shard: Option<Shard>,
    /// λ, 1 / scene unit².
    pub lambda: f64,
    /// Scalar read off H.
    pub covariance: Covariance,
    /// How λ depends on the size of cells.
    pub prior: Prior,
    /// Pooling by evidence; 0 is none.
    pub min_rays: f64,
    /// Where the octree is refined.
    pub criteria: Criteria,
    /// Largest change of log10 U by leaves that are coarser than the finest level and, for [`SAMPLES_SHARE`] of it, by samples that are left out
    /// as negligible; what [`Protocol::cutoff`] leaves out is not part of it. On a dense grid it only says which vertices count for pooling.
    pub tolerance: f64,
    /// Distance between samples along rays, scene units.
    pub march_step: Option<f64>,
    /// Where the field's derivatives came from; never [`GradientMethod::Auto`].
    pub gradient: Option<GradientMethod>,
    /// Finite-difference step along x, y and z, scene units; `None` with derivatives of the field's own.
    pub difference_step: Option<[f64; 3]>,
    /// Samples below this weight and expected sensitivity were not differentiated, and rays ended at this transmittance. It is not a bound on log10 U.
    pub cutoff: Option<f64>,
    /// Colour behind the scene.
    pub background: Option<[f32; 3]>,
    /// Where in a pixel rays went through; ½ is the centre.
    pub pixel_offset: Option<f64>,
}

impl Protocol {
    /// The one draw that its seed and share name, if they do.
    #[must_use]
    pub fn draw(&self) -> Option<Draw> {
        self.seed.zip(self.shard).map(|(seed, shard)| Draw { seed, shard })
    }

    /// Whether these rays are but a part of a run.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.shard.is_some_and(|share| share.of > 1)
    }

    /// How evidence is pooled.
    #[must_use]
    pub fn pooling(&self) -> Pooling {
        Pooling { min_rays: self.min_rays, floor: self.floor(self.rays) }
    }

    /// Information (tr S) that is negligible beside the prior, if it is that of `rays` rays.
    pub(super) fn floor(&self, rays: u64) -> f64 {
        negligible_information((1.0 - SAMPLES_SHARE) * self.tolerance, rays, self.lambda)
    }

    /// Whether a run can have had this protocol: for protocols read from files.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        let counts = self.rays > 0 && self.dropped <= self.rays && self.shard.is_none_or(|s| s.is_valid());
        // λ is accepted if f32 holds the prior's deviation, which queries far from all rays return.
        let lambda = self.lambda > 0.0
            && self.lambda.is_finite()
            && Covariance::ALL.iter().all(|c| (c.prior(self.lambda) as f32).is_normal());
        let limits = [self.tolerance, self.min_rays].iter().all(|v| *v >= 0.0 && v.is_finite());
        let lengths = self.march_step.iter().chain(self.difference_step.iter().flatten());
        let others = self.cutoff.iter().chain(&self.pixel_offset);
        counts
            && lambda
            && limits
            && lengths.into_iter().all(|v| *v > 0.0 && v.is_finite())
            && others.into_iter().all(|v| *v >= 0.0 && v.is_finite())
            && self.background.iter().flatten().all(|v| (0.0..=1.0).contains(v))
    }

    /// The protocol of a field from elsewhere, of which no more is known than this.
    #[must_use]
    pub fn unstated(source: String, rays: u64, lambda: f64, covariance: Covariance) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            source,
            origin: Origin::default(),
            rays,
            dropped: 0,
            pixels: None,
            seed: None,
            shard: None,
            lambda,
            covariance,
            prior: Prior::Uniform,
            min_rays: 0.0,
            criteria: Criteria::default(),
            tolerance: 0.0,
            march_step: None,
            gradient: None,
            difference_step: None,
            cutoff: None,
            background: None,
            pixel_offset: None,
        }
    }
}
