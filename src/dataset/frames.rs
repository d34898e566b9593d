//! Splits the frames of a camera file into training frames, held-out frames and frames to ignore:
//! one rule for all verbs.
//!
//! Frames without an image are ignored. If no frame has an image, the file only lists cameras, and all of them count.
//! Otherwise every eighth frame is held out, unless the file's name decides: `transforms_train.json` beside a
//! `transforms_test.json` is all for training, `transforms_test.json` and `transforms_val.json` are all held out.

use std::path::{Path, PathBuf};

use super::{Frame, Views};
use crate::error::printable;
use crate::{Error, Result};

/// Missing images that are named.
const NAMED: usize = 6;
/// One image in this many is held out, unless the name of the file decides.
const HOLD_OUT: usize = 8;

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
    /// The frames of these indices, from 0, in the order of the camera file.
    Indices(Vec<usize>),
}

/// The frames of a camera file, split into parts.
#[derive(Debug, Clone)]
pub struct FrameSplit {
    path: PathBuf,
    /// Number of frames in the file.
    total: usize,
    /// The usable frames, each with true if it is held out; in the file's order.
    frames: Vec<(Frame, bool)>,
    /// Missing images, if any other exists.
    missing: Vec<PathBuf>,
    has_images: bool,
}

impl FrameSplit {
    /// Splits the frames of a file, after checking which images exist.
    #[must_use]
    pub fn new(views: Views) -> Self {
        let Views { path, frames, .. } = views;
        let total = frames.len();
        let (mut usable, others): (Vec<Frame>, Vec<Frame>) = frames.into_iter().partition(|frame| frame.image.exists());
        let (has_images, mut missing) = (!usable.is_empty(), Vec::new());
        if has_images {
            missing = others.into_iter().map(|frame| frame.image).collect();
        } else {
            usable = others;
        }
        let all_held_out = is_held_out_by_name(&path);
        let is_split = has_images && test_partner(&path).is_none() && !all_held_out;
        // Starts in the middle of the first eight, so that a single image is for training.
        let is_held_out = |i: usize| all_held_out || is_split && i % HOLD_OUT == HOLD_OUT / 2 - 1;
        let frames = usable.into_iter().enumerate().map(|(i, frame)| (frame, is_held_out(i))).collect();
        Self { path, total, frames, missing, has_images }
    }

    /// Returns true if any frame has an image.
    #[must_use]
    pub fn has_images(&self) -> bool {
        self.has_images
    }

    /// Missing images, if any other exists.
    #[must_use]
    pub fn missing(&self) -> &[PathBuf] {
        &self.missing
    }

    /// Selects frames of a part for which `keep` holds, in the file's order. Indices count before `keep`
    /// applies, a count after it.
    ///
    /// # Errors
    /// If there are no such frames.
    pub fn select(&self, part: Part, selection: &Selection, keep: impl Fn(&Frame) -> bool) -> Result<Vec<Frame>> {
        let mut frames = self.part(part, *selection == Selection::BothParts);
        let n = frames.len();
        if let Selection::Indices(indices) = selection {
            if let Some(i) = indices.iter().find(|i| **i >= n) {
                let expected = format!("indices of images from 0 to {}", n.saturating_sub(1));
                return Err(Error::setting("training views", expected, i.to_string()));
            }
            let mut index = 0..n;
            frames.retain(|_| index.next().is_some_and(|i| indices.contains(&i)));
        }
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

    fn part(&self, part: Part, both: bool) -> Vec<&Frame> {
        let of = |held_out: bool| -> Vec<&Frame> {
            self.frames.iter().filter(|(_, is)| both || *is == held_out).map(|(frame, _)| frame).collect()
        };
        let frames = of(part == Part::HeldOut);
        // A file with one part serves as either.
        if frames.is_empty() { of(part != Part::HeldOut) } else { frames }
    }

    /// Describes in a sentence how many frames are `used` as this part, and why the others are not.
    #[must_use]
    pub fn describe(&self, part: Part, used: &[Frame]) -> String {
        let mut others = Vec::new();
        if let Some(first) = self.missing.first() {
            let has = if self.missing.len() == 1 { "has" } else { "have" };
            let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
            let mut names = vec![first.display().to_string()];
            names.extend(self.missing[1..].iter().take(NAMED - 1).filter_map(name));
            let more = self.missing.len().saturating_sub(NAMED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            others.push(format!("{} {has} no image ({}{more})", self.missing.len(), printable(&names.join(", "))));
        }
        let is_other = |is_held_out: bool| is_held_out != (part == Part::HeldOut);
        // A file with one part serves as either.
        let has_both = self.frames.iter().any(|(_, is)| !is_other(*is));
        let is_left = |(frame, is): &&(Frame, bool)| has_both && is_other(*is) && !used.contains(frame);
        let other_part = self.frames.iter().filter(is_left).count();
        if other_part > 0 {
            let (is, for_what) = match part {
                Part::Training => (if other_part == 1 { "is" } else { "are" }, "held out, every eighth"),
                Part::HeldOut => (if other_part == 1 { "is" } else { "are" }, "for training"),
            };
            others.push(format!("{other_part} {is} {for_what} (views `all` takes both)"));
        }
        let rest = self.frames.len().saturating_sub(other_part + used.len());
        if rest > 0 {
            others.push(format!("{rest} not chosen"));
        }
        let others = if others.is_empty() { String::new() } else { format!(": {}", others.join(", ")) };
        let cameras = if used.len() == 1 { "camera" } else { "cameras" };
        format!("{} {cameras} of {} frames of {}{others}", used.len(), self.total, self.path.display())
    }
}

fn has_name(path: &Path, names: &[&str]) -> bool {
    path.file_name().is_some_and(|name| names.iter().any(|known| name == *known))
}

fn is_held_out_by_name(path: &Path) -> bool {
    has_name(path, &["transforms_test.json", "transforms_val.json"])
}

/// The camera file that `path` means for a part. Of a folder it is `transforms_train.json` or `transforms_test.json`,
/// or else `transforms.json` or the COLMAP model, in this order.
#[must_use]
pub fn camera_file(path: &Path, part: Part) -> PathBuf {
    let of_part = match part {
        Part::Training => "transforms_train.json",
        Part::HeldOut => "transforms_test.json",
    };
    let mut files = [of_part, "transforms.json"].map(|name| path.join(name)).into_iter();
    files.find(|file| file.is_file()).unwrap_or_else(|| path.to_path_buf())
}

/// The file of held-out frames that belongs to a file of training frames, if it exists.
#[must_use]
pub fn test_partner(path: &Path) -> Option<PathBuf> {
    let partner = path.with_file_name("transforms_test.json");
    (has_name(path, &["transforms_train.json"]) && partner.exists()).then_some(partner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::write_transforms;
    use crate::field::ClosedForm;

    /// A folder with camera files of 20 frames, where only the given `images` exist.
    fn split(name: &str, images: &[usize]) -> (tempfile::TempDir, FrameSplit) {
        let folder = tempfile::tempdir().unwrap();
        let cameras = ClosedForm::half_circle(20, [8, 8]).into_iter().enumerate();
        let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
        for file in ["transforms_test.json", name] {
            write_transforms(&folder.path().join(file), &named).unwrap();
        }
        for i in images {
            std::fs::write(folder.path().join(format!("r_{i}.png")), b"").unwrap();
        }
        let split = FrameSplit::new(Views::read(&folder.path().join(name), Some([8, 8])).unwrap());
        (folder, split)
    }

    fn names(frames: &[Frame]) -> Vec<&str> {
        frames.iter().map(|frame| frame.name.as_str()).collect()
    }

    #[test]
    fn missing_images_are_left_out_before_every_eighth_is_held_out() {
        let images: Vec<usize> = (0..20).filter(|i| ![1, 5].contains(i)).collect();
        let (folder, split) = split("transforms.json", &images);
        let select = |part, selection: &Selection| split.select(part, selection, |_| true).unwrap();
        let [training, held_out] = [Part::Training, Part::HeldOut].map(|part| select(part, &Selection::All));
        // The fourth and the twelfth of 0 2 3 4 6 7 8 9 10 11 12 13 ….
        assert_eq!(names(&held_out), ["r_4", "r_13"]);
        assert_eq!((training.len(), names(&training)[3]), (16, "r_6"));
        assert_eq!(select(Part::Training, &Selection::BothParts).len(), 18);
        let three = select(Part::Training, &Selection::Count(3));
        assert_eq!(names(&three), [2, 8, 13].map(|i| names(&training)[i]));
        assert_eq!(names(&select(Part::Training, &Selection::Indices(vec![0, 3]))), ["r_0", "r_6"]);
        assert!(split.select(Part::Training, &Selection::Count(17), |_| true).is_err());
        assert!(split.select(Part::Training, &Selection::Indices(vec![16]), |_| true).is_err());

        let path = folder.path().display();
        let start = format!("of 20 frames of {path}/transforms.json: 2 have no image ({path}/r_1.png, r_5.png)");
        let held = "2 are held out, every eighth (views `all` takes both)";
        assert_eq!(split.describe(Part::Training, &training), format!("16 cameras {start}, {held}"));
        assert_eq!(split.describe(Part::Training, &three), format!("3 cameras {start}, {held}, 13 not chosen"));
        let both = select(Part::Training, &Selection::BothParts);
        assert_eq!(split.describe(Part::Training, &both), format!("18 cameras {start}"));
        let judged = split.describe(Part::HeldOut, &held_out);
        assert_eq!(judged, format!("2 cameras {start}, 16 are for training (views `all` takes both)"));
    }

    #[test]
    fn a_folder_means_the_file_of_the_part() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| std::fs::write(folder.path().join(name), b"").unwrap();
        let named = |part| camera_file(folder.path(), part);
        ["cameras.txt", "images.txt"].into_iter().for_each(write);
        assert_eq!(named(Part::Training), folder.path(), "a model of COLMAP");
        write("transforms.json");
        assert_eq!(
            [named(Part::Training), named(Part::HeldOut)],
            ["transforms.json"; 2].map(|name| folder.path().join(name))
        );
        ["transforms_train.json", "transforms_test.json"].into_iter().for_each(write);
        let file = folder.path().join("transforms_train.json");
        assert_eq!(named(Part::Training), file);
        assert_eq!(named(Part::HeldOut), folder.path().join("transforms_test.json"));
        assert_eq!(camera_file(&file, Part::HeldOut), file);
    }

    #[test]
    fn files_that_say_what_they_are_for_are_not_split() {
        let all: Vec<usize> = (0..20).collect();
        for name in ["transforms_train.json", "transforms_test.json", "transforms_val.json"] {
            let (_folder, split) = split(name, &all);
            for part in [Part::Training, Part::HeldOut] {
                assert_eq!(split.select(part, &Selection::All, |_| true).unwrap().len(), 20, "{name}");
            }
        }
        // Without any image it is a file of cameras.
        let (_folder, split) = split("transforms.json", &[]);
        assert!(!split.has_images() && split.missing().is_empty());
        assert_eq!(split.select(Part::Training, &Selection::All, |_| true).unwrap().len(), 20);
    }
}
