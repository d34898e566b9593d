//! Training and test images.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use glam::DVec3;
use image::{DynamicImage, GenericImageView, ImageDecoder, ImageError, ImageFormat, ImageReader};
use rayon::prelude::*;

use super::jpeg;
use super::sizes::{Head, is_resized};
use super::views::Frame;
use octobayes::geometry::{MAX_PIXELS, covered};
use octobayes::{Error, Result};

/// Decodes a PNG or JPEG of known size. The size in the file is compared with it before memory is allocated.
///
/// # Errors
/// If the file is missing, damaged or cut short, or its size differs.
pub(super) fn decode(path: &Path, what: &str, resolution: [u32; 2]) -> Result<DynamicImage> {
    let file = open(path)?;
    if file.format() == Some(ImageFormat::Jpeg) {
        Head::read(path).map_or(Ok(()), |head| head.check(path, what, resolution))?;
        return jpeg::decode(path, what, octobayes::io::read(path)?, resolution);
    }
    let mut decoder = file.into_decoder().map_err(|e| wrong(path, what, e))?;
    Head::of(&mut decoder).check(path, what, resolution)?;
    DynamicImage::from_decoder(decoder).map_err(|e| wrong(path, what, e))
}

/// Width and height of an image, from its first bytes, and how much memory decoding it takes.
///
/// # Errors
/// If the file is missing, is no PNG or JPEG, or has more pixels than any image may have.
pub fn measure(path: &Path, what: &str) -> Result<([u32; 2], u64)> {
    let file = open(path)?;
    let is_jpeg = file.format() == Some(ImageFormat::Jpeg);
    let decoder = file.into_decoder().map_err(|e| wrong(path, what, e))?;
    let (w, h) = decoder.dimensions();
    let pixels = u64::from(w) * u64::from(h);
    if pixels as f64 > MAX_PIXELS {
        return Err(Error::malformed(path, what, "a PNG or JPEG", format!("{w} x {h} pixels")));
    }
    let bytes = if is_jpeg { jpeg::working_memory(&octobayes::io::read(path)?, pixels) } else { decoder.total_bytes() };
    Ok(([w, h], bytes))
}

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    octobayes::io::refuse_pipe(path)?;
    let file = ImageReader::open(path).map_err(Error::io(path, "cannot open"))?;
    // The content decides: a JPEG named like a PNG is still a JPEG.
    file.with_guessed_format().map_err(Error::io(path, "cannot read"))
}

fn wrong(path: &Path, what: &str, error: ImageError) -> Error {
    match error {
        // Errors of the system carry a number; those of the decoder concern the content.
        ImageError::IoError(e) if e.raw_os_error().is_some() => Error::io(path, "cannot read")(e),
        e => Error::malformed(path, what, "a PNG or JPEG", e.to_string()),
    }
}

/// An 8-bit image with alpha, read as linear fractions in [0, 1] of its own (sRGB-like) colour space.
#[derive(Debug, Clone)]
pub struct PosedImage {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: red, green, blue, alpha; straight alpha.
    pixels: Vec<[u8; 4]>,
}

/// Some pixels of an image.
pub struct SampledImage {
    /// These pixels, in a row.
    pub pixels: PosedImage,
    /// Whether all pixels of the image are alike, as in the placeholder of a picture.
    pub is_of_one_color: bool,
}

impl PosedImage {
    /// Makes an image of `[height · width]` pixels: red, green, blue and straight alpha.
    ///
    /// # Panics
    /// If the number of pixels differs from the resolution.
    #[must_use]
    pub fn new(resolution: [u32; 2], pixels: Vec<[u8; 4]>) -> Self {
        let expected = u64::from(resolution[0]) * u64::from(resolution[1]);
        assert_eq!(pixels.len() as u64, expected, "pixels of an image of {resolution:?}");
        Self { resolution, pixels }
    }

    /// Checksum of the pixels.
    #[must_use]
    pub fn checksum(&self) -> u32 {
        crc32fast::hash(self.pixels.as_flattened())
    }

    /// Reads a PNG or JPEG taken by a camera of this `resolution`.
    ///
    /// # Errors
    /// If the file is missing or damaged, or its size differs.
    pub fn read(path: &Path, resolution: [u32; 2]) -> Result<Self> {
        let image = decode(path, "image", resolution)?.into_rgba8();
        Ok(Self { resolution, pixels: image.pixels().map(|p| p.0).collect() })
    }

    /// Reads the picture of a frame at the size of its camera: one that is larger is made [smaller](Self::shrunk).
    ///
    /// # Errors
    /// As [`PosedImage::read`].
    pub fn of(frame: &Frame) -> Result<Self> {
        let camera @ [w, h] = frame.camera.resolution;
        let size = Head::read(&frame.image).map(|head| head.size);
        let larger = size.filter(|size| is_resized(camera, *size) && size[0] >= w && size[1] >= h);
        Ok(Self::read(&frame.image, larger.unwrap_or(camera))?.shrunk(camera))
    }

    /// The same picture with fewer pixels, or as many, each the mean of what it covers, also of parts of pixels.
    /// Colours are weighed by alpha.
    ///
    /// # Panics
    /// If there are more pixels along an axis.
    #[must_use]
    pub fn shrunk(self, resolution: [u32; 2]) -> Self {
        let ([width, height], [w, h]) = (self.resolution, resolution);
        if resolution == self.resolution {
            return self;
        }
        assert!((1..=width).contains(&w) && (1..=height).contains(&h), "{resolution:?} of {:?}", self.resolution);
        let columns: Vec<Vec<(u32, u64)>> = (0..w).map(|i| covered(i, width, w).collect()).collect();
        let area = u64::from(width) * u64::from(height);
        let rounded = |sum: u64, of: u64| ((2 * sum + of) / (2 * of)) as u8;
        let row = |row: u32| {
            let rows: Vec<(u32, u64)> = covered(row, height, h).collect();
            let mean = |columns: &Vec<(u32, u64)>| {
                // Whole numbers, so that nothing is rounded before the end: at most 255² times the area.
                let (mut color, mut alpha) = ([0; 3], 0);
                for &(y, share) in &rows {
                    for &(x, part) in columns {
                        let [r, g, b, a] = self.pixels[y as usize * width as usize + x as usize].map(u64::from);
                        let a = a * share * part;
                        alpha += a;
                        color = [color[0] + r * a, color[1] + g * a, color[2] + b * a];
                    }
                }
                let [r, g, b] = color.map(|sum| rounded(sum, alpha.max(1)));
                [r, g, b, rounded(alpha, area)]
            };
            columns.iter().map(mean).collect::<Vec<_>>()
        };
        let pixels = (0..h).into_par_iter().flat_map_iter(row).collect();
        Self { resolution, pixels }
    }

    /// Reads the pixels of these columns and rows alone, so that no more than the decoded image is held.
    ///
    /// # Errors
    /// As [`PosedImage::read`].
    pub fn sample(path: &Path, resolution: [u32; 2], at: &[[u32; 2]]) -> Result<SampledImage> {
        let image = decode(path, "image", resolution)?;
        let mut all = image.as_bytes().chunks_exact(usize::from(image.color().bytes_per_pixel()));
        let first = all.next();
        let is_of_one_color = all.all(|pixel| Some(pixel) == first);
        let pixels = at.iter().map(|&[column, row]| image.get_pixel(column, row).0).collect();
        Ok(SampledImage { pixels: Self::new([at.len() as u32, 1], pixels), is_of_one_color })
    }

    /// Colour of pixel `i` over a background.
    #[must_use]
    pub fn over(&self, i: usize, background: DVec3) -> DVec3 {
        let [r, g, b, a] = self.pixels[i].map(|v| f64::from(v) / 255.0);
        a * DVec3::new(r, g, b) + (1.0 - a) * background
    }

    /// Alpha of pixel `i`: the share of it that shows the object.
    #[must_use]
    pub fn alpha(&self, i: usize) -> f64 {
        f64::from(self.pixels[i][3]) / 255.0
    }

    /// Returns true if pixel `i` is fully opaque, so that it shows only the object.
    #[must_use]
    pub fn is_opaque(&self, i: usize) -> bool {
        self.pixels[i][3] == 255
    }

    /// Number of pixels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Returns true if the image has no pixels.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }
}
