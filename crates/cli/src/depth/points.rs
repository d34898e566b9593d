//! Trusted points of all photographs.

use glam::Vec3;
use octobayes_depth::{DEPTH_JUMP, Trust};
use octobayes_show::export::DepthPoint;

use super::view::DepthView;
use super::{Look, Unit};

/// Points of every so many pixels: twice as many pixels whenever there are too many points.
pub struct Cloud {
    most: usize,
    every: u64,
    unit: Unit,
    /// Pixels until the next point.
    next: u64,
    points: Vec<DepthPoint>,
}

impl Cloud {
    /// At most so many points.
    pub fn new(most: usize, unit: Unit) -> Self {
        Self { most, every: 1, unit, next: 0, points: Vec::new() }
    }

    /// Adds points of a photograph.
    pub fn add(&mut self, view: &DepthView, look: &Look) {
        let offset = look.surveyor.pixel_offset;
        let background = look.surveyor.renderer.background();
        for (i, x) in view.trusted(offset) {
            if self.next > 0 {
                self.next -= 1;
                continue;
            }
            if self.points.len() == self.most {
                let mut is_even = false;
                self.points.retain(|_| {
                    is_even = !is_even;
                    is_even
                });
                self.every *= 2;
            }
            self.next = self.every - 1;
            let pixel = &view.rendered.pixels[i];
            let color = (pixel.color - (1.0 - pixel.opacity) * background) / pixel.opacity;
            self.points.push(DepthPoint {
                position: (self.unit.factor * x).as_vec3(),
                normal: normal(view, i, offset),
                color: color.as_vec3(),
                sigma: (self.unit.factor * view.sigma[i]) as f32,
                views: look.surveyor.training.sighting(x).agreeing as u16,
            });
        }
    }

    /// All points.
    pub fn points(&self) -> &[DepthPoint] {
        &self.points
    }
}

/// The normal of the depth map at pixel `i`, from its trusted neighbours; zero if there are none along x or y.
fn normal(view: &DepthView, i: usize, offset: f64) -> Vec3 {
    let [width, height] = view.rendered.resolution.map(|n| n as usize);
    let (x, y) = (i % width, i / width);
    let at = |x: usize, y: usize| {
        let j = y * width + x;
        let ray = view.camera.ray(x as f64 + offset, y as f64 + offset);
        (view.trust[j] == Trust::Trusted).then(|| ray.at(view.rendered.pixels[j].median_depth))
    };
    let Some(here) = at(x, y) else { return Vec3::ZERO };
    // What lies beyond a jump is another surface.
    let far = DEPTH_JUMP * view.rendered.pixels[i].median_depth;
    let beside = |x: usize, y: usize| at(x, y).filter(|other| other.distance(here) <= far);
    // Both sides where they are there, so that noise of one pixel counts less.
    let along = |before: Option<glam::DVec3>, after: Option<glam::DVec3>| match (before, after) {
        (Some(before), Some(after)) => Some(after - before),
        (Some(before), None) => Some(here - before),
        (None, Some(after)) => Some(after - here),
        (None, None) => None,
    };
    let right = along(x.checked_sub(1).and_then(|x| beside(x, y)), (x + 1 < width).then(|| beside(x + 1, y)).flatten());
    let down = along(y.checked_sub(1).and_then(|y| beside(x, y)), (y + 1 < height).then(|| beside(x, y + 1)).flatten());
    let Some((right, down)) = right.zip(down) else { return Vec3::ZERO };
    let normal = down.cross(right).normalize_or_zero();
    let towards = view.camera.position - here;
    (if normal.dot(towards) < 0.0 { -normal } else { normal }).as_vec3()
}
