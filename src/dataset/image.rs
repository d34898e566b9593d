//! Training and test images.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use glam::DVec3;
use image::{DynamicImage, GenericImageView, ImageDecoder, ImageError, ImageFormat, ImageReader};

use super::jpeg;
use crate::geometry::MAX_PIXELS;
use crate::{Error, Result};

/// Decodes a PNG or JPEG of known size. The size in the file is compared with it before memory is allocated.
///
/// # Errors
/// If the file is missing, damaged or cut short, or its size differs.
pub(super) fn decode(path: &Path, what: &str, resolution: [u32; 2]) -> Result<DynamicImage> {
    let file = open(path)?;
    if file.format() == Some(ImageFormat::Jpeg) {
        return jpeg::decode(path, what, crate::io::read(path)?, resolution);
    }
    let decoder = file.into_decoder().map_err(|e| wrong(path, what, e))?;
    check_size(path, what, resolution, decoder.dimensions().into())?;
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
    let bytes = if is_jpeg { jpeg::working_memory(&crate::io::read(path)?, pixels) } else { decoder.total_bytes() };
    Ok(([w, h], bytes))
}

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>> {
    crate::io::refuse_pipe(path)?;
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

/// Refuses an image of another size.
pub(super) fn check_size(path: &Path, what: &str, expected: [u32; 2], found: [u32; 2]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let [expected, found] = [expected, found].map(|[w, h]| format!("{w} x {h} pixels"));
    Err(Error::malformed(path, what, expected, found))
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
