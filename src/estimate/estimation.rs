//! The settings of a run.

use std::path::PathBuf;

use super::{Checkpoint, Feature, GridSettings, Model, RaySettings, require};
use crate::geometry::{Camera, Domain, Lattice, Mask};
use crate::monitor::{Monitor, Silent};
use crate::posterior::Pooling;
use crate::posterior::overflow::MOST_RUNS;
use crate::rays::{Pixels, RayStream, Shard};
use crate::render::RaySamples;
use crate::{Error, Result};

/// The rays that a run draws, and when it ends.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Goal {
    /// A part of the rays; the whole run is part 0 of 1.
    Shard {
        /// Number of the part, from 0.
        index: u64,
        /// Number of parts.
        of: u64,
    },
    /// All rays, in this many independent groups; their disagreement gives error bars.
    Groups(u16),
    /// Rays until the mean error of log10 U is within this, decades.
    MeanError(f64),
}

impl Default for Goal {
    fn default() -> Self {
        Self::Shard { index: 0, of: 1 }
    }
}

impl Goal {
    /// The goal of a mean error in decades, a part as index and number of parts, or a number of groups; the
    /// first that is given.
    #[must_use]
    pub fn of(mean_error: Option<f64>, part: Option<[u64; 2]>, groups: Option<u16>) -> Self {
        match (mean_error, part, groups) {
            (Some(decades), ..) => Self::MeanError(decades),
            (_, Some([index, of]), _) => Self::Shard { index, of },
            (.., Some(groups)) => Self::Groups(groups),
            _ => Self::default(),
        }
    }

    /// Number of groups, if there are any.
    #[must_use]
    pub fn groups(&self) -> Option<u16> {
        match self {
            Self::Groups(groups) => Some(*groups),
            _ => None,
        }
    }

    /// Number of sets of rays that have sums of their own.
    pub(super) fn sets_of_rays(self) -> u16 {
        match self {
            Self::Shard { .. } => 1,
            Self::Groups(groups) => groups,
            Self::MeanError(_) => 2,
        }
    }

    /// Number of sets of sums that are in memory at once, if none leaves it.
    pub(super) fn sets_of_sums(self, pooling: Pooling) -> u16 {
        match self {
            Self::Groups(groups) => groups.saturating_add(1),
            // Error bars of pooled halves are made of a copy of both, and of their sum.
            Self::MeanError(_) if pooling.is_on() => 5,
            _ => self.sets_of_rays(),
        }
    }
}

/// Receives a run's samples as they are drawn.
pub(super) type Tap<'a> = Box<dyn FnMut(&[RaySamples]) -> Result<()> + 'a>;

/// A run from a trained field and its training cameras to an uncertainty field.
///
/// Only field and cameras are required; everything else has the command line's defaults. The result does
/// not depend on the number of threads.
///
/// ```
/// use octobayes::estimate::{Checkpoint, Estimation, GridSettings, RaySettings};
/// use octobayes::field::ClosedForm;
/// use octobayes::geometry::{Domain, Norm};
///
/// # let folder = tempfile::tempdir()?;
/// let scene = ClosedForm::courtyard();
/// let cameras = ClosedForm::half_circle(4, [48, 48]);
/// // All of space, contracted outside a ball; the first of two shards; resumable.
/// let outcome = Estimation::new(&scene, &cameras)
///     .domain(Domain::contracted([0.0, 0.0, 0.0].into(), 1.0, Norm::L2)?)
///     .rays(RaySettings::default().rays(20_000).occupancy(48))
///     .grid(GridSettings::default().level(6))
///     .shard(0, 2)
///     .checkpoint(Checkpoint::new(folder.path().join("run.chk")))
///     .run()?;
/// outcome.field.write(&folder.path().join("part-0.oct"))?;
/// # assert_eq!(outcome.progress.rays, 9_760);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub struct Estimation<'a> {
    pub(super) model: &'a dyn Model,
    pub(super) cameras: &'a [Camera],
    pub(super) masks: &'a [Option<Mask>],
    pub(super) domain: Domain,
    pub(super) rays: RaySettings,
    pub(super) grid: GridSettings,
    pub(super) goal: Goal,
    pub(super) checkpoint: Option<Checkpoint>,
    pub(super) source: String,
    /// Checksum of the model's content, if known.
    pub(super) checksum: Option<u32>,
    /// Bytes that decoding the largest picture takes.
    pub(super) picture: u64,
    pub(super) monitor: &'a dyn Monitor,
    pub(super) tap: Option<Tap<'a>>,
    /// The folder of sums that a budget of memory has no room for.
    pub(super) scratch: PathBuf,
}

impl<'a> Estimation<'a> {
    /// Creates a run for the uncertainty of `model` given its training `cameras`, over the model's own box.
    ///
    /// Use [`Model::covered`] where single parts lie far away. What a model
    /// [lacks](Model::lacks) is refused.
    pub fn new(model: &'a dyn Model, cameras: &'a [Camera]) -> Self {
        Self {
            model,
            cameras,
            masks: &[],
            domain: Domain::Box(model.whole_box()),
            rays: RaySettings::default(),
            grid: GridSettings::default(),
            goal: Goal::default(),
            checkpoint: None,
            source: model.describe(),
            checksum: None,
            picture: 0,
            monitor: &Silent,
            tap: None,
            scratch: std::env::temp_dir(),
        }
    }

    /// Sets which pixels the model was trained on, by a mask or none for each camera. Rays pass only through these.
    pub fn masks(self, masks: &'a [Option<Mask>]) -> Self {
        Self { masks, ..self }
    }

    /// Sets the region that the field covers: another box, or all of space, contracted.
    pub fn domain(self, domain: Domain) -> Self {
        Self { domain, ..self }
    }

    /// Sets which rays are drawn and how they are differentiated.
    pub fn rays(self, rays: RaySettings) -> Self {
        Self { rays, ..self }
    }

    /// Sets the grid on which information is summed. Its memory budget, if any, applies to the run.
    pub fn grid(self, grid: GridSettings) -> Self {
        Self { grid, ..self }
    }

    /// Sets which rays are drawn, and when the run ends.
    pub fn goal(self, goal: Goal) -> Self {
        Self { goal, ..self }
    }

    /// Draws only part `index` of `of` of the rays; [`merge`](crate::uncertainty::merge) joins the parts.
    pub fn shard(self, index: u64, of: u64) -> Self {
        Self { goal: Goal::Shard { index, of }, ..self }
    }

    /// Draws the rays in `groups` independent groups, and stores with every log10 U its error relative to the
    /// limit of infinitely many rays.
    ///
    /// Summing takes `groups` + 1 times the memory. Under a [budget](GridSettings::memory), the sums of each group
    /// leave memory before the next is drawn.
    pub fn error_bars(self, groups: u16) -> Self {
        Self { goal: Goal::Groups(groups), ..self }
    }

    /// Draws rays until the estimated mean error of log10 U is at most `decades`, or the settings' number of rays
    /// is reached.
    pub fn until_mean_error(self, decades: f64) -> Self {
        Self { goal: Goal::MeanError(decades), ..self }
    }

    /// Saves the run's state in a file, and goes on from there if the file is that of an interrupted run.
    pub fn checkpoint(self, checkpoint: Checkpoint) -> Self {
        Self { checkpoint: Some(checkpoint), ..self }
    }

    /// Sets the folder of temporary files for sums that a [budget](GridSettings::memory) has no room for. The default
    /// is the system's folder of such files, which may be memory itself. With a checkpoint, they lie beside that.
    pub fn scratch(self, folder: impl Into<PathBuf>) -> Self {
        Self { scratch: folder.into(), ..self }
    }

    /// Sets a human-readable name of model and cameras for the result. The default is the field's description.
    pub fn source(self, source: impl Into<String>) -> Self {
        Self { source: source.into(), ..self }
    }

    /// Sets a checksum of the model's content. Results are matched by this checksum instead of a name.
    pub fn checksum(self, checksum: u32) -> Self {
        Self { checksum: Some(checksum), ..self }
    }

    /// Sets the bytes that decoding a picture takes before the first ray, one picture at a time. A plan foresees
    /// them.
    pub fn picture(self, bytes: u64) -> Self {
        Self { picture: bytes, ..self }
    }

    /// Sets the monitor, which receives progress and can stop the run.
    pub fn monitor(self, monitor: &'a dyn Monitor) -> Self {
        Self { monitor, ..self }
    }

    /// Passes every group of samples to `tap` after it was summed, in ray order.
    pub fn tap(self, tap: impl FnMut(&[RaySamples]) -> Result<()> + 'a) -> Self {
        Self { tap: Some(Box::new(tap)), ..self }
    }

    /// The stream of training rays by these settings, differentiated for `lattice`.
    pub(super) fn stream(&self, rays: &RaySettings, lattice: &Lattice) -> Result<RayStream<'a>> {
        rays.stream(self.model, self.cameras, lattice, self.monitor)?.with_masks(self.masks)
    }

    /// The rays of the goal, if it draws one fixed set of them.
    pub(super) fn own_shard(&self) -> Shard {
        match self.goal {
            Goal::Shard { index, of } => Shard::new(self.rays.rays, index, of),
            _ => Shard::whole(self.rays.rays),
        }
    }

    /// Identifies the model in a checkpoint: by its content if that is known, not by its path.
    pub(super) fn key_source(&self) -> String {
        self.checksum.map_or_else(|| self.source.clone(), |checksum| format!("model {checksum:08x}"))
    }

    /// Rejects incompatible settings before any work is done.
    pub(super) fn check(&self) -> Result<()> {
        if self.cameras.is_empty() {
            return Err(Error::setting("cameras", "at least one", "none"));
        }
        for (is_set, feature, what) in [
            (matches!(self.goal, Goal::MeanError(_)), Feature::AnyOrder, "run to a mean error"),
            (self.grid.criteria.density, Feature::Density, "criterion `density`"),
            (self.grid.pooling.is_on(), Feature::Pooling, "pooling"),
        ] {
            if is_set {
                require(self.model, feature, what)?;
            }
        }
        if self.grid.pooling.is_on() && self.rays.pixels == Pixels::Every {
            let expected = "some of the pixels: where all are drawn, nothing is left to chance";
            return Err(Error::setting("pooling", expected, "every pixel"));
        }
        let shard = self.own_shard();
        if !shard.is_valid() || shard.own_rays() == 0 {
            let found = format!("part {} of {} of {} rays, which is empty", shard.index, shard.of, shard.rays);
            return Err(Error::setting("shard", "fewer parts than batches of 512 rays", found));
        }
        if self.goal != Goal::default() && self.tap.is_some() {
            return Err(Error::setting("samples as they are drawn", "a run of all rays in one group", "another"));
        }
        if self.tap.is_some() && self.checkpoint.is_some() {
            // A run that resumes would pass on rays twice or not at all.
            return Err(Error::setting("samples as they are drawn", "no checkpoint", "one"));
        }
        match self.goal {
            Goal::Groups(_) | Goal::MeanError(_) if self.rays.pixels == Pixels::Every => {
                let expected = "chosen ones, beside error bars or a mean error: every pixel leaves no such error";
                Err(Error::setting("pixels", expected, "every pixel"))
            }
            Goal::Groups(groups) if self.grid.memory.is_some() && usize::from(groups) > MOST_RUNS => {
                let expected = format!("at most {MOST_RUNS} groups under a memory budget, a file of each");
                Err(Error::setting("error bars", expected, groups.to_string()))
            }
            Goal::MeanError(_) if self.grid.is_limited() => {
                let expected = "a grid without limits to its refinement";
                Err(Error::setting("run to a mean error", expected, "criterion `ray-count`"))
            }
            Goal::MeanError(_) if self.checkpoint.is_some() => {
                Err(Error::setting("run to a mean error", "a run by itself, to its end", "a checkpoint"))
            }
            _ => Ok(()),
        }?;
        self.checkpoint.as_ref().map_or(Ok(()), |checkpoint| checkpoint.check(self.goal.groups()))
    }
}
