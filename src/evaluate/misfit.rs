//! What training left unexplained, and where: residuals of the training images on the vertices of a lattice.
//!
//! The Laplace approximation knows how far matter could be moved without a training image noticing. It does not know
//! where the model fails to show what the images show: noise of the images, and what the model cannot represent
//! (Goli et al. 2024, section 6, "aleatoric").
//!
//! Letters: r² squared residual of a pixel's colour, mean over red, green and blue; φ trilinear weights.

use glam::Vec3;
use rustc_hash::FxHashMap;

use super::TrueView;
use crate::Result;
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::octree::corners;
use crate::render::{Tracer, render_view};

/// The weight of the mean over all pixels at every vertex, in pixels.
const PRIOR: f64 = 1.0;

/// Residuals of the training images around each point.
#[derive(Debug, Clone)]
pub struct Misfit {
    lattice: Lattice,
    /// Σ φ r² and Σ φ over the pixels that show a vertex' surroundings, by lattice point.
    sums: FxHashMap<[u32; 3], [f64; 2]>,
    /// Mean r² over the pixels of all images that show matter.
    mean: f64,
}

impl Misfit {
    /// Compares the model with its training images. A pixel's residual lies at its expected depth. Advances the monitor
    /// by one per row.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn new(tracer: &Tracer, images: &[TrueView], lattice: Lattice, monitor: &dyn Monitor) -> Result<Self> {
        let mut found = Self { lattice, sums: FxHashMap::default(), mean: 0.0 };
        let mut pixels = 0.0_f64;
        for image in images {
            let view = render_view(tracer, &image.camera, image.pixel_offset, &[], monitor)?;
            let width = image.camera.resolution[0] as usize;
            // In the order of the pixels, so that the sums do not depend on the number of threads.
            for (i, pixel) in view.pixels.iter().enumerate().filter(|(_, pixel)| pixel.opacity > 0.5) {
                let [x, y] = [i % width, i / width].map(|n| n as f64 + image.pixel_offset);
                let position = image.camera.ray(x, y).at(pixel.expected_depth).as_vec3();
                let residual = (pixel.color - image.colors[i]).length_squared() / 3.0;
                (found.mean, pixels) = (found.mean + residual, pixels + 1.0);
                let Some(u) = found.lattice.coordinates(position) else { continue };
                let (cell, offset) = found.lattice.cell(u);
                for (point, share) in corners(cell, offset) {
                    let sums = found.sums.entry(point).or_default();
                    *sums = [sums[0] + share * residual, sums[1] + share];
                }
            }
        }
        found.mean /= pixels.max(1.0);
        Ok(found)
    }

    /// Root mean square residual around a scene point, in colours from 0 to 1. Where no training image shows matter it
    /// is that of all pixels.
    #[must_use]
    pub fn at(&self, x: Vec3) -> f64 {
        let of = |point: [u32; 3]| {
            let [sum, count] = self.sums.get(&point).copied().unwrap_or_default();
            (sum + PRIOR * self.mean) / (count + PRIOR)
        };
        let mean = self.lattice.coordinates(x).map_or(self.mean, |u| {
            let (cell, offset) = self.lattice.cell(u);
            corners(cell, offset).into_iter().map(|(point, share)| share * of(point)).sum()
        });
        mean.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

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
        let misfit = Misfit::new(&tracer, &[truth], lattice, &Silent).unwrap();
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
