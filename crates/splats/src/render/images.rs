//! Images of splats.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{Hits, SplatRenderer, SplatView, tile_of};
use octobayes::Result;
use octobayes::geometry::{Aabb, Camera, Ray};
use octobayes::monitor::{Monitor, check};
use octobayes::render::{
    CameraView, CompositingWeights, ImagePoints, Outputs, Probe, RaySamples, RenderedView, Renderer, VisibleSegment,
    WeightedRays, WeightedSamples, check_size,
};

/// Rows of pixels that are composited together, so that probes are evaluated at many points at once: those of one tile.
const ROWS: u32 = super::tiles::TILE;

/// Image points that a thread lists together.
const POINTS: usize = 256;

impl Renderer for SplatRenderer<'_> {
    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn background(&self) -> DVec3 {
        self.background.as_dvec3()
    }

    fn main_box(&self) -> Aabb {
        self.splats.main_box()
    }

    fn memory(&self) -> usize {
        self.splats.memory()
    }

    fn view<'v>(&'v self, camera: &Camera, to: Outputs) -> Box<dyn CameraView + 'v> {
        Box::new(self.prepare(camera, to))
    }

    fn tile_of(&self, at: [f64; 2]) -> [u32; 2] {
        tile_of(at)
    }

    fn stands_in_matter(&self, camera: &Camera, _sight: &[VisibleSegment]) -> bool {
        self.splats.is_in_one(camera.position)
    }

    fn strided_image(
        &self,
        camera: &Camera,
        stride: u32,
        pixel_offset: f64,
        probes: &[Probe],
        monitor: &dyn Monitor,
    ) -> Result<RenderedView> {
        check_size(camera)?;
        Self::check_cameras([camera])?;
        let view = self.prepare(camera, Outputs::Colors);
        let resolution = camera.strided(stride, pixel_offset).resolution;
        let [width, height] = resolution;
        let bands: Vec<u32> = (0..height).step_by(ROWS as usize).collect();
        let part = |first: u32| {
            check(monitor)?;
            let rows = first..height.min(first + ROWS);
            let at = |x: u32, y: u32| [x, y].map(|i| f64::from(i * stride) + pixel_offset);
            let points: Vec<[f64; 2]> = rows.clone().flat_map(|y| (0..width).map(move |x| at(x, y))).collect();
            let part = view.points(&points, probes);
            monitor.advance(u64::from(rows.end - rows.start));
            Ok(part)
        };
        let parts = bands.into_par_iter().map(part).collect::<Result<_>>()?;
        Ok(RenderedView::joined(resolution, parts))
    }

    fn points(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<RenderedView> {
        Self::check_cameras(views.iter().map(|(camera, _)| camera))?;
        let of_view = |(camera, points): &(Camera, Vec<[f64; 2]>)| {
            check(monitor)?;
            Ok(self.prepare(camera, Outputs::Colors).points(points, &[]))
        };
        let parts = views.iter().map(of_view).collect::<Result<Vec<RenderedView>>>()?;
        let points: usize = parts.iter().map(|part| part.pixels.len()).sum();
        Ok(RenderedView::joined([points as u32, 1], parts))
    }

    fn weighted(&self, views: &[(Camera, Vec<[f64; 2]>)], monitor: &dyn Monitor) -> Result<WeightedSamples> {
        let mut parts = Vec::new();
        for (camera, points) in views {
            check(monitor)?;
            let view = self.prepare(camera, Outputs::Colors);
            let weighted = points.par_chunks(POINTS).map(|points| view.weighted(points));
            parts.extend(weighted.collect::<Vec<_>>());
        }
        Ok(WeightedSamples::joined(parts))
    }
}

impl CameraView for SplatView<'_> {
    fn samples(&self, points: &[ImagePoints], monitor: &dyn Monitor) -> Result<Vec<RaySamples>> {
        let of_points = |points: &ImagePoints| {
            let (mut hits, mut out) = (Hits::default(), RaySamples::default());
            for (&at, index) in points.at.iter().zip(points.first..) {
                self.push_samples(at, index, &mut hits, &mut out);
            }
            out
        };
        check(monitor).map(|()| points.par_iter().map(of_points).collect())
    }

    fn sight(&self, points: &[ImagePoints]) -> Vec<RaySamples> {
        let of_points = |points: &ImagePoints| {
            let mut hits = Hits::default();
            let sight = points.at.iter().map(|&at| self.sight(at, &mut hits)).collect();
            RaySamples { sight, ..RaySamples::default() }
        };
        points.par_iter().map(of_points).collect()
    }
}

impl SplatView<'_> {
    /// The splats that image points show, with their weights.
    fn weighted(&self, points: &[[f64; 2]]) -> WeightedSamples {
        let (mut hits, mut out) = (Hits::default(), WeightedSamples::default());
        for &at in points {
            let ray = self.camera.ray(at[0], at[1]);
            self.hits(at, &mut hits);
            for hit in &hits.list {
                out.positions.push(self.renderer.splats.mean(self.splat(hit)));
                out.weights.push(hit.weight());
                out.t.push(self.distance(hit, &ray));
            }
            out.offsets.push(out.positions.len());
            out.is_dropped.push(false);
        }
        out
    }

    /// Renders single image points, as an image of one row.
    fn points(&self, points: &[[f64; 2]], probes: &[Probe]) -> RenderedView {
        let rays: Vec<Ray> = points.iter().map(|&[x, y]| self.camera.ray(x, y)).collect();
        let mut quadrature = CompositingWeights::default();
        let (mut positions, mut colors, mut t) = (Vec::<Vec3>::new(), Vec::<Vec3>::new(), Vec::<f64>::new());
        let (mut samples, mut thickness) = (Vec::with_capacity(rays.len()), Vec::with_capacity(rays.len()));
        let mut hits = Hits::default();
        for (&at, ray) in points.iter().zip(&rays) {
            self.hits(at, &mut hits);
            let first = t.len();
            let (mut total, mut own) = (0.0, 0.0);
            for hit in &hits.list {
                let footprint = &self.footprints[hit.footprint as usize];
                quadrature.weights.push(hit.weight());
                quadrature.transmittance_after.push(hit.before - hit.weight());
                positions.push(self.renderer.splats.mean(footprint.splat as usize));
                colors.push(footprint.color.as_vec3());
                t.push(self.distance(hit, ray));
                (total, own) = (total + hit.weight(), own + hit.weight() * footprint.thickness);
            }
            samples.push(first..t.len());
            // Along the view axis; along the ray it is as much longer as distances are, squared.
            let slant = ray.direction.dot(self.forward());
            thickness.push(if total > 0.0 { own / (total * slant * slant) } else { 0.0 });
        }
        let weighted = WeightedRays {
            rays: &rays,
            samples,
            quadrature: &quadrature,
            positions: &positions,
            colors: &colors,
            t: &t,
            thickness,
            background: self.renderer.background.as_dvec3(),
            bounds: self.renderer.bounds,
            dropped: 0,
        };
        weighted.view(probes)
    }
}
