//! Ray samples with their Jacobians: the input of a posterior, wherever it comes from.

use glam::Vec3;

use crate::geometry::Ray;

/// Ray samples with their Jacobians.
///
/// Rays come in increasing order; rays without samples are absent. Ray r of the list
/// owns `offsets[r]..offsets[r + 1]`.
#[derive(Debug, Clone, PartialEq)]
pub struct RaySamples {
    /// `[rays]`, increasing: index of each ray in the whole run.
    pub rays: Vec<u64>,
    /// `[rays + 1]`: first sample of each ray, and the end of the last.
    pub offsets: Vec<usize>,
    /// `[n]`: positions in scene units.
    pub positions: Vec<Vec3>,
    /// `[n]`: ∂C_c/∂x_k at 3·c + k.
    pub jacobians: Vec<[f32; 9]>,
    /// `[n]`: w, the sample's share of the pixel's colour; 0 if unknown.
    pub weights: Vec<f32>,
    /// What the rays saw on their way, those without samples too; empty if unknown.
    pub sight: Vec<VisibleSegment>,
    /// Centres of splats that a ray shows before half of its light is lost, each with the ray's place in `sight`, in
    /// increasing order. They lie beside the ray; samples of a volume, which lie on it, are not listed.
    pub reached: Vec<(usize, Vec3)>,
    /// Number of rays dropped because the field was not finite.
    pub dropped: u64,
    /// Position of the first sample that was not finite.
    pub first_invalid: Option<Vec3>,
}

impl Default for RaySamples {
    fn default() -> Self {
        Self {
            rays: Vec::new(),
            offsets: vec![0],
            positions: Vec::new(),
            jacobians: Vec::new(),
            weights: Vec::new(),
            sight: Vec::new(),
            reached: Vec::new(),
            dropped: 0,
            first_invalid: None,
        }
    }
}

/// The part of a ray that is seen: up to where half of its light is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisibleSegment {
    /// The ray.
    pub ray: Ray,
    /// Distance at which T falls to ½, to within a step of the march, scene units; infinite if it does not.
    pub until: f64,
}

/// One sample of a ray; see [`RaySamples`] for units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RaySample {
    /// Position.
    pub position: Vec3,
    /// ∂C_c/∂x_k at 3·c + k.
    pub jacobian: [f32; 9],
    /// w, the sample's share of the pixel's colour.
    pub weight: f32,
}

impl RaySamples {
    /// Makes room for so many samples more, and not for any beyond.
    pub(super) fn reserve(&mut self, samples: usize) {
        self.positions.reserve_exact(samples);
        self.jacobians.reserve_exact(samples);
        self.weights.reserve_exact(samples);
    }

    /// Appends one sample to the ray of index `ray`, which must not be below the last one.
    pub fn push(&mut self, ray: u64, sample: RaySample) {
        if self.rays.last() != Some(&ray) {
            self.rays.push(ray);
            self.offsets.push(self.positions.len());
        }
        self.positions.push(sample.position);
        self.jacobians.push(sample.jacobian);
        self.weights.push(sample.weight);
        if let Some(end) = self.offsets.last_mut() {
            *end = self.positions.len();
        }
    }

    /// Appends rays whose indices are above those of this list.
    pub(crate) fn append(&mut self, mut other: Self) {
        if self.positions.is_empty() && self.sight.is_empty() && self.dropped == 0 {
            *self = other;
            return;
        }
        let first = self.positions.len();
        self.rays.append(&mut other.rays);
        self.offsets.extend(other.offsets[1..].iter().map(|offset| first + offset));
        self.positions.append(&mut other.positions);
        self.jacobians.append(&mut other.jacobians);
        self.weights.append(&mut other.weights);
        let lines = self.sight.len();
        self.reached.extend(other.reached.iter().map(|(line, x)| (lines + line, *x)));
        self.sight.append(&mut other.sight);
        self.dropped += other.dropped;
        self.first_invalid = self.first_invalid.or(other.first_invalid);
    }

    /// Returns sample `i` of the list.
    #[must_use]
    pub fn sample(&self, i: usize) -> RaySample {
        RaySample { position: self.positions[i], jacobian: self.jacobians[i], weight: self.weights[i] }
    }

    /// Iterates over the index and the range of samples of each ray.
    pub fn iter(&self) -> impl Iterator<Item = (u64, std::ops::Range<usize>)> + '_ {
        self.rays.iter().zip(self.offsets.windows(2)).map(|(&ray, pair)| (ray, pair[0]..pair[1]))
    }
}
