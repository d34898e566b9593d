//! Derivatives of a pixel by the parameters of a hash grid, for methods whose posterior is over the parameters:
//! FisherRF (Jiang, Lei, Daniilidis, ECCV 2024) and Laplace's approximation (Daxberger et al., NeurIPS 2021).
//!
//! Letters as in the loss of the trainer: colour C = Σ w c + T_end · background, expected depth D = Σ w s / W with
//! W = Σ w. Both are functions of the weights: a_i = c_i and a_end = background; a_i = (s_i − D) / W and a_end = 0.

use std::ops::Range;

use glam::Vec3;
use rustc_hash::FxHashMap;

use octobayes::geometry::Ray;
use octobayes_models::HashGrid;
use octobayes_models::hash_grid::{Entry, LAYERS, N_FEATURES_PER_LEVEL, Transposed, harmonics};
use octobayes_train::parts::{
    OccupancyGrid, RaySample, SampleGradient, Tape, Walk, composite, density_gradients, end_transmittance,
};

const OUTPUTS: usize = PixelGradient::OUTPUTS;

/// The least Σ w of a ray that has a depth.
const MIN_HIT_WEIGHT: f32 = 1e-20;

/// The features and weights of a hash grid as parameters of its pixels.
pub struct PixelGradients<'a> {
    field: &'a HashGrid,
    occupancy: OccupancyGrid,
    transposed: Transposed,
    background: Vec3,
}

/// A pixel and its derivatives.
#[derive(Debug, Clone)]
pub struct PixelGradient {
    /// Red, green and blue over the background, in [0, 1]; expected depth, scene units, 0 where nothing is hit.
    pub values: [f32; Self::OUTPUTS],
    /// Entries of the hash tables that the pixel depends on, each once, by their index below
    /// [`PixelGradients::entries`], with their derivatives `[outputs][features]`. All others are zero.
    pub entries: Vec<(u32, [Entry; Self::OUTPUTS])>,
    /// Derivatives by the weights of both networks, `[outputs][weights]`; empty if the ray met nothing.
    pub weights: [Vec<f32>; Self::OUTPUTS],
}

impl PixelGradient {
    /// What is differentiated: red, green, blue, expected depth.
    pub const OUTPUTS: usize = 4;
}

impl<'a> PixelGradients<'a> {
    /// Pixels of `field` over a background, whose components are in [0, 1].
    #[must_use]
    pub fn new(field: &'a HashGrid, background: Vec3) -> Self {
        Self {
            field,
            occupancy: OccupancyGrid::reached(field.config().occupancy, field.space(), field.occupied()),
            transposed: Transposed::new(&field.parameters().network),
            background,
        }
    }

    /// Number of entries of the hash tables, each of four features.
    #[must_use]
    pub fn entries(&self) -> usize {
        self.field.parameters().encoding.table.len()
    }

    /// Number of weights of both networks. Some are padding, whose derivatives are zero.
    #[must_use]
    pub fn weights() -> usize {
        LAYERS.iter().map(|(_, [inputs, outputs])| inputs * outputs).sum()
    }

    /// Where the weights of the last layer of the density network and of the colour network are.
    #[must_use]
    pub fn last_layers() -> [Range<usize>; 2] {
        ["density1", "color1"].map(|wanted| {
            let size = |(_, [inputs, outputs]): &(&str, [usize; 2])| inputs * outputs;
            let before = LAYERS.iter().take_while(|(name, _)| *name != wanted).map(size).sum();
            before..before + LAYERS.iter().find(|(name, _)| *name == wanted).map_or(0, size)
        })
    }

    /// The pixel of a ray. Samples lie where training puts them, shifted by `jitter` steps, in `[0, 1)`.
    #[must_use]
    pub fn of(&self, ray: &Ray, jitter: f64) -> PixelGradient {
        let (space, parameters) = (self.field.space(), self.field.parameters());
        let sh = [harmonics(ray.direction.as_vec3())];
        let mut walks = [Walk::new(space, *ray, jitter)];
        let window = |u| self.field.window_at(u);
        let tape = Tape::record(space, &self.occupancy, parameters, &mut walks, &sh, window);
        let samples: Vec<RaySample> = (0..tape.len()).map(|i| tape.sample(i)).collect();
        let (mut values, mut gradients) = pixel(&samples, self.background);
        let unit_length = space.unit_length() as f32;
        values[OUTPUTS - 1] *= unit_length;
        gradients[OUTPUTS - 1].iter_mut().for_each(|gradient| gradient.sigma *= unit_length);
        if samples.is_empty() {
            return PixelGradient { values, entries: Vec::new(), weights: Default::default() };
        }
        let found = gradients.map(|gradients| tape.backpropagate(&self.transposed, &gradients, &sh));
        let mut entries: Vec<(u32, [Entry; OUTPUTS])> = Vec::new();
        let mut places = FxHashMap::default();
        for (i, &u) in tape.u.iter().enumerate() {
            for (level, corners) in parameters.encoding.entries_of(u).iter().enumerate() {
                let own =
                    found.each_ref().map(|(_, features)| features[i].as_chunks::<N_FEATURES_PER_LEVEL>().0[level]);
                for &(entry, weight) in corners {
                    let place = *places.entry(entry).or_insert_with(|| {
                        entries.push((entry, Default::default()));
                        entries.len() - 1
                    });
                    for (sum, own) in entries[place].1.as_flattened_mut().iter_mut().zip(own.as_flattened()) {
                        *sum += weight * own;
                    }
                }
            }
        }
        PixelGradient { values, entries, weights: found.map(|(weights, _)| weights.layers().concat()) }
    }
}

/// C and D of a ray, and their derivatives by density and colour of its samples, `[outputs][samples]`.
fn pixel(samples: &[RaySample], background: Vec3) -> ([f32; OUTPUTS], [Vec<SampleGradient>; OUTPUTS]) {
    let weights = composite(samples);
    let transmittance = end_transmittance(&weights);
    let mut color = transmittance * background;
    let (mut total, mut moment) = (0.0, 0.0);
    for (sample, [weight, _]) in samples.iter().zip(&weights) {
        color += weight * sample.color;
        total += weight;
        moment += weight * sample.s;
    }
    // Divided by less, derivatives would not be finite.
    let is_hit = total > MIN_HIT_WEIGHT;
    let depth = if is_hit { moment / total } else { 0.0 };
    let gradients = std::array::from_fn(|output| {
        let axis = Vec3::AXES.get(output);
        let of_color = |[weight, _]: &[f32; 2]| axis.map_or(Vec3::ZERO, |axis| weight * axis);
        let mut gradients: Vec<SampleGradient> =
            weights.iter().map(|weight| SampleGradient { sigma: 0.0, color: of_color(weight) }).collect();
        let end = axis.map_or(0.0, |axis| transmittance * background.dot(*axis));
        let a = |i: usize| match axis {
            Some(axis) => samples[i].color.dot(*axis),
            None if is_hit => (samples[i].s - depth) / total,
            None => 0.0,
        };
        density_gradients(samples, &weights, end, a, &mut gradients);
        gradients
    });
    ([color.x, color.y, color.z, depth], gradients)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use octobayes::field::{ClosedForm, RadianceField};
    use octobayes::geometry::{Domain, Norm};
    use octobayes_models::hash_grid::Space;
    use octobayes_models::hash_grid::slow::{SMALL, SlowField, random_parameters};
    use octobayes_train::parts::Sample;

    const BACKGROUND: Vec3 = Vec3::new(0.9, 0.2, 0.6);
    /// How far values and derivatives of a ray with so many samples may lie apart, relative to 1 or to the largest
    /// derivative of the output by the same layer or level.
    ///
    /// A derivative by density or colour of one of n samples goes through five sums of at most 32 products and is
    /// summed over the ray: at most 160 + n roundings of f32, 6e-8 each, of the sum of absolute terms. Where terms
    /// cancel, that sum is up to some ten times the largest derivative. The differences in f64 err by 1e-10 for their
    /// step's square and 1e-11 for rounding: less than a tenth of it, even if the third derivative is 1e4 times the
    /// scale.
    fn tolerance(samples: usize) -> f64 {
        10.0 * 6e-8 * (160 + samples) as f64
    }

    /// Moves a parameter by a step.
    type Change<'a> = &'a dyn Fn(&mut SlowField, f64);

    /// The pixel from its definition, in f64.
    fn pixel_slowly(field: &HashGrid, slow: &SlowField, ray: &Ray, samples: &[Sample]) -> [f64; OUTPUTS] {
        let (mut transmittance, mut color, mut total, mut moment) = (1.0, DVec3::ZERO, 0.0, 0.0);
        for sample in samples {
            let value = slow.value(DVec3::from(sample.u.map(f64::from)), ray.direction.as_vec3());
            let window = f64::from(field.window_at(sample.u));
            let alpha = 1.0 - (-window * value.sigma * sample.delta / field.space().unit_length()).exp();
            color += transmittance * alpha * DVec3::from(value.color);
            total += transmittance * alpha;
            moment += transmittance * alpha * sample.t;
            transmittance *= 1.0 - alpha;
        }
        color += transmittance * BACKGROUND.as_dvec3();
        [color.x, color.y, color.z, if total > 0.0 { moment / total } else { 0.0 }]
    }

    /// The largest absolute derivative of each output.
    fn largest(values: impl Iterator<Item = [f32; OUTPUTS]>) -> [f64; OUTPUTS] {
        values.fold([0.0; OUTPUTS], |max, v| std::array::from_fn(|k| f64::from(v[k].abs()).max(max[k])))
    }

    #[test]
    #[ignore = "slow: several seconds"]
    fn derivatives_are_those_of_the_definition() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut compared, mut kinks, mut ramps, mut worst) = ([[0; OUTPUTS]; LAYERS.len() + 2], 0, 0, 0.0_f64);
        for domain in [
            Domain::Box(ClosedForm::courtyard().bounds()),
            // Contracted, so that steps differ in length.
            Domain::contracted(DVec3::new(0.1, 0.0, 0.2), 0.5, Norm::L2).unwrap(),
        ] {
            let parameters = random_parameters(|most| rng.random_range(-most..most));
            let occupied = (0..512).map(|_| rng.random_bool(0.02)).collect();
            let config = SMALL;
            let space = Space::new(domain).unwrap();
            let field = HashGrid::new(config, space, parameters, occupied, serde_json::Value::Null);
            let slow = SlowField::new(field.parameters());
            let pixels = PixelGradients::new(&field, BACKGROUND);
            let half = 0.5 * field.bounds().size().min_element().min(2.0);
            for _ in 0..16 {
                let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                let (origin, target) = (4.0 * half * vector().normalize(), half * vector());
                let ray = Ray::new(origin, target - origin);
                let found = pixels.of(&ray, 0.25);
                let mut walk = Walk::new(&space, ray, 0.25);
                let samples: Vec<Sample> = std::iter::from_fn(|| walk.next(&space, &pixels.occupancy)).collect();
                let tolerance = tolerance(samples.len());
                let in_ramp = |sample: &&Sample| (0.01..0.99).contains(&field.window_at(sample.u));
                ramps += samples.iter().filter(in_ramp).count();
                let expected = pixel_slowly(&field, &slow, &ray, &samples);
                for (expected, found) in expected.iter().zip(found.values) {
                    assert!((expected - f64::from(found)).abs() < tolerance, "{expected} {found}");
                }
                if samples.is_empty() {
                    continue;
                }
                let mut compare = |kind: usize, own: [f32; OUTPUTS], scale: [f64; OUTPUTS], change: Change| {
                    let difference = |h: f64| {
                        let [high, low] = [h, -h].map(|h| {
                            let mut moved = slow.clone();
                            change(&mut moved, h);
                            pixel_slowly(&field, &moved, &ray, &samples)
                        });
                        std::array::from_fn::<f64, OUTPUTS, _>(|k| (high[k] - low[k]) / (2.0 * h))
                    };
                    let (expected, coarse) = (difference(1e-5), difference(3e-5));
                    for k in 0..OUTPUTS {
                        // Where two steps disagree, a hidden unit switches in between.
                        if (expected[k] - coarse[k]).abs() > 0.1 * tolerance * scale[k] {
                            kinks += 1;
                            continue;
                        }
                        compared[kind][k] += 1;
                        let error = (expected[k] - f64::from(own[k])).abs();
                        worst = worst.max(error / (tolerance * scale[k]));
                        let text = format!("{kind} {k}: {} {} of {}", expected[k], own[k], scale[k]);
                        assert!(error <= tolerance * scale[k], "{text}");
                    }
                };
                let mut first = 0;
                for (l, (_, [inputs, outputs])) in LAYERS.iter().enumerate() {
                    let own = |i: usize| found.weights.each_ref().map(|weights| weights[first + i]);
                    let scale = largest((0..inputs * outputs).map(own));
                    for _ in 0..3 {
                        let (i, o) = (rng.random_range(0..*inputs), rng.random_range(0..*outputs));
                        compare(l, own(i * outputs + o), scale, &|slow, h| slow.layers[l][i][o] += h);
                    }
                    first += inputs * outputs;
                }
                assert_eq!(first, PixelGradients::weights());
                let mut first = 0;
                for (l, level) in field.parameters().encoding.levels().iter().enumerate() {
                    let own = |entry: usize, k: usize| {
                        let of = |(_, d): &(u32, [Entry; OUTPUTS])| d.map(|entry| entry[k]);
                        found.entries.iter().find(|(e, _)| *e as usize == first + entry).map(of)
                    };
                    let of_level = |(entry, _): &&(u32, _)| (first..first + level.size).contains(&(*entry as usize));
                    let visited: Vec<&(u32, [Entry; OUTPUTS])> = found.entries.iter().filter(of_level).collect();
                    let all = visited.iter().flat_map(|(_, d)| (0..N_FEATURES_PER_LEVEL).map(|k| d.map(|e| e[k])));
                    let scale = largest(all);
                    for _ in 0..2 {
                        let e = visited[rng.random_range(0..visited.len())].0 as usize - first;
                        let k = rng.random_range(0..N_FEATURES_PER_LEVEL);
                        compare(LAYERS.len(), own(e, k).unwrap(), scale, &|slow, h| slow.tables[l][e][k] += h);
                    }
                    // What is not listed has no effect, unless an entry of coarse levels is always visited.
                    let other = rng.random_range(0..level.size);
                    if own(other, 0).is_none() {
                        let kind = LAYERS.len() + 1;
                        compare(kind, [0.0; OUTPUTS], scale, &|slow, h| slow.tables[l][other][0] += h);
                    }
                    first += level.size;
                }
                assert_eq!(first, pixels.entries());
            }
        }
        let enough = compared.iter().flatten().all(|n| *n >= 50) && ramps > 1000;
        assert!(enough && kinks < 20, "{compared:?} {kinks} {ramps} {worst}");
    }

    #[test]
    fn last_layers_have_their_places() {
        let [density, color] = PixelGradients::last_layers();
        assert_eq!([density.len(), color.len()], [32 * 16, 32 * 4]);
        assert_eq!((density.start, color.end), (32 * 32, PixelGradients::weights()));
    }
}
