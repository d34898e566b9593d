//! Sizes of pictures, from their first bytes, and cameras that are stated for another size.
//!
//! Tanks and Temples, Deep Blending and every data set with `images_4` have cameras of larger pictures than those that
//! are there. The original code, gsplat and nerfstudio let the intrinsics follow the picture.

use std::fs::File;
use std::io::{Cursor, Read};
use std::path::Path;

use image::metadata::Orientation;
use image::{ImageDecoder, ImageReader};
use rayon::prelude::*;

use super::views::Views;
use octobayes::error::printable;
use octobayes::geometry::MAX_PIXELS;
use octobayes::{Error, Result};

/// First bytes of a picture that are read, more if its size does not stand in them: thumbnails and profiles come first.
const FIRST_BYTES: [u64; 3] = [1 << 14, 1 << 18, 1 << 24];
/// Larger factors between the sides of two pictures are no change of size that anybody makes. A small file cannot claim
/// more memory than this allows.
const LARGEST_FACTOR: f64 = 32.0;
/// How files are turned as their EXIF orientation demands.
const TURN: &str = "`mogrify -auto-orient` or `jhead -autorot` turns the files themselves";

/// Whether sides of pictures have the same ratio up to rounding: two that are off by less than a pixel.
pub fn has_shape([w, h]: [u32; 2], [other_w, other_h]: [u32; 2]) -> bool {
    let [w, h, other_w, other_h] = [w, h, other_w, other_h].map(u64::from);
    (w * other_h).abs_diff(h * other_w) < (w + h).max(other_w + other_h)
}

/// Whether a picture of the other size may be this one resized. A crop is not, nor a picture that was turned.
pub(super) fn is_resized(size: [u32; 2], other: [u32; 2]) -> bool {
    let factors = [0, 1].map(|k| f64::from(other[k]) / f64::from(size[k]));
    let is_usual = |factor: f64| (1.0 / LARGEST_FACTOR..=LARGEST_FACTOR).contains(&factor);
    let fits = other.map(f64::from).iter().product::<f64>() <= MAX_PIXELS;
    has_shape(size, other) && factors.into_iter().all(is_usual) && fits
}

/// Whether a map that lies beside a picture, of these sizes, can be read by the nearest pixel. A side alone that is off
/// by a pixel is a mistake.
pub(super) fn is_resized_map(map @ [w, h]: [u32; 2], picture: [u32; 2]) -> bool {
    map == picture || w != picture[0] && h != picture[1] && is_resized(picture, map)
}

/// Width and height in words.
pub(super) fn in_words([w, h]: [u32; 2]) -> String {
    format!("{w} x {h}")
}

/// What the first bytes of a picture state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Head {
    /// Width and height as stored, pixels.
    pub size: [u32; 2],
    /// EXIF orientation, 1 to 8; 1 is upright.
    pub orientation: u8,
}

impl Head {
    /// Of a decoder that has read them.
    pub fn of(decoder: &mut impl ImageDecoder) -> Self {
        let (w, h) = decoder.dimensions();
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms).to_exif();
        Self { size: [w, h], orientation }
    }

    /// Of a file, if it is a picture.
    pub fn read(path: &Path) -> Option<Self> {
        // A pipe would wait.
        let mut file = path.is_file().then(|| File::open(path).ok()).flatten()?;
        let mut bytes = Vec::new();
        FIRST_BYTES.into_iter().find_map(|most| {
            (&mut file).take(most - bytes.len() as u64).read_to_end(&mut bytes).ok()?;
            let reader = ImageReader::new(Cursor::new(&bytes)).with_guessed_format().ok()?;
            reader.into_decoder().ok().map(|mut decoder| Self::of(&mut decoder))
        })
    }

    /// Whether a camera of this size is that of the picture as its EXIF orientation turns it.
    pub fn is_turned_for(self, camera: [u32; 2]) -> bool {
        let [w, h] = self.size;
        self.orientation > 4 && !is_resized(camera, self.size) && is_resized(camera, [h, w])
    }

    /// Whether the size does not show if cameras are those of the picture as it is stored, or as EXIF turns it.
    fn is_ambiguous(self) -> bool {
        self.orientation > 1 && (self.orientation < 5 || self.size[0] == self.size[1])
    }

    /// Refuses a picture of another size than its camera's.
    pub fn check(self, path: &Path, what: &str, camera: [u32; 2]) -> Result<()> {
        if self.size == camera {
            return Ok(());
        }
        let [expected, found] = self.expected_and_found(camera);
        Err(Error::malformed(path, what, expected, found))
    }

    /// What a picture must be for a camera of this size and what it is, if these differ.
    pub fn expected_and_found(self, camera: [u32; 2]) -> [String; 2] {
        let [expected, found] = [camera, self.size].map(|size| format!("{} pixels", in_words(size)));
        if !self.is_turned_for(camera) {
            return [expected, found];
        }
        let found = format!("{found} with EXIF orientation {}, which is not applied", self.orientation);
        [format!("{expected} ({TURN})"), found]
    }
}

/// Lets cameras and sizes follow the pictures that are there. With `is_requested`, the size of the cameras is not
/// that of the file. Adds notes about it.
pub(super) fn follow_pictures(views: &mut Views, is_requested: bool) {
    let heads: Vec<Option<Head>> = views.frames.par_iter().map(|frame| Head::read(&frame.image)).collect();
    let there = heads.iter().flatten().count();
    let (mut resized, mut others, mut turned) = (Vec::new(), Vec::new(), Vec::new());
    for (frame, head) in views.frames.iter_mut().zip(heads) {
        let Some(head) = head else { continue };
        let (name, stated, found) = (printable(&frame.name), in_words(frame.size), in_words(head.size));
        if head.size == frame.size {
            if head.is_ambiguous() {
                turned.push(format!("`{name}` has orientation {}", head.orientation));
            }
        } else if is_resized(frame.size, head.size) {
            frame.size = head.size;
            if !is_requested {
                frame.camera = frame.camera.resized(head.size);
                resized.push(format!("`{name}` has {found} pixels, its camera {stated}"));
            }
        } else {
            let [_, found] = head.expected_and_found(frame.size);
            let crop = "the camera of a cropped picture is another";
            let way_out = if head.is_turned_for(frame.size) { TURN } else { crop };
            others.push(format!("`{name}` has {found}, its camera {stated}; {way_out}"));
        }
    }
    let notes = [
        ("cameras are resized to their pictures", resized, ""),
        ("pictures have another shape than their cameras", others, ""),
        ("EXIF orientation is not applied", turned, "; if the cameras are of upright pictures, "),
    ];
    for (what, list, end) in notes {
        let Some(first) = list.first() else { continue };
        let way_out = if end.is_empty() { "" } else { TURN };
        views.notes.push(format!("{what} ({} of {there}): {first}{end}{way_out}", list.len()));
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::Frame;
    use super::super::views::ResolutionSource;
    use super::*;
    use octobayes::geometry::Camera;

    #[test]
    fn a_size_that_was_rounded_is_told_from_a_crop() {
        for (camera, picture) in [
            // Tanks and Temples and mip-NeRF 360, as published, and the other way round.
            ([1957, 1091], [979, 546]),
            ([1959, 1090], [980, 545]),
            ([979, 546], [1957, 1091]),
            ([5187, 3361], [1297, 840]),
            ([4946, 3286], [618, 411]),
            ([101, 67], [50, 33]),
            ([101, 67], [51, 34]),
            ([640, 480], [640, 480]),
        ] {
            assert!(is_resized(camera, picture), "{camera:?} {picture:?}");
        }
        for (camera, picture) in [
            ([64, 96], [96, 64]),
            ([195, 109], [195, 100]),
            ([195, 109], [98, 60]),
            ([1920, 1080], [1440, 1080]),
            ([4000, 3000], [4000, 2990]),
            ([10, 10], [400, 400]),
            ([2000, 2000], [20_000, 20_000]),
        ] {
            assert!(!is_resized(camera, picture), "{camera:?} {picture:?}");
        }
        assert!(is_resized_map([24, 24], [48, 48]) && is_resized_map([98, 55], [195, 109]));
        assert!(!is_resized_map([24, 23], [24, 24]) && !is_resized_map([24, 20], [48, 48]));
    }

    /// The first bytes of a JPEG whose EXIF has only an orientation.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut segment = b"\xff\xe1\x00\x22Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
        segment.extend([orientation, 0, 0, 0, 0, 0, 0]);
        segment
    }

    fn jpeg(path: &Path, [w, h]: [u32; 2], orientation: u8, comment: usize) {
        image::RgbImage::new(w, h).save_with_format(path, image::ImageFormat::Jpeg).unwrap();
        let mut bytes = std::fs::read(path).unwrap();
        let mut more = exif(orientation);
        for _ in 0..comment {
            more.extend(b"\xff\xfe\xff\xff");
            more.extend([b'c'; 0xfffd]);
        }
        bytes.splice(2..2, more);
        std::fs::write(path, bytes).unwrap();
    }

    #[test]
    fn first_bytes_have_size_and_orientation() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        jpeg(&path, [9, 6], 6, 0);
        assert_eq!(Head::read(&path), Some(Head { size: [9, 6], orientation: 6 }));
        // Its size stands behind 650,000 bytes of comments.
        jpeg(&path, [9, 6], 1, 10);
        assert_eq!(Head::read(&path), Some(Head { size: [9, 6], orientation: 1 }));
        image::GrayImage::new(3, 700).save(&path).unwrap();
        assert_eq!(Head::read(&path), Some(Head { size: [3, 700], orientation: 1 }));
        std::fs::write(&path, b"\xff\xd8\xff\xe1").unwrap();
        assert_eq!([Head::read(&path), Head::read(folder.path())], [None, None]);
    }

    #[test]
    fn cameras_follow_their_pictures_and_those_alone() {
        let folder = tempfile::tempdir().unwrap();
        let camera = |size| {
            let mut camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, size);
            camera.center = [0.45 * f64::from(size[0]), 0.6 * f64::from(size[1])];
            camera
        };
        let frame = |name: &str, size, picture: Option<([u32; 2], u8)>| {
            let path = folder.path().join(name);
            if let Some((picture, orientation)) = picture {
                jpeg(&path, picture, orientation, 0);
            }
            Frame::new(camera(size), name, path)
        };
        let views = |is_requested| {
            let frames = vec![
                frame("half", [195, 109], Some(([98, 55], 1))),
                frame("whole", [40, 30], Some(([40, 30], 8))),
                frame("none", [195, 109], None),
                frame("crop", [195, 109], Some(([180, 109], 1))),
                frame("turned", [64, 96], Some(([96, 64], 6))),
                frame("upside down", [40, 30], Some(([40, 30], 3))),
            ];
            let resolution_source = ResolutionSource::File;
            let mut views = Views { path: "c".into(), frames, resolution_source, notes: Vec::new() };
            follow_pictures(&mut views, is_requested);
            views
        };
        let found = views(false);
        let sizes: Vec<[u32; 2]> = found.frames.iter().map(|frame| frame.size).collect();
        assert_eq!(sizes, [[98, 55], [40, 30], [195, 109], [195, 109], [64, 96], [40, 30]]);
        assert_eq!(sizes, found.cameras().iter().map(|camera| camera.resolution).collect::<Vec<_>>());
        let ([half, ..], stated) = (&found.cameras()[..], camera([195, 109])) else { panic!("six cameras") };
        // The same part of the picture, along either axis alone.
        assert!((half.center[0] - 0.45 * 98.0).abs() < 1e-12 && (half.center[1] - 0.6 * 55.0).abs() < 1e-12);
        assert!((half.focal[0] / stated.focal[0] - 98.0 / 195.0).abs() < 1e-12);
        assert!((half.focal[1] / stated.focal[1] - 55.0 / 109.0).abs() < 1e-12);
        assert_eq!(
            found.notes,
            [
                "cameras are resized to their pictures (1 of 5): `half` has 98 x 55 pixels, its camera 195 x 109"
                    .to_string(),
                "pictures have another shape than their cameras (2 of 5): `crop` has 180 x 109 pixels, its camera \
                 195 x 109; the camera of a cropped picture is another"
                    .to_string(),
                format!(
                    "EXIF orientation is not applied (1 of 5): `upside down` has orientation 3; if the cameras are of \
                     upright pictures, {TURN}"
                ),
            ]
        );
        // Only the sizes, by which masks are read, and no word: the size is the caller's.
        let found = views(true);
        assert_eq!((found.frames[0].size, found.frames[0].camera), ([98, 55], camera([195, 109])));
        assert_eq!(found.notes.len(), 2);
    }
}
