//! One ranking: candidates are looked at once, then taken one by one.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::evidence::{Blank, Evidence, Viewer};
use super::greedy::Candidates;
use super::objective::Objective;
use super::{Gain, GainMap, Region, Settings, VertexGain};
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::{Camera, Lattice};
use octobayes::monitor::{Monitor, Silent, check};
use octobayes::posterior::RayCoverage;
use octobayes::render::{GradientMethod, Renderer};
use octobayes::uncertainty::{Precision, UncertaintyField};
use octobayes::{Error, Result};

/// A view that was taken.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Step {
    /// Number of the candidate, from 0.
    pub index: usize,
    /// The information that its image would add to those taken before: nats.
    pub gain: f64,
    /// The same for each of its pixels.
    pub gain_per_pixel: f64,
    /// Share of its rays that end on a surface in the domain.
    pub surface: f64,
    /// Share of these whose surface neither training rays nor views taken before reached; `None` if it is not known
    /// where training rays passed, or no ray ends on a surface.
    pub unseen: Option<f64>,
    /// Time of the step; the first one's includes the first look at all candidates.
    pub seconds: f64,
}

/// Views in the order in which to take them.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Ranking {
    /// The views, from the best. Fewer than requested if not as many candidates add information.
    pub steps: Vec<Step>,
    /// `[candidates]`: gain before any was taken.
    pub gains: Vec<f64>,
    /// `[candidates]`: why its gain is 0.
    pub blanks: Vec<Option<Blank>>,
    /// Mean number of a candidate's rays that meet a vertex that they meet at all; `None` for coverage, or if none
    /// meets matter.
    pub rays_per_vertex: Option<f64>,
    /// Number of gains found anew in later steps.
    pub rescored: usize,
    /// True if all steps are there, false if the monitor requested a stop.
    pub complete: bool,
}

/// Rays per vertex from which neighbouring pixels meet the same vertices, so that gains are not those of chance: a
/// vertex's hat is two cells wide, and rays one and a half cells apart meet it about twice.
const MIN_RAYS_PER_VERTEX: f64 = 2.0;

impl Ranking {
    /// In words, that candidates had too few pixels for the field's level, if they had.
    #[must_use]
    pub fn doubt(&self) -> Option<String> {
        let rays = self.rays_per_vertex.filter(|rays| *rays < MIN_RAYS_PER_VERTEX)?;
        Some(format!(
            "{rays:.1} rays of a candidate meet each vertex that it shows; with fewer than {MIN_RAYS_PER_VERTEX}, \
             gains depend on chance: take more --pixels, or a field of a coarser --level"
        ))
    }
}

octobayes::setters! {
    /// Ranks candidates for the next photograph.
    #[must_use]
    pub struct NextView<'a> {
        model: &'a dyn Model as skip,
        field: &'a UncertaintyField as skip,
        candidates: &'a [Camera] as skip,
        /// The cameras of the images that were taken, for [`Gain::Coverage`].
        training: &'a [Camera],
        /// Set by [`NextView::vertex_gain`].
        vertex_gain: Option<VertexGain<'a>> as skip,
        /// The part of the scene whose displacements, or surface, count; all of it if none is given.
        region: Option<Region<'a>>,
        /// Settings.
        settings: Settings,
        /// Receives progress and can stop the work.
        monitor: &'a dyn Monitor,
    }
}

impl<'a> NextView<'a> {
    /// Ranks `candidates` for the `model` whose uncertainty is `field`.
    pub fn new(model: &'a dyn Model, field: &'a UncertaintyField, candidates: &'a [Camera]) -> Self {
        let settings = Settings::default();
        Self { model, field, candidates, training: &[], vertex_gain: None, region: None, settings, monitor: &Silent }
    }

    /// Stands for the log det or trace of a vertex. It must not grow with P, or lazy and full rescoring may differ.
    pub fn vertex_gain(mut self, gain: VertexGain<'a>) -> Self {
        self.vertex_gain = Some(gain);
        self
    }

    /// Takes views until there are enough. If the monitor requests a stop, those taken so far are returned.
    ///
    /// # Errors
    /// If the field cannot be added to ([`UncertaintyField::precision`]), there is no candidate, a lens distorts in
    /// front of splats, a setting makes no sense, the model is not finite on too many rays, or [`Error::Interrupted`]
    /// before the first view was taken.
    pub fn run(&self) -> Result<Ranking> {
        self.run_with(|_| Ok(()))
    }

    /// As [`NextView::run`]; passes on every view as it is taken.
    ///
    /// # Errors
    /// Also what `on_step` returns.
    pub fn run_with(&self, mut on_step: impl FnMut(&Step) -> Result<()>) -> Result<Ranking> {
        let Settings { take, gain, .. } = self.settings;
        self.check()?;
        let precision = self.precision()?;
        let source = self.source()?;
        let viewer = self.viewer(&*source, precision.as_ref());
        let mut objective = Objective::new(gain, precision.as_ref(), self.field.ray_coverage()).with(self.vertex_gain);
        let mut start = Instant::now();
        if gain == Gain::Coverage {
            self.each(&viewer, self.training, "training views", |_, evidence| {
                objective.add(&evidence);
                Ok(())
            })?;
        }
        let (mut gains, mut blanks, mut kept, mut room) = (Vec::new(), Vec::new(), Vec::new(), self.settings.memory);
        let (mut vertices, mut meetings) = (0_u64, 0_u64);
        self.each(&viewer, self.candidates, "candidates", |_, evidence| {
            vertices += evidence.added.len() as u64;
            meetings += evidence.added.iter().map(|added| u64::from(added.rays)).sum::<u64>();
            gains.push(objective.gain(&evidence));
            blanks.push(evidence.blank);
            let bytes = evidence.memory();
            kept.push((bytes <= room).then_some(evidence));
            room -= if kept.last().is_some_and(Option::is_some) { bytes } else { 0 };
            Ok(())
        })?;
        let again = |kept: &[Option<Evidence>], candidate: usize| match &kept[candidate] {
            Some(evidence) => Ok(evidence.clone()),
            None => viewer.evidence(&self.candidates[candidate], self.monitor),
        };
        let mut candidates = Candidates::new(&gains);
        let (mut steps, mut complete) = (Vec::new(), true);
        self.monitor.begin("views", take as u64);
        while steps.len() < take {
            let best = candidates.take(self.settings.rescoring, |candidate| {
                check(self.monitor)?;
                match &kept[candidate] {
                    Some(evidence) => Ok(objective.gain(evidence)),
                    None => Ok(objective.gain(&again(&kept, candidate)?)),
                }
            });
            let (index, gain) = match best {
                Ok(Some(best)) if best.1 > 0.0 => best,
                Ok(_) => break,
                Err(Error::Interrupted) if !steps.is_empty() => {
                    complete = false;
                    break;
                }
                Err(error) => return Err(error),
            };
            let evidence = again(&kept, index)?;
            let step = Step {
                index,
                gain,
                gain_per_pixel: gain / evidence.pixels as f64,
                surface: evidence.met as f64 / evidence.rays as f64,
                unseen: objective.unseen_share(&evidence),
                seconds: start.elapsed().as_secs_f64(),
            };
            start = Instant::now();
            objective.add(&evidence);
            kept[index] = None;
            on_step(&step)?;
            steps.push(step);
            self.monitor.advance(1);
        }
        self.monitor.end();
        let rays_per_vertex = (vertices > 0).then(|| meetings as f64 / vertices as f64);
        Ok(Ranking { steps, gains, blanks, rays_per_vertex, rescored: candidates.rescored, complete })
    }

    /// The information that each pixel of a view alone would add to the training images.
    ///
    /// # Errors
    /// As [`NextView::run`]; also for [`Gain::Coverage`], which is no sum over pixels.
    pub fn map(&self, camera: &Camera) -> Result<GainMap> {
        self.settings.gain.check_map()?;
        let precision = self.field.precision()?;
        self.check_lenses([camera])?;
        let source = self.source()?;
        let viewer = self.viewer(&*source, Some(&precision));
        let objective = Objective::new(self.settings.gain, Some(&precision), None).with(self.vertex_gain);
        GainMap::of(camera, &viewer, &precision, &objective, self.monitor)
    }

    /// `[candidates]`: share of the surface that each shows that no training ray reached; `None` if it shows none,
    /// stands in matter, or if it is not known where training rays passed.
    ///
    /// # Errors
    /// As [`NextView::run`].
    pub fn unseen(&self) -> Result<Vec<Option<f64>>> {
        self.check_lenses(self.candidates)?;
        let source = self.source()?;
        let objective = Objective::new(Gain::Coverage, None, self.field.ray_coverage());
        let mut shares = Vec::new();
        self.each(&self.viewer(&*source, None), self.candidates, "sides", |_, evidence| {
            shares.push(objective.unseen_share(&evidence).filter(|_| evidence.blank.is_none()));
            Ok(())
        })?;
        Ok(shares)
    }

    fn check(&self) -> Result<()> {
        if self.candidates.is_empty() {
            return Err(Error::setting("candidates", "at least one", "none"));
        }
        let Settings { take, pixels, gain, .. } = self.settings;
        if take == 0 || pixels == 0 {
            let found = format!("{take} views by {pixels} pixels");
            return Err(Error::setting("views to take", "at least one, by at least one pixel", found));
        }
        if gain == Gain::Coverage && self.training.is_empty() {
            let expected = "the training cameras, whose coverage counts";
            return Err(Error::setting("cameras", expected, "none"));
        }
        if gain == Gain::Coverage && self.vertex_gain.is_some() {
            return Err(Error::setting("gain of a vertex", "`logdet` or `trace`, which it stands for", "`coverage`"));
        }
        self.check_lenses(self.candidates.iter().chain(self.training))
    }

    fn check_lenses<'c>(&self, cameras: impl IntoIterator<Item = &'c Camera>) -> Result<()> {
        cameras.into_iter().try_for_each(|camera| self.model.check_camera(camera))
    }

    fn precision(&self) -> Result<Option<Precision<'a>>> {
        match self.settings.gain {
            Gain::Coverage => Ok(None),
            Gain::Logdet | Gain::Trace => self.field.precision().map(Some),
        }
    }

    fn viewer<'v>(&self, source: &'v dyn Renderer, precision: Option<&'v Precision<'v>>) -> Viewer<'v>
    where
        'a: 'v,
    {
        let Settings { pixels, seed, .. } = self.settings;
        // As fine as so many rays leave no holes by chance, for a view's own surface.
        let cells: Lattice = self.field.lattice().coarsened(RayCoverage::level_of(pixels));
        Viewer {
            source,
            pixel_offset: self.offset(),
            precision,
            ray_coverage: self.field.ray_coverage(),
            cells,
            region: self.region,
            pixels,
            seed,
        }
    }

    /// The rays of the run that made the field, as far as its record states them.
    fn source(&self) -> Result<Arc<dyn Renderer + 'a>> {
        let record = self.field.record();
        let (lattice, defaults) = (self.field.lattice(), RaySettings::default());
        let background = record.background.map_or(defaults.background, glam::Vec3::from_array);
        let gradient = record.gradient.unwrap_or(GradientMethod::Auto);
        // The same share of an edge along all axes, unless f32 positions needed more, as they will again.
        let shares = record.difference_step.map(|step| [0, 1, 2].map(|k| step[k] / lattice.edge()[k]));
        let is_even = |shares: &[f64; 3]| shares.iter().all(|share| (share / shares[0] - 1.0).abs() < 1e-9);
        let rays = defaults
            .gradient(gradient)
            .step(shares.filter(is_even).map(|shares| shares[0].min(1.0)))
            .cutoff(record.cutoff.unwrap_or(defaults.cutoff))
            .march_step(record.march_step)
            .background(background)
            .occupancy(self.settings.occupancy);
        self.model.for_rays(&rays, lattice, self.monitor)
    }

    /// Where in a pixel its ray passes: as in the run that made the field.
    fn offset(&self) -> f64 {
        self.field.record().pixel_offset.unwrap_or_else(|| self.model.pixel_offset())
    }

    /// What each camera would see, in their order.
    fn each(
        &self,
        viewer: &Viewer,
        cameras: &[Camera],
        stage: &'static str,
        mut sink: impl FnMut(usize, Evidence) -> Result<()>,
    ) -> Result<()> {
        self.monitor.begin(stage, cameras.len() as u64);
        let together = if viewer.takes_turns() { 1 } else { rayon::current_num_threads() };
        let mut done = 0;
        for some in cameras.chunks(together) {
            check(self.monitor)?;
            let found: Vec<Result<Evidence>> = match some {
                [camera] => vec![viewer.evidence(camera, self.monitor)],
                several => several.par_iter().map(|camera| viewer.evidence(camera, self.monitor)).collect(),
            };
            for evidence in found {
                sink(done, evidence?)?;
                done += 1;
            }
            self.monitor.advance(some.len() as u64);
        }
        self.monitor.end();
        Ok(())
    }
}
