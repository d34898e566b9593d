//! One run: what is requested, checked, drawn and attached.

mod images;

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::Vec3;

use super::memory::{bytes, peak};
use super::needs::Foresight;
use super::{Choices, Finished, ScaleKind, TrainingPixels, checks, world};
use octobayes::estimate::{
    Audit, Checkpoint, ErrorBudget, Estimation, Feature, Goal, GridSettings, Model, Outcome, RayError, RaySettings,
    Run, StepCheck, require,
};
use octobayes::geometry::{Camera, Domain, Mask, kept_pixels};
use octobayes::monitor::{Message, Monitor};
use octobayes::posterior::Scale;
use octobayes::rays::Pixels;
use octobayes::{Error, Result};
use octobayes_data::SamplesWriter;
use octobayes_data::{Views, memory_of_masks, read_masks};
use octobayes_evaluation::{ImageCheck, memory_of_images};

/// Why cameras may see little of splats.
const FRAMES_OF_SPLATS: &str = "splats in a frame that their training normalised (nerfstudio's: pass the run's \
                                dataparser_transforms.json as --cameras; gsplat's), with the axes of glTF, or cameras \
                                whose cx and cy are missing";

octobayes::setters! {
    /// Everything that a user can ask of a run of some model.
    pub struct Session {
        views: Views as skip,
        cameras: Vec<Camera> as skip,
        writer: RefCell<Option<SamplesWriter>> as skip,
        /// Which pixels of each camera the model was trained on, if not all; by default, by the frames' masks.
        masks: Vec<Option<Mask>>,
        /// Checksum of the model's content, if known.
        checksum: Option<u32>,
        /// What the field covers; `None` for what the model does.
        domain: Option<Domain>,
        /// Which rays are drawn, and how they are differentiated.
        rays: RaySettings,
        /// What lay behind the scene in training, if the user names it. For splats a file beside them may state it, or
        /// images may fit white or black better; else it is the background of `rays`.
        background: Option<Vec3>,
        /// The file of the model, beside which others may lie.
        model_file: Option<PathBuf>,
        /// The grid on which information is summed. `choices` decide on its scale, level, covariance and sums.
        grid: GridSettings,
        /// What was chosen, and what the field is for.
        choices: Choices,
        /// Which rays are drawn, and when the run ends.
        goal: Goal,
        /// Where the state is saved.
        checkpoint: Option<Checkpoint>,
        /// The folder of sums that a budget of memory has no room for; `None` for the system's folder of such files.
        scratch: Option<PathBuf>,
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
        source: String as skip,
    }
}

/// A run that was checked, before its first ray.
pub struct Prepared<'a> {
    session: &'a Session,
    model: &'a dyn Model,
    monitor: &'a dyn Monitor,
    pub(super) run: Run<'a>,
    pub(super) grid: GridSettings,
    pub(super) start: Instant,
    step: Option<StepCheck>,
    audit: Option<Audit>,
    images: Option<ImageCheck>,
}

/// Training views that were checked against the model.
#[derive(Debug, Clone, Copy)]
pub struct CheckedViews<'a> {
    /// The cameras.
    pub cameras: &'a [Camera],
    /// Which pixels of each count, `[cameras]`, if not all.
    pub masks: &'a [Option<Mask>],
    /// Where the ray of a pixel lies in it, pixels.
    pub pixel_offset: f64,
    /// What lay behind the model in training.
    pub background: Vec3,
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
            background: None,
            model_file: None,
            grid: GridSettings::default(),
            choices: Choices::default(),
            goal: Goal::default(),
            checkpoint: None,
            scratch: None,
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
        model: &'a dyn Model,
        monitor: &'a dyn Monitor,
        tell: &mut dyn FnMut(Message),
    ) -> Result<Prepared<'a>> {
        let start = Instant::now();
        let choices = &self.choices;
        let grid = choices.settle(self.grid, Some(model.centers().len()).filter(|count| *count > 0), tell)?;
        if self.audit {
            require(model, Feature::March, "audit")?;
        }
        model.remarks(&self.cameras).into_iter().for_each(&mut *tell);
        checks::masks(&self.views, &self.masks, tell)?;
        let (rays, mut images) = self.settled(model, monitor, tell)?;
        let domain = match self.domain {
            Some(domain) => domain,
            None => {
                let (domain, messages) = model.covered(&self.cameras, self.rays.background, monitor)?;
                messages.into_iter().for_each(&mut *tell);
                if let Domain::Contracted { .. } = domain {
                    tell(Message::Note(format!("domain: the model's own, {domain} (--box for a box)")));
                }
                domain
            }
        };
        let noise = match (choices.scale(), choices.noise, model.training_noise()) {
            (ScaleKind::Data, None, None) => self.noise_of_images(model, &rays, &mut images, monitor, tell)?,
            (_, _, own) => own,
        };
        let pixels = kept_pixels(&self.cameras, &self.masks);
        let training = TrainingPixels { pixels: Some(pixels), noise };
        let grid = grid.scale(choices.scale().over(&domain, choices.noise, training)?);
        if matches!(grid.scale, Scale::Data(_)) {
            checks::pixels(&self.views, pixels, tell);
        }
        let run = self.estimation(model, domain, rays, grid)?.picture(self.picture()?).monitor(monitor).prepare()?;
        let sight = run.sight()?;
        // Camera files have one kind of coordinates for these models. If rays meet matter, but outside the domain, they
        // are right.
        let is_chosen = self.has_chosen_coordinates && sight.meet_matter <= 2.0 * sight.meet_domain;
        let is_of_splats = !model.centers().is_empty();
        let frame = if sight.causes().is_some() { world::other_frame(model.centers(), &self.views)? } else { None };
        let causes = [
            frame.as_deref().or(is_of_splats.then_some(FRAMES_OF_SPLATS)),
            is_chosen.then_some("--cameras in other units and axes than those of NeRF-synthetic"),
            self.has_given_fov.then_some("--fov"),
        ];
        checks::sight(&sight, &causes.into_iter().flatten().collect::<Vec<_>>(), tell)?;
        let step = run.check_step()?;
        let warnings = [run.check_positions()?.warning(), step.as_ref().and_then(StepCheck::warning)];
        warnings.into_iter().flatten().for_each(|text| tell(Message::Warning(text)));
        let audit = self.audit.then(|| run.audit()).transpose()?;
        let mut prepared = Prepared { session: self, model, monitor, run, grid, start, step, audit, images };
        prepared.check_images(sight.causes().is_none(), tell)?;
        Ok(prepared)
    }

    /// The files beside which the original code of Gaussian splatting writes what it was run with.
    fn files_of_training(&self) -> Vec<&Path> {
        [self.model_file.as_deref(), Some(self.views.path.as_path())].into_iter().flatten().collect()
    }

    /// Bytes that decoding the largest picture takes: a mask, or an image that is compared.
    fn picture(&self) -> Result<u64> {
        let masks = memory_of_masks(&self.views.frames);
        if let Some(budget) = self.grid.memory.filter(|&budget| masks > budget) {
            let expected =
                format!("at least {} MB, to decode the largest mask, or smaller masks", masks / 1_000_000 + 1);
            return Err(Error::setting("memory budget", expected, format!("{} MB", budget / 1_000_000)));
        }
        Ok(masks.max(memory_of_images(&self.views.frames)))
    }

    fn estimation<'a>(
        &'a self,
        model: &'a dyn Model,
        domain: Domain,
        rays: RaySettings,
        grid: GridSettings,
    ) -> Result<Estimation<'a>> {
        if let Some(path) = &self.dump {
            self.writer.replace(Some(SamplesWriter::create(path)?));
        }
        let estimation = Estimation::new(model, &self.cameras);
        let estimation =
            estimation.masks(&self.masks).domain(domain).rays(rays).grid(grid).goal(self.goal).source(&*self.source);
        let estimation = self.checksum.into_iter().fold(estimation, Estimation::checksum);
        let estimation = self.checkpoint.iter().cloned().fold(estimation, Estimation::checkpoint);
        let estimation = self.scratch.iter().fold(estimation, Estimation::scratch);
        Ok(match &self.dump {
            None => estimation,
            Some(_) => {
                estimation.tap(|batches| self.writer.borrow_mut().as_mut().map_or(Ok(()), |writer| writer.add(batches)))
            }
        })
    }

    /// Notes how many of the run's rays a checkpoint holds, if it holds any.
    fn note_progress(&self, rays: u64, then: &str, tell: &mut dyn FnMut(Message)) {
        let Some(checkpoint) = &self.checkpoint else { return };
        let drawn = checkpoint.rays(self.goal.groups());
        if drawn > 0 {
            let path = checkpoint.path().display();
            tell(Message::Note(format!("{path} holds {drawn} of {rays} rays; {then}")));
        }
    }
}

impl<'a> Prepared<'a> {
    /// The training views as the run takes them.
    #[must_use]
    pub fn checked_views(&self) -> CheckedViews<'a> {
        let Session { cameras, masks, .. } = self.session;
        let stream = self.run.stream();
        let background = stream.source.background().as_vec3();
        CheckedViews { cameras, masks, pixel_offset: stream.pixel_offset, background }
    }

    /// Whether the number of rays is known beforehand.
    pub(super) fn has_fixed_rays(&self) -> bool {
        !matches!(self.session.goal, Goal::MeanError(_))
    }

    /// What is known of the errors before the first ray.
    pub(super) fn known_errors(&self) -> ErrorBudget {
        let mut errors = ErrorBudget::of_settings(&self.grid);
        (errors.audit, errors.step) = (self.audit, self.step.clone());
        errors
    }

    /// Draws the rays and computes the field, with what belongs to it.
    ///
    /// # Errors
    /// As [`Run::finish`], or if the samples cannot be written.
    pub fn finish(self, tell: &mut dyn FnMut(Message)) -> Result<Finished> {
        let (has_fixed_rays, of_run) = (self.has_fixed_rays(), self.grid);
        let Self { session, model, monitor, run, start, step, audit, images, .. } = self;
        let (rays, grid) = (run.rays(), &session.grid);
        let could_pool = session.rays.pixels != Pixels::Every && model.lacks(Feature::Pooling).is_none();
        if session.checkpoint.as_ref().is_some_and(|checkpoint| !checkpoint.is_restart()) {
            session.note_progress(rays, "--restart discards them", tell);
        }
        let foresight = Foresight::of(&run, &of_run);
        if !run.is_foreseen_under_way() && grid.memory.is_some() && has_fixed_rays {
            foresight.check(&run.forecast()?, tell)?;
        }
        let outcome = run.finish_foreseen(&mut |plan| foresight.check(plan, tell)).inspect_err(|error| {
            if matches!(error, Error::Interrupted) {
                session.note_progress(rays, "the same command goes on", tell);
            }
        })?;
        let Outcome { field, progress, sums_bytes, disk_bytes, mut errors, .. } = outcome;
        (errors.audit, errors.step) = (audit, step);
        if let (Some(RayError::Halves(error)), Goal::MeanError(target)) = (errors.rays, session.goal)
            && (error.mean > target || error.vertices == 0)
        {
            let rays = progress.rays;
            let text = format!("stopped at --rays {rays}; the mean error is still above {target:?} decades");
            tell(Message::Warning(text));
        }
        if let Some((budget, peak)) = grid.memory.zip(peak()).filter(|(budget, peak)| peak > budget) {
            let of_field = field.memory().iter().map(|part| part.1).sum();
            let [budget, peak] = [budget, peak].map(|size| bytes(size as usize));
            let text = format!(
                "--memory {budget} was exceeded: {peak} at the peak; the field itself takes {}",
                bytes(of_field)
            );
            tell(Message::Warning(text));
        }
        if let Some(first) = progress.first_invalid {
            let dropped = progress.dropped;
            tell(Message::Warning(format!("{dropped} rays dropped, the field is not finite; first at {first:?}")));
        }
        if let Some(writer) = session.writer.take() {
            writer.finish(progress.rays, kept_pixels(&session.cameras, &session.masks))?;
        }
        checks::field(&field, session.grid.pooling, could_pool, tell);
        checks::unseen(model, &field, &session.cameras, monitor, tell)?;
        Ok(Finished {
            field,
            errors,
            elapsed: start.elapsed(),
            sums_bytes,
            images,
            disk_bytes,
            checkpoint: session.checkpoint.clone().map(|checkpoint| (checkpoint, session.goal.groups())),
        })
    }
}
