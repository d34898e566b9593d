//! What pixels of training views show, listed once: the splats can then be looked at without some of them at once.

use glam::Vec3;
use octobayes::Result;
use octobayes::geometry::{Camera, Mask, check_sizes};
use octobayes::monitor::{Monitor, check};
use octobayes::render::Outputs;
use octobayes_splats::{Hits, SplatRenderer, SplatView, Splats, strided_pixels};
use rayon::prelude::*;

/// Which pixels of training views are looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Views<'a> {
    pub cameras: &'a [Camera],
    /// Which pixels count, `[cameras]`, or none for all.
    pub masks: &'a [Option<Mask>],
    /// The place of a pixel's ray in it, pixels.
    pub pixel_offset: f64,
    /// One of so many pixels along each side.
    pub stride: u32,
    /// One of so many views.
    pub every: usize,
}

/// A splat that a pixel shows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Listed {
    pub splat: u32,
    /// α.
    pub alpha: f32,
    /// Along the view axis, scene units.
    pub depth: f32,
}

/// The splats of some pixels of a view.
pub(crate) struct ListedView {
    pub camera: Camera,
    /// The first row and column, and how far it is to the next ones.
    pub start: u32,
    pub stride: u32,
    /// By row: of every column the splats front to back, or `None` where the mask leaves the pixel out.
    pub rows: Vec<ListedRow>,
}

/// A row of pixels.
#[derive(Default)]
pub(crate) struct ListedRow {
    hits: Vec<Listed>,
    /// Where each pixel's splats end; the next one's begin there.
    ends: Vec<u32>,
    is_masked: Vec<bool>,
}

impl ListedView {
    /// Number of pixels that were looked at.
    pub fn pixels(&self) -> u64 {
        self.rows.iter().map(|row| row.pixels().flatten().count() as u64).sum()
    }
}

impl ListedRow {
    /// The splats of every column, front to back; `None` where the mask leaves it out.
    pub fn pixels(&self) -> impl Iterator<Item = Option<&[Listed]>> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let ranges = starts.zip(&self.ends).map(|(start, &end)| &self.hits[start as usize..end as usize]);
        ranges.zip(&self.is_masked).map(|(hits, is_masked)| (!is_masked).then_some(hits))
    }
}

impl Views<'_> {
    /// Lists what each view shows, 12 bytes a splat and pixel, and passes it on.
    pub fn list(&self, splats: &Splats, monitor: &dyn Monitor, mut take: impl FnMut(ListedView)) -> Result<()> {
        SplatRenderer::check_cameras(self.cameras)?;
        check_sizes(self.cameras, self.masks)?;
        // What lies behind the splats takes no part in their weights.
        let renderer = SplatRenderer::new(splats, Vec3::ZERO);
        monitor.begin("training views", self.cameras.len().div_ceil(self.every) as u64);
        for (i, camera) in self.cameras.iter().enumerate().step_by(self.every) {
            check(monitor)?;
            let mask = self.masks.get(i).and_then(Option::as_ref);
            take(self.view(&renderer.prepare(camera, Outputs::Colors), mask));
            monitor.advance(1);
        }
        monitor.end();
        Ok(())
    }

    /// The cameras whose views are left out.
    pub fn others(&self) -> impl Iterator<Item = &Camera> {
        self.cameras.iter().enumerate().filter(|(i, _)| i % self.every != 0).map(|(_, camera)| camera)
    }

    fn view(&self, view: &SplatView, mask: Option<&Mask>) -> ListedView {
        let [columns, rows] = strided_pixels(view.camera(), self.stride);
        let of_row = |&row: &u32| {
            let (mut hits, mut listed) = (Hits::default(), ListedRow::default());
            for &column in &columns {
                let is_masked = mask.is_some_and(|mask| !mask.keeps(column, row));
                if !is_masked {
                    view.hits([column, row].map(|i| f64::from(i) + self.pixel_offset), &mut hits);
                    listed.hits.extend(hits.list.iter().map(|hit| Listed {
                        splat: view.splat(hit) as u32,
                        alpha: hit.alpha as f32,
                        depth: view.depth(hit) as f32,
                    }));
                }
                listed.ends.push(listed.hits.len() as u32);
                listed.is_masked.push(is_masked);
            }
            listed.hits.shrink_to_fit();
            listed
        };
        let rows = rows.par_iter().map(of_row).collect();
        ListedView { camera: *view.camera(), start: columns[0], stride: self.stride, rows }
    }
}
