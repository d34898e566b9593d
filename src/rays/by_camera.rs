//! Rays camera by camera, through a model whose views have to be prepared.
//!
//! To prepare a view of splats takes as long as to composite ten thousand of its pixels, so a run draws all rays of a
//! camera before those of the next. They are the rays that [`PixelSequence`] gives the camera when cameras take turns:
//! the set of rays of a whole run is the same, and only their order differs. Within a camera they are sorted by tiles,
//! whose splats then stay in the cache.

use std::ops::Range;

use rayon::prelude::*;

use super::pixels::PixelSequence;
use crate::geometry::Camera;
use crate::monitor::{Monitor, check};
use crate::render::{CameraView, ImagePoints, Outputs, RaySamples, Renderer};
use crate::{Error, Result};

/// Rays of a run camera by camera: where each camera's begin.
struct Order {
    /// `[cameras + 1]`.
    starts: Vec<u64>,
}

impl Order {
    fn new(pixels: &PixelSequence, rays: u64) -> Self {
        let mut starts = vec![0];
        for share in pixels.shares(rays) {
            starts.push(starts[starts.len() - 1] + share);
        }
        Self { starts }
    }

    /// Number of rays of a camera.
    fn share(&self, camera: usize) -> u64 {
        self.starts[camera + 1] - self.starts[camera]
    }

    /// Splits rays by camera: each camera, and the ranks of its rays among all of its own.
    fn parts(&self, rays: Range<u64>) -> Vec<(usize, Range<u64>)> {
        let mut camera = self.starts.partition_point(|&start| start <= rays.start) - 1;
        let mut parts = Vec::new();
        let mut at = rays.start;
        while at < rays.end {
            let end = rays.end.min(self.starts[camera + 1]);
            if at < end {
                parts.push((camera, at - self.starts[camera]..end - self.starts[camera]));
            }
            (at, camera) = (end, camera + 1);
        }
        parts
    }
}

/// A camera's view, and the pixels of all its rays by tile.
struct Prepared<'a> {
    camera: usize,
    view: Box<dyn CameraView + 'a>,
    pixels: Vec<[u32; 2]>,
}

/// Draws the rays of a run; keeps the view that it used last.
pub(super) struct CameraByCamera<'r> {
    renderer: &'r dyn Renderer,
    cameras: &'r [Camera],
    pixels: &'r PixelSequence,
    pixel_offset: f64,
    order: Order,
    prepared: Option<Prepared<'r>>,
}

/// A part of a batch that one camera sees.
struct Part {
    /// Which batch of those that are drawn together.
    batch: usize,
    camera: usize,
    ranks: Range<u64>,
    /// Index of the first ray in the run.
    first: u64,
}

impl<'r> CameraByCamera<'r> {
    /// Prepares to draw a run of `rays` rays.
    ///
    /// # Errors
    /// If pixels are drawn at random, which cannot be sorted by camera.
    pub fn new(
        renderer: &'r dyn Renderer,
        cameras: &'r [Camera],
        pixels: &'r PixelSequence,
        pixel_offset: f64,
        rays: u64,
    ) -> Result<Self> {
        if pixels.kind() == super::Pixels::Random {
            let expected = "`sobol` or `every`, which can be drawn camera by camera";
            return Err(Error::setting("pixels", expected, "random ones"));
        }
        Ok(Self { renderer, cameras, pixels, pixel_offset, order: Order::new(pixels, rays), prepared: None })
    }

    fn prepare(&self, camera: usize) -> Prepared<'r> {
        let pick = |n: u64| (self.pixels.of_camera(camera, n).pixel, n);
        let mut picks: Vec<([u32; 2], u64)> = (0..self.order.share(camera)).into_par_iter().map(pick).collect();
        let key = |pixel: [u32; 2]| self.renderer.tile_of(pixel.map(f64::from));
        picks.par_sort_unstable_by_key(|&(pixel, n)| (key(pixel), n));
        let view = self.renderer.view(&self.cameras[camera], Outputs::Derivatives);
        Prepared { camera, view, pixels: picks.into_iter().map(|(pixel, _)| pixel).collect() }
    }

    /// The samples of batches of rays, each a range of the run's.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn samples(&mut self, batches: &[Range<u64>], monitor: &dyn Monitor) -> Result<Vec<RaySamples>> {
        let of_batch = |(batch, rays): (usize, &Range<u64>)| {
            let mut first = rays.start;
            let parts = self.order.parts(rays.clone()).into_iter().map(move |(camera, ranks)| {
                let part = Part { batch, camera, first, ranks: ranks.clone() };
                first += ranks.end - ranks.start;
                part
            });
            parts.collect::<Vec<Part>>()
        };
        let parts: Vec<Part> = batches.iter().enumerate().flat_map(of_batch).collect();
        let mut samples = vec![RaySamples::default(); batches.len()];
        for of_camera in parts.chunk_by(|a, b| a.camera == b.camera) {
            check(monitor)?;
            let camera = of_camera[0].camera;
            let prepared = match self.prepared.take().filter(|prepared| prepared.camera == camera) {
                Some(prepared) => prepared,
                None => self.prepare(camera),
            };
            let offset = self.pixel_offset;
            let points = |part: &Part| {
                let pixels = &prepared.pixels[part.ranks.start as usize..part.ranks.end as usize];
                let at = pixels.iter().map(|pixel| pixel.map(|i| f64::from(i) + offset)).collect();
                ImagePoints { at, jitter: Vec::new(), first: part.first }
            };
            let drawn = prepared.view.samples(&of_camera.iter().map(points).collect::<Vec<_>>(), monitor)?;
            monitor.advance(of_camera.iter().map(|part| part.ranks.end - part.ranks.start).sum());
            for (part, drawn) in of_camera.iter().zip(drawn) {
                samples[part.batch].append(drawn);
            }
            self.prepared = Some(prepared);
        }
        Ok(samples)
    }
}
