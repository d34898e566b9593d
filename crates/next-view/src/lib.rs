//! Which photograph should be taken next? Ranks cameras by the information that their images, not yet taken, would add.
//!
//! Letters: `P_v` = k S_v + I / τ², the precision of the displacement of vertex v given the training pixels, in the
//! scale of the data ([`DataScale`](octobayes::posterior::DataScale)); `ΔP_v` = (1/s²) Σ JᵀJ over a candidate's pixels,
//! where s is the noise of a pixel. A Gauss-Newton Hessian needs Jacobians of the model and no image. The gain of a
//! candidate is Σ_v ½ log det(I + P_v⁻¹ ΔP_v), in nats: the information that its image would add about the
//! displacements (Lindley 1956; of blocks of a Hessian: POp-GS, CVPR 2025). FisherRF (ECCV 2024) takes the first-order
//! term ½ tr(P_v⁻¹ ΔP_v), on the diagonal of a model's own parameters.
//!
//! ΔP comes from some of the candidate's pixels, in a low-discrepancy sequence, scaled to all of them. Candidates are
//! taken greedily, each with those before it added to P.
//!
//! Matter alone is displaced. Space behind opaque matter, which no training ray reached and where the model has nothing
//! to see, attracts no view; a surface that the model made up there does.
//!
//! ```
//! use octobayes::estimate::{Estimation, GridSettings, RaySettings};
//! use octobayes::field::ClosedForm;
//! use octobayes_next_view::{NextView, Settings};
//! use octobayes::posterior::{DataScale, Scale};
//! # use octobayes::geometry::Domain;
//! # use octobayes::field::RadianceField;
//!
//! // Cameras around half of a courtyard; those on one side are the training cameras.
//! let scene = ClosedForm::courtyard();
//! let cameras = ClosedForm::half_circle(6, [48, 48]);
//! let (training, candidates) = cameras.split_at(2);
//! let scale = DataScale::from_cameras(training, 0.03, &Domain::Box(scene.bounds()))?;
//! let grid = GridSettings::default().level(5).keep_sums(true).scale(Scale::Data(scale));
//! let rays = RaySettings::default().rays(4_000).occupancy(32);
//! let field = Estimation::new(&scene, training).rays(rays).grid(grid).run()?.field;
//!
//! let settings = Settings::default().take(2).pixels(512);
//! let ranking = NextView::new(&scene, &field, candidates).settings(settings).run()?;
//! // One of the two far from the training cameras: the near ones see what these have seen.
//! assert!(ranking.steps[0].index >= 2);
//! # Ok::<(), octobayes::Error>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod coverage;
mod evidence;
mod gain;
mod greedy;
mod made;
mod map;
mod object;
mod objective;
mod ranking;
mod report;
mod way;

pub use evidence::Blank;
pub use ranking::{NextView, Ranking, Step};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{
    gain::{first_order, log_det},
    made::{Around, Made},
    map::GainMap,
    object::NearMesh,
    report::{NamedCandidate, NamedStep, Report},
    way::Way,
};

use glam::DVec3;
use octobayes::posterior::Information;

/// What more precision at one vertex is worth, given P and ΔP, both symmetric 3×3: xx, xy, xz, yy, yz, zz, in
/// 1 / scene unit². As [`log_det`] and [`first_order`].
#[doc(hidden)]
pub type VertexGain<'a> = &'a (dyn Fn(&Information, &Information) -> f64 + Sync);

/// The places that count: whether a point, scene units, is one of them.
pub type Region<'a> = &'a (dyn Fn(DVec3) -> bool + Sync);

octobayes::choices! {
    /// What a view is worth.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    #[non_exhaustive]
    pub enum Gain {
        #[default]
        Logdet = "logdet", "Information about displacements, sum of 1/2 log det(I + P^-1 dP), nats";
        Trace = "trace",
        "Its first-order term, sum of 1/2 tr(P^-1 dP): what was seen well counts as much as what was not";
        Coverage = "coverage",
        "Directional coverage of visible surface, whatever the model is sensitive to; needs the training cameras";
    }
}

impl Gain {
    /// Refuses a gain that is no sum over pixels.
    ///
    /// # Errors
    /// For [`Gain::Coverage`].
    pub fn check_map(self) -> octobayes::Result<()> {
        if self == Self::Coverage {
            let expected = "a gain of `logdet` or `trace`, which pixels have";
            return Err(octobayes::Error::setting("map", expected, "`coverage`"));
        }
        Ok(())
    }
}

/// Which gains are found anew after a view was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Rescoring {
    /// Those that may be the largest; the choice is the same.
    #[default]
    Lazy,
    /// All of them, for comparisons.
    All,
}

octobayes::setters! {
    /// Settings of a ranking.
    #[derive(Debug, Clone, Copy, PartialEq)]
    #[non_exhaustive]
    pub struct Settings {
        /// Number of views to take.
        pub take: usize,
        /// What a view is worth.
        pub gain: Gain,
        /// Number of pixels of a candidate whose rays are traced; all of a smaller image.
        ///
        /// The gain's noise falls with it, and its bias: a vertex that no ray of the sample meets gains nothing, one
        /// that a ray meets gains as if a whole neighbourhood of pixels met it.
        pub pixels: u64,
        /// Seed of pixels and jitter, the same for all candidates.
        pub seed: u64,
        /// Which gains are found anew after a view was taken.
        pub rescoring: Rescoring,
        /// Cells per axis of the occupancy grid that lets rays of a volume skip empty space.
        pub occupancy: usize,
        /// Bytes for what candidates add, kept from step to step; of others the rays are traced again.
        pub memory: usize,
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            take: 1,
            gain: Gain::default(),
            pixels: 4096,
            seed: 0,
            rescoring: Rescoring::default(),
            occupancy: octobayes::render::Occupancy::DEFAULT_RESOLUTION,
            memory: 1 << 30,
        }
    }
}

#[cfg(test)]
mod tests;
