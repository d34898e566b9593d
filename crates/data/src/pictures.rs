//! Where the picture of a frame is, and which of its pixels count.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::Frame;
use super::image::{decode, measure};
use super::sizes::is_resized_map;
use octobayes::geometry::Mask;
use octobayes::io::place::folder_of;
use octobayes::{Error, Result};

/// Extensions of pictures, in the order in which they are tried.
const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

/// Masks that take more bytes than this are decoded one at a time.
const LARGE_MASK_BYTES: u64 = 32_000_000;

/// The picture of a frame named `file_path` in a camera file of `folder`.
///
/// Names from Windows, names without an extension and names whose extension is written in the other case are found as
/// instant-ngp finds them. Where there is none of these, this is the name with `.png` added unless it ends in a known
/// extension.
#[must_use]
pub fn image_path(folder: &Path, file_path: &str) -> PathBuf {
    let turned = file_path.replace('\\', "/");
    let names = if turned == file_path { vec![file_path] } else { vec![file_path, &turned] };
    let candidates = names.iter().flat_map(|name| spellings(&folder.join(name)));
    let found = candidates.into_iter().find(|path| path.is_file());
    found.unwrap_or_else(|| {
        let path = folder.join(&turned);
        if has_known_extension(&path) { path } else { with_suffix(&path, "png") }
    })
}

/// Folders of smaller copies of the pictures in `images`, as mip-NeRF 360, gsplat and nerfstudio name them.
pub const SMALLER: [&str; 3] = ["images_2", "images_4", "images_8"];

/// The scene, if `path` is a folder of its pictures: `images`, or a smaller copy.
pub(super) fn scene_of(path: &Path) -> Option<&Path> {
    let name = path.file_name()?.to_str()?;
    let is_copy = |times: &str| times.bytes().all(|b| b.is_ascii_digit());
    let is_of_pictures = name == "images" || name.strip_prefix("images_").is_some_and(is_copy);
    (is_of_pictures && path.is_dir()).then(|| folder_of(path))
}

/// The picture that `name` stands for in another folder than `images`; without `images` in its name, that of this name
/// below the folder if it `may_be_below`.
pub(super) fn image_path_in(folder: &Path, pictures: &str, name: &str, may_be_below: bool) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    let mut parts: Vec<&str> = name.split('/').collect();
    match parts.iter().rev().skip(1).position(|part| *part == "images") {
        Some(at) => {
            let at = parts.len() - 2 - at;
            parts[at] = pictures;
        }
        None if may_be_below => parts.insert(0, pictures),
        None => return None,
    }
    Some(image_path(folder, &parts.join("/")))
}

/// The note that pictures of a smaller copy are used, for nobody chose it.
pub(super) fn note_of_smaller(pictures: &Path) -> Option<String> {
    let name = pictures.file_name()?.to_str().filter(|name| SMALLER.contains(name))?;
    Some(format!("no picture is in `images`; those in `{name}` are used"))
}

fn has_known_extension(path: &Path) -> bool {
    path.extension().is_some_and(|extension| EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known)))
}

/// The path as it is, and with every known extension.
fn spellings(path: &Path) -> Vec<PathBuf> {
    let mut spellings = vec![path.to_path_buf()];
    // `r_0.5` is a name without an extension.
    let is_known = has_known_extension(path);
    let with = |extension: &&str| if is_known { path.with_extension(extension) } else { with_suffix(path, extension) };
    spellings.extend(EXTENSIONS.iter().map(with));
    spellings
}

/// The path with a dot and an extension at its end, also if it is not UTF-8.
fn with_suffix(path: &Path, extension: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".");
    name.push(extension);
    PathBuf::from(name)
}

/// A mask: a picture that selects the pixels of another one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MaskFile {
    /// `mask_path` of nerfstudio: pixels that are not black were trained on.
    Kept(PathBuf),
    /// `dynamic_mask_NAME.png` of instant-ngp: pixels that are not black were left out.
    LeftOut(PathBuf),
}

impl MaskFile {
    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Kept(path) | Self::LeftOut(path) => path,
        }
    }

    /// instant-ngp's mask of a picture, if it is there.
    #[must_use]
    pub fn beside(image: &Path) -> Option<Self> {
        let mut name = OsString::from("dynamic_mask_");
        name.push(image.file_stem()?);
        name.push(".png");
        let path = image.with_file_name(name);
        path.is_file().then_some(Self::LeftOut(path))
    }

    /// Reads the mask of a picture of `size` pixels. In a smaller one the pixels at the same places count; of a larger
    /// one all that a pixel covers.
    fn read(&self, size: [u32; 2]) -> Result<Mask> {
        let (own, _) = measure(self.path(), "mask")?;
        let image = decode(self.path(), "mask", if is_resized_map(own, size) { own } else { size })?;
        let mut is_black = Vec::with_capacity(own[0] as usize * own[1] as usize);
        let (mut first, mut is_of_one_color) = (None, true);
        for row in 0..own[1] {
            // 16 bits hold both depths of pixels exactly, so that only 0 becomes 0.
            let pixels = image.crop_imm(0, row, own[0], 1).into_rgba16();
            // Programs that cut objects out leave the shape in alpha, and any colour elsewhere. nerfstudio refuses it.
            if let Some(column) = pixels.pixels().position(|p| p.0[3] != u16::MAX) {
                let expected = "an opaque image, in which black is what counts; save its alpha channel as a grey image";
                let found = format!("a pixel that is not opaque in row {row}, column {column}");
                return Err(Error::malformed(self.path(), "mask", expected, found));
            }
            is_of_one_color &= pixels.pixels().all(|pixel| pixel == first.get_or_insert(*pixel));
            // instant-ngp looks at the first channel only, nerfstudio has one only.
            is_black.extend(pixels.pixels().map(|p| p.0[..3] == [0; 3]));
        }
        // A palette may give the pixels that do not count any colour, and a JPEG makes black nearly black.
        if !is_black.contains(&true) && !is_of_one_color {
            let expected = "an image of one colour, or with pixels that are exactly black; save it as a grey PNG";
            return Err(Error::malformed(self.path(), "mask", expected, "several colours, none of them black"));
        }
        let keeps_black = matches!(self, Self::LeftOut(_));
        let at = |column: u32, row: u32| row as usize * own[0] as usize + column as usize;
        let mask = Mask::new(own, |column, row| is_black[at(column, row)] == keeps_black);
        // Masks of the original pictures may lie beside smaller ones, whose pixels are means.
        Ok(if own[0] > size[0] { mask.shrunk(size) } else { mask.resized(size) })
    }
}

/// Reads the masks of frames, at the size of their cameras; none for frames without one.
///
/// # Errors
/// If a mask is missing, damaged, of another shape than its picture, not opaque, or of several colours without black.
pub fn read_masks(frames: &[Frame]) -> Result<Vec<Option<Mask>>> {
    let read = |frame: &Frame| {
        let Some(file) = &frame.mask else { return Ok(None) };
        Ok(Some(file.read(frame.size)?.resized(frame.camera.resolution)))
    };
    // Large ones one at a time, as memory is planned for one.
    if memory_of_masks(&frames[..frames.len().min(1)]) > LARGE_MASK_BYTES {
        return frames.iter().map(read).collect();
    }
    frames.par_iter().map(read).collect()
}

/// Reads which pixels of a frame show the object, at the size of its camera, if that is known.
///
/// # Errors
/// As [`read_masks`].
pub fn read_object(frame: &Frame) -> Result<Option<Mask>> {
    let read = |path: &PathBuf| Ok(MaskFile::Kept(path.clone()).read(frame.size)?.resized(frame.camera.resolution));
    frame.object.as_ref().map(read).transpose()
}

/// Memory that it takes to decode the largest mask of these frames, bytes.
#[must_use]
pub fn memory_of_masks(frames: &[Frame]) -> u64 {
    let memory = |frame: &Frame| {
        let ([w, h], bytes) = measure(frame.mask.as_ref()?.path(), "mask").ok()?;
        Some(bytes + u64::from(w) * u64::from(h))
    };
    frames.iter().filter_map(memory).max().unwrap_or(0)
}

/// Refuses frames whose masks keep nothing at all.
///
/// # Errors
/// If every frame has a mask, and all of them are black.
pub fn check_masks(path: &Path, masks: &[Option<Mask>]) -> Result<()> {
    if !masks.is_empty() && masks.iter().all(|mask| mask.as_ref().is_some_and(|mask| mask.pixels() == 0)) {
        return Err(Error::malformed(path, "masks", "pixels that were trained on", "masks that keep none"));
    }
    Ok(())
}

/// Refuses a file that two frames claim, one of them `chosen`. Files that do not exist are passed over.
///
/// # Errors
/// If there is one: names both frames, and the file.
pub fn each_has_its_own<'a>(
    source: &Path,
    what: &str,
    claims: impl IntoIterator<Item = (&'a str, &'a Path)>,
    chosen: impl Fn(&str) -> bool,
) -> Result<()> {
    let mut owners: HashMap<PathBuf, &str> = HashMap::new();
    for (name, path) in claims {
        let Ok(file) = path.canonicalize() else { continue };
        let Some(other) = owners.insert(file, name) else { continue };
        if chosen(name) || chosen(other) {
            let expected = "a file for each frame, below the folder from which the frames' names start";
            let found = format!("{} for both `{other}` and `{name}`", path.display());
            return Err(Error::malformed(source, what, expected, found));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use octobayes::geometry::Camera;

    #[test]
    fn pictures_are_found_however_their_names_are_written() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("images")).unwrap();
        for name in ["00.jpg", "01.JPG", "02.png", "r_0.5.png", "odd", "é.png"] {
            std::fs::write(folder.path().join("images").join(name), b"").unwrap();
        }
        for (name, found) in [
            ("images/00.jpg", "images/00.jpg"),
            ("images\\00.jpg", "images/00.jpg"),
            (".\\images\\00", "images/00.jpg"),
            ("images/00", "images/00.jpg"),
            ("images/00.JPG", "images/00.jpg"),
            ("images/00.jpeg", "images/00.jpg"),
            ("images/01.jpg", "images/01.JPG"),
            ("images/01", "images/01.JPG"),
            ("images/r_0.5", "images/r_0.5.png"),
            ("images/odd", "images/odd"),
            ("images/é", "images/é.png"),
            // Not there.
            ("images/03", "images/03.png"),
            ("images\\03.jpg", "images/03.jpg"),
        ] {
            let path = image_path(folder.path(), name);
            let expected: PathBuf = folder.path().join(found).components().collect();
            assert_eq!(path.components().collect::<PathBuf>(), expected, "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn pictures_are_found_in_folders_that_are_not_utf8() {
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        let odd = folder.path().join(std::ffi::OsStr::from_bytes(b"a\xffb"));
        std::fs::create_dir(&odd).unwrap();
        std::fs::write(odd.join("00.png"), b"").unwrap();
        assert_eq!(image_path(&odd, "00"), odd.join("00.png"));
        assert_eq!(image_path(&odd, "01"), odd.join("01.png"));
    }

    #[test]
    fn masks_of_both_kinds_keep_what_was_trained_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dynamic_mask_00.png");
        // White in the left half, but for one grey pixel and one almost black.
        let shade = |x: u32, y: u32| {
            if [x, y] == [3, 1] {
                1
            } else if x < 2 {
                255
            } else {
                0
            }
        };
        image::GrayImage::from_fn(4, 2, |x, y| image::Luma([shade(x, y)])).save(&path).unwrap();
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, [4, 2]);
        let kept = |mask: MaskFile, camera: Camera| {
            let frame = Frame { mask: Some(mask), size: [4, 2], ..Frame::new(camera, "00", "") };
            let mask = read_masks(&[frame]).unwrap().remove(0).unwrap();
            let [w, h] = camera.resolution;
            assert_eq!(mask.resolution(), camera.resolution);
            (0..h).map(|y| (0..w).map(|x| if mask.keeps(x, y) { '#' } else { '.' }).collect()).collect::<Vec<String>>()
        };
        assert_eq!(kept(MaskFile::Kept(path.clone()), camera), ["##..", "##.#"]);
        let beside = MaskFile::beside(&folder.path().join("00.jpg")).unwrap();
        assert_eq!(beside, MaskFile::LeftOut(path.clone()));
        assert_eq!(kept(beside, camera), ["..##", "..#."]);
        assert_eq!(kept(MaskFile::Kept(path.clone()), camera.resized([2, 2])), ["#.", "##"]);
        assert_eq!(MaskFile::beside(&folder.path().join("01.jpg")), None);

        // Of a picture that became smaller, and of one that became larger; of another picture.
        let of = |size: [u32; 2]| {
            let frame = Frame { mask: Some(MaskFile::Kept(path.clone())), size, ..Frame::new(camera, "00", "") };
            read_masks(&[Frame { camera: camera.resized(size), ..frame }]).map(|mut masks| masks.remove(0).unwrap())
        };
        let [small, large] = [[2, 1], [8, 4]].map(|size| of(size).unwrap());
        assert_eq!([small.keeps(0, 0), small.keeps(1, 0)], [true, false]);
        assert!(large.resolution() == [8, 4] && large.keeps(3, 3) && !large.keeps(4, 1) && large.keeps(6, 2));
        for (size, found) in [([8, 8], "8 x 8"), ([5, 2], "5 x 2")] {
            let error = of(size).unwrap_err().to_string();
            assert!(error.contains(&format!("mask: expected {found} pixels, found 4 x 2 pixels")), "{error}");
        }
    }

    #[test]
    fn a_mask_of_several_colours_has_a_black_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.png");
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, [3, 2]);
        let read = |colors: [[u8; 3]; 3]| {
            image::RgbImage::from_fn(3, 2, |x, _| image::Rgb(colors[x as usize])).save(&path).unwrap();
            let frame = Frame { mask: Some(MaskFile::Kept(path.clone())), ..Frame::new(camera, "00", "") };
            read_masks(&[frame]).map(|mut masks| masks.remove(0).unwrap().pixels()).map_err(|e| e.to_string())
        };
        let [black, blue, red] = [[0, 0, 0], [0, 0, 128], [128, 0, 0]];
        assert_eq!(read([black, red, blue]), Ok(4));
        assert_eq!([read([black; 3]), read([red; 3])], [Ok(0), Ok(6)]);
        for odd in [[blue, red, red], [[1; 3], [2; 3], [255; 3]]] {
            let error = read(odd).unwrap_err();
            assert!(error.ends_with("found several colours, none of them black"), "{error}");
        }
    }

    #[test]
    fn a_mask_whose_shape_is_in_its_alpha_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.png");
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, [3, 2]);
        let read = |image: image::DynamicImage| {
            image.save(&path).unwrap();
            let frame = Frame { mask: Some(MaskFile::Kept(path.clone())), ..Frame::new(camera, "00", "") };
            read_masks(&[frame]).map(|mut masks| masks.remove(0).unwrap().pixels()).map_err(|e| e.to_string())
        };
        // Clear in row 1, column 2; black in column 0.
        let clear = |x: u32, y: u32, most: u16| if [x, y] == [2, 1] { 0 } else { most };
        let grey = |x: u32| u8::from(x > 0) * 255;
        let wide = |x: u32| u16::from(x > 0);
        type Alpha<'a> = &'a dyn Fn(u32, u32, u16) -> u16;
        type Image = fn(Alpha, &dyn Fn(u32) -> u8, &dyn Fn(u32) -> u16) -> image::DynamicImage;
        let images: [Image; 4] = [
            |alpha, grey, _| {
                let pixel = |x, y| image::LumaA([grey(x), alpha(x, y, 255) as u8]);
                image::DynamicImage::from(image::ImageBuffer::from_fn(3, 2, pixel))
            },
            |alpha, grey, _| {
                let pixel = |x, y| image::Rgba([grey(x), grey(x), grey(x), alpha(x, y, 255) as u8]);
                image::ImageBuffer::from_fn(3, 2, pixel).into()
            },
            |alpha, _, wide| {
                image::ImageBuffer::from_fn(3, 2, |x, y| image::LumaA([wide(x), alpha(x, y, u16::MAX)])).into()
            },
            |alpha, _, wide| {
                let pixel = |x, y| image::Rgba([wide(x), wide(x), wide(x), alpha(x, y, u16::MAX)]);
                image::ImageBuffer::from_fn(3, 2, pixel).into()
            },
        ];
        for image in images {
            let error = read(image(&clear, &grey, &wide)).unwrap_err();
            assert!(error.contains("found a pixel that is not opaque in row 1, column 2"), "{error}");
            // Of 65,536 shades, 1 is not black.
            assert_eq!(read(image(&|_, _, most| most, &grey, &wide)), Ok(4));
        }
    }
}
