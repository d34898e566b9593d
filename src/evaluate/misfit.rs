//! Compares a model with its training images.

use super::TrueView;
use crate::Result;
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::render::{Tracer, render_view};
use crate::uncertainty::{Misfit, MisfitSums};

/// What training left unexplained in these images, for fields on a lattice.
///
/// A pixel's residual lies at its expected depth; pixels that show no matter have none. Images are taken one by one.
/// Advances the monitor by one per row.
///
/// # Errors
/// Those of the images, and [`crate::Error::Interrupted`].
pub fn measure_misfit(
    tracer: &Tracer,
    images: impl IntoIterator<Item = Result<TrueView>>,
    of: &Lattice,
    monitor: &dyn Monitor,
) -> Result<Misfit> {
    let mut sums = MisfitSums::new(of);
    for image in images {
        let image = image?;
        let view = render_view(tracer, &image.camera, image.pixel_offset, &[], monitor)?;
        let width = image.camera.resolution[0] as usize;
        // In the order of the pixels, so that the sums do not depend on the number of threads.
        for (i, pixel) in view.pixels.iter().enumerate().filter(|(_, pixel)| pixel.opacity > 0.5) {
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
            pixel_offset: 0.5,
            colors,
            covered: vec![true; 64 * 64],
            distance: vec![None; 64 * 64],
        };
        let lattice = Lattice::new(ball.bounds(), 4).unwrap();
        let misfit = measure_misfit(&tracer, [Ok(truth)], &lattice, &Silent).unwrap();
        let at = |x: f64, y: f64| {
            let pixel = &view.pixels[y as usize * 64 + x as usize];
            misfit.at(camera.ray(x + 0.5, y + 0.5).at(pixel.expected_depth).as_vec3())
        };
        let (high, low) = (at(32.0, 20.0), at(32.0, 44.0));
        let wrong = 0.2 / 3_f64.sqrt();
        // The mean square, about half of the wrong one, has the weight of one pixel beside six or more of the vertex'
        // own: √(6.5 / 7) of the wrong residual where it is, √(0.5 / 7) where none is.
        assert!((0.96 * wrong..=wrong).contains(&high) && low < 0.28 * wrong, "{high} and {low}");
        // Behind the ball, where no image shows anything: the mean over the pixels that show matter.
        let matter: Vec<usize> = (0..64 * 64).filter(|&i| view.pixels[i].opacity > 0.5).collect();
        let mean = matter.iter().filter(|&&i| i < 32 * 64).count() as f64 / matter.len() as f64;
        let behind = misfit.at(Vec3::new(-0.45, 0.0, 0.0));
        assert!((behind - wrong * mean.sqrt()).abs() < 1e-6 * wrong, "{behind}");
    }
}
