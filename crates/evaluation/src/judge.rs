//! One evaluation, from its inputs to its report.

use std::path::PathBuf;

use super::kinds::JUMP;
use super::looked::{Looked, are_far_off, size_of};
use super::training_cameras::training_cameras;
use super::truly_seen::from_depth_maps;
use super::{
    CleanUp, DepthFiles, DepthMeaning, EvaluatedView, Evaluator, FramesWithDepth, Interval, Reading, Report,
    THRESHOLDS, TrueView, clean_up,
};
use glam::DVec3;

use crate::metrics::STEPS;
use octobayes::error::counted;
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::{Aabb, Camera, NamedCamera};
use octobayes::monitor::{Message, Monitor};
use octobayes::render::RenderedView;
use octobayes::uncertainty::BakedField;
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, Frame, FrameSplit, Part, Selection, Views};
use octobayes_depth::{DepthDeviation, Photograph, TrainingViews, find_images};

/// Memory of a pixel that shows matter, until all views are judged, bytes: 216 to 266 were measured without the seven of
/// their kinds. The pixels of lego on white took 65 to 72 in the mean.
const BYTES_PER_PIXEL: u64 = 273;
/// Memory that is announced, bytes.
const MUCH_MEMORY: u64 = 1 << 30;

/// What is judged, and by what.
#[derive(Clone)]
pub struct Evaluation<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// Its name, for the report.
    pub name: String,
    /// How its images are rendered.
    pub settings: RaySettings,
    /// Readings to rank its errors by. The first one is used for the clean-up and for calibration.
    pub readings: &'a [Reading],
    /// Models of the same kind that were trained like it, by their names.
    pub ensemble: Vec<(String, &'a dyn Model)>,
    /// The camera file with the held-out frames.
    pub cameras: PathBuf,
    /// Which of them are taken.
    pub selection: Selection,
    /// Every so many pixels along x and y are looked at.
    pub stride: u32,
    /// Their true depth.
    pub depth: DepthFiles,
    /// Folder of masks that show the object, if not those that the camera file names: `{}.png` of each frame.
    pub object_masks: Option<PathBuf>,
    /// Folder of the true depth of the training frames, with names and values as in `depth`.
    pub training_depth: Option<PathBuf>,
    /// Folder of the training images, if deviations of depth are to count them, too.
    pub images: Option<PathBuf>,
    /// Share of errors that an interval of depth is to hold, if one is wanted.
    pub calibrate: Option<f64>,
    /// Whether density, or splats, are removed above [`THRESHOLDS`].
    pub clean_up: bool,
    /// Whether curves are drawn, which need true depth.
    pub curves: bool,
}

/// An evaluation whose files are found.
pub struct Prepared<'a> {
    evaluation: Evaluation<'a>,
    frames: Vec<Frame>,
    /// The cameras that the model was trained on, if they are known.
    training: Vec<NamedCamera>,
    /// How many of the frames belong to them.
    trained_on: usize,
    /// The true depth of the frames; `None` if depth is not judged.
    pub depth: Option<FramesWithDepth>,
    /// The true depth of the training frames.
    pub training_depth: Option<FramesWithDepth>,
    /// The training frames with their images.
    pub images: Option<Vec<Frame>>,
    /// How many frames are used, and why the others are not.
    pub used: String,
    /// What is odd about the inputs.
    pub remarks: Vec<Message>,
}

/// What an evaluation found.
pub struct Judged {
    /// All figures.
    pub report: Report,
    /// What the cameras should see, for the pictures of a clean-up; empty without.
    pub truths: Vec<TrueView>,
    /// The views after each clean-up; the first is the model as it is.
    pub cleaned: Vec<(CleanUp, Vec<RenderedView>)>,
}

impl Evaluation<'_> {
    /// Default stride: every pixel.
    pub const STRIDE: u32 = 1;
    /// Default share of errors that a calibrated interval is to hold.
    pub const PROBABILITY: f64 = 0.9;
}

impl<'a> Evaluation<'a> {
    /// Whether depth is evaluated: always, unless only the clean-up is requested.
    #[must_use]
    pub fn judges_depth(&self) -> bool {
        let DepthFiles { folder, scale, kind, .. } = &self.depth;
        let has_maps = folder.is_some()
            || scale.is_some()
            || *kind == DepthKind::Z
            || self.training_depth.is_some()
            || self.images.is_some();
        !self.clean_up || has_maps || self.curves || self.calibrate.is_some() || !self.ensemble.is_empty()
    }

    /// Finds the files of the frames of [`Evaluation::cameras`], and checks what can be checked before any work.
    ///
    /// # Errors
    /// If a member of the ensemble covers another box or is of another kind, if a field has no deviation of depth to
    /// calibrate, if there are no such frames, if a lens distorts the images of splats, or if depth maps are missing
    /// ([`DepthFiles::find`]).
    pub fn prepare(self, views: Views) -> Result<Prepared<'a>> {
        self.ensemble.iter().try_for_each(|(name, member)| check_member(name, *member, self.model))?;
        if let (Some(_), Some(first)) = (self.calibrate, self.readings.first()) {
            DepthDeviation::new(&BakedField::unbaked(&first.field), None)?;
        }
        let all = views.frames.clone();
        let wanted = self.readings.first().and_then(|reading| reading.field.record().cameras_checksum);
        let training = training_cameras(self.model, &self.name, wanted, &self.cameras, &views);
        let length = self.model.main_box().longest_edge();
        let is_known = |frame: &Frame| training.iter().any(|known| known.camera.is_like(&frame.camera, length));
        let split = FrameSplit::new(views).by_model(is_known);
        let frames = split.select(Part::HeldOut, &self.selection, |_| true)?;
        let frames = if self.judges_depth() { self.with_object_masks(frames, &all)? } else { frames };
        let mut remarks = Vec::new();
        frames.iter().try_for_each(|frame| self.model.check_camera(&frame.camera))?;
        let known = frames.iter().filter(|frame| is_known(frame)).count();
        if let (true, Some(first)) = (self.model.depends_on_pixels(), training.first())
            && let Some(other) = frames.iter().find(|frame| frame.camera.resolution != first.camera.resolution)
        {
            let ([w, h], [width, height]) = (other.camera.resolution, first.camera.resolution);
            remarks.push(Message::Warning(format!(
                "images of {w} x {h} pixels, but the splats were trained at {width} x {height}: they look right only \
                 at the size of their training"
            )));
        }
        remarks.extend(self.memory(&frames));
        if known > 0 {
            let n = frames.len();
            remarks.push(Message::Warning(format!(
                "the model was trained on {known} of these {n} frames: it fits them better than others"
            )));
        }
        let depth = self.judges_depth().then(|| self.depth.find(&self.cameras, &frames, &all)).transpose()?;
        if depth.is_none() && frames.iter().any(|frame| frame.depth.is_some()) {
            let text = "the depth maps that the camera file names are not evaluated: --clean-up alone does without \
                        (--depth-encoding, --z-depth or --plot use them)";
            remarks.push(Message::Note(text.into()));
        }
        if let (false, true, true) = (self.model.stores_cameras(), training.is_empty(), depth.is_some()) {
            let text = "splats store no cameras, and no camera file beside them or --cameras has those of the field: \
                        which depths training views confirm is left out";
            remarks.push(Message::Note(text.into()));
        }
        let maps = |folder: &PathBuf| {
            let frames = self.training_frames("--training-depth", &training)?;
            DepthFiles { folder: Some(folder.into()), ..self.depth.clone() }.find(folder, &frames, &frames)
        };
        let training_depth = self.training_depth.as_ref().map(maps).transpose()?;
        let find = |folder: &PathBuf| {
            let has_deviation =
                |reading: &Reading| DepthDeviation::new(&BakedField::unbaked(&reading.field), None).is_ok();
            if !self.readings.iter().any(has_deviation) {
                let expected = "a field of deviations of depth (`uncertainty --for depth`)";
                return Err(Error::setting("--images", expected, "none"));
            }
            find_images(folder, &self.training_frames("--images", &training)?)
        };
        let images = self.images.as_ref().map(find).transpose()?;
        let used = split.describe(Part::HeldOut, &frames);
        Ok(Prepared {
            evaluation: self,
            frames,
            training,
            trained_on: known,
            depth,
            training_depth,
            images,
            used,
            remarks,
        })
    }

    /// The frames with masks of the object: all of them or none.
    fn with_object_masks(&self, frames: Vec<Frame>, all: &[Frame]) -> Result<Vec<Frame>> {
        if let Some(folder) = &self.object_masks {
            return DepthFiles::find_object_masks(folder, &frames, all);
        }
        let Some(with) = frames.iter().find_map(|frame| frame.object.as_ref()) else { return Ok(frames) };
        for frame in &frames {
            let wrong = |found: String| {
                let expected =
                    format!("a mask of the object for every frame, as {} (`object_mask_path`)", with.display());
                Err(Error::malformed(&self.cameras, format!("frame `{}`", frame.name), expected, found))
            };
            match &frame.object {
                None => return wrong("none".into()),
                Some(mask) if !mask.is_file() => return wrong(format!("no file {}", mask.display())),
                Some(_) => {}
            }
        }
        Ok(frames)
    }

    /// In words, the memory that the pixels take until all views are judged, if it is much.
    fn memory(&self, frames: &[Frame]) -> Option<Message> {
        let side = |side: u32| u64::from(side.div_ceil(self.stride));
        let pixels = |frame: &Frame| frame.camera.resolution.map(side).iter().product::<u64>();
        let bytes = BYTES_PER_PIXEL * frames.iter().map(pixels).sum::<u64>();
        (bytes >= MUCH_MEMORY).then(|| {
            Message::Note(format!(
                "the pixels of {} take up to {:.1} GB of memory (--stride N: every Nth pixel along x and y)",
                counted(frames.len(), "view"),
                bytes as f64 / 1e9
            ))
        })
    }

    /// The frames that the model was trained on, whose files `option` names.
    fn training_frames(&self, option: &'static str, cameras: &[NamedCamera]) -> Result<Vec<Frame>> {
        if cameras.is_empty() {
            let expected = if self.model.stores_cameras() {
                "a model that stores its training cameras, such as those of `train`"
            } else {
                "the field's training cameras in a camera file beside the splats or --cameras"
            };
            return Err(Error::setting(option, expected, self.model.describe()));
        }
        Ok(cameras.iter().map(|named| Frame::new(named.camera, &named.name, "")).collect())
    }
}

/// A member of an ensemble must cover the same box as the model. Splats that were trained again have their own boxes,
/// which must share half of what either covers.
fn check_member(name: &str, member: &dyn Model, model: &dyn Model) -> Result<()> {
    let refused = |expected: String, found: String| Err(Error::setting(format!("member `{name}`"), expected, found));
    if model.kind() != member.kind() {
        return refused(format!("{}, as the model", model.kind()), member.kind().into());
    }
    if let Err([expected, found]) = model.check_drawn_like(member) {
        return refused(format!("{expected}, as the model"), found);
    }
    let [expected, found] = [model, member].map(Model::main_box);
    let is_same = if model.ends_at_its_box() {
        let distances = [expected.min() - found.min(), expected.max() - found.max()];
        distances.iter().all(|d| d.abs().max_element() <= 1e-5 * expected.longest_edge())
    } else {
        shared(&expected, &found) >= 0.5
    };
    if is_same {
        return Ok(());
    }
    let [expected, found] = [expected, found].map(|b| format!("{} to {}", b.min(), b.max()));
    Err(Error::setting(format!("box of the member `{name}`"), format!("the model's, {expected}"), found))
}

/// The share of the space in either of two boxes that is in both.
fn shared(a: &Aabb, b: &Aabb) -> f64 {
    let volume = |size: DVec3| size.max(DVec3::ZERO).element_product();
    let both = volume(a.max().min(b.max()) - a.min().max(b.min()));
    both / (volume(a.size()) + volume(b.size()) - both)
}

impl Prepared<'_> {
    /// The frames that are judged.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        self.depth.as_ref().map_or(&self.frames, |found| &found.frames)
    }

    /// Renders all frames, compares, and cleans up and calibrates if requested. `tell` receives messages as they arise.
    ///
    /// # Errors
    /// If a file is damaged, if nearly no value of the depth maps is a measurement or no error of a model explains
    /// half of them, if the pixels are too few, and [`Error::Interrupted`].
    pub fn judge(&self, monitor: &dyn Monitor, tell: &mut dyn FnMut(Message)) -> Result<Judged> {
        let Evaluation { model, settings, readings, .. } = &self.evaluation;
        let offset = settings.offset_for(*model);
        let bounds = model.main_box();
        let jump = JUMP * size_of(*model);
        let meaning = |found: &FramesWithDepth| DepthMeaning { encoding: found.encoding, bounds, jump };
        let truly_seen =
            self.training_depth.as_ref().map(|found| truly_seen(found, &meaning(found), offset, monitor, tell));
        let truly_seen = truly_seen.transpose()?;
        let shown = model.for_images(settings, monitor)?;
        let cameras: Vec<Camera> = self.training.iter().map(|named| named.camera).collect();
        let knows_cameras = self.depth.is_some() && !cameras.is_empty();
        let training = || TrainingViews::render(&*shown, &cameras, offset, monitor);
        let training = knows_cameras.then(training).transpose()?;
        let read = |frames: &Vec<Frame>| Photograph::read_all(frames, shown.background(), offset, monitor);
        let photographs = self.images.as_ref().map(read).transpose()?;
        let members = self.evaluation.ensemble.iter();
        let members = members.map(|(_, member)| member.for_images(settings, monitor));
        let members = members.collect::<Result<Vec<_>>>()?;
        let evaluator = Evaluator {
            members: members.iter().map(AsRef::as_ref).collect(),
            training: training.as_ref(),
            photographs: photographs.as_deref(),
            truly_seen: truly_seen.as_ref(),
            ..Evaluator::new(&*shown, readings)
        };

        let looked = self.look(&evaluator, self.depth.as_ref().map(meaning), offset, monitor)?;
        let views = &looked.views;
        let mut report = Report::new(&self.evaluation, &evaluator, views);
        if let Some(found) = &self.depth {
            report.depth = Some(found.source.to_string_lossy().into());
            let masks = self.evaluation.object_masks.as_ref().unwrap_or(&self.evaluation.cameras);
            let has_masks = found.frames.iter().any(|frame| frame.object.is_some());
            report.object_masks = has_masks.then(|| masks.to_string_lossy().into());
            report.depth_readings = Some(looked.counts);
            let error = looked.error_of_depth(found, *model, tell)?;
            report.depth_error = Some(error);
            let few = || looked.too_few(found, &format!("at least {STEPS} pixels with depth and some error"));
            report.rank(&evaluator, views).ok_or_else(few)?;
            report.verdict = report.verdict(&evaluator, views, self.trained_on, are_far_off(&error, *model));
        }
        if let (Some(probability), Some(found)) = (self.evaluation.calibrate, &self.depth) {
            let few =
                || looked.too_few(found, &format!("more pixels with known depth (for probability {probability})"));
            report.calibrated = Some(Interval::calibrate(&evaluator, views, probability).ok_or_else(few)?);
        }
        let cleaned = match (self.evaluation.clean_up, evaluator.baked.first()) {
            (true, Some(field)) => clean_up(*model, &*shown, field, &looked.truths, &THRESHOLDS, monitor)?,
            _ => Vec::new(),
        };
        report.clean_up = cleaned.iter().map(|(cleaned, _)| *cleaned).collect();
        Ok(Judged { report, truths: looked.truths, cleaned })
    }

    /// The loop over all frames.
    fn look(
        &self,
        evaluator: &Evaluator,
        depth: Option<DepthMeaning>,
        offset: f64,
        monitor: &dyn Monitor,
    ) -> Result<Looked> {
        let Evaluation { settings, stride, clean_up, .. } = &self.evaluation;
        let kind = depth.map(|depth| depth.encoding.kind).unwrap_or_default();
        let mut looked = Looked::default();
        let rows = self.frames().iter().map(|frame| u64::from(frame.camera.resolution[1].div_ceil(*stride)));
        let times = 1 + evaluator.members.len() as u64 + u64::from(evaluator.with_images().is_some());
        monitor.begin("rows", rows.sum::<u64>() * times);
        for (seed, frame) in (0..).zip(self.frames()) {
            let truth = TrueView::read(frame, depth.as_ref(), settings.background.as_dvec3(), offset, *stride)?;
            let view = evaluator.evaluate(&truth, seed, monitor)?;
            let other = truth.distance_if_not(kind);
            let error = |&i: &usize| Some((view.rendered.pixels[i].median_depth - other[i]?).abs());
            looked.otherwise.extend(view.pixels.iter().filter_map(error));
            looked.counts += truth.readings;
            looked.largest.count(truth.largest_depth(kind));
            // Whole images are large, and only the clean-up needs the true ones again.
            looked.views.push(EvaluatedView { rendered: RenderedView::default(), ..view });
            looked.truths.extend(clean_up.then_some(truth));
        }
        monitor.end();
        Ok(looked)
    }
}

/// What the training cameras truly saw. Notes what their depth maps lack.
fn truly_seen(
    maps: &FramesWithDepth,
    depth: &DepthMeaning,
    offset: f64,
    monitor: &dyn Monitor,
    tell: &mut dyn FnMut(Message),
) -> Result<TrainingViews> {
    let (seen, counts) = from_depth_maps(&maps.frames, depth, offset, monitor)?;
    if counts.are_nearly_all_unmeasured() {
        let expected = "depths of what the model shows in at least 1 % of the pixels (--depth-encoding)";
        return Err(Error::malformed(&maps.source, "depth maps of training views", expected, counts.to_string()));
    }
    if counts.measured < counts.total() {
        tell(Message::Note(format!("training views: {counts}; pixels without depth are treated as unoccluded")));
    }
    Ok(seen)
}
