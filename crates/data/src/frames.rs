//! Splits the frames of a camera file into training frames, held-out frames and frames to ignore:
//! one rule for all verbs.
//!
//! Frames without an image are ignored. If no frame has an image, the file only lists cameras, and all of them count.
//! The file's own split decides; or else its name: `transforms_train.json` beside a
//! `transforms_test.json` is all for training, `transforms_test.json` and `transforms_val.json` are all held out; or
//! else the cameras that the model stores. If none of them does, frames are held out that programs hold out which train
//! on such files, sorted by name ([`Rule`]).
//!
//! Frames have the numbers of their file, whichever of them are used. Those programs train on no set with a missing
//! picture, so a picture that is missing now was there: it counts when frames are numbered off.

use std::collections::HashSet;
use std::path::PathBuf;

use super::folders::{is_held_out_by_name, test_partner};
use super::views::{Frame, Purpose, Views};
use octobayes::error::{counted, printable};
use octobayes::{Error, Result};

/// Frames that are named, of those without an image or held out.
const MAX_NAMES: usize = 6;
/// Runs of frames whose numbers are listed.
const RUNS: usize = 20;
/// Of a COLMAP model, one image in this many is held out, from the first on.
const HOLD_OUT: usize = 8;
/// So many images are all for training.
const TOO_FEW: usize = 2;
/// Of other files, the share of the images that are for training.
const TRAINING_SHARE: f64 = 0.9;

/// Purpose of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// For training, and for computing the uncertainty.
    Training,
    /// For evaluation; all frames, if none is held out.
    HeldOut,
}

/// Frames of a part to use.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// All frames of the part.
    #[default]
    All,
    /// All frames of both parts.
    BothParts,
    /// This many frames, spread evenly over the order of the camera file.
    Count(usize),
    /// The frames of these numbers, from 0, in the order of the camera file, whatever part they belong to.
    Indices(Vec<usize>),
}

/// The frames of a camera file, split into parts.
#[derive(Debug, Clone)]
pub struct FrameSplit {
    path: PathBuf,
    /// Number of frames in the file.
    total: usize,
    /// The usable frames and what each is for, in the file's order.
    frames: Vec<(Frame, Purpose)>,
    /// What decides which frames are held out.
    rule: Rule,
    /// Frames without an image, if any other has one.
    missing: Vec<Frame>,
    has_images: bool,
    /// The frames that would be held out if images were there: they are named, but none exists.
    would_be_held_out: Vec<Frame>,
}

/// What decides which frames are held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// The split in the file, or in its name.
    File,
    /// The cameras that the model stores.
    Model,
    /// Of COLMAP models, every eighth: the test set of the original code of Gaussian splatting (`--eval`), gsplat and
    /// nerfstudio's reader of COLMAP, as of LLFF and mip-NeRF 360.
    Eighth,
    /// Of others, a tenth: the test set of nerfstudio, which holds out all but evenly spread nine tenths.
    Tenth,
}

impl Rule {
    /// The rule's frames to hold out: places in the order of names.
    fn held_out(self, count: usize) -> Vec<usize> {
        match self {
            Self::Eighth if count > TOO_FEW => (0..count).step_by(HOLD_OUT).collect(),
            Self::Tenth if count > TOO_FEW => {
                // NumPy's linspace from the first frame to the last, rounded down, has those for training.
                let trained = (count as f64 * TRAINING_SHARE).ceil() as usize;
                let step = (count - 1) as f64 / (trained - 1) as f64;
                let place = |k: usize| if k + 1 == trained { count - 1 } else { (k as f64 * step) as usize };
                let kept: Vec<usize> = (0..trained).map(place).collect();
                (0..count).filter(|place| kept.binary_search(place).is_err()).collect()
            }
            _ => Vec::new(),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::File => "by the file",
            Self::Model => "as the model was not trained on them",
            Self::Eighth => "every eighth by name, the test set of Gaussian splatting and gsplat",
            Self::Tenth => "a tenth, as nerfstudio does",
        }
    }
}

impl FrameSplit {
    /// Splits the frames of a file, after checking which images exist.
    #[must_use]
    pub fn new(views: Views) -> Self {
        let Views { path, frames, .. } = views;
        let total = frames.len();
        let all_held_out = is_held_out_by_name(&path);
        let is_stated = frames.iter().any(|frame| frame.purpose.is_some());
        let has_images = frames.iter().any(|frame| frame.image.exists());
        let rule = match Views::files(&path) {
            _ if is_stated || all_held_out || test_partner(&path).is_some() => Rule::File,
            files if files.iter().any(|file| file.file_stem().is_some_and(|stem| stem == "images")) => Rule::Eighth,
            _ => Rule::Tenth,
        };
        let mut order: Vec<usize> = (0..total).collect();
        if rule == Rule::Tenth {
            // Folder by folder; frames of a COLMAP model are sorted by name already.
            order.sort_by(|&a, &b| frames[a].image.cmp(&frames[b].image));
        }
        let places: HashSet<usize> = rule.held_out(total).into_iter().map(|place| order[place]).collect();
        let purpose = |(i, frame): (usize, &Frame)| match frame.purpose {
            _ if all_held_out => Purpose::HeldOut,
            Some(purpose) => purpose,
            None if is_stated => Purpose::Unused,
            None if has_images && places.contains(&i) => Purpose::HeldOut,
            None => Purpose::Training,
        };
        let purposes: Vec<Purpose> = frames.iter().enumerate().map(purpose).collect();
        let are_named = frames.iter().all(|frame| !frame.name.is_empty());
        let would_be = |(i, _): &(usize, &Frame)| !has_images && are_named && places.contains(i);
        let would_be_held_out = frames.iter().enumerate().filter(would_be).map(|(_, frame)| frame.clone()).collect();
        let is_usable = |frame: &Frame| !has_images || frame.image.exists();
        let (frames, missing): (Vec<_>, Vec<_>) =
            frames.into_iter().zip(purposes).partition(|(frame, _)| is_usable(frame));
        let missing = missing.into_iter().map(|(frame, _)| frame).collect();
        Self { path, total, frames, rule, missing, has_images, would_be_held_out }
    }

    /// Makes the frames for which `is_trained` holds those for training, and holds out the others; unless the file
    /// states the purpose of its frames, or it holds for none.
    #[must_use]
    pub fn by_model(mut self, is_trained: impl Fn(&Frame) -> bool) -> Self {
        if self.rule == Rule::File {
            return self;
        }
        let trained: Vec<bool> = self.frames.iter().map(|(frame, _)| is_trained(frame)).collect();
        if trained.contains(&true) {
            (self.rule, self.would_be_held_out) = (Rule::Model, Vec::new());
            for ((_, purpose), is_trained) in self.frames.iter_mut().zip(trained) {
                *purpose = if is_trained { Purpose::Training } else { Purpose::HeldOut };
            }
        }
        self
    }

    /// In words, that the file has no frame for training, by its split or its name.
    #[must_use]
    pub fn without_training(&self) -> Option<String> {
        let is_held_out = |(_, purpose): &(Frame, Purpose)| *purpose == Purpose::HeldOut;
        let none = self.rule == Rule::File && !self.frames.is_empty() && self.frames.iter().all(is_held_out);
        none.then(|| {
            let partner = self.path.with_file_name("transforms_train.json");
            let instead = if partner.is_file() { format!("; pass {}", partner.display()) } else { String::new() };
            format!(
                "{} lists held-out frames: a model was hardly trained on them, but U would count them as seen{instead}",
                self.path.display()
            )
        })
    }

    /// Returns true if any frame has an image.
    #[must_use]
    pub fn has_images(&self) -> bool {
        self.has_images
    }

    /// Number of frames without an image, if any other has one.
    #[must_use]
    pub fn missing(&self) -> usize {
        self.missing.len()
    }

    /// Selects frames of a part for which `keep` holds, in the file's order. A count counts those for which it holds.
    ///
    /// # Errors
    /// If there are no such frames, or if one of them has no image.
    pub fn select(&self, part: Part, selection: &Selection, keep: impl Fn(&Frame) -> bool) -> Result<Vec<Frame>> {
        let frames = self.matching(part, selection, keep)?;
        if frames.is_empty() {
            let expected = match part {
                Part::Training => "frames that are for training",
                Part::HeldOut => "frames that are held out, or for training",
            };
            return Err(Error::malformed(&self.path, "frames", expected, format!("none of {}", self.total)));
        }
        Ok(frames)
    }

    /// The same frames, which may be none.
    ///
    /// # Errors
    /// If one of them has no image, or if the cameras are those of a camera path.
    pub fn matching(&self, part: Part, selection: &Selection, keep: impl Fn(&Frame) -> bool) -> Result<Vec<Frame>> {
        if self.frames.iter().any(|(frame, _)| frame.purpose == Some(Purpose::Planned)) {
            let expected = "cameras of pictures; pass the data set's transforms.json or COLMAP model, as the frame of \
                            a nerfstudio run by its dataparser_transforms.json";
            let found =
                "a camera path, along which no picture was taken (`next-view --candidates` and `render` read it)";
            return Err(Error::malformed(&self.path, "cameras", expected, found));
        }
        let mut frames = match selection {
            Selection::Indices(indices) => self.numbered(indices)?,
            Selection::BothParts => self.frames.iter().map(|(frame, _)| frame).collect(),
            _ => self.part(part),
        };
        frames.retain(|frame| keep(frame));
        let n = frames.len();
        if let Selection::Count(count) = selection {
            if *count > n {
                return Err(Error::setting("training views", format!("at most {n} images"), count.to_string()));
            }
            let kept: Vec<usize> = (0..*count).map(|i| (2 * i + 1) * n / (2 * count)).collect();
            let mut index = 0..n;
            frames.retain(|_| index.next().is_some_and(|i| kept.contains(&i)));
        }
        Ok(frames.into_iter().cloned().collect())
    }

    /// The frames of these numbers.
    fn numbered(&self, indices: &[usize]) -> Result<Vec<&Frame>> {
        if let Some(i) = indices.iter().find(|i| **i >= self.total) {
            let expected = format!("numbers of frames from 0 to {}", self.total - 1);
            return Err(Error::setting("views", expected, i.to_string()));
        }
        if let Some(frame) = self.missing.iter().find(|frame| indices.contains(&frame.index)) {
            let expected = "frames with an image, as others have one";
            return Err(Error::setting(
                "views",
                expected,
                format!("frame {} (no {})", frame.index, frame.image.display()),
            ));
        }
        let frames = self.frames.iter().map(|(frame, _)| frame);
        Ok(frames.filter(|frame| indices.contains(&frame.index)).collect())
    }

    fn of(&self, wanted: Purpose) -> Vec<&Frame> {
        self.frames.iter().filter(|(_, purpose)| *purpose == wanted).map(|(frame, _)| frame).collect()
    }

    fn part(&self, part: Part) -> Vec<&Frame> {
        let [own, other] = part.purposes();
        let frames = self.of(own);
        // A file with one part serves as either.
        if frames.is_empty() { self.of(other) } else { frames }
    }

    /// Describes in a sentence how many frames are `used` as this part, and why the others are not.
    #[must_use]
    pub fn describe(&self, part: Part, used: &[Frame]) -> String {
        let mut others = Vec::new();
        if let Some(first) = self.missing.first() {
            let has = if self.missing.len() == 1 { "has" } else { "have" };
            let name = |frame: &Frame| frame.image.file_name().map(|name| name.to_string_lossy().into_owned());
            let mut names = vec![first.image.display().to_string()];
            names.extend(self.missing[1..].iter().take(MAX_NAMES - 1).filter_map(name));
            let more = self.missing.len().saturating_sub(MAX_NAMES);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            others.push(format!("{} {has} no image ({}{more})", self.missing.len(), printable(&names.join(", "))));
        }
        if let Some((first, _)) = self.frames.first().filter(|_| !self.would_be_held_out.is_empty()) {
            let name = printable(&first.image.display().to_string());
            let those = numbered_names(&self.would_be_held_out);
            others.push(format!(
                "no image is there, such as {name}, so that no frame is held out, though training may have held out \
                 {those}"
            ));
        }
        let [own, other] = part.purposes();
        // A file with one part serves as either.
        let has_both = self.frames.iter().any(|(_, purpose)| *purpose == own);
        let left = |wanted: Purpose| {
            let is_left = |(frame, purpose): &&(Frame, Purpose)| *purpose == wanted && !used.contains(frame);
            self.frames.iter().filter(is_left).count()
        };
        let other_part = if has_both { left(other) } else { 0 };
        if other_part > 0 {
            let is = if other_part == 1 { "is" } else { "are" };
            let (rule, held_out) = (self.rule.words(), numbered_names(&self.of(Purpose::HeldOut)));
            others.push(match part {
                Part::Training => format!("{other_part} {is} held out, {rule}: {held_out} (views `all` takes both)"),
                Part::HeldOut => {
                    format!("{other_part} {is} for training (views `all` takes both); held out, {rule}: {held_out}")
                }
            });
        }
        let unused = left(Purpose::Unused);
        if unused > 0 {
            others.push(format!("{unused} {} in neither part", if unused == 1 { "is" } else { "are" }));
        }
        let other_part = other_part + unused;
        let rest = self.frames.len().saturating_sub(other_part + used.len());
        if rest > 0 {
            others.push(format!("{rest} not chosen; used are {}", numbers(used)));
        }
        let others = if others.is_empty() { String::new() } else { format!(": {}", others.join(", ")) };
        let (cameras, frames) = (counted(used.len(), "camera"), counted(self.total, "frame"));
        format!("{cameras} of {frames} of {}{others}", self.path.display())
    }
}

impl Part {
    /// What frames of this part are for, and those of the other.
    fn purposes(self) -> [Purpose; 2] {
        match self {
            Self::Training => [Purpose::Training, Purpose::HeldOut],
            Self::HeldOut => [Purpose::HeldOut, Purpose::Training],
        }
    }
}

/// Frames by number and name, such as `0 (a.png), 8 (b.png) and 3 more`.
fn numbered_names<F: std::borrow::Borrow<Frame>>(frames: &[F]) -> String {
    let name = |frame: &F| {
        let Frame { index, name, .. } = frame.borrow();
        if name.is_empty() { index.to_string() } else { format!("{index} ({})", printable(name)) }
    };
    let more = frames.len().saturating_sub(MAX_NAMES);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    frames.iter().take(MAX_NAMES).map(name).collect::<Vec<_>>().join(", ") + &more
}

/// The numbers of frames in words, such as `frames 0, 2-4, 9`.
fn numbers(frames: &[Frame]) -> String {
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for frame in frames {
        match runs.last_mut().filter(|run| run[1] + 1 == frame.index) {
            Some(run) => run[1] = frame.index,
            None => runs.push([frame.index; 2]),
        }
    }
    let run = |[first, last]: &[usize; 2]| if first == last { first.to_string() } else { format!("{first}-{last}") };
    let more = if runs.len() > RUNS { ", …" } else { "" };
    let listed: Vec<String> = runs.iter().take(RUNS).map(run).collect();
    format!("{} {}{more}", if frames.len() == 1 { "frame" } else { "frames" }, listed.join(", "))
}

#[cfg(test)]
mod tests;
