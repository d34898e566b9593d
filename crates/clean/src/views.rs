//! What pixels of training views show, listed once: the model can then be looked at without some parts at once.

use octobayes::Result;
use octobayes::geometry::{Camera, Mask, check_sizes};
use octobayes::monitor::{Monitor, check};
use octobayes_splats::strided_pixels;
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

/// A part that a pixel shows: a splat, or what a ray meets in a cell.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Listed {
    pub part: u32,
    /// α.
    pub alpha: f32,
    /// Along the view axis, scene units.
    pub depth: f32,
}

/// The parts of some pixels of a view.
pub(crate) struct ListedView {
    pub camera: Camera,
    /// The first row and column, and how far it is to the next ones.
    pub start: u32,
    pub stride: u32,
    /// By row: of every column the parts front to back.
    pub rows: Vec<ListedRow>,
}

/// A row of pixels.
#[derive(Default)]
pub(crate) struct ListedRow {
    hits: Vec<Listed>,
    /// Where each pixel's parts end; the next one's begin there.
    ends: Vec<u32>,
    /// Left out by the mask, or because the ray was dropped.
    is_masked: Vec<bool>,
}

/// The parts of some points of a view, one point after the other.
#[derive(Default)]
pub(crate) struct ListedPoints {
    hits: Vec<Listed>,
    ends: Vec<u32>,
    is_unknown: Vec<bool>,
}

impl ListedPoints {
    /// Adds the parts of the next point, front to back.
    pub fn push(&mut self, hits: impl IntoIterator<Item = Listed>) {
        self.hits.extend(hits);
        self.ends.push(self.hits.len() as u32);
        self.is_unknown.push(false);
    }

    /// Adds a point without an answer: its ray was dropped.
    pub fn push_unknown(&mut self) {
        self.ends.push(self.hits.len() as u32);
        self.is_unknown.push(true);
    }
}

impl ListedView {
    /// Number of pixels that were looked at.
    pub fn pixels(&self) -> u64 {
        self.rows.iter().map(|row| row.pixels().flatten().count() as u64).sum()
    }
}

impl ListedRow {
    /// The parts that the row shows.
    pub fn hits(&self) -> &[Listed] {
        &self.hits
    }

    /// The same, to be numbered anew.
    pub fn hits_mut(&mut self) -> &mut [Listed] {
        &mut self.hits
    }

    /// The parts of every column, front to back; `None` where the mask leaves it out, or its ray was dropped.
    pub fn pixels(&self) -> impl Iterator<Item = Option<&[Listed]>> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let ranges = starts.zip(&self.ends).map(|(start, &end)| &self.hits[start as usize..end as usize]);
        ranges.zip(&self.is_masked).map(|(hits, is_masked)| (!is_masked).then_some(hits))
    }
}

impl Views<'_> {
    /// Lists what each view shows, 12 bytes a part and pixel, and passes it on. `prepare` makes of a camera what adds
    /// the parts of image points (pixels from the top left corner) to a list.
    pub fn list<R>(
        &self,
        monitor: &dyn Monitor,
        prepare: impl Fn(&Camera) -> R,
        mut take: impl FnMut(ListedView),
    ) -> Result<()>
    where
        R: Fn(&[[f64; 2]], &mut ListedPoints) -> Result<()> + Sync,
    {
        check_sizes(self.cameras, self.masks)?;
        monitor.begin("training views", self.cameras.len().div_ceil(self.every) as u64);
        for (i, camera) in self.cameras.iter().enumerate().step_by(self.every) {
            check(monitor)?;
            let mask = self.masks.get(i).and_then(Option::as_ref);
            take(self.view(camera, mask, &prepare(camera))?);
            monitor.advance(1);
        }
        monitor.end();
        Ok(())
    }

    /// The cameras whose views are left out.
    pub fn others(&self) -> impl Iterator<Item = &Camera> {
        self.cameras.iter().enumerate().filter(|(i, _)| i % self.every != 0).map(|(_, camera)| camera)
    }

    fn view<R>(&self, camera: &Camera, mask: Option<&Mask>, list: &R) -> Result<ListedView>
    where
        R: Fn(&[[f64; 2]], &mut ListedPoints) -> Result<()> + Sync,
    {
        let [columns, rows] = strided_pixels(camera, self.stride);
        let of_row = |&row: &u32| {
            let is_masked: Vec<bool> =
                columns.iter().map(|&column| mask.is_some_and(|mask| !mask.keeps(column, row))).collect();
            let kept = columns.iter().zip(&is_masked).filter(|(_, is_masked)| !**is_masked);
            let points: Vec<[f64; 2]> =
                kept.map(|(&column, _)| [column, row].map(|i| f64::from(i) + self.pixel_offset)).collect();
            let mut listed = ListedPoints::default();
            list(&points, &mut listed)?;
            let mut points = listed.ends.into_iter().zip(listed.is_unknown);
            let (mut is_masked, mut ends, mut last) = (is_masked, Vec::with_capacity(columns.len()), 0);
            for is_masked in &mut is_masked {
                if !*is_masked {
                    (last, *is_masked) = points.next().expect("an end of every point");
                }
                ends.push(last);
            }
            listed.hits.shrink_to_fit();
            Ok(ListedRow { hits: listed.hits, ends, is_masked })
        };
        let rows = rows.par_iter().map(of_row).collect::<Result<_>>()?;
        Ok(ListedView { camera: *camera, start: columns[0], stride: self.stride, rows })
    }
}
