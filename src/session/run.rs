//! One run: what is asked for, checked, drawn and attached.

use std::cell::RefCell;
use std::path::PathBuf;
use std::time::Instant;

use derive_setters::Setters;

use super::{Finished, ScaleKind, TrainingPixels, checks};
use crate::dataset::{Views, read_masks};
use crate::estimate::{
    Audit, Checkpoint, ErrorBudget, Estimation, Goal, GridSettings, Outcome, RayError, RaySettings, Run, StepCheck,
    Subject,
};
use crate::evaluate::{Compared, Remark, TrainingImages, check_images, check_splat_images};
use crate::geometry::{Camera, Domain, Mask, kept_pixels};
use crate::monitor::Monitor;
use crate::posterior::Scale;
use crate::rays::{RaySource, SamplesWriter};
use crate::splats::{SplatRenderer, seen_domain};
use crate::{Error, Result};

/// Why cameras may see little of splats.
const FRAMES_OF_SPLATS: &str = "splats in a frame that their export normalised (nerfstudio's \
                                dataparser_transforms.json, gsplat), with the axes of glTF, or cameras whose cx and cy \
                                are missing";

/// Everything that a user can ask of a run of some model.
#[derive(Setters)]
#[non_exhaustive]
pub struct Session {
    #[setters(skip)]
    views: Views,
    #[setters(skip)]
    cameras: Vec<Camera>,
    #[setters(skip)]
    writer: RefCell<Option<SamplesWriter>>,
    /// Which pixels of each camera the model was trained on, if not all; by default, as the frames' masks say.
    masks: Vec<Option<Mask>>,
    /// Checksum of the model's content, if known.
    checksum: Option<u32>,
    /// What the field covers; `None` for what the model does.
    domain: Option<Domain>,
    /// Which rays are drawn, and how they are differentiated.
    rays: RaySettings,
    /// The grid on which information is summed. Its scale follows from `scale` and `noise`.
    grid: GridSettings,
    /// What U is a deviation of.
    scale: ScaleKind,
    /// The noise that training left; `None` for what the model records.
    noise: Option<f64>,
    /// Which rays are drawn, and when the run ends.
    goal: Goal,
    /// Where the state is saved.
    checkpoint: Option<Checkpoint>,
    /// Images that the model is compared with, for the deviation of depth.
    images: Option<TrainingImages>,
    /// Where the samples are written.
    dump: Option<PathBuf>,
    /// Whether what skipped samples and derivatives cost is measured.
    audit: bool,
    /// Whether cameras are taken although the model does not show their images.
    force: bool,
    /// Whether the model's coordinates were chosen for a camera file, which is a likely cause of seeing little.
    has_chosen_coordinates: bool,
    /// Whether the angle of view was given, which is another.
    has_given_fov: bool,
    /// What the field is computed from, for people.
    #[setters(skip)]
    source: String,
}

/// A run that was checked, before its first ray.
pub struct Prepared<'a> {
    session: &'a Session,
    model: Subject<'a>,
    monitor: &'a dyn Monitor,
    pub(super) run: Run<'a>,
    pub(super) grid: GridSettings,
    pub(super) start: Instant,
    step: Option<StepCheck>,
    audit: Option<Audit>,
}

impl Session {
    /// A run over the training pixels of `views`, with default settings. Reads the frames' masks. `source` says for
    /// people what model and cameras are.
    ///
    /// # Errors
    /// If a mask cannot be read.
    pub fn new(views: Views, source: impl Into<String>) -> Result<Self> {
        Ok(Self {
            cameras: views.cameras(),
            masks: read_masks(&views.frames)?,
            views,
            writer: RefCell::default(),
            checksum: None,
            domain: None,
            rays: RaySettings::default(),
            grid: GridSettings::default(),
            scale: ScaleKind::default(),
            noise: None,
            goal: Goal::default(),
            checkpoint: None,
            images: None,
            dump: None,
            audit: false,
            force: false,
            has_chosen_coordinates: false,
            has_given_fov: false,
            source: source.into(),
        })
    }

    /// Prepares the run of `model`, and checks what can be checked before its first ray.
    ///
    /// # Errors
    /// If settings do not go together, if the cameras see nothing of the model, if it shows nothing of the images
    /// beside them (unless forced), as [`Estimation::prepare`], or if the work was interrupted.
    pub fn prepare<'a>(
        &'a self,
        model: Subject<'a>,
        monitor: &'a dyn Monitor,
        tell: &mut dyn FnMut(Remark),
    ) -> Result<Prepared<'a>> {
        let start = Instant::now();
        if let Subject::Splats(splats) = model {
            splats.notes().iter().for_each(|note| tell(Remark::Note(note.clone())));
            checks::near(splats, &self.cameras, tell);
        }
        checks::masks(&self.views, &self.masks, tell)?;
        let domain = self.domain.map_or_else(|| self.covered(model, monitor, tell), Ok)?;
        let noise = match model {
            Subject::Volume(field) => field.training_noise(),
            Subject::Splats(_) => None,
        };
        let pixels = kept_pixels(&self.cameras, &self.masks);
        let training = TrainingPixels { pixels: Some(pixels), noise };
        let grid = self.grid.scale(self.scale.over(&domain, self.noise, training)?);
        self.images.as_ref().map_or(Ok(()), |_| self.scale.check_images())?;
        if matches!(grid.scale, Scale::Data(_)) {
            checks::pixels(&self.views, pixels, tell);
        }
        let run = self.estimation(model, domain, grid)?.monitor(monitor).prepare()?;
        let sight = run.sight()?;
        // Camera files have one kind of coordinates for these models. If rays meet matter, but outside the domain, they
        // are right.
        let is_chosen = self.has_chosen_coordinates && sight.meet_matter <= 2.0 * sight.meet_domain;
        let is_of_splats = matches!(model, Subject::Splats(_));
        let causes = [
            is_of_splats.then_some(FRAMES_OF_SPLATS),
            is_chosen.then_some("--cameras in other units and axes than those of NeRF-synthetic"),
            self.has_given_fov.then_some("--fov"),
        ];
        checks::sight(&sight, &causes.into_iter().flatten().collect::<Vec<_>>(), tell)?;
        let step = run.check_step()?;
        let warnings = [run.check_positions()?.warning(), step.as_ref().and_then(StepCheck::warning)];
        warnings.into_iter().flatten().for_each(|text| tell(Remark::Warning(text)));
        let audit = self.audit.then(|| run.audit()).transpose()?;
        let prepared = Prepared { session: self, model, monitor, run, grid, start, step, audit };
        prepared.check_images(tell)?;
        Ok(prepared)
    }

    /// The space that the field covers if nobody says another.
    fn covered(&self, model: Subject, monitor: &dyn Monitor, tell: &mut dyn FnMut(Remark)) -> Result<Domain> {
        let domain = match model {
            Subject::Volume(field) => field.natural_domain(),
            Subject::Splats(splats) => {
                let seen = seen_domain(&SplatRenderer::new(splats, self.rays.background), &self.cameras, monitor)?;
                if seen.behind > 0.0 {
                    tell(Remark::Note(format!(
                        "{:.0} % of what the cameras see lies far behind what they stand around, as a sky does; the \
                         field leaves that out (--box or --contract covers it)",
                        100.0 * seen.behind
                    )));
                }
                seen.domain
            }
        };
        match (model, domain) {
            (_, Domain::Contracted { .. }) => {
                tell(Remark::Note(format!("the field covers what the model does, {domain} (--box for a box)")));
            }
            (Subject::Splats(_), Domain::Box(bounds)) => {
                let [low, high] = [bounds.min(), bounds.max()];
                let text = format!("the cameras see splats from {low:.3} to {high:.3}; the field covers that (--box)");
                tell(Remark::Note(text));
            }
            (Subject::Volume(_), Domain::Box(_)) => {}
        }
        Ok(domain)
    }

    fn estimation<'a>(&'a self, model: Subject<'a>, domain: Domain, grid: GridSettings) -> Result<Estimation<'a>> {
        if let Some(path) = &self.dump {
            self.writer.replace(Some(SamplesWriter::create(path)?));
        }
        let estimation = match model {
            Subject::Volume(field) => Estimation::new(field, &self.cameras),
            Subject::Splats(splats) => Estimation::of_splats(splats, &self.cameras),
        };
        let estimation = estimation
            .masks(&self.masks)
            .domain(domain)
            .rays(self.rays)
            .grid(grid)
            .goal(self.goal)
            .source(&*self.source);
        let estimation = self.checksum.into_iter().fold(estimation, Estimation::model);
        let estimation = self.checkpoint.iter().cloned().fold(estimation, Estimation::checkpoint);
        Ok(match &self.dump {
            None => estimation,
            Some(_) => {
                estimation.tap(|batches| self.writer.borrow_mut().as_mut().map_or(Ok(()), |writer| writer.add(batches)))
            }
        })
    }

    /// Notes how many of the run's rays a checkpoint holds, if it holds any.
    fn note_progress(&self, rays: u64, then: &str, tell: &mut dyn FnMut(Remark)) {
        let Some(checkpoint) = &self.checkpoint else { return };
        let drawn = checkpoint.rays(self.goal.groups());
        if drawn > 0 {
            let path = checkpoint.path().display();
            tell(Remark::Note(format!("{path} holds {drawn} of {rays} rays; {then}")));
        }
    }
}

impl Prepared<'_> {
    /// Compares the model with the images beside the cameras. Refuses cameras whose images it does not show at all,
    /// unless forced. Warns if it shows them poorly.
    fn check_images(&self, tell: &mut dyn FnMut(Remark)) -> Result<()> {
        let (session, stream) = (self.session, self.run.stream());
        let frames = session.images.as_ref().map_or(&*session.views.frames, TrainingImages::frames);
        let found = match &stream.source {
            RaySource::Volume(volume) => check_images(&volume.tracer, frames, stream.pixel_offset, self.monitor)?,
            RaySource::Splats(splats) => check_splat_images(splats, frames, stream.pixel_offset, self.monitor)?,
        };
        let Some(found) = found else { return Ok(()) };
        if !session.force {
            found.refuse()?;
        }
        found.warnings().into_iter().for_each(|text| tell(Remark::Warning(text)));
        Ok(())
    }

    /// Compares the model with its training images, if they were given.
    fn compared(&self) -> Result<Option<Compared>> {
        let Some(images) = &self.session.images else { return Ok(None) };
        let Subject::Volume(field) = self.model else {
            return Err(Error::setting("--images", "a volume, whose training images are compared with it", "splats"));
        };
        let RaySettings { background, occupancy, march_step, pixel_offset, .. } = self.session.rays;
        let settings = RaySettings { background, occupancy, march_step, pixel_offset, ..RaySettings::for_images() };
        let tracer = settings.tracer(field, 0.0, self.monitor)?;
        images.compare(&tracer, settings.offset_for(field), self.run.lattice(), self.monitor).map(Some)
    }

    /// Whether the number of rays is known beforehand.
    pub(super) fn has_fixed_rays(&self) -> bool {
        !matches!(self.session.goal, Goal::MeanError(_))
    }

    /// What is known of the errors before the first ray.
    pub(super) fn known_errors(&self) -> ErrorBudget {
        ErrorBudget { audit: self.audit, step: self.step.clone(), ..ErrorBudget::of_settings(&self.grid) }
    }

    /// Draws the rays and computes the field, with what belongs to it.
    ///
    /// # Errors
    /// If a training image cannot be read, as [`Run::finish`], or if the samples cannot be written.
    pub fn finish(self, tell: &mut dyn FnMut(Remark)) -> Result<Finished> {
        // Before the rays, so that a wrong image ends the work at once.
        let compared = self.compared()?;
        let Self { session, run, start, step, audit, .. } = self;
        let rays = run.rays();
        if session.checkpoint.as_ref().is_some_and(|checkpoint| !checkpoint.is_restart()) {
            session.note_progress(rays, "--restart discards them", tell);
        }
        let outcome = run.finish().inspect_err(|error| {
            if matches!(error, Error::Interrupted) {
                session.note_progress(rays, "the same command goes on", tell);
            }
        })?;
        let Outcome { field, progress, sums_bytes, plan, is_replanned, errors, .. } = outcome;
        let errors = ErrorBudget { audit, step, ..errors };
        if let (Some(RayError::Halves(error)), Goal::MeanError(target)) = (errors.rays, session.goal)
            && (error.mean > target || error.vertices == 0)
        {
            let rays = progress.rays;
            let text =
                format!("{rays} rays, the most by --rays, do not bring the mean error within {target:?} decades");
            tell(Remark::Warning(text));
        }
        if is_replanned {
            let text = "the rays took more or less memory than planned; the run started again";
            tell(Remark::Note(text.into()));
        }
        if let Some(first) = progress.first_invalid {
            let dropped = progress.dropped;
            tell(Remark::Warning(format!("{dropped} rays dropped, the field is not finite; first at {first:?}")));
        }
        if let Some(writer) = session.writer.take() {
            writer.finish(progress.rays, kept_pixels(&session.cameras, &session.masks))?;
        }
        let field = match compared {
            Some(compared) => compared.join(field)?,
            None => field,
        };
        checks::field(&field, session.grid.pooling, tell);
        Ok(Finished {
            field,
            errors,
            elapsed: start.elapsed(),
            sums_bytes,
            replanned: plan.filter(|_| is_replanned),
            checkpoint: session.checkpoint.clone().map(|checkpoint| (checkpoint, session.goal.groups())),
        })
    }
}
