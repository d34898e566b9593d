//! Training and test images.

use std::path::Path;

use glam::DVec3;

use crate::{Error, Result};

/// An 8-bit image with alpha, as linear fractions in [0, 1] of its own (sRGB-like) colour space.
#[derive(Debug, Clone)]
pub struct PosedImage {
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`: red, green, blue, alpha; straight alpha.
    pixels: Vec<[u8; 4]>,
}

impl PosedImage {
    /// From `[height · width]` pixels: red, green, blue and straight alpha.
    ///
    /// # Panics
    /// If that is not their number.
    #[must_use]
    pub fn new(resolution: [u32; 2], pixels: Vec<[u8; 4]>) -> Self {
        let expected = u64::from(resolution[0]) * u64::from(resolution[1]);
        assert_eq!(pixels.len() as u64, expected, "pixels of an image of {resolution:?}");
        Self { resolution, pixels }
    }

    /// Reads a PNG or JPEG.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let image = image::open(path)
            .map_err(|e| match e {
                image::ImageError::IoError(e) => Error::io(path, "cannot read the image")(e),
                e => Error::malformed(path, "image", "a PNG or JPEG", e.to_string()),
            })?
            .into_rgba8();
        Ok(Self { resolution: [image.width(), image.height()], pixels: image.pixels().map(|p| p.0).collect() })
    }

    /// Colour of pixel `i` over a background.
    #[must_use]
    pub fn over(&self, i: usize, background: DVec3) -> DVec3 {
        let [r, g, b, a] = self.pixels[i].map(|v| f64::from(v) / 255.0);
        a * DVec3::new(r, g, b) + (1.0 - a) * background
    }

    /// Whether pixel `i` is fully opaque: it shows the object alone.
    #[must_use]
    pub fn is_opaque(&self, i: usize) -> bool {
        self.pixels[i][3] == 255
    }

    /// Number of pixels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Whether the image has no pixel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }
}
