//! Depth maps: the truth that rendered depths are evaluated against.

use std::path::Path;

use glam::DVec3;

use super::Unmeasured;
use super::image::decode;
use super::sizes::{Head, in_words, is_resized_map};
use crate::{Real, npy};
use octobayes::geometry::{Aabb, Camera, nearest};
use octobayes::{Error, Result};

/// What a pixel of a depth map holds: a depth, or why it is none.
type Reading = std::result::Result<f64, Unmeasured>;

/// Quantity that a depth map measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthKind {
    /// Distance from the camera's centre.
    #[default]
    Euclidean,
    /// Distance along the camera's viewing axis.
    Z,
}

impl DepthKind {
    /// Distance from the camera's centre per depth of this kind, along the ray through image coordinates `(x, y)`.
    #[must_use]
    pub fn stretch(self, camera: &Camera, x: f64, y: f64) -> f64 {
        match self {
            Self::Euclidean => 1.0,
            Self::Z => 1.0 / camera.ray(x, y).direction.dot(-camera.axes.z_axis),
        }
    }

    /// The other kind, for which this one may have been taken.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Euclidean => Self::Z,
            Self::Z => Self::Euclidean,
        }
    }
}

/// Encoding of a depth map: depth = offset + scale · p in scene units, with p = value / largest
/// value of the integer type.
///
/// Value 0 means "unknown", and the largest value "this far or farther".
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct DepthEncoding {
    /// Depth at p = 0.
    pub offset: f64,
    /// Depth at p = 1, minus the offset.
    pub scale: f64,
    /// Quantity that is measured.
    pub kind: DepthKind,
}

impl DepthEncoding {
    /// The encoding of depth maps of this name or pattern of names, from an offset and scale for those that need one.
    ///
    /// # Errors
    /// If maps of this name cannot be read, if maps in .exr or .npy, which are in scene units, are given an offset and
    /// scale, or others none.
    pub fn of_maps(name: &Path, given: Option<[f64; 2]>, kind: DepthKind) -> Result<Self> {
        let extension = name.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        if let Some(extension) = extension.filter(|known| !EXTENSIONS.contains(&&**known)) {
            let expected = "depth in .exr or .npy (scene units), or .png or .jpg (with --depth-encoding); in Python, \
                            numpy.save(new, cv2.imread(old, cv2.IMREAD_UNCHANGED)) converts others";
            return Err(Error::setting("depth maps", expected, format!(".{extension}")));
        }
        let refused = |expected: &str, found: String| Err(Error::setting("depth encoding", expected, found));
        match (given, is_exact(name)) {
            (Some([offset, scale]), false) => Ok(Self { offset, scale, kind }),
            (None, true) => Ok(Self { offset: 0.0, scale: 1.0, kind }),
            (None, false) => {
                let expected = "offset and scale of the depth maps (those in .exr and .npy are in scene units), such \
                                as 0,65.535 for 16 bits in millimetres of scenes in metres";
                refused(expected, "none".into())
            }
            (Some([offset, scale]), true) => {
                refused("none, as depth maps in .exr and .npy are in scene units", format!("{offset},{scale}"))
            }
        }
    }
}

/// A depth map, converted to distances from the camera's centre.
#[derive(Debug, Clone)]
pub struct DepthMap {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: Euclidean distance in scene units, above 0 and finite; or why there is none.
    pub distance: Vec<std::result::Result<f64, Unmeasured>>,
    /// How much depths that follow each other differ, scene units; 0 if depths are floats.
    pub step: f64,
}

impl DepthMap {
    /// Reads an 8- or 16-bit PNG (a colour image must be grey), or the depth channel of an EXR or a NumPy array, which
    /// are in scene units whatever the encoding's offset and scale. Values that are known to mean "unknown" or "no
    /// surface" are no distances. A map of another size than the camera's, as of a depth sensor beside a larger
    /// picture, has the depth of its nearest pixel at each of the camera's.
    ///
    /// # Errors
    /// If the file is missing or damaged, or if it is no map of the camera's whole picture by the ratio of its sides.
    pub fn read(path: &Path, encoding: DepthEncoding, camera: &Camera, pixel_offset: f64) -> Result<Self> {
        let resolution = camera.resolution;
        let ([w, h], depths, step) = if is_exact(path) {
            let (size, depths) = exact(path, resolution)?;
            (size, depths, 0.0)
        } else {
            steps(path, encoding, resolution)?
        };
        let at = |column: u32, row: u32| {
            let [x, y] = [column, row].map(|n| f64::from(n) + pixel_offset);
            let place = [nearest(column, w, resolution[0]), nearest(row, h, resolution[1])].map(|n| n as usize);
            in_front(depths[place[1] * w as usize + place[0]]? * encoding.kind.stretch(camera, x, y))
        };
        let distance = (0..resolution[1]).flat_map(|row| (0..resolution[0]).map(move |column| (column, row)));
        Ok(Self { resolution, distance: distance.map(|(column, row)| at(column, row)).collect(), step })
    }

    /// Marks distances beyond the reach of a model that is empty outside `bounds`: behind the corner that is farthest
    /// from the camera by more than the diagonal of the box.
    ///
    /// A model cannot be wrong by more than its box is wide, so such a distance has another unit, belongs to something
    /// outside of the scene, or stands for "no surface" in a program of its own custom.
    #[must_use]
    pub fn within(mut self, bounds: &Aabb, camera: &Camera) -> Self {
        let [low, high] = [bounds.min(), bounds.max()].map(|corner| (corner - camera.position).abs());
        let reach = DVec3::max(low, high).length() + bounds.size().length();
        for distance in &mut self.distance {
            *distance = distance.and_then(|d| if d > reach { Err(Unmeasured::Beyond) } else { Ok(d) });
        }
        self
    }
}

/// Extensions of depth maps that are read. The content decides of a map without one.
const EXTENSIONS: [&str; 5] = ["exr", "npy", "png", "jpg", "jpeg"];

/// Whether a depth map of this name holds scene units.
fn is_exact(name: &Path) -> bool {
    ["exr", "npy"].iter().any(|exact| has_extension(name, exact))
}

fn has_extension(name: &Path, known: &str) -> bool {
    name.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(known))
}

/// Refuses a map that is not of a whole picture of this resolution.
fn check_size(path: &Path, size: [u32; 2], resolution: [u32; 2]) -> Result<()> {
    if is_resized_map(size, resolution) {
        return Ok(());
    }
    let [expected, found] = [resolution, size].map(|size| format!("{} pixels", in_words(size)));
    Err(Error::malformed(path, "depth map", expected, found))
}

/// A distance, if it is one.
fn in_front(distance: f64) -> Reading {
    match distance {
        0.0 => Err(Unmeasured::Zero),
        d if !d.is_finite() => Err(Unmeasured::NotFinite),
        d if d < 0.0 => Err(Unmeasured::Negative),
        d => Ok(d),
    }
}

/// Width and height of a map that holds scene units, and its depths.
fn exact(path: &Path, resolution: [u32; 2]) -> Result<([u32; 2], Vec<Reading>)> {
    /// Values of this size and above mean "no surface": Blender's Cycles writes 1e10, other programs the largest f32.
    const NO_SURFACE: f32 = 1e10;
    /// Largest f16, which larger numbers become.
    const LARGEST_F16: f32 = 65504.0;
    let is_depth = |depth: f32| depth < NO_SURFACE && depth != LARGEST_F16;
    let reading = |depth: f32| match in_front(f64::from(depth)) {
        Ok(_) if !is_depth(depth) => Err(Unmeasured::Largest),
        reading => reading,
    };
    let (size, depths) = if has_extension(path, "npy") {
        array(path, resolution)?
    } else {
        crate::exr::read_exr_depth(path, |size| check_size(path, size, resolution))?
    };
    Ok((size, depths.into_iter().map(reading).collect()))
}

/// Width and height of a NumPy array, and its numbers.
fn array(path: &Path, resolution: [u32; 2]) -> Result<([u32; 2], Vec<f32>)> {
    let stream = npy::stream::<Real>(path)?;
    let size = match *stream.shape() {
        [h, w] | [h, w, 1] | [1, h, w] => [w, h].map(|side| u32::try_from(side).unwrap_or(u32::MAX)),
        ref other => {
            let expected = "an array of shape [height, width]";
            return Err(Error::malformed(path, "depth map", expected, format!("shape {other:?}")));
        }
    };
    check_size(path, size, resolution)?;
    Ok((size, stream.into_reals()?.data))
}

/// Width and height of a PNG, its depths, and how far apart they are at least.
fn steps(path: &Path, encoding: DepthEncoding, resolution: [u32; 2]) -> Result<([u32; 2], Vec<Reading>, f64)> {
    let size = Head::read(path).map_or(resolution, |head| head.size);
    check_size(path, size, resolution)?;
    let image = decode(path, "depth map", size)?;
    refuse_colours(path, &image)?;
    let levels = if image.color().bytes_per_pixel() / image.color().channel_count() == 2 { 65535.0 } else { 255.0 };
    let raw: Vec<f64> = match &image {
        image::DynamicImage::ImageLuma16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        image::DynamicImage::ImageLumaA16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        image::DynamicImage::ImageRgb16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        image::DynamicImage::ImageRgba16(i) => i.pixels().map(|p| f64::from(p.0[0]) / 65535.0).collect(),
        other => other.to_rgba8().pixels().map(|p| f64::from(p.0[0]) / 255.0).collect(),
    };
    let reading = |p: f64| match p {
        0.0 => Err(Unmeasured::Zero),
        1.0 => Err(Unmeasured::Largest),
        p => Ok(encoding.offset + encoding.scale * p),
    };
    Ok((size, raw.into_iter().map(reading).collect(), encoding.scale.abs() / levels))
}

/// Refuses false colours, and depths packed into several channels: their first channel is no depth.
fn refuse_colours(path: &Path, image: &image::DynamicImage) -> Result<()> {
    /// Difference of channels that a JPEG makes by rounding: a step of 8 bits.
    const ROUNDING: u16 = 257;
    if !image.color().has_color() {
        return Ok(());
    }
    let is_coloured = |[r, g, b]: [u16; 3]| r.max(g).max(b) - r.min(g).min(b) > ROUNDING;
    match image.to_rgb16().pixels().find(|pixel| is_coloured(pixel.0)) {
        None => Ok(()),
        Some(pixel) => {
            let expected = "shades of grey, as false colours and packed channels hold no depth that can be read";
            let [r, g, b] = pixel.0.map(|value| f64::from(value) / 65535.0);
            Err(Error::malformed(path, "depth map", expected, format!("a colour of ({r:.3}, {g:.3}, {b:.3})")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn z_depth_becomes_distance_and_zero_is_unknown() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let mut image = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(4, 4, image::Luma([32768_u16]));
        image.put_pixel(0, 0, image::Luma([0]));
        image.save(&path).unwrap();
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 4]);
        let encoding = DepthEncoding { offset: 0.0, scale: 65.535, kind: DepthKind::Z };
        let map = DepthMap::read(&path, encoding, &camera, 0.5).unwrap();
        assert_eq!((map.distance[0], map.step), (Err(Unmeasured::Zero), 0.001));
        // The point at that distance along the pixel's ray has z-depth 32.768.
        let point = camera.ray(3.5, 1.5).at(map.distance[7].unwrap());
        assert!((camera.project(point).unwrap().1 - 32.768).abs() < 1e-9);
    }

    #[test]
    fn what_lies_far_behind_the_box_is_no_measurement() {
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 1]);
        // The farthest corners are at (±1, 1, ±1), and the diagonal is √12.
        let reach = 27_f64.sqrt() + 12_f64.sqrt();
        let distance = vec![Ok(0.1), Ok(reach - 1e-9), Ok(reach + 1e-9), Err(Unmeasured::Zero)];
        let map = DepthMap { resolution: [4, 1], distance, step: 0.0 }.within(&Aabb::centered_cube(1.0), &camera);
        let expected = [Ok(0.1), Ok(reach - 1e-9), Err(Unmeasured::Beyond), Err(Unmeasured::Zero)];
        assert_eq!(map.distance, expected);
    }

    #[test]
    fn the_ends_of_every_kind_of_png_are_no_measurements() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 1]);
        // Colour images are read if they are grey; whatever alpha holds.
        let eight = |x: u32| [0_u8, 51, 254, 255][x as usize];
        let sixteen = |x: u32| [0_u16, 13107, 65534, 65535][x as usize];
        let images: [image::DynamicImage; 6] = [
            image::ImageBuffer::from_fn(4, 1, |x, _| image::Luma([eight(x)])).into(),
            image::ImageBuffer::from_fn(4, 1, |x, _| image::Rgb([eight(x); 3])).into(),
            image::ImageBuffer::from_fn(4, 1, |x, _| image::Rgba([eight(x), eight(x), eight(x), 0])).into(),
            image::ImageBuffer::from_fn(4, 1, |x, _| image::Luma([sixteen(x)])).into(),
            image::ImageBuffer::from_fn(4, 1, |x, _| image::LumaA([sixteen(x), 9])).into(),
            image::ImageBuffer::from_fn(4, 1, |x, _| image::Rgb([sixteen(x); 3])).into(),
        ];
        for image in images {
            image.save(&path).unwrap();
            let read = |offset: f64, scale: f64| {
                let encoding = DepthEncoding { offset, scale, kind: DepthKind::Euclidean };
                DepthMap::read(&path, encoding, &camera, 0.5).unwrap().distance
            };
            let [zero, fifth, high, most] = read(0.0, 10.0)[..] else { panic!("4 pixels") };
            assert_eq!([zero, most], [Err(Unmeasured::Zero), Err(Unmeasured::Largest)], "{:?}", image.color());
            assert!((fifth.unwrap() - 2.0).abs() < 1e-12 && (9.9..10.0).contains(&high.unwrap()));
            // Behind the camera.
            assert_eq!(read(-3.0, 10.0)[1], Err(Unmeasured::Negative), "{:?}", image.color());
        }
    }

    /// A map of half the picture's size, and one of twice it: its nearest pixel, by hand.
    #[test]
    fn maps_of_another_size_have_the_depth_of_their_nearest_pixel() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [6, 4]);
        let values = |[w, h]: [u32; 2]| (0..w * h).map(|i| 1.0 + i as f32).collect::<Vec<f32>>();
        let read = |name: &str, encoding: Option<[f64; 2]>| {
            let encoding = DepthEncoding::of_maps(Path::new(name), encoding, DepthKind::Euclidean).unwrap();
            DepthMap::read(&path(name), encoding, &camera, 0.5).map(|map| {
                assert_eq!(map.resolution, [6, 4]);
                map.distance.into_iter().map(|d| d.unwrap() as f32).collect::<Vec<_>>()
            })
        };
        npy::write(&path("half.npy"), &[2, 3], values([3, 2])).unwrap();
        let half = [1, 1, 2, 2, 3, 3, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 4, 4, 5, 5, 6, 6].map(|v| v as f32);
        assert_eq!(read("half.npy", None).unwrap(), half);
        let steps = image::ImageBuffer::from_fn(3, 2, |x, y| image::Luma([(1 + x + 3 * y) as u16]));
        steps.save(path("half.png")).unwrap();
        let found = read("half.png", Some([0.0, 65535.0])).unwrap();
        assert!(found.iter().zip(half).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
        // Of twice the size, the pixel right and below of the centre; with an axis of one channel.
        npy::write(&path("twice.npy"), &[8, 12, 1], values([12, 8])).unwrap();
        let twice: Vec<f32> =
            (0..4).flat_map(|y| (0..6).map(move |x| (1 + (2 * y + 1) * 12 + 2 * x + 1) as f32)).collect();
        assert_eq!(read("twice.npy", None).unwrap(), twice);
        npy::write(&path("same.npy"), &[1, 4, 6], values([6, 4]).into_iter().map(f64::from)).unwrap();
        assert_eq!(read("same.npy", None).unwrap(), values([6, 4]));
        crate::write_exr(&path("half.exr"), [3, 2], vec![("Z", values([3, 2]))]).unwrap();
        assert_eq!(read("half.exr", None).unwrap(), half);
        // Another shape, a row too few, or no map at all.
        for (shape, found) in [
            (vec![4, 3], "expected 6 x 4 pixels, found 3 x 4 pixels"),
            (vec![3, 6], "expected 6 x 4 pixels, found 6 x 3 pixels"),
            (vec![24], "expected an array of shape [height, width], found shape [24]"),
            (vec![2, 4, 6], "expected an array of shape [height, width], found shape [2, 4, 6]"),
        ] {
            npy::write(&path("odd.npy"), &shape, (0..shape.iter().product()).map(|i| i as f32)).unwrap();
            let error = read("odd.npy", None).unwrap_err().to_string();
            assert!(error.ends_with(found), "{error}");
        }
        // Values that are no depths, as in an EXR.
        npy::write(&path("same.npy"), &[4, 6], [0.0, f32::NAN, -1.0, 1e10].into_iter().cycle().take(24)).unwrap();
        let encoding = DepthEncoding { offset: 0.0, scale: 1.0, kind: DepthKind::Z };
        let found = DepthMap::read(&path("same.npy"), encoding, &camera, 0.5).unwrap().distance;
        use Unmeasured::{Largest, Negative, NotFinite, Zero};
        assert_eq!(found[..4], [Zero, NotFinite, Negative, Largest].map(Err));
    }

    #[test]
    fn maps_that_cannot_be_read_are_named_with_those_that_can() {
        let of = |name: &str, given| {
            DepthEncoding::of_maps(Path::new(name), given, DepthKind::Z).map_err(|e| e.to_string()).map(|e| e.scale)
        };
        for name in ["{}.tif", "{}.TIFF", "a/{}.pfm", "{}.npz"] {
            let error = of(name, None).unwrap_err();
            let found = Path::new(name).extension().unwrap().to_str().unwrap().to_lowercase();
            assert!(error.starts_with("depth maps: expected depth in .exr or .npy (scene units)"), "{error}");
            assert!(error.contains("numpy.save") && error.ends_with(&format!("found .{found}")), "{error}");
            assert_eq!(of(name, Some([0.0, 1.0])), Err(error));
        }
        assert_eq!(
            [of("{}.npy", None), of("{}.EXR", None), of("{}_depth", Some([0.0, 2.0]))],
            [Ok(1.0), Ok(1.0), Ok(2.0)]
        );
        assert!(of("{}.npy", Some([0.0, 1.0])).unwrap_err().ends_with("in scene units, found 0,1"));
    }

    #[test]
    fn false_colours_and_packed_depths_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 1]);
        let encoding = DepthEncoding { offset: 0.0, scale: 10.0, kind: DepthKind::Euclidean };
        let of = |packed: [u8; 3]| {
            image::ImageBuffer::from_fn(4, 1, move |x, _| image::Rgb(if x == 3 { packed } else { [0; 3] }))
        };
        let images: [image::DynamicImage; 3] = [
            of([51, 204, 102]).into(),
            of([51, 53, 51]).into(),
            image::ImageBuffer::from_fn(4, 1, |_, _| image::Rgba([13107_u16, 0, 0, 65535])).into(),
        ];
        for (image, found) in
            images.iter().zip(["(0.200, 0.800, 0.400)", "(0.200, 0.208, 0.200)", "(0.200, 0.000, 0.000)"])
        {
            image.save(&path).unwrap();
            let error = DepthMap::read(&path, encoding, &camera, 0.5).unwrap_err().to_string();
            assert!(
                error.contains("expected shades of grey") && error.ends_with(&format!("found a colour of {found}")),
                "{error}"
            );
        }
        // A JPEG rounds its colours.
        image::DynamicImage::from(of([51, 52, 51])).save(&path).unwrap();
        assert_eq!(DepthMap::read(&path, encoding, &camera, 0.5).unwrap().distance[3], Ok(2.0));
    }
}
