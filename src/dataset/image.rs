//! Training and test images.

use std::path::Path;

use glam::DVec3;
use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};

use crate::{Error, Result};

/// Decodes a PNG or JPEG of known size. The size in the file is compared with it before memory is allocated.
///
/// # Errors
/// If the file is missing or damaged, or its size differs.
pub(super) fn decode(path: &Path, what: &str, resolution: [u32; 2]) -> Result<DynamicImage> {
    let wrong = |e| match e {
        // Errors of the system carry a number; those of the decoder concern the content.
        ImageError::IoError(e) if e.raw_os_error().is_some() => Error::io(path, "cannot read")(e),
        e => Error::malformed(path, what, "a PNG or JPEG", e.to_string()),
    };
    crate::io::refuse_pipe(path)?;
    let file = ImageReader::open(path).map_err(Error::io(path, "cannot open"))?;
    // The content decides: a JPEG named like a PNG is still a JPEG.
    let file = file.with_guessed_format().map_err(Error::io(path, "cannot read"))?;
    let decoder = file.into_decoder().map_err(wrong)?;
    let (w, h) = decoder.dimensions();
    if [w, h] != resolution {
        let [expected, found] = [resolution, [w, h]].map(|[w, h]| format!("{w} x {h} pixels"));
        return Err(Error::malformed(path, what, expected, found));
    }
    DynamicImage::from_decoder(decoder).map_err(wrong)
}

/// An 8-bit image with alpha, read as linear fractions in [0, 1] of its own (sRGB-like) colour space.
#[derive(Debug, Clone)]
pub struct PosedImage {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: red, green, blue, alpha; straight alpha.
    pixels: Vec<[u8; 4]>,
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

    /// Returns true if all pixels are alike, as in the placeholder of a picture.
    #[must_use]
    pub fn is_of_one_color(&self) -> bool {
        self.pixels.iter().all(|pixel| *pixel == self.pixels[0])
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
