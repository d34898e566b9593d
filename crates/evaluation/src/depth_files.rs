//! Which depth map belongs to which frame.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use octobayes::{Error, Result};
use octobayes_data::{DepthEncoding, DepthKind, Frame, each_has_its_own};

/// Extensions that a frame's `file_path` may have, in any case.
const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "exr"];

/// Location and meaning of true depth maps.
#[derive(Debug, Clone)]
pub struct DepthFiles {
    /// Folder of the maps; `None` for those that the camera file names.
    pub folder: Option<PathBuf>,
    /// Name of a map in the folder; `{}` is the frame's file name without extension.
    pub pattern: String,
    /// Offset and scale of maps that are not in scene units.
    pub scale: Option<[f64; 2]>,
    /// Quantity that the maps measure.
    pub kind: DepthKind,
}

/// Frames, each with its depth map.
#[derive(Debug, Clone)]
pub struct FramesWithDepth {
    /// The frames; [`Frame::depth`] is the map.
    pub frames: Vec<Frame>,
    /// Meaning of the maps' values.
    pub encoding: DepthEncoding,
    /// Where the maps come from: their folder, or the camera file.
    pub source: PathBuf,
    /// The maps of all frames of the camera file, as far as they exist.
    pub files: Vec<PathBuf>,
}

impl DepthFiles {
    /// Name of a map where none is given: that of the NeRF-synthetic data sets.
    pub const PATTERN: &str = "{}_depth_0001.png";

    /// Finds the maps of `frames`, some of `all` the frames of the camera file `cameras`.
    ///
    /// In a folder, a map is looked for below the directories of the frame's `file_path`, with and without a leading
    /// `images`, then with fewer and fewer of them, and at last by its name alone.
    ///
    /// # Errors
    /// If a frame has no map, if another frame has the same one, or if the maps' names and [`DepthFiles::scale`] do not
    /// go together.
    pub fn find(&self, cameras: &Path, frames: &[Frame], all: &[Frame]) -> Result<FramesWithDepth> {
        let (source, encoding, frames) = match &self.folder {
            Some(folder) => {
                let encoding = DepthEncoding::of_maps(Path::new(&self.pattern), self.scale, self.kind)?;
                let find = |frame: &Frame| Ok(Frame { depth: Some(self.find_in(folder, frame)?), ..frame.clone() });
                (folder.as_path(), encoding, frames.iter().map(find).collect::<Result<Vec<Frame>>>()?)
            }
            None => (cameras, self.named(cameras, frames)?, frames.to_vec()),
        };
        let of = |frame: &Frame| match &self.folder {
            Some(folder) => existing(&candidates(folder, &self.pattern, &frame.name)),
            None => frame.depth.clone(),
        };
        let maps: Vec<(&str, PathBuf)> = all.iter().filter_map(|frame| Some((&*frame.name, of(frame)?))).collect();
        let chosen: HashSet<&str> = frames.iter().map(|frame| &*frame.name).collect();
        let claims = maps.iter().map(|(name, path)| (*name, path.as_path()));
        each_has_its_own(source, "depth maps", claims, |name| chosen.contains(name))?;
        let files = maps.into_iter().map(|(_, path)| path).collect();
        Ok(FramesWithDepth { encoding, source: source.into(), files, frames })
    }

    /// Finds the masks of the object of `frames`, some of `all`, in a folder, as maps are found.
    ///
    /// # Errors
    /// If a frame has none, or if another frame has the same one.
    pub(crate) fn find_object_masks(folder: &Path, frames: &[Frame], all: &[Frame]) -> Result<Vec<Frame>> {
        const WHAT: &str = "masks of the object";
        let mask = |frame: &Frame| existing(&candidates(folder, "{}.png", &frame.name));
        let masks: Vec<(&str, PathBuf)> = all.iter().filter_map(|frame| Some((&*frame.name, mask(frame)?))).collect();
        let chosen: HashSet<&str> = frames.iter().map(|frame| &*frame.name).collect();
        let claims = masks.iter().map(|(name, path)| (*name, path.as_path()));
        each_has_its_own(folder, WHAT, claims, |name| chosen.contains(name))?;
        let with_mask = |frame: &Frame| {
            let expected = format!("a PNG with the name of frame `{}`", frame.name);
            let object = mask(frame).ok_or_else(|| Error::malformed(folder, WHAT, expected, "none"))?;
            Ok(Frame { object: Some(object), ..frame.clone() })
        };
        frames.iter().map(with_mask).collect()
    }

    /// The meaning of the maps that the camera file names.
    fn named(&self, cameras: &Path, frames: &[Frame]) -> Result<DepthEncoding> {
        let Some(first) = frames.iter().find_map(|frame| frame.depth.as_ref()) else {
            let expected = "a folder of depth maps, or a camera file that names them (`depth_file_path`)";
            return Err(Error::setting("depth", expected, format!("neither, in {}", cameras.display())));
        };
        for frame in frames {
            let Some(map) = &frame.depth else {
                let expected = "`depth_file_path` for every frame, as for others, or a folder of depth maps";
                return Err(Error::malformed(cameras, format!("frame `{}`", frame.name), expected, "none"));
            };
            DepthEncoding::of_maps(map, self.scale, self.kind)?;
        }
        DepthEncoding::of_maps(first, self.scale, self.kind)
    }

    fn find_in(&self, folder: &Path, frame: &Frame) -> Result<PathBuf> {
        let places = candidates(folder, &self.pattern, &frame.name);
        match (existing(&places), &places[..]) {
            (Some(path), _) => Ok(path),
            // Its reader reports the error.
            (None, [only]) => Ok(only.clone()),
            (None, _) => {
                let below = |path: &PathBuf| path.strip_prefix(folder).unwrap_or(path).display().to_string();
                let expected = format!("a map for frame `{}`", frame.name);
                let found = format!("none of {}", places.iter().map(below).collect::<Vec<_>>().join(", "));
                Err(Error::malformed(folder, "depth maps", expected, found))
            }
        }
    }
}

/// Where the map of a frame with this `file_path` may be, best first.
fn candidates(folder: &Path, pattern: &str, name: &str) -> Vec<PathBuf> {
    // Names may have been written on Windows, or be absolute.
    let is_name = |part: &&str| !["", ".", ".."].contains(part) && !part.ends_with(':');
    let mut directories: Vec<&str> = name.split(['/', '\\']).filter(is_name).collect();
    let stem = without_extension(directories.pop().unwrap_or_default());
    let file = pattern.replace("{}", stem);
    let below = |directories: &[&str]| directories.iter().fold(folder.to_path_buf(), |path, part| path.join(part));
    let mut folders: Vec<PathBuf> = (0..=directories.len()).map(|from| below(&directories[from..])).collect();
    if directories.first().is_some_and(|first| *first != "images") {
        folders.insert(1, below(&[&["images"], &directories[..]].concat()));
    }
    folders.into_iter().map(|folder| folder.join(&file)).collect()
}

fn without_extension(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, extension)) if EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known)) => stem,
        _ => name,
    }
}

/// The first file that exists, with its extension in small letters or capitals.
fn existing(places: &[PathBuf]) -> Option<PathBuf> {
    let spellings = |path: &PathBuf| {
        let extension = path.extension().map(|extension| extension.to_string_lossy().into_owned());
        let other = extension.map(|e| [e.to_lowercase(), e.to_uppercase()].map(|e| path.with_extension(e)));
        std::iter::once(path.clone()).chain(other.into_iter().flatten())
    };
    places.iter().flat_map(spellings).find(|path| path.is_file())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use octobayes::geometry::Camera;

    fn frame(name: &str, depth: Option<&str>) -> Frame {
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 4]);
        Frame { depth: depth.map(PathBuf::from), ..Frame::new(camera, name, "") }
    }

    fn files(folder: Option<&Path>, pattern: &str, scale: Option<[f64; 2]>) -> DepthFiles {
        DepthFiles { folder: folder.map(Into::into), pattern: pattern.into(), scale, kind: DepthKind::Z }
    }

    #[test]
    fn the_directories_of_a_name_are_left_off_one_by_one() {
        let at = |name: &str| -> Vec<String> {
            let found = candidates(Path::new("d"), "{}_z.exr", name);
            found.iter().map(|path| path.to_string_lossy().replace('\\', "/")).collect()
        };
        let [base, front] = ["d/0_z.exr", "d/front/0_z.exr"];
        for name in ["0", "0.png", "./0.PNG", "../0.jpeg", "/0.Jpg", "0.exr"] {
            assert_eq!(at(name), [base], "{name}");
        }
        assert_eq!(at("images/0.png"), ["d/images/0_z.exr", base]);
        for name in ["images/front/0.png", "./images/front/0", "..\\images\\front\\0.JPG", "/images//front/./0.png"] {
            assert_eq!(at(name), ["d/images/front/0_z.exr", front, base], "{name}");
        }
        assert_eq!(at("front/0.png"), [front, "d/images/front/0_z.exr", base]);
        assert_eq!(at("C:\\front\\0.png"), at("front/0.png"));
        // Only an image's extension is one.
        assert_eq!(at("frame.0001"), ["d/frame.0001_z.exr"]);
        assert_eq!(at(""), ["d/_z.exr"]);
    }

    #[test]
    fn maps_that_the_camera_file_names_are_used_without_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        for name in ["a.exr", "b.exr", "0.exr", "1.exr"] {
            std::fs::write(path(name), b"").unwrap();
        }
        let cameras = Path::new("cameras.json");
        let frames = [frame("0.png", Some(&path("a.exr"))), frame("1.png", Some(&path("b.exr")))];
        let found = files(None, "{}.png", None).find(cameras, &frames, &frames).unwrap();
        assert_eq!((&found.frames[..], &*found.source), (&frames[..], cameras));
        assert_eq!(found.encoding, DepthEncoding { offset: 0.0, scale: 1.0, kind: DepthKind::Z });
        // A folder wins.
        let found = files(Some(folder.path()), "{}.exr", None).find(cameras, &frames, &frames).unwrap();
        assert_eq!(found.frames[1].depth, Some(folder.path().join("1.exr")));
        assert_eq!((found.source, found.files.len()), (folder.path().into(), 2));

        let said = |frames: &[Frame], scale| {
            files(None, "{}.exr", scale).find(cameras, &frames[..1], frames).unwrap_err().to_string()
        };
        // PNG needs an encoding, EXR has none.
        let png = [frame("0.png", Some(&path("a.png"))), frame("1.png", None)];
        assert!(said(&png, None).contains("0,65.535 for 16 bits in millimetres"), "{}", said(&png, None));
        assert!(said(&frames, Some([0.0, 1.0])).starts_with("depth encoding: expected none"));
        let found = files(None, "{}.exr", Some([0.0, 65.535])).find(cameras, &png[..1], &png).unwrap();
        assert_eq!(found.encoding, DepthEncoding { offset: 0.0, scale: 65.535, kind: DepthKind::Z });
        // One map of two frames, even if the other frame is not selected.
        let twice = [frames[0].clone(), frame("1.png", Some(&path("a.exr")))];
        assert!(said(&twice, None).ends_with("a.exr for both `0.png` and `1.png`"), "{}", said(&twice, None));
        // None, and some.
        let none = [frame("0.png", None)];
        assert!(said(&none, None).starts_with("depth: expected a folder of depth maps, or a camera file that names"));
        let some = [frame("0.png", None), frames[1].clone()];
        let said = files(None, "{}.exr", None).find(cameras, &some, &some).unwrap_err().to_string();
        assert!(said.starts_with("cameras.json: frame `0.png`: expected `depth_file_path`"), "{said}");
    }
}
