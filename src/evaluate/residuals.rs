//! Compares a model with its training images.

use std::path::{Path, PathBuf};

use super::TrueView;
use super::depth_files::each_has_its_own;
use crate::dataset::{Frame, image_path};
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::render::{Tracer, render_view};
use crate::uncertainty::{ResidualSums, Residuals};
use crate::{Error, Result};

/// Approximate number of rendered pixels, over all training images.
const PIXELS: u64 = 1 << 18;

/// Training frames with their images.
#[derive(Debug, Clone)]
pub struct TrainingImages(Vec<Frame>);

impl TrainingImages {
    /// Frames whose images exist at their paths.
    ///
    /// # Errors
    /// If two frames have one image.
    pub fn new(frames: Vec<Frame>) -> Result<Self> {
        Self::of(Path::new("cameras"), frames)
    }

    fn of(source: &Path, frames: Vec<Frame>) -> Result<Self> {
        let images = frames.iter().map(|frame| (&*frame.name, frame.image.as_path()));
        each_has_its_own(source, "training images", images, |_| true)?;
        Ok(Self(frames))
    }

    /// Finds the images of frames below a folder, by their names.
    ///
    /// # Errors
    /// If an image is missing, or if two frames have one.
    pub fn find(folder: &Path, frames: &[Frame]) -> Result<Self> {
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
        Self::of(folder, frames.iter().map(find).collect::<Result<_>>()?)
    }

    /// The frames, each with its image.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        &self.0
    }

    /// The images' paths, in the order of the frames.
    pub fn paths(&self) -> impl Iterator<Item = &PathBuf> {
        self.0.iter().map(|frame| &frame.image)
    }

    /// Compares the model behind a tracer with the images over its background, for fields on a lattice. About 260,000
    /// pixels of all images together are looked at, each at `pixel_offset`. A stage of its own for the monitor.
    ///
    /// # Errors
    /// If an image cannot be read, or if the work was interrupted.
    pub fn residuals(
        &self,
        tracer: &Tracer,
        pixel_offset: f64,
        of: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<Residuals> {
        let pixels: u64 = self.0.iter().map(|frame| frame.camera.pixels()).sum();
        let stride = (pixels as f64 / PIXELS as f64).sqrt().ceil().max(1.0) as u32;
        let background = tracer.background.as_dvec3();
        let images = self.0.iter().map(|frame| TrueView::read(frame, None, background, pixel_offset, stride));
        let rows = |frame: &Frame| u64::from(frame.camera.resolution[1].div_ceil(stride));
        monitor.begin("rows of training images", self.0.iter().map(rows).sum());
        let residuals = measure_residuals(tracer, images, of, monitor)?;
        monitor.end();
        Ok(residuals)
    }
}

/// What training left unexplained in these images, for fields on a lattice.
///
/// A pixel's residual lies at its expected depth; pixels that show no matter, and masked ones, have none. Images are
/// taken one by one.
/// Advances the monitor by one per row.
///
/// # Errors
/// Those of the images, and [`crate::Error::Interrupted`].
pub fn measure_residuals(
    tracer: &Tracer,
    images: impl IntoIterator<Item = Result<TrueView>>,
    of: &Lattice,
    monitor: &dyn Monitor,
) -> Result<Residuals> {
    let mut sums = ResidualSums::new(of);
    for image in images {
        let image = image?;
        let view = render_view(tracer, &image.camera, image.pixel_offset, &[], monitor)?;
        let width = image.camera.resolution[0] as usize;
        // In the order of the pixels, so that the sums do not depend on the number of threads.
        for (i, pixel) in view.pixels.iter().enumerate().filter(|(i, pixel)| pixel.opacity > 0.5 && image.kept[*i]) {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + image.pixel_offset);
            let position = tracer.marcher.bounds.clamp(image.camera.ray(x, y).at(pixel.expected_depth).as_vec3());
            sums.add(position, (pixel.color - image.colors[i]).length_squared() / 3.0);
        }
    }
    Ok(sums.finish())
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::dataset::DepthReadings;
    use crate::field::{ClosedForm, RadianceField};
    use crate::geometry::Camera;
    use crate::monitor::Silent;
    use crate::render::Marcher;

    #[test]
    fn residuals_are_found_where_they_are() {
        let ball = ClosedForm::ball();
        let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
        let camera = Camera::look_at(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [64; 2]);
        let view = render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap();
        // The upper half of the picture is off by 0.2 in red, the lower half is right.
        let off = |i: usize| if i < 32 * 64 { DVec3::new(0.2, 0.0, 0.0) } else { DVec3::ZERO };
        let colors = view.pixels.iter().enumerate().map(|(i, pixel)| pixel.color + off(i)).collect();
        let truth = TrueView {
            name: String::new(),
            camera,
            whole: camera,
            stride: 1,
            pixel_offset: 0.5,
            colors,
            kept: vec![true; 64 * 64],
            covered: vec![true; 64 * 64],
            distance: vec![None; 64 * 64],
            readings: DepthReadings::default(),
        };
        let lattice = Lattice::new(ball.bounds(), 4).unwrap();
        let residuals = measure_residuals(&tracer, [Ok(truth)], &lattice, &Silent).unwrap();
        let at = |x: f64, y: f64| {
            let pixel = &view.pixels[y as usize * 64 + x as usize];
            residuals.at(camera.ray(x + 0.5, y + 0.5).at(pixel.expected_depth).as_vec3())
        };
        let (high, low) = (at(32.0, 20.0), at(32.0, 44.0));
        let wrong = 0.2 / 3_f64.sqrt();
        // The mean square, about half of the wrong one, has the weight of one pixel beside six or more of the vertex'
        // own: √(6.5 / 7) of the wrong residual where it is, √(0.5 / 7) where none is.
        assert!((0.96 * wrong..=wrong).contains(&high) && low < 0.28 * wrong, "{high} and {low}");
        // Behind the ball, where no image shows anything: the mean over the pixels that show matter.
        let matter: Vec<usize> = (0..64 * 64).filter(|&i| view.pixels[i].opacity > 0.5).collect();
        let mean = matter.iter().filter(|&&i| i < 32 * 64).count() as f64 / matter.len() as f64;
        let behind = residuals.at(Vec3::new(-0.45, 0.0, 0.0));
        assert!((behind - wrong * mean.sqrt()).abs() < 1e-6 * wrong, "{behind}");
    }
}
