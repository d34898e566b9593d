//! Compares a model with its training images.

use std::path::{Path, PathBuf};

use glam::DVec3;
use octobayes::geometry::{Camera, Lattice};
use octobayes::monitor::Monitor;
use octobayes::render::Renderer;
use octobayes::uncertainty::{ColorSpread, ColorSums, ResidualSums, Residuals, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_data::{Frame, PosedImage, each_has_its_own, image_path, read_masks};

/// Approximate number of rendered pixels, over all training images.
const PIXELS: u64 = 1 << 18;

/// What training images show of a model's errors, for fields on one lattice.
#[derive(Debug, Clone)]
pub struct Compared {
    /// What training left unexplained in them.
    pub residuals: Residuals,
    /// How differently they show the same place, if two of them do.
    pub color_spread: Option<ColorSpread>,
}

impl Compared {
    /// The field with these layers.
    ///
    /// # Errors
    /// Those of [`UncertaintyField::with_residuals`] and [`UncertaintyField::with_color_spread`].
    pub fn join(self, field: UncertaintyField) -> Result<UncertaintyField> {
        let field = field.with_residuals(self.residuals)?;
        match self.color_spread {
            Some(spread) => field.with_color_spread(spread),
            None => Ok(field),
        }
    }
}

/// Some pixels of a training image.
#[derive(Debug, Clone)]
pub struct TrainingImage {
    /// A camera with exactly these pixels.
    pub camera: Camera,
    /// The camera of the whole image. These are every [`TrainingImage::stride`]-th of its pixels along x and y.
    pub whole: Camera,
    /// See [`TrainingImage::whole`].
    pub stride: u32,
    /// Position in a pixel that its ray passes through, 0 to 1 along x and y.
    pub pixel_offset: f64,
    /// `[height · width]`: colour over the background, in [0, 1].
    pub colors: Vec<DVec3>,
    /// `[height · width]`: true if the pixel is not masked.
    pub kept: Vec<bool>,
}

impl TrainingImage {
    /// Reads every `stride`-th pixel along x and y of a frame's image at the size of the camera.
    ///
    /// # Errors
    /// If a file is missing or damaged, or its size differs from the camera's.
    pub fn read(frame: &Frame, background: DVec3, pixel_offset: f64, stride: u32) -> Result<Self> {
        let image = PosedImage::of(frame)?;
        let mask = read_masks(std::slice::from_ref(frame))?.swap_remove(0);
        let whole = frame.camera;
        let camera = whole.strided(stride, pixel_offset);
        let [width, height] = camera.resolution;
        let places = || (0..height).flat_map(|row| (0..width).map(move |column| [column * stride, row * stride]));
        let color = |[x, y]: [u32; 2]| image.over((y * whole.resolution[0] + x) as usize, background);
        let keeps = |[x, y]: [u32; 2]| mask.as_ref().is_none_or(|mask| mask.keeps(x, y));
        let (colors, kept) = (places().map(color).collect(), places().map(keeps).collect());
        Ok(Self { camera, whole, stride, pixel_offset, colors, kept })
    }
}

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

    /// Compares the model behind a renderer with the images over its background, for fields on a lattice. About 260,000
    /// pixels of all images together are looked at, each at `pixel_offset`. A stage of its own for the monitor.
    ///
    /// # Errors
    /// If an image cannot be read, or if the work was interrupted.
    pub fn compare(
        &self,
        renderer: &dyn Renderer,
        pixel_offset: f64,
        of: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<Compared> {
        let pixels: u64 = self.0.iter().map(|frame| frame.camera.pixels()).sum();
        let stride = (pixels as f64 / PIXELS as f64).sqrt().ceil().max(1.0) as u32;
        let background = renderer.background();
        let images = self.0.iter().map(|frame| TrainingImage::read(frame, background, pixel_offset, stride));
        let rows = |frame: &Frame| u64::from(frame.camera.resolution[1].div_ceil(stride));
        monitor.begin("rows of training images", self.0.iter().map(rows).sum());
        let compared = compare_images(renderer, images, of, monitor)?;
        monitor.end();
        Ok(compared)
    }
}

/// Compares a model with these images, for fields on a lattice.
///
/// A pixel's residual lies at its expected depth, its colour at its median depth, which depth edges do not move off
/// surfaces. Pixels that show no matter, and masked ones, have neither. Images are taken one by one.
/// Advances the monitor by one per row.
///
/// # Errors
/// Those of the images, and [`octobayes::Error::Interrupted`].
pub fn compare_images(
    renderer: &dyn Renderer,
    images: impl IntoIterator<Item = Result<TrainingImage>>,
    of: &Lattice,
    monitor: &dyn Monitor,
) -> Result<Compared> {
    let (mut residuals, mut colors) = (ResidualSums::new(of), ColorSums::new(of));
    for image in images {
        let image = image?;
        let TrainingImage { whole, stride, pixel_offset, .. } = &image;
        let view = renderer.strided_image(whole, *stride, *pixel_offset, &[], &[], monitor)?;
        let width = image.camera.resolution[0] as usize;
        let at = |i: usize, depth: f64| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + image.pixel_offset);
            renderer.bounds().clamp(image.camera.ray(x, y).at(depth).as_vec3())
        };
        // In the order of the pixels, so that the sums do not depend on the number of threads.
        let shown = || view.pixels.iter().enumerate().filter(|(i, pixel)| pixel.opacity > 0.5 && image.kept[*i]);
        for (i, pixel) in shown() {
            residuals.add(at(i, pixel.expected_depth), (pixel.color - image.colors[i]).length_squared() / 3.0);
        }
        colors.add_image(shown().map(|(i, pixel)| (at(i, pixel.median_depth), image.colors[i])));
    }
    Ok(Compared { residuals: residuals.finish(), color_spread: colors.finish() })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use octobayes::field::{ClosedForm, RadianceField};
    use octobayes::monitor::Silent;
    use octobayes::render::{Marcher, Tracer, VolumeRenderer};

    const SIDE: u32 = 64;

    fn renderer(ball: &ClosedForm) -> VolumeRenderer<'_> {
        let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
        VolumeRenderer { tracer: Tracer { field: ball, marcher, background: Vec3::ONE }, differentiation: None }
    }

    fn image(camera: Camera, colors: Vec<DVec3>) -> TrainingImage {
        let kept = vec![true; (SIDE * SIDE) as usize];
        TrainingImage { camera, whole: camera, stride: 1, pixel_offset: 0.5, colors, kept }
    }

    /// Two cameras look at one side of a ball. A picture painted on it they show alike; of a picture that hangs in the
    /// air before each of them, they show different parts at the same place.
    #[test]
    fn images_agree_on_what_is_painted_on_the_surface() {
        let ball = ClosedForm::ball();
        let renderer = renderer(&ball);
        let cameras =
            [-0.6, 0.6].map(|y| Camera::look_at(DVec3::new(3.0, y, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [SIDE; 2]));
        let views = cameras.map(|camera| renderer.image(&camera, 0.5, &[], &[], &Silent).unwrap());
        let lattice = Lattice::new(ball.bounds(), 5).unwrap();
        let compared = |color: &dyn Fn(usize, DVec3) -> DVec3| {
            let images = [0, 1].map(|k| {
                let points = views[k].median_points(&cameras[k], 0.5);
                Ok(image(cameras[k], points.map(|(_, x)| color(k, x)).collect()))
            });
            compare_images(&renderer, images, &lattice, &Silent).unwrap().color_spread.unwrap()
        };
        // Ramps of 0.4 per scene unit: cells are a 32nd of the box wide, and a vertex counts pixels up to one of them
        // away, so that the means of two images differ by less than a ramp over two cells.
        let painted = compared(&|_, x| DVec3::splat(0.5 + 0.4 * x.y));
        let cell = ball.bounds().longest_edge() / 32.0;
        assert!(painted.mean() < 0.4 * 2.0 * cell / 2.0_f64.sqrt(), "{painted:?}");
        let off = compared(&|k, _| DVec3::splat([0.3, 0.7][k]));
        // Where both show it, colours 0.4 apart have a variance of 0.4² / 2.
        let front = off.at(Vec3::new(0.5, 0.0, 0.0)).unwrap();
        assert!(
            (off.mean() / 0.08_f64.sqrt() - 1.0).abs() < 1e-6 && (front / off.mean() - 1.0).abs() < 1e-6,
            "{front}"
        );
        // In red alone, the mean over three channels.
        let red = compared(&|k, _| DVec3::new([0.3, 0.7][k], 0.5, 0.5));
        assert!((red.mean() / (0.08_f64 / 3.0).sqrt() - 1.0).abs() < 1e-6, "{red:?}");
        // What one camera alone sees is not known, and nothing is where there is nothing.
        let shown = off.of_view(&cameras[0], 0.5, &views[0]);
        let [known, faint, all] = [
            shown.iter().filter(|v| !v.is_nan()).count(),
            views[0].pixels.iter().zip(&shown).filter(|(pixel, v)| pixel.opacity == 0.0 && !v.is_nan()).count(),
            views[0].pixels.iter().filter(|pixel| pixel.opacity > 0.0).count(),
        ];
        assert!(faint == 0 && known < all && 2 * known > all, "{known} of {all}, {faint}");
    }

    #[test]
    fn residuals_are_found_where_they_are() {
        let ball = ClosedForm::ball();
        let renderer = renderer(&ball);
        let camera = Camera::look_at(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [SIDE; 2]);
        let view = renderer.image(&camera, 0.5, &[], &[], &Silent).unwrap();
        // The upper half of the picture is off by 0.2 in red, the lower half is right.
        let off = |i: usize| if i < 32 * 64 { DVec3::new(0.2, 0.0, 0.0) } else { DVec3::ZERO };
        let colors = view.pixels.iter().enumerate().map(|(i, pixel)| pixel.color + off(i)).collect();
        let truth = image(camera, colors);
        let lattice = Lattice::new(ball.bounds(), 4).unwrap();
        let Compared { residuals, color_spread } = compare_images(&renderer, [Ok(truth)], &lattice, &Silent).unwrap();
        assert!(color_spread.is_none(), "of one image");
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
