//! What one camera sees of splats, and the way back from its pixels to their parameters.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::cloud::Row;
use super::project::{Ellipse, Moments, View};
use super::raster::Tiles;
use octobayes::geometry::Camera;

/// The ellipses of an image.
pub struct Picture {
    view: View,
    pub ellipses: Vec<Ellipse>,
    tiles: Tiles,
}

impl Picture {
    /// Projects, sorts and lists splats, with colours up to a degree of the spherical harmonics.
    pub fn new(rows: &[Row], camera: &Camera, degree: u8) -> Self {
        let view = View::new(camera, degree);
        let ellipses: Vec<Ellipse> =
            rows.par_iter().enumerate().with_min_len(256).filter_map(|(i, row)| view.ellipse(i, row)).collect();
        let tiles = Tiles::new(&ellipses, camera.resolution);
        Self { view, ellipses, tiles }
    }

    /// The pixels `[height · width]` in front of a background.
    pub fn image(&self, background: Vec3) -> Vec<Vec3> {
        self.tiles.image(&self.ellipses, background)
    }

    /// Derivatives of a loss by the parameters of each ellipse's splat, and by its place on the image (1 / pixel), from
    /// the image and the derivatives by its pixels.
    pub fn pull_back(&self, rows: &[Row], image: &[Vec3], by_pixel: &[Vec3]) -> Vec<(Row, Vec2)> {
        let moments = self.tiles.moments(&self.ellipses, image, by_pixel);
        let of =
            |(ellipse, sums): (&Ellipse, &Moments)| self.view.pull_back(&rows[ellipse.splat as usize], ellipse, sums);
        self.ellipses.par_iter().zip(&moments).with_min_len(256).map(of).collect()
    }
}
