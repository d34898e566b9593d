//! Splats as parts.

use glam::Vec3;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes::render::Outputs;
use octobayes_splats::{Hits, SplatRenderer, Splats, stride_for};
use rayon::prelude::*;

use crate::evidence::Parts;
use crate::run::Listing;
use crate::views::{Listed, ListedPoints, ListedView, Views};
use crate::{Clean, Cleaned};

/// Most projections of a splat to a view, all together: each takes a third of a microsecond on two cores.
/// [`LEAST_VIEWS`] come first.
const MOST_PROJECTED: usize = 64_000_000;
const LEAST_VIEWS: usize = 48;

impl Clean<'_> {
    /// Finds which splats go at each strength.
    ///
    /// # Errors
    /// If there is no camera, if masks are not those of the cameras, if a lens distorts, if nothing would be left at any
    /// strength, or [`Error::Interrupted`](octobayes::Error::Interrupted).
    pub fn splats(&self, splats: &Splats) -> Result<Cleaned> {
        self.check_cameras()?;
        let most = (MOST_PROJECTED / splats.len()).max(LEAST_VIEWS);
        let every = self.cameras.len().div_ceil(most);
        let stride = stride_for(self.cameras.iter().map(Camera::pixels).sum::<u64>() / every as u64, self.pixels);
        let (cameras, masks, pixel_offset) = (self.cameras, self.masks, self.pixel_offset);
        let pixels = Views { cameras, masks, pixel_offset, stride, every };
        let mut views = Vec::new();
        list_splats(&pixels, splats, self.monitor, |view| views.push(view))?;
        let parts = Parts { centers: splats.means(), reach: &[], by_window: false };
        let opacities = (0..splats.len()).map(|i| splats.opacity(i)).collect();
        // In the image of a camera that was not looked through.
        let others: Vec<&Camera> = pixels.others().collect();
        let is_in_one = |x: &Vec3| others.iter().any(|camera| camera.project_inside(x.as_dvec3()).is_some());
        let may_be_shown = splats.means().par_iter().map(is_in_one).collect();
        self.decide(&Listing { views, parts, opacities, may_be_shown })
    }
}

/// Lists the splats that each view shows.
pub(crate) fn list_splats(
    views: &Views,
    splats: &Splats,
    monitor: &dyn Monitor,
    take: impl FnMut(ListedView),
) -> Result<()> {
    SplatRenderer::check_cameras(views.cameras)?;
    // What lies behind the splats takes no part in their weights.
    let renderer = SplatRenderer::new(splats, Vec3::ZERO);
    let prepare = |camera: &Camera| {
        let view = renderer.prepare(camera, Outputs::Colors);
        move |points: &[[f64; 2]], listed: &mut ListedPoints| {
            let mut hits = Hits::default();
            for &at in points {
                view.hits(at, &mut hits);
                listed.push(hits.list.iter().map(|hit| Listed {
                    part: view.splat(hit) as u32,
                    alpha: hit.alpha as f32,
                    depth: view.depth(hit) as f32,
                }));
            }
            Ok(())
        }
    };
    views.list(monitor, prepare, take)
}

#[cfg(test)]
mod tests;
