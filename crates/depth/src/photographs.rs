//! Training images, for colours between pixels.

use std::path::Path;

use glam::DVec3;
use octobayes::geometry::{Camera, Mask};
use octobayes::monitor::{Monitor, check};
use octobayes::{Error, Result};
use octobayes_data::{Frame, PosedImage, each_has_its_own, image_path, read_masks};
use rayon::prelude::*;

/// A training image, small enough to be kept in memory beside all others.
#[derive(Debug, Clone)]
pub struct Photograph {
    /// With the pixels that are kept.
    camera: Camera,
    /// Where in a kept pixel its colour is, along x and y: that of several pixels is in their middle.
    offset: [f64; 2],
    /// `[height · width]`: red, green, blue over the background.
    pixels: Vec<[u8; 3]>,
    mask: Option<Mask>,
}

impl Photograph {
    /// Longest side that is kept, pixels.
    pub const SIDE: u32 = 512;

    /// Reads the images and masks of frames. A stage of its own for the monitor.
    ///
    /// # Errors
    /// As [`Photograph::read`], or [`Error::Interrupted`].
    pub fn read_all(
        frames: &[Frame],
        background: DVec3,
        pixel_offset: f64,
        monitor: &dyn Monitor,
    ) -> Result<Vec<Self>> {
        monitor.begin("training images", frames.len() as u64);
        let read = |frame: &Frame| {
            check(monitor)?;
            let photograph = Self::read(frame, background, pixel_offset)?;
            monitor.advance(1);
            Ok(photograph)
        };
        let photographs = frames.par_iter().map(read).collect::<Result<_>>()?;
        monitor.end();
        Ok(photographs)
    }

    /// Reads the image and the mask of a frame.
    ///
    /// # Errors
    /// If a file is missing or damaged, or its size differs from the camera's.
    pub fn read(frame: &Frame, background: DVec3, pixel_offset: f64) -> Result<Self> {
        let mask = read_masks(std::slice::from_ref(frame))?.swap_remove(0);
        Ok(Self::new(frame.camera, PosedImage::of(frame)?, mask, background, pixel_offset))
    }

    /// An image at the size of its camera.
    #[must_use]
    pub fn new(camera: Camera, image: PosedImage, mask: Option<Mask>, background: DVec3, pixel_offset: f64) -> Self {
        let longest = camera.resolution[0].max(camera.resolution[1]);
        let small = camera.resolution.map(|n| (n * Self::SIDE.min(longest)).div_ceil(longest));
        let image = image.shrunk(small);
        let mask = mask.map(|mask| mask.shrunk(small));
        let byte = |v: f64| (255.0 * v).round() as u8;
        let pixels = (0..image.len()).map(|i| image.over(i, background).to_array().map(byte)).collect();
        let offset = [0, 1].map(|k| {
            let share = f64::from(small[k]) / f64::from(camera.resolution[k]);
            0.5 + (pixel_offset - 0.5) * share
        });
        Self { camera: camera.resized(small), offset, pixels, mask }
    }

    /// The camera of the pixels that are kept.
    #[must_use]
    pub(crate) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The colour where the image shows a scene point, between the four nearest pixels, in [0, 1]. `None` outside the
    /// image, and where it is masked.
    #[must_use]
    pub fn color(&self, x: DVec3) -> Option<[f32; 3]> {
        let (at, _) = self.camera.project_inside(x)?;
        let [width, height] = self.camera.resolution;
        let cell = |k: usize, n: u32| {
            let v = (at[k] - self.offset[k]).clamp(0.0, f64::from(n - 1));
            let low = (v as u32).min(n.saturating_sub(2));
            (low as usize, (low + 1).min(n - 1) as usize, (v - f64::from(low)) as f32)
        };
        let (left, right, u) = cell(0, width);
        let (top, bottom, v) = cell(1, height);
        let places = [(left, top), (right, top), (left, bottom), (right, bottom)];
        let is_kept = |mask: &Mask| places.iter().all(|&(x, y)| mask.keeps(x as u32, y as u32));
        if !self.mask.as_ref().is_none_or(is_kept) {
            return None;
        }
        let pixel = |(x, y): (usize, usize)| self.pixels[y * width as usize + x].map(|v| f32::from(v) / 255.0);
        let [a, b, c, d] = places.map(pixel);
        Some(std::array::from_fn(|k| {
            let (upper, lower) = (a[k] + u * (b[k] - a[k]), c[k] + u * (d[k] - c[k]));
            upper + v * (lower - upper)
        }))
    }
}

/// The frames with their images below a folder, found by their names.
///
/// # Errors
/// If an image is missing, or if two frames have one.
pub fn find_images(folder: &Path, frames: &[Frame]) -> Result<Vec<Frame>> {
    let find = |frame: &Frame| {
        // COLMAP's names start from the folder of the images, those of a transforms.json from its own.
        let places = [folder, &folder.join("images")].map(|folder| image_path(folder, &frame.name));
        let image = places.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
            let expected = "the folder from which the names of the training images start";
            let [place, other] = &places;
            let found = format!("neither {} nor {}", place.display(), other.display());
            Error::malformed(folder, "training images", expected, found)
        })?;
        Ok(Frame { image, ..frame.clone() })
    };
    let found = frames.iter().map(find).collect::<Result<Vec<Frame>>>()?;
    let images = found.iter().map(|frame| (&*frame.name, frame.image.as_path()));
    each_has_its_own(folder, "training images", images, |_| true)?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_those_of_the_pixels_and_between_them() {
        // A ramp along x: pixel column c has the red c / 8.
        let camera = Camera::look_at(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y, 0.8, [8, 6]);
        let pixels = (0..48).map(|i| [(i % 8) as u8 * 32, 10, 20, 255]).collect();
        let mask = Mask::new([8, 6], |column, row| row > 0 || column < 4);
        let image = PosedImage::new([8, 6], pixels);
        let photograph = Photograph::new(camera, image, Some(mask), DVec3::ONE, 0.5);
        let at = |x: f64, y: f64| photograph.color(camera.ray(x, y).at(3.0));
        let red = |x: f64, y: f64| 255.0 * f64::from(at(x, y).unwrap()[0]);
        assert!((red(3.5, 2.5) - 96.0).abs() < 1e-3 && (red(4.0, 2.5) - 112.0).abs() < 1e-3);
        assert!((red(0.1, 2.5) - 0.0).abs() < 1e-3, "the border goes on");
        assert!(at(6.5, 0.5).is_none() && at(2.5, 0.5).is_some(), "masked");
        assert!(
            photograph.color(camera.ray(4.0, -0.5).at(3.0)).is_none() && photograph.color(DVec3::Z * 9.0).is_none()
        );
        // Larger ones become smaller, with cameras to match.
        let large = Camera::look_at(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y, 0.8, [1024, 2048]);
        let image = PosedImage::new([1024, 2048], vec![[50, 100, 150, 255]; 1024 * 2048]);
        let kept = Photograph::new(large, image, None, DVec3::ONE, 0.5);
        assert_eq!(kept.camera().resolution, [256, 512]);
        let color = kept.color(large.ray(1000.0, 30.0).at(2.0)).unwrap().map(|v| (255.0 * v).round());
        assert_eq!(color, [50.0, 100.0, 150.0]);
    }
}
