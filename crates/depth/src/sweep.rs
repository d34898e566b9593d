//! A plane sweep over the training images: where along a pixel's ray do they agree best?
//!
//! Collins 1996, "A space-sweep approach to true multi-image matching"; here around a depth that a model has already,
//! and as a measure of how far that may be off.

use glam::DVec3;
use octobayes::Result;
use octobayes::geometry::{Camera, Ray};
use octobayes::monitor::{Monitor, check};
use octobayes::render::RenderedView;
use rayon::prelude::*;

use super::{Photograph, TrainingViews};

/// Training images that are compared at a pixel: of those that see its surface the nearest in angle.
const IMAGES: usize = 8;
/// Steps of the sweep, forwards and backwards.
const STEPS: i32 = 20;
/// Where the images are compared beside a pixel, pixels: they agree by chance at a single point.
const PATCH: [[f64; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];

/// The training images, and what each camera sees.
#[derive(Clone, Copy)]
pub struct Sweep<'a> {
    photographs: &'a [Photograph],
    views: &'a TrainingViews,
}

impl<'a> Sweep<'a> {
    /// A step along the ray, as a share of the depth.
    pub const STEP: f64 = 1.0 / 400.0;

    /// A sweep of the images of these cameras.
    ///
    /// # Panics
    /// If there is not one image for every camera.
    #[must_use]
    pub fn new(photographs: &'a [Photograph], views: &'a TrainingViews) -> Self {
        assert_eq!(photographs.len(), views.len(), "one image for every camera");
        Self { photographs, views }
    }

    /// `[height · width]`: how far from the median depth the training images agree best, scene units, in whole steps up
    /// to a 20th of the depth. Half of that where fewer than two cameras see the place, NaN where nothing is shown.
    /// Advances the monitor by one per row.
    ///
    /// # Errors
    /// [`octobayes::Error::Interrupted`] only.
    pub fn of_view(
        &self,
        camera: &Camera,
        pixel_offset: f64,
        view: &RenderedView,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>> {
        let width = view.resolution[0] as usize;
        let row = |y: usize| {
            check(monitor)?;
            let pixel = |x: usize| {
                let pixel = &view.pixels[y * width + x];
                let at = [x, y].map(|n| n as f64 + pixel_offset);
                if pixel.opacity > 0.0 { self.at(camera, at, pixel.median_depth) } else { f64::NAN }
            };
            let row = (0..width).map(pixel).collect::<Vec<f64>>();
            monitor.advance(1);
            Ok(row)
        };
        let rows = (0..view.resolution[1] as usize).into_par_iter().map(row).collect::<Result<Vec<_>>>()?;
        Ok(rows.concat())
    }

    /// The same at an image point whose median depth is `depth`.
    fn at(&self, camera: &Camera, [x, y]: [f64; 2], depth: f64) -> f64 {
        let rays = PATCH.map(|[dx, dy]| camera.ray(x + dx, y + dy));
        let point = rays[0].at(depth);
        let towards = (camera.position - point).normalize();
        let angle = |i: usize| (self.photographs[i].camera().position - point).normalize().dot(towards);
        let mut seeing: Vec<(f64, usize)> = self.views.seeing(point).map(|(i, _)| (angle(i), i)).collect();
        seeing.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        seeing.truncate(IMAGES);
        let step = Self::STEP * depth;
        let unknown = 0.5 * f64::from(STEPS) * step;
        if seeing.len() < 2 {
            return unknown;
        }
        // The nearest of equals, so that images of one colour leave the depth where it is.
        let mut best = (self.spread(&rays, depth, &seeing), 0);
        for k in (1..=STEPS).flat_map(|k| [k, -k]) {
            let spread = self.spread(&rays, depth + f64::from(k) * step, &seeing);
            if spread < best.0 {
                best = (spread, k.abs());
            }
        }
        if best.0.is_finite() { f64::from(best.1) * step } else { unknown }
    }

    /// Variance of the colours that images have of the points of rays at a depth, mean over the points that two or more
    /// show; infinite if there is none.
    fn spread(&self, rays: &[Ray], depth: f64, seeing: &[(f64, usize)]) -> f64 {
        let (mut spread, mut points) = (0.0, 0.0);
        for ray in rays {
            let x = ray.at(depth);
            let (mut n, mut sum, mut squares) = (0.0, DVec3::ZERO, 0.0);
            for color in seeing.iter().filter_map(|(_, i)| self.photographs[*i].color(x)) {
                let color = DVec3::from(color.map(f64::from));
                (n, sum, squares) = (n + 1.0, sum + color, squares + color.length_squared());
            }
            if n > 1.0 {
                spread += (squares / n - (sum / n).length_squared()).max(0.0);
                points += 1.0;
            }
        }
        if points > 0.0 { spread / points } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use octobayes::field::{ClosedForm, RadianceField};
    use octobayes::monitor::Silent;
    use octobayes::render::{Marcher, Renderer, Tracer, VolumeRenderer};
    use octobayes_data::PosedImage;

    use super::*;

    const SIDE: u32 = 96;

    #[test]
    fn images_agree_at_the_true_depth_wherever_the_model_has_it() {
        let ball = ClosedForm::ball();
        let marcher = Marcher { step: 0.01, bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
        let model = VolumeRenderer { tracer, differentiation: None };
        let camera = |azimuth: f64| {
            let eye = 3.0 * DVec3::new(azimuth.cos(), azimuth.sin(), 0.2);
            Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.4, [SIDE; 2])
        };
        let cameras = [-0.5, -0.25, 0.0, 0.25, 0.5].map(camera);
        let views = TrainingViews::render(&model, &cameras, 0.5, &Silent).unwrap();
        let photograph = |camera: &Camera, grey: bool| {
            let shown = model.image(camera, 0.5, &[], &Silent).unwrap();
            let color = |v: f64| if grey { 100 } else { (255.0 * v).round() as u8 };
            let pixel = |pixel: &octobayes::render::Pixel| {
                let [r, g, b] = pixel.color.to_array().map(color);
                [r, g, b, 255]
            };
            let image = PosedImage::new([SIDE; 2], shown.pixels.iter().map(pixel).collect());
            Photograph::new(*camera, image, None, DVec3::ONE, 0.5)
        };
        let photographs: Vec<Photograph> = cameras.iter().map(|camera| photograph(camera, false)).collect();
        let between = camera(0.1);
        let shown = model.image(&between, 0.5, &[], &Silent).unwrap();
        // Pixels that show the front of the ball.
        let front: Vec<usize> = (0..(SIDE * SIDE) as usize)
            .filter(|&i| shown.pixels[i].opacity > 0.99 && shown.pixels[i].median_depth < 2.7)
            .collect();
        let median_of = |photographs: &[Photograph], moved: f64| {
            let mut view = shown.clone();
            view.pixels.iter_mut().for_each(|pixel| pixel.median_depth += moved);
            let found = Sweep::new(photographs, &views).of_view(&between, 0.5, &view, &Silent).unwrap();
            assert!(found.iter().zip(&view.pixels).all(|(b, pixel)| b.is_nan() == (pixel.opacity == 0.0)));
            let mut found: Vec<f64> = front.iter().map(|&i| found[i]).collect();
            found.sort_unstable_by(f64::total_cmp);
            found[found.len() / 2]
        };
        // The density of the ball rises over 0.04, five steps of 3 / 400, and a pixel mixes the colours there.
        let step = 3.0 * Sweep::STEP;
        assert!(front.len() > 1000 && median_of(&photographs, 0.0) <= 2.0 * step);
        for moved in [-0.06, -0.1] {
            let found = median_of(&photographs, moved);
            assert!((found + moved).abs() <= 3.0 * step, "{found} of {moved}");
        }
        // Images of one colour know of no better place, and one image alone neither.
        let grey: Vec<Photograph> = cameras.iter().map(|camera| photograph(camera, true)).collect();
        assert_eq!(median_of(&grey, -0.06), 0.0);
        let one = TrainingViews::render(&model, &cameras[..1], 0.5, &Silent).unwrap();
        let alone = Sweep::new(&photographs[..1], &one).of_view(&between, 0.5, &shown, &Silent).unwrap();
        let expected = 10.0 * Sweep::STEP;
        assert!(front.iter().all(|&i| (alone[i] / shown.pixels[i].median_depth - expected).abs() < 1e-9));
    }
}
