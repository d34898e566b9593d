//! The record of a run: everything that the numbers of its field depend on.

use crate::posterior::{Covariance, Criteria, Pooling, Reading, Scale};
use crate::rays::{MAX_RAYS, Pixels, RaySet, Shard};
use crate::render::GradientMethod;

/// Everything that the numbers in a field depend on. `None` where the field came from elsewhere and the value is
/// unknown.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct RunRecord {
    /// Version of this crate.
    pub version: String,
    /// Model and cameras, or the samples file.
    pub source: String,
    /// Checksum of the model's content, wherever its file lies.
    pub model_checksum: Option<u32>,
    /// Checksum of its cameras and their masks ([`crate::geometry::Camera::checksum_with`]).
    pub cameras_checksum: Option<u32>,
    /// R, the number of rays drawn, including those that hit nothing.
    pub rays: u64,
    /// Number of rays dropped because the field was not finite.
    pub dropped: u64,
    /// The method of choosing pixels.
    pub pixels: Option<Pixels>,
    /// Seed of the run's pixels and jitter; [`super::UncertaintyField::ray_sets`] has those of all its sequences.
    pub seed: Option<u64>,
    /// The part of a run that drew these rays.
    pub shard: Option<Shard>,
    /// Prior precision λ, 1 / scene unit².
    pub lambda: f64,
    /// What U is a deviation of.
    pub scale: Scale,
    /// Definition of the standard deviation.
    pub covariance: Covariance,
    /// How sums were pooled where rays are few.
    pub pooling: Pooling,
    /// Criteria for refining the octree.
    pub criteria: Criteria,
    /// Largest change of log10 U due to leaves coarser than the finest level.
    ///
    /// What [`RunRecord::cutoff`] leaves out is not included. With pooling it is 0.01 at most, whatever this is.
    pub tolerance: f64,
    /// Distance between samples along rays, scene units.
    pub march_step: Option<f64>,
    /// Source of the field's derivatives; never [`GradientMethod::Auto`].
    pub gradient: Option<GradientMethod>,
    /// Finite-difference step along x, y and z, scene units; `None` if the field's own derivatives were used.
    pub difference_step: Option<[f64; 3]>,
    /// Samples below this weight and expected sensitivity were not differentiated, and rays ended at this
    /// transmittance. It does not bound log10 U.
    pub cutoff: Option<f64>,
    /// Colour behind the scene.
    pub background: Option<[f32; 3]>,
    /// Position of rays within their pixel; ½ is the centre.
    pub pixel_offset: Option<f64>,
    /// Angle of a pixel of the cameras, radians: the median of 1 / focal length.
    pub pixel_angle: Option<f64>,
}

impl RunRecord {
    /// The draw named by the seed and shard, if both are known.
    #[must_use]
    pub fn ray_set(&self) -> Option<RaySet> {
        self.seed.zip(self.shard).map(|(seed, shard)| RaySet { seed, shard })
    }

    /// Whether the rays are those of splats: only these are not marched along, of all whose way is known.
    pub(crate) fn is_of_splats(&self) -> bool {
        self.march_step.is_none()
    }

    /// Whether these rays are only a part of a run.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.shard.is_some_and(|share| share.of > 1)
    }

    /// Whether a field with this record and these sets of rays is only a part of a run.
    pub(super) fn is_part_by(&self, ray_sets: &[RaySet]) -> bool {
        self.is_part() || ray_sets.iter().any(RaySet::is_part)
    }

    /// How the sums of these rays are read as deviations.
    #[must_use]
    #[doc(hidden)]
    pub fn reading(&self) -> Reading {
        let Self { covariance, scale, lambda, rays, pooling, tolerance, .. } = *self;
        Reading { covariance, scale, lambda, rays, pooling, tolerance }
    }

    /// The first number that no run can have, for records read from files: its name, what it can be, and what it is.
    pub(super) fn impossible(&self) -> Option<(&'static str, &'static str, String)> {
        const SHARE: &str = "a number from 0 to 1";
        const LENGTH: &str = "a length above 0 that f32 can hold";
        let is_share = |v: &f64| (0.0..=1.0).contains(v);
        let in_f32 = |v: &f64| *v > 0.0 && (*v as f32).is_normal();
        let is_of_scale = match &self.scale {
            Scale::Paper => true,
            Scale::Data(data) => data.is_possible() && data.lambda() == self.lambda,
        };
        let checks = [
            ("rays", (1..=MAX_RAYS).contains(&self.rays), "a whole number from 1 to 2^53"),
            ("dropped", self.dropped <= self.rays, "no more than all rays"),
            (
                "shard",
                self.shard.is_none_or(|shard| shard.is_valid() && shard.rays <= MAX_RAYS),
                "a part of 1 to 2^53 rays, with an index below the number of parts",
            ),
            // f32 holds the prior's deviation, which queries far from all rays return.
            (
                "lambda",
                Covariance::ALL.iter().all(|c| in_f32(&c.prior(self.lambda))),
                "a precision above 0 whose prior deviation f32 can hold",
            ),
            ("scale", is_of_scale, "pixels, noise and prior deviation of a run, which give its lambda"),
            ("tolerance", self.tolerance == 0.0 || in_f32(&self.tolerance), "0 or more, as far as f32 goes"),
            ("march_step", self.march_step.iter().all(in_f32), LENGTH),
            ("difference_step", self.difference_step.iter().flatten().all(in_f32), LENGTH),
            ("cutoff", self.cutoff.iter().all(is_share), SHARE),
            ("background", self.background.iter().flatten().all(|v| is_share(&f64::from(*v))), SHARE),
            ("pixel_offset", self.pixel_offset.iter().all(is_share), SHARE),
            ("pixel_angle", self.pixel_angle.iter().all(in_f32), "an angle above 0 that f32 can hold"),
        ];
        let (name, _, expected) = checks.into_iter().find(|(_, is_possible, _)| !is_possible)?;
        let found = serde_json::to_value(self).map(|all| all[name].to_string()).unwrap_or_default();
        Some((name, expected, found))
    }

    /// The record of a field from another program, with only these values known.
    #[must_use]
    pub fn unstated(source: String, rays: u64, lambda: f64, covariance: Covariance) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            source,
            model_checksum: None,
            cameras_checksum: None,
            rays,
            dropped: 0,
            pixels: None,
            seed: None,
            shard: None,
            lambda,
            scale: Scale::Paper,
            covariance,
            pooling: Pooling::Off,
            criteria: Criteria::default(),
            tolerance: 0.0,
            march_step: None,
            gradient: None,
            difference_step: None,
            cutoff: None,
            background: None,
            pixel_offset: None,
            pixel_angle: None,
        }
    }
}
