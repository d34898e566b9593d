//! What one camera's rays meet: in a volume they are traced one by one, splats are projected for all of them at once.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::estimate::Subject;
use crate::geometry::Camera;
use crate::monitor::Monitor;
use crate::rays::{MAX_DROPPED_SHARE, RaySource, VolumeRays};
use crate::render::{CompositingWeights, JacobianBuffers, RayBatch, RaySamples, TraceBuffers, VisibleSegment};
use crate::splats::{Hits, SplatView, Splats, Use};
use crate::{Error, Result};

/// A camera stands in a volume's matter if half of its rays lose half of their light within so many samples.
const INSIDE_MATTER_SAMPLES: f64 = 4.0;

/// Image points of a camera whose rays are differentiated together.
pub struct Points {
    /// Column and row, pixels.
    pub at: Vec<[f64; 2]>,
    /// Shift of each ray's samples, in steps; splats have none.
    pub jitter: Vec<f64>,
    /// Index of the first ray.
    pub first: u64,
}

/// A camera in front of a model.
pub enum Look<'a> {
    /// A volume.
    Volume(&'a VolumeRays<'a>, Camera),
    /// Splats as it sees them.
    Splats(Box<SplatView<'a>>),
}

impl<'a> Look<'a> {
    /// Prepares to look.
    pub fn new(source: &'a RaySource<'a>, camera: &Camera, to: Use) -> Self {
        match source {
            RaySource::Volume(volume) => Self::Volume(volume, *camera),
            RaySource::Splats(splats) => Self::Splats(Box::new(splats.prepare(camera, to))),
        }
    }

    /// The samples of rays, with their Jacobians.
    ///
    /// # Errors
    /// [`Error::NonFinite`] if more than [`MAX_DROPPED_SHARE`] of the rays were dropped, or [`Error::Interrupted`].
    pub fn samples(&self, points: &[Points], monitor: &dyn Monitor) -> Result<Vec<RaySamples>> {
        let samples: Vec<RaySamples> = match self {
            Self::Splats(view) => points.par_iter().map(|points| splat_samples(view, points)).collect(),
            Self::Volume(VolumeRays { tracer, differentiation }, camera) => {
                let batches: Vec<RayBatch> = points.iter().map(|points| points.batch(camera)).collect();
                if tracer.field.batch() > 0 {
                    tracer.jacobians_together(&batches, differentiation, monitor)?
                } else {
                    let each = batches.par_iter().map_init(JacobianBuffers::default, |buffers, batch| {
                        tracer.jacobians(batch, differentiation, buffers)
                    });
                    each.collect()
                }
            }
        };
        let rays = points.iter().map(|points| points.at.len() as u64).sum();
        let first = samples.iter().find_map(|batch| batch.first_invalid);
        refuse_dropped(samples.iter().map(|batch| batch.dropped).sum(), rays, first)?;
        Ok(samples)
    }

    /// How far rays see, without derivatives.
    ///
    /// # Errors
    /// As [`Look::samples`].
    pub fn sight(&self, points: &[Points]) -> Result<Vec<VisibleSegment>> {
        match self {
            Self::Splats(view) => {
                let of = |hits: &mut Hits, points: &Points| -> Vec<VisibleSegment> {
                    points.at.iter().map(|&at| view.sight(at, hits)).collect()
                };
                Ok(points.par_iter().map_init(Hits::default, of).flatten_iter().collect())
            }
            Self::Volume(volume, camera) => volume_sight(volume, camera, points),
        }
    }
}

impl Points {
    fn batch(&self, camera: &Camera) -> RayBatch {
        let rays = self.at.iter().map(|&[x, y]| camera.ray(x, y)).collect();
        RayBatch { rays, jitter: self.jitter.clone(), first: self.first }
    }
}

fn splat_samples(view: &SplatView, points: &Points) -> RaySamples {
    let (mut hits, mut out) = (Hits::default(), RaySamples::default());
    for (&at, index) in points.at.iter().zip(points.first..) {
        view.push_samples(at, index, &mut hits, &mut out);
    }
    out
}

fn volume_sight(volume: &VolumeRays, camera: &Camera, points: &[Points]) -> Result<Vec<VisibleSegment>> {
    let tracer = &volume.tracer;
    let step = tracer.marcher.step;
    let (mut sight, mut dropped, mut first, mut rays) = (Vec::new(), 0, None, 0);
    let (mut buffers, mut quadrature) = (TraceBuffers::default(), CompositingWeights::default());
    for batch in points.iter().map(|points| points.batch(camera)) {
        tracer.trace(&batch.rays, &batch.jitter, &mut buffers);
        let traced = &buffers.traced;
        quadrature.set(traced, step);
        (rays, dropped) = (rays + batch.rays.len() as u64, dropped + traced.dropped);
        first = first.or(traced.first_invalid);
        for (r, &ray) in batch.rays.iter().enumerate().filter(|(r, _)| !traced.is_dropped[*r]) {
            let dark = traced.samples(r).find(|&i| quadrature.transmittance_after[i] < 0.5);
            let until = dark.map_or(f64::INFINITY, |i| traced.t[i] + 0.5 * step);
            sight.push(VisibleSegment { ray, until });
        }
    }
    refuse_dropped(dropped, rays, first)?;
    Ok(sight)
}

fn refuse_dropped(dropped: u64, rays: u64, first: Option<Vec3>) -> Result<()> {
    match first {
        Some(first) if dropped as f64 > MAX_DROPPED_SHARE * rays as f64 => {
            let limit_percent = 100.0 * MAX_DROPPED_SHARE;
            Err(Error::NonFinite { dropped, rays, limit_percent, first: first.to_array() })
        }
        _ => Ok(()),
    }
}

/// Distance from where rays are found to end to a place in front of the surface, scene units. Rays of splats end at
/// centres, which lie on it.
pub fn in_front(source: &RaySource) -> f64 {
    source.volume().map_or(0.0, |volume| volume.tracer.marcher.step)
}

/// Whether a camera that has this sight stands in matter.
pub fn stands_in_matter(source: &RaySource, camera: &Camera, sight: &[VisibleSegment]) -> bool {
    match source {
        RaySource::Splats(splats) => is_in_a_splat(splats.splats(), camera.position),
        RaySource::Volume(volume) => {
            let marcher = &volume.tracer.marcher;
            let near = sight.iter().filter(|segment| segment.until <= INSIDE_MATTER_SAMPLES * marcher.step).count();
            marcher.bounds.contains(camera.position.as_vec3()) && 2 * near >= sight.len().max(1)
        }
    }
}

/// Which cameras at `eyes` would stand in matter, whatever they look at. Samples of a volume are `step` apart, or as it
/// suggests.
pub fn in_matter(model: &Subject, step: Option<f64>, eyes: &[DVec3]) -> Vec<bool> {
    match model {
        Subject::Splats(splats) => eyes.iter().map(|eye| is_in_a_splat(splats, *eye)).collect(),
        Subject::Volume(field) => {
            // A model is asked only where it is.
            let (bounds, step) = (field.bounds(), step.unwrap_or_else(|| field.suggested_step()));
            let inside = |i: &usize| bounds.contains(eyes[*i].as_vec3());
            let asked: Vec<usize> = (0..eyes.len()).filter(inside).collect();
            let points: Vec<Vec3> = asked.iter().map(|&i| eyes[i].as_vec3()).collect();
            let mut densities = vec![0.0; points.len()];
            field.densities(&points, &mut densities);
            let mut found = vec![false; eyes.len()];
            for (i, density) in asked.into_iter().zip(densities) {
                found[i] = f64::from(density) * INSIDE_MATTER_SAMPLES * step >= std::f64::consts::LN_2;
            }
            found
        }
    }
}

/// Whether a splat takes half of the light or more where the eye is.
fn is_in_a_splat(splats: &Splats, eye: DVec3) -> bool {
    let takes_half = |i: usize| {
        let opacity = f64::from(splats.opacity(i));
        // o exp(-q/2) >= 1/2, with q the squared distance in standard deviations.
        let reach = 2.0 * (2.0 * opacity).ln();
        let away = (splats.rotation(i).inverse() * (eye.as_vec3() - splats.mean(i))).as_dvec3();
        opacity >= 0.5 && (away / splats.scale(i).as_dvec3()).length_squared() <= reach
    };
    (0..splats.len()).into_par_iter().with_min_len(4096).any(takes_half)
}
