//! What cameras see: pixels of `render`, to which the volume is fitted.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::grid::Grid;
use octobayes::Result;
use octobayes::geometry::{Camera, Ray};
use octobayes::monitor::{Monitor, check};
use octobayes::render::{CompositingWeights, TraceBuffers, Tracer};
use octobayes::uncertainty::{BakedField, ThresholdedField};

/// Most cameras that look.
const CAMERAS: usize = 48;
/// Rays that are traced together, unless the model prefers more.
const RAYS_AT_ONCE: usize = 1024;
/// Rays that lose less are left out.
const MIN_RAY_LOSS: f64 = 0.02;
/// What contributes less to its ray is not seen.
const MIN_CONTRIBUTION: f64 = 0.01;

/// A ray that hits something.
pub struct SeenRay {
    pub ray: Ray,
    /// 1 − the transmittance at its end.
    pub opacity: f32,
    /// Mean of log10 U over what was hit.
    pub log10: f32,
    /// Distance at which half of what is lost is lost.
    pub depth: f64,
    /// Distances between which it loses light.
    pub span: [f64; 2],
    /// log10 U above which there is no density.
    pub most: f64,
}

impl SeenRay {
    /// True if there is density at x; `log10` returns log10 U.
    pub fn keeps(&self, x: Vec3, log10: impl Fn(Vec3) -> f64) -> bool {
        self.most == f64::INFINITY || log10(x) <= self.most
    }
}

/// Some of the cameras, spread over their order.
pub fn spread(cameras: &[Camera], most: usize) -> Vec<Camera> {
    let n = cameras.len().min(most);
    (0..n).map(|k| cameras[(2 * k + 1) * cameras.len() / (2 * n)]).collect()
}

/// The rays of smaller images of some of the `cameras` that hit something, as `render` sees them: of about `count`
/// pixels, without density where log10 U is above `most`.
///
/// # Errors
/// [`octobayes::Error::Interrupted`] only.
pub fn look(
    tracer: &Tracer,
    (field, most): (&BakedField, f64),
    cameras: &[Camera],
    offset: f64,
    count: f64,
    monitor: &dyn Monitor,
) -> Result<Vec<SeenRay>> {
    let cleaned = ThresholdedField::new(tracer.field, field, most);
    let tracer = if most < f64::INFINITY {
        &Tracer { field: &cleaned, marcher: tracer.marcher.clone(), background: tracer.background }
    } else {
        tracer
    };
    let cameras = spread(cameras, CAMERAS);
    let pixels: u64 = cameras.iter().map(Camera::pixels).sum();
    let scale = (count / pixels.max(1) as f64).sqrt().min(1.0);
    let small = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
    let rays: Vec<Ray> = cameras
        .iter()
        .map(|camera| camera.resized(camera.resolution.map(small)))
        .flat_map(|camera| {
            let [width, height] = camera.resolution;
            let ray = move |x: u32, y: u32| camera.ray(f64::from(x) + offset, f64::from(y) + offset);
            (0..height).flat_map(move |y| (0..width).map(move |x| ray(x, y)))
        })
        .collect();
    monitor.begin("rays", rays.len() as u64);
    let found: Vec<Vec<SeenRay>> = rays
        .par_chunks(RAYS_AT_ONCE.max(tracer.field.batch() / 4))
        .map(|rays| {
            check(monitor)?;
            monitor.advance(rays.len() as u64);
            Ok(see(tracer, field, most, rays))
        })
        .collect::<Result<_>>()?;
    monitor.end();
    Ok(found.into_iter().flatten().collect())
}

/// What single rays hit.
fn see(tracer: &Tracer, field: &BakedField, most: f64, rays: &[Ray]) -> Vec<SeenRay> {
    let mut buffers = TraceBuffers::default();
    tracer.trace(rays, &vec![0.5; rays.len()], &mut buffers);
    let traced = &buffers.traced;
    let mut quadrature = CompositingWeights::default();
    quadrature.set(traced, tracer.marcher.step);
    // Only depths of the pixel are needed.
    let colors = vec![Vec3::ZERO; traced.t.len()];
    let of_ray = |(r, ray): (usize, &Ray)| {
        let samples = traced.samples(r);
        let pixel = quadrature.pixel(&samples, &colors, &traced.t, DVec3::ZERO);
        if pixel.opacity < MIN_RAY_LOSS {
            return None;
        }
        let hit =
            || samples.clone().map(|i| (i, quadrature.weights[i])).filter(|(_, weight)| *weight >= MIN_CONTRIBUTION);
        let total: f64 = hit().map(|(_, weight)| weight).sum();
        let sum: f64 = hit().map(|(i, weight)| weight * field.log10(traced.positions[i])).sum();
        Some(SeenRay {
            ray: *ray,
            opacity: pixel.opacity as f32,
            // Thin fog only, that is nowhere worth a place: it has no value.
            log10: (sum / total) as f32,
            depth: pixel.median_depth,
            span: [traced.t[hit().next()?.0], traced.t[hit().next_back()?.0]],
            most,
        })
    };
    rays.iter().enumerate().filter_map(of_ray).collect()
}

/// The samples of a lattice around what rays see.
pub struct Marks {
    /// Words along x, and samples along y.
    rows: [usize; 2],
    /// One bit a sample.
    bits: Vec<u64>,
}

impl Marks {
    /// Marks the samples of the cells through which `rays` lose light, and those next to them.
    pub fn new(grid: &Grid, rays: &[SeenRay]) -> Self {
        let [nx, ny, nz] = grid.samples();
        let rows = [nx.div_ceil(64), ny];
        let mut marks = Self { rows, bits: vec![0; rows[0] * ny * nz] };
        for SeenRay { ray, span: [from, to], .. } in rays {
            let mut t = *from;
            loop {
                let x = ray.at(t);
                if let Some(at) = grid.lattice(x) {
                    marks.around(at.floor().to_array().map(|k| k as usize), [nx, ny, nz]);
                }
                if t >= *to {
                    break;
                }
                t = (t + 0.7 * grid.length(x.as_vec3())).min(*to);
            }
        }
        marks
    }

    fn around(&mut self, cell: [usize; 3], samples: [usize; 3]) {
        let [x, y, z] = [0, 1, 2].map(|axis| cell[axis].saturating_sub(1)..(cell[axis] + 3).min(samples[axis]));
        for z in z {
            for y in y.clone() {
                let row = self.rows[0] * (y + self.rows[1] * z);
                for x in x.clone() {
                    self.bits[row + x / 64] |= 1 << (x % 64);
                }
            }
        }
    }

    /// True if a sample is near to what is seen.
    pub fn has(&self, at: DVec3) -> bool {
        let [x, y, z] = at.to_array().map(|k| k as usize);
        self.bits[x / 64 + self.rows[0] * (y + self.rows[1] * z)] >> (x % 64) & 1 == 1
    }
}
