//! Colour without its dependence on direction: the mean over the directions from which cameras look.

use glam::Vec3;

use super::grid::{SAMPLES, SIDE, neighbours, place};
use octobayes::field::{Radiance, RadianceField};

/// Directions over which a colour is averaged.
const DIRECTIONS: usize = 3;
/// The same inside of matter, where hardly any camera sees.
const INSIDE: usize = 2;
/// Stride of colour samples in bricks that no ray sees.
const SAMPLE_STRIDE: usize = 37;
/// Matter that changes less than this from sample to sample has no surface.
const FLAT: f32 = 0.02;
/// Samples that absorb less than this get the colour of their neighbours.
const MIN_ABSORBED_SHARE: f64 = 1e-3;

/// Colours of a model as cameras at `eyes` see them.
pub struct MeanColor<'a> {
    /// The model.
    pub model: &'a dyn RadianceField,
    /// Positions of cameras.
    pub eyes: &'a [Vec3],
}

impl MeanColor<'_> {
    /// Colours at the samples of a brick, which absorb `alpha`. What absorbs nothing gets the mean of its neighbours,
    /// so that interpolation does not darken edges; what is not marked, the mean of the marked or of a few.
    pub fn of_brick(&self, positions: &[Option<Vec3>], alpha: &[f64], is_marked: &[bool]) -> Vec<[u8; 3]> {
        let mut owners = Vec::new();
        let (mut points, mut directions) = (Vec::new(), Vec::new());
        let has_marked = (0..SAMPLES).any(|i| is_marked[i] && alpha[i] >= MIN_ABSORBED_SHARE);
        let is_asked = |i: usize| {
            alpha[i] >= MIN_ABSORBED_SHARE && if has_marked { is_marked[i] } else { i.is_multiple_of(SAMPLE_STRIDE) }
        };
        for (i, x) in positions.iter().enumerate().filter(|(i, _)| is_asked(*i)) {
            let Some(x) = *x else { continue };
            for (direction, weight) in self.directions(x, outwards(alpha, i)) {
                owners.push((i, weight));
                points.push(x);
                directions.push(direction);
            }
        }
        let mut radiance = vec![Radiance::default(); points.len()];
        self.model.evaluate(&points, &directions, &mut radiance);
        let mut sums = vec![(Vec3::ZERO, 0.0_f32); SAMPLES];
        for ((i, weight), found) in owners.into_iter().zip(radiance).filter(|(_, found)| found.color.is_finite()) {
            sums[i].0 += weight * found.color;
            sums[i].1 += weight;
        }
        let known: Vec<Option<Vec3>> =
            sums.iter().map(|(sum, weight)| (*weight > 0.0).then(|| *sum / *weight)).collect();
        let grey = mean(known.iter().flatten().copied()).unwrap_or(Vec3::splat(0.5));
        let known: Vec<Option<Vec3>> = if has_marked { known } else { vec![None; SAMPLES] };
        let color = |i: usize| known[i].or_else(|| mean(neighbours(i).filter_map(|j| known[j]))).unwrap_or(grey);
        (0..SAMPLES).map(|i| color(i).to_array().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8)).collect()
    }

    /// The directions, with weights, along which cameras look at a point whose surface faces `outwards`: those that see
    /// it least obliquely.
    fn directions(&self, x: Vec3, outwards: Option<Vec3>) -> Vec<(Vec3, f32)> {
        let weight = |direction: Vec3| outwards.map_or(1.0, |n| (-n.dot(direction)).max(0.02));
        let mut all: Vec<(Vec3, f32)> = self
            .eyes
            .iter()
            .filter_map(|eye| (x - *eye).try_normalize())
            .map(|direction| (direction, weight(direction)))
            .collect();
        if all.is_empty() {
            all.push((outwards.map_or(Vec3::Z, |n| -n), 1.0));
        }
        all.sort_by(|a, b| b.1.total_cmp(&a.1));
        match outwards {
            Some(_) => all.truncate(DIRECTIONS),
            // All alike: a few that are spread over the order.
            None => all = all.iter().step_by(all.len().div_ceil(INSIDE)).copied().collect(),
        }
        all
    }
}

/// The direction in which matter gets thinner at a sample; `None` if it does not.
pub fn outwards(alpha: &[f64], i: usize) -> Option<Vec3> {
    let at = place(i);
    let slope = [1, SIDE, SIDE * SIDE].into_iter().zip(at).map(|(stride, k)| {
        let (low, high) = (if k > 0 { i - stride } else { i }, if k + 1 < SIDE { i + stride } else { i });
        (alpha[low] - alpha[high]) as f32
    });
    let slope: Vec<f32> = slope.collect();
    Some(Vec3::from_slice(&slope)).filter(|slope| slope.length() >= FLAT)?.try_normalize()
}

fn mean(colors: impl Iterator<Item = Vec3>) -> Option<Vec3> {
    let (sum, n) = colors.fold((Vec3::ZERO, 0), |(sum, n), color| (sum + color, n + 1));
    (n > 0).then(|| sum / n as f32)
}
