//! Evaluates the field along groups of rays.

use glam::{DVec3, Vec3};

use super::{Marcher, Walk};
use crate::field::{Radiance, RadianceField};
use crate::geometry::Ray;

/// Samples taken per ray before its transmittance is looked at again: small enough that little is evaluated behind opaque
/// surfaces, large enough that a group of rays fills the field's batches.
const ROUND: usize = 8;

/// A field, where to sample it, and what lies behind it.
#[derive(Clone)]
pub struct Tracer<'a> {
    /// The field.
    pub field: &'a dyn RadianceField,
    /// Sample positions.
    pub marcher: Marcher,
    /// Colour of a ray that meets nothing.
    pub background: Vec3,
}

/// Samples of a group of rays, concatenated: ray r owns `offsets[r]..offsets[r + 1]`.
#[derive(Debug, Clone, Default)]
pub struct TracedRays {
    /// `[rays + 1]`.
    pub offsets: Vec<usize>,
    /// Distances along the ray, scene units.
    pub t: Vec<f64>,
    /// Positions, scene units.
    pub positions: Vec<Vec3>,
    /// Density and colour.
    pub radiance: Vec<Radiance>,
    /// Rays dropped because the field returned something not finite or a negative density: they own no samples.
    pub dropped: u64,
    /// Position of the first such sample.
    pub first_invalid: Option<Vec3>,
}

impl TracedRays {
    /// Number of rays.
    #[must_use]
    pub fn rays(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Indices of ray `r`'s samples.
    #[must_use]
    pub fn samples(&self, r: usize) -> std::ops::Range<usize> {
        self.offsets[r]..self.offsets[r + 1]
    }

    /// Appends a ray; an invalid sample drops the whole ray.
    fn push(&mut self, samples: &[(f64, Vec3, Radiance)]) {
        if let Some((_, position, _)) = samples.iter().find(|(_, _, radiance)| !radiance.is_valid()) {
            self.dropped += 1;
            self.first_invalid.get_or_insert(*position);
        } else {
            for &(t, position, radiance) in samples {
                self.t.push(t);
                self.positions.push(position);
                self.radiance.push(radiance);
            }
        }
        self.offsets.push(self.t.len());
    }
}

/// One ray under way.
struct Path<'a> {
    /// Distances still to sample.
    pending: Walk<'a>,
    samples: Vec<(f64, Vec3, Radiance)>,
    optical_depth: f64,
}

impl Tracer<'_> {
    /// The background as f64.
    #[must_use]
    pub fn background(&self) -> DVec3 {
        self.background.as_dvec3()
    }

    /// Samples `rays`, each shifted by its `jitter` in `[0, 1)` steps. A ray ends when its transmittance falls below the
    /// marcher's cutoff.
    #[must_use]
    pub fn trace(&self, rays: &[Ray], jitter: &[f64]) -> TracedRays {
        let mut paths: Vec<Path> = rays
            .iter()
            .zip(jitter)
            .map(|(ray, &jitter)| Path {
                pending: self.marcher.walk(ray, jitter),
                samples: Vec::new(),
                optical_depth: 0.0,
            })
            .collect();
        let longest = if self.marcher.cutoff > 0.0 { -self.marcher.cutoff.ln() } else { f64::INFINITY };

        // One entry per sample of a round: whose it is, and where.
        let (mut owners, mut distances) = (Vec::new(), Vec::new());
        let (mut positions, mut directions, mut radiance) = (Vec::new(), Vec::new(), Vec::new());
        loop {
            owners.clear();
            distances.clear();
            positions.clear();
            directions.clear();
            for (owner, (path, ray)) in paths.iter_mut().zip(rays).enumerate() {
                if path.optical_depth >= longest {
                    continue;
                }
                for t in path.pending.by_ref().take(ROUND) {
                    owners.push(owner);
                    distances.push(t);
                    positions.push(self.marcher.bounds.clamp(ray.at(t).as_vec3()));
                    directions.push(ray.direction.as_vec3());
                }
            }
            if owners.is_empty() {
                break;
            }
            radiance.clear();
            radiance.resize(owners.len(), Radiance::default());
            self.field.evaluate(&positions, &directions, &mut radiance);
            for (i, &owner) in owners.iter().enumerate() {
                let path = &mut paths[owner];
                path.samples.push((distances[i], positions[i], radiance[i]));
                path.optical_depth += f64::from(radiance[i].density) * self.marcher.step;
            }
        }
        let mut traced = TracedRays { offsets: vec![0], ..TracedRays::default() };
        for path in paths {
            traced.push(&path.samples);
        }
        traced
    }
}
