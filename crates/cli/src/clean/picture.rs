//! Views before and after, and what goes in the colours of its reasons.

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, Silent, check};
use octobayes::render::Renderer;
use octobayes_clean::Strength;
use octobayes_session::scaled;
use octobayes_show::picture::{Panel, color_panel, write_sheet};

use super::found::{Found, legend};

/// Cameras among which those are looked for that show most of the difference.
const CAMERAS: usize = 8;
/// Longest side of the images in which it is looked for, and of those that are written, pixels.
const SKETCH: f64 = 128.0;
const SIDE: f64 = 480.0;

/// A model before and after, and the cameras that may show it.
pub struct Pictures<'a> {
    pub found: &'a dyn Found,
    pub cameras: &'a [Camera],
    pub background: Vec3,
    pub monitor: &'a dyn Monitor,
}

impl Pictures<'_> {
    /// A model, ready for images.
    pub fn renderer<'m>(&self, model: &'m dyn Model) -> Result<Box<dyn Renderer + 'm>> {
        model.for_images(&RaySettings::for_images().background(self.background), &Silent)
    }

    /// A model as a camera shows it.
    pub fn panel(&self, title: &str, renderer: &dyn Renderer, camera: &Camera) -> Result<Panel> {
        let (resolution, colors) = self.image(renderer, camera, SIDE)?;
        Ok(color_panel(title, resolution, colors))
    }

    fn image(&self, renderer: &dyn Renderer, camera: &Camera, side: f64) -> Result<([u32; 2], Vec<DVec3>)> {
        check(self.monitor)?;
        let longest = f64::from(camera.resolution.into_iter().max().unwrap_or(1));
        let camera = scaled(camera, (side / longest).min(1.0));
        let view = renderer.image(&camera, 0.5, &[], &Silent)?;
        Ok((view.resolution, view.pixels.iter().map(|pixel| pixel.color).collect()))
    }

    /// Up to `count` cameras, of some evenly chosen ones those that show most of what goes at a strength, in their
    /// order; each with its number.
    pub fn cameras(&self, strength: Strength, count: usize) -> Result<Vec<(usize, &Camera)>> {
        let left = self.found.left(strength)?;
        let [before, after] = [self.renderer(self.found.before())?, self.renderer(&*left)?];
        let used = self.cameras.len().min(CAMERAS);
        let mut shown = Vec::new();
        self.monitor.begin("views before and after", used as u64);
        for i in (0..used).map(|i| i * self.cameras.len() / used) {
            let [before, after] = [&before, &after].map(|renderer| self.image(&**renderer, &self.cameras[i], SKETCH));
            let pairs = before?.1.into_iter().zip(after?.1);
            shown.push((i, pairs.map(|(a, b)| (a - b).abs().element_sum()).sum::<f64>()));
            self.monitor.advance(1);
        }
        self.monitor.end();
        shown.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut best: Vec<usize> = shown.into_iter().take(count).map(|(i, _)| i).collect();
        best.sort_unstable();
        Ok(best.into_iter().map(|i| (i, &self.cameras[i])).collect())
    }
}

/// Writes three images of the camera that shows most of what goes.
pub fn write(path: &Path, pictures: &Pictures, strength: Strength) -> Result<()> {
    let Pictures { found, .. } = pictures;
    let (_, camera) = pictures.cameras(strength, 1)?[0];
    let (marked, left) = (found.marked(strength), found.left(strength)?);
    let title = format!("what goes: {}", legend(*found, strength).join(", "));
    let panels = [("before", found.before()), (&title, &*marked), ("after", &*left)];
    let panels = panels.into_iter().map(|(title, model)| pictures.panel(title, &*pictures.renderer(model)?, camera));
    write_sheet(path, &[panels.collect::<Result<Vec<Panel>>>()?])
}
