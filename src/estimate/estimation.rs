//! The settings of one run.

use super::run::Run;
use super::{Checkpoint, GridSettings, Outcome, RaySettings};
use crate::field::RadianceField;
use crate::geometry::{Camera, Domain, Lattice, Mask};
use crate::monitor::{Monitor, Silent};
use crate::rays::{RayStream, Shard};
use crate::render::RaySamples;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The rays that a run draws, and when it ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Goal {
    /// Part `index` of `of` of the rays; the whole run is part 0 of 1.
    Shard { index: u64, of: u64 },
    /// All rays, in this many independent groups; their disagreement gives error bars.
    Groups(u16),
    /// Rays until the mean error of log10 U is within this, decades.
    MeanError(f64),
}

/// Receives a run's samples as they are drawn.
pub(super) type Tap<'a> = Box<dyn FnMut(&[RaySamples]) -> Result<()> + 'a>;

/// A run from a trained field and its training cameras to an uncertainty field.
///
/// Only field and cameras are required; everything else has the command line's defaults. The result does
/// not depend on the number of threads, unless a budget of memory does.
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
///     .checkpoint(Checkpoint::new(folder.path().join("run.chk")).resume(true))
///     .run()?;
/// outcome.field.write(&folder.path().join("part-0.oct"))?;
/// # assert_eq!(outcome.progress.rays, 9_760);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub struct Estimation<'a> {
    pub(super) field: &'a dyn RadianceField,
    pub(super) cameras: &'a [Camera],
    pub(super) masks: &'a [Option<Mask>],
    pub(super) domain: Domain,
    pub(super) rays: RaySettings,
    pub(super) grid: GridSettings,
    pub(super) goal: Goal,
    pub(super) checkpoint: Option<Checkpoint>,
    /// Levels below the grid's own that are summed from the same rays.
    pub(super) coarser_levels: u8,
    pub(super) source: String,
    /// Checksum of the model's content, if known.
    pub(super) model: Option<u32>,
    pub(super) monitor: &'a dyn Monitor,
    pub(super) tap: Option<Tap<'a>>,
}

impl<'a> Estimation<'a> {
    /// Creates a run for the uncertainty of `field` given its training `cameras`, over the field's own box.
    pub fn new(field: &'a dyn RadianceField, cameras: &'a [Camera]) -> Self {
        Self {
            field,
            cameras,
            masks: &[],
            domain: Domain::Box(field.bounds()),
            rays: RaySettings::default(),
            grid: GridSettings::default(),
            goal: Goal::Shard { index: 0, of: 1 },
            checkpoint: None,
            coarser_levels: 0,
            source: field.describe(),
            model: None,
            monitor: &Silent,
            tap: None,
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

    /// Draws only part `index` of `of` of the rays; [`merge`](crate::uncertainty::merge) joins the parts.
    pub fn shard(self, index: u64, of: u64) -> Self {
        Self { goal: Goal::Shard { index, of }, ..self }
    }

    /// Draws the rays in `groups` independent groups, and stores with every log10 U its error relative to the
    /// limit of infinitely many rays.
    ///
    /// Summing takes `groups` + 1 times the memory.
    pub fn error_bars(self, groups: u16) -> Self {
        Self { goal: Goal::Groups(groups), ..self }
    }

    /// Draws rays until the estimated mean error of log10 U is at most `decades`, or the settings' number of rays
    /// is reached.
    pub fn until_mean_error(self, decades: f64) -> Self {
        Self { goal: Goal::MeanError(decades), ..self }
    }

    /// Saves the run's state in a file, from which it can be resumed.
    pub fn checkpoint(self, checkpoint: Checkpoint) -> Self {
        Self { checkpoint: Some(checkpoint), ..self }
    }

    /// Also sums the rays on so many levels below the grid's own, at most [`MOST_COARSER`], so that
    /// [`RayAverage::USpread`] and [`RayAverage::USpreadPerRootRay`] read the mean of log10 U over all of them. A level
    /// has at most half as many vertices as the one before, on surfaces a quarter.
    ///
    /// [`MOST_COARSER`]: crate::uncertainty::UncertaintyField::MOST_COARSER
    /// [`RayAverage::USpread`]: crate::render::RayAverage::USpread
    /// [`RayAverage::USpreadPerRootRay`]: crate::render::RayAverage::USpreadPerRootRay
    pub fn coarser_levels(self, coarser_levels: u8) -> Self {
        Self { coarser_levels, ..self }
    }

    /// Sets a human-readable name of model and cameras for the result. The default is the field's description.
    pub fn source(self, source: impl Into<String>) -> Self {
        Self { source: source.into(), ..self }
    }

    /// Sets a checksum of the model's content ([`open::checksum`](crate::open::checksum)). Results are matched by
    /// this checksum instead of a name.
    pub fn model(self, checksum: u32) -> Self {
        Self { model: Some(checksum), ..self }
    }

    /// Sets the monitor, which receives progress and can stop the run.
    pub fn monitor(self, monitor: &'a dyn Monitor) -> Self {
        Self { monitor, ..self }
    }

    /// Passes every group of samples to `tap` after it was summed, in ray order.
    pub fn tap(self, tap: impl FnMut(&[RaySamples]) -> Result<()> + 'a) -> Self {
        Self { tap: Some(Box::new(tap)), ..self }
    }

    /// Prepares everything that precedes the first ray: lattice, occupancy grid, and a plan if
    /// memory or rays limit the octree.
    ///
    /// # Errors
    /// If a setting is out of range, settings are incompatible, there is no camera, a checkpoint would be
    /// overwritten or belongs to another run, the plan exceeds its budget, or the work was interrupted.
    pub fn prepare(self) -> Result<Run<'a>> {
        self.check()?;
        Run::new(self)
    }

    /// Prepares the run and finishes it.
    ///
    /// # Errors
    /// As [`Estimation::prepare`] and [`Run::finish`].
    pub fn run(self) -> Result<Outcome> {
        self.prepare()?.finish()
    }

    /// The stream of training rays by these settings, differentiated for `lattice`.
    pub(super) fn stream(&self, rays: &RaySettings, lattice: &Lattice) -> Result<RayStream<'a>> {
        rays.stream(self.field, self.cameras, lattice, self.monitor)?.with_masks(self.masks)
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
        self.model.map_or_else(|| self.source.clone(), |checksum| format!("model {checksum:08x}"))
    }

    /// Number of groups of the goal, if it has any.
    pub(super) fn groups(&self) -> Option<u16> {
        match self.goal {
            Goal::Groups(groups) => Some(groups),
            _ => None,
        }
    }

    /// Rejects incompatible settings before any work is done.
    fn check(&self) -> Result<()> {
        if self.cameras.is_empty() {
            return Err(Error::setting("cameras", "at least one", "none"));
        }
        let shard = self.own_shard();
        if !shard.is_valid() || shard.own_rays() == 0 {
            let found = format!("part {} of {} of {} rays, which is empty", shard.index, shard.of, shard.rays);
            return Err(Error::setting("shard", "fewer parts than batches of 512 rays", found));
        }
        if self.goal != (Goal::Shard { index: 0, of: 1 }) && self.tap.is_some() {
            return Err(Error::setting("samples as they are drawn", "a run of all rays in one group", "another"));
        }
        if self.tap.is_some() && (self.grid.memory.is_some() || self.checkpoint.is_some()) {
            // A run that restarts or resumes would pass on rays twice or not at all.
            return Err(Error::setting(
                "samples as they are drawn",
                "no memory budget and no checkpoint",
                "one of them",
            ));
        }
        self.check_levels()?;
        match self.goal {
            Goal::Groups(_) | Goal::MeanError(_) if self.grid.tile.is_some() => {
                Err(Error::setting("tile", "a run of one set of rays", "error bars, or a run to a mean error"))
            }
            Goal::Groups(_) if self.grid.memory.is_some() => {
                Err(Error::setting("error bars", "no memory budget, which is for one set of sums", "a budget"))
            }
            Goal::MeanError(_) if self.grid.needs_plan() => {
                let expected = "a grid without limits to its refinement";
                Err(Error::setting("run to a mean error", expected, "a memory budget or criterion `ray-count`"))
            }
            Goal::MeanError(_) if self.checkpoint.is_some() => {
                Err(Error::setting("run to a mean error", "a run by itself, to its end", "a checkpoint"))
            }
            _ => Ok(()),
        }?;
        self.checkpoint.as_ref().map_or(Ok(()), |checkpoint| checkpoint.check(&checkpoint.files(self.groups())))
    }

    /// Rejects coarser levels that there cannot be.
    fn check_levels(&self) -> Result<()> {
        let (coarser, level) = (self.coarser_levels, self.grid.level);
        let most = UncertaintyField::most_coarser(level);
        if coarser > most {
            let expected = format!("at most {most} below level {level}");
            return Err(Error::setting("coarser levels", expected, coarser.to_string()));
        }
        let is_simple = self.goal == (Goal::Shard { index: 0, of: 1 }) && !self.grid.needs_plan();
        if coarser > 0 && !(is_simple && self.checkpoint.is_none() && self.grid.tile.is_none()) {
            let expected = "a run of a number of rays in one group, without a checkpoint, tile, memory budget \
                            or criterion `ray-count`";
            return Err(Error::setting("coarser levels", expected, "another"));
        }
        Ok(())
    }
}
