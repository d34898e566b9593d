//! Density along groups of rays, and one call of the field for the points of several batches.
//!
//! Colour is left to later steps: most samples lie before a surface or just behind it, and have no weight.

use glam::{DVec3, Vec3};

use super::{Marcher, SampleDistances};
use crate::field::RadianceField;
use crate::geometry::Ray;

/// Samples taken per ray between two checks of its transmittance.
///
/// Small enough that little is evaluated behind opaque surfaces, large enough that a group of rays fills the
/// batches of the field.
const ROUND: usize = 8;

/// A field, where to sample it, and what lies behind it.
#[derive(Clone)]
pub struct Tracer<'a> {
    /// The field.
    pub field: &'a dyn RadianceField,
    /// Placement of samples.
    pub marcher: Marcher,
    /// Colour of a ray that meets nothing.
    pub background: Vec3,
}

/// Samples of a group of rays, concatenated: ray r owns `offsets[r]..offsets[r + 1]`.
#[derive(Debug, Clone, Default)]
pub struct TracedRays {
    /// `[rays + 1]`: first sample of each ray, and the end of the last.
    pub offsets: Vec<usize>,
    /// `[n]`: distances along the ray, in scene units.
    pub t: Vec<f64>,
    /// `[n]`: positions in scene units.
    pub positions: Vec<Vec3>,
    /// `[n]`: σ, 1 / scene unit.
    pub densities: Vec<f32>,
    /// Number of rays dropped because the field returned a density that was negative or
    /// not finite. They own no samples.
    pub dropped: u64,
    /// `[rays]`: whether each of them was dropped.
    pub is_dropped: Vec<bool>,
    /// Position of the first such sample.
    pub first_invalid: Option<Vec3>,
}

impl TracedRays {
    /// Number of rays.
    #[must_use]
    pub fn rays(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Indices of the samples of ray `r`.
    #[must_use]
    pub fn samples(&self, r: usize) -> std::ops::Range<usize> {
        self.offsets[r]..self.offsets[r + 1]
    }
}

/// A ray while it is traced.
struct Path<'a> {
    /// Distances still to sample.
    pending: SampleDistances<'a>,
    optical_depth: f64,
    samples: usize,
    /// True once a sample had no valid density.
    invalid: bool,
}

/// The samples of one round, or all of them in the order in which they were taken.
#[derive(Default)]
struct Samples {
    /// Index of the ray of each sample.
    owners: Vec<u32>,
    t: Vec<f64>,
    positions: Vec<Vec3>,
    densities: Vec<f32>,
}

impl Samples {
    fn clear(&mut self) {
        self.owners.clear();
        self.t.clear();
        self.positions.clear();
        self.densities.clear();
    }
}

/// Buffers that a thread reuses from batch to batch.
#[derive(Default)]
pub struct TraceBuffers<'a> {
    paths: Vec<Path<'a>>,
    samples: Samples,
    /// First sample of the round.
    round: usize,
    /// Samples of the rays.
    pub traced: TracedRays,
}

impl<'a> Tracer<'a> {
    /// The background as f64.
    #[must_use]
    pub fn background(&self) -> DVec3 {
        self.background.as_dvec3()
    }

    /// Samples `rays` into `buffers.traced`, each shifted by its `jitter` in `[0, 1)` steps. A ray ends when its
    /// transmittance falls below the marcher's cutoff.
    #[doc(hidden)]
    pub fn trace<'b>(&'b self, rays: &[Ray], jitter: &[f64], buffers: &mut TraceBuffers<'b>) {
        self.start(rays, jitter, buffers);
        loop {
            self.next_round(rays, buffers);
            let Points { positions, out, .. } = buffers.round();
            if positions.is_empty() {
                break;
            }
            self.field.densities(positions, out);
            self.absorb(buffers);
        }
        buffers.gather();
    }

    /// Begins to trace `rays`: [`Tracer::next_round`], the densities of its points and [`Tracer::absorb`] follow in
    /// turns, and [`TraceBuffers::gather`] after a round without points.
    pub(super) fn start<'b>(&'b self, rays: &[Ray], jitter: &[f64], buffers: &mut TraceBuffers<'b>) {
        let TraceBuffers { paths, samples, .. } = buffers;
        paths.clear();
        paths.extend(rays.iter().zip(jitter).map(|(ray, &jitter)| Path {
            pending: self.marcher.walk(ray, jitter),
            optical_depth: 0.0,
            samples: 0,
            invalid: false,
        }));
        samples.clear();
    }

    /// Places the next samples of all rays that go on.
    pub(super) fn next_round(&self, rays: &[Ray], buffers: &mut TraceBuffers) {
        let TraceBuffers { paths, samples, round, .. } = buffers;
        let longest = if self.marcher.cutoff > 0.0 { -self.marcher.cutoff.ln() } else { f64::INFINITY };
        // Samples of round k follow those of round k - 1.
        *round = samples.owners.len();
        for (owner, (path, ray)) in paths.iter_mut().zip(rays).enumerate() {
            if path.optical_depth >= longest {
                continue;
            }
            for t in path.pending.by_ref().take(ROUND) {
                samples.owners.push(owner as u32);
                samples.t.push(t);
                samples.positions.push(self.marcher.bounds.clamp(ray.at(t).as_vec3()));
            }
        }
        samples.densities.resize(samples.owners.len(), 0.0);
    }

    /// Takes in the densities of the round.
    pub(super) fn absorb(&self, buffers: &mut TraceBuffers) {
        let TraceBuffers { paths, samples, round, .. } = buffers;
        for (&owner, &density) in samples.owners[*round..].iter().zip(&samples.densities[*round..]) {
            let path = &mut paths[owner as usize];
            path.optical_depth += f64::from(density) * self.marcher.step;
            path.samples += 1;
            path.invalid |= !(density >= 0.0 && density.is_finite());
        }
    }
}

impl TraceBuffers<'_> {
    /// The samples of the round, and room for their densities.
    pub(super) fn round(&mut self) -> Points<'_, f32> {
        let (samples, first) = (&mut self.samples, self.round);
        Points { positions: &samples.positions[first..], directions: &[], out: &mut samples.densities[first..] }
    }

    /// Sorts the samples by ray into `traced`.
    pub(super) fn gather(&mut self) {
        gather(&self.paths, &self.samples, &mut self.traced);
    }
}

/// Sorts samples by ray. A ray with an invalid sample owns none.
fn gather(paths: &[Path], samples: &Samples, traced: &mut TracedRays) {
    traced.offsets.clear();
    traced.offsets.push(0);
    traced.is_dropped.clear();
    traced.is_dropped.extend(paths.iter().map(|path| path.invalid));
    traced.dropped = paths.iter().filter(|path| path.invalid).count() as u64;
    traced.first_invalid = None;
    let mut total = 0;
    for path in paths {
        total += if path.invalid { 0 } else { path.samples };
        traced.offsets.push(total);
    }
    traced.t.clear();
    traced.t.resize(total, 0.0);
    traced.positions.clear();
    traced.positions.resize(total, Vec3::ZERO);
    traced.densities.clear();
    traced.densities.resize(total, 0.0);
    // offsets[r] moves to the end of ray r while its samples arrive. Then the list is shifted back by one.
    for (i, &owner) in samples.owners.iter().enumerate() {
        let owner = owner as usize;
        if paths[owner].invalid {
            continue;
        }
        let at = traced.offsets[owner];
        traced.offsets[owner] += 1;
        traced.t[at] = samples.t[i];
        traced.positions[at] = samples.positions[i];
        traced.densities[at] = samples.densities[i];
    }
    traced.offsets.rotate_right(1);
    traced.offsets[0] = 0;
    if traced.dropped > 0 {
        let invalid = |i: &usize| {
            let density = samples.densities[*i];
            !(density >= 0.0 && density.is_finite())
        };
        // The first invalid sample of the first such ray, independent of the rounds.
        let first = (0..samples.owners.len()).filter(invalid).min_by_key(|&i| samples.owners[i]);
        traced.first_invalid = first.map(|i| samples.positions[i]);
    }
}

/// Points of one batch, and room for the field's answer.
pub(super) struct Points<'p, T> {
    /// `[n]`: scene units.
    pub positions: &'p [Vec3],
    /// `[n]`: unit directions; empty if the answer does not depend on them.
    pub directions: &'p [Vec3],
    /// `[n]`.
    pub out: &'p mut [T],
}

/// Calls `ask` with positions, directions and room for the answers: once for all parts, or not at all if they have no
/// points. Returns whether there were any.
pub(super) fn ask_together<T: Copy + Default>(
    mut parts: Vec<Points<'_, T>>,
    ask: impl FnOnce(&[Vec3], &[Vec3], &mut [T]),
) -> bool {
    parts.retain(|part| !part.positions.is_empty());
    match &mut parts[..] {
        [] => return false,
        [one] => ask(one.positions, one.directions, one.out),
        several => {
            let positions = several.iter().map(|part| part.positions).collect::<Vec<_>>().concat();
            let directions = several.iter().map(|part| part.directions).collect::<Vec<_>>().concat();
            let mut answers = vec![T::default(); positions.len()];
            ask(&positions, &directions, &mut answers);
            let mut rest = &answers[..];
            for part in several {
                let (own, others) = rest.split_at(part.out.len());
                part.out.copy_from_slice(own);
                rest = others;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_get_their_own_answers_in_one_call() {
        let positions = [1.0, 2.0, 3.0, 4.0].map(|x| Vec3::X * x);
        let directions = [Vec3::Y; 4].map(|d| 10.0 * d);
        // All four in parts of one, none and three; then two alone; then none.
        for (cuts, calls) in [(vec![0..1, 1..1, 1..4], 1), (vec![1..3, 0..0], 1), (vec![2..2, 0..0], 0)] {
            let mut out: Vec<Vec<f32>> = cuts.iter().map(|cut| vec![0.0; cut.len()]).collect();
            let parts = cuts.iter().zip(&mut out).map(|(cut, out)| Points {
                positions: &positions[cut.clone()],
                directions: &directions[cut.clone()],
                out,
            });
            let mut asked = 0;
            let any = ask_together(parts.collect(), |x, d, out| {
                asked += 1;
                assert!(x.len() == d.len() && x.len() == out.len());
                x.iter().zip(d).zip(out).for_each(|((x, d), out)| *out = x.x + d.y);
            });
            assert!(asked == calls && any == (calls > 0), "{cuts:?}: {asked} calls");
            for (cut, out) in cuts.iter().zip(&out) {
                assert_eq!(*out, positions[cut.clone()].iter().map(|x| x.x + 10.0).collect::<Vec<f32>>());
            }
        }
    }
}
