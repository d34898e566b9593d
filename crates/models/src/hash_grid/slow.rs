//! The field as the paper defines it, in f64 and one point at a time: the reference for the fast code.

use glam::DVec3;

use super::{Encoding, HashGridConfig, N_FEATURES_PER_LEVEL, Network, Parameters, spherical_harmonics};

/// A small field.
pub const SMALL: HashGridConfig =
    HashGridConfig { log2_hashmap_size: 9, base_resolution: 3, per_level_scale: 1.5, occupancy: 8 };

/// Weights that make every layer matter: densities around 1, hidden units on both sides of 0.
///
/// `random` draws from minus to plus a number.
pub fn random_parameters(mut random: impl FnMut(f32) -> f32) -> Parameters {
    let levels = Encoding::levels_of(&SMALL);
    let table = (0..Encoding::entries(&levels)).map(|_| std::array::from_fn(|_| random(1.0))).collect();
    let mut network = Network::zero();
    network.layers_mut().into_iter().for_each(|layer| layer.fill_with(|| random(0.5)));
    network.clear_padding();
    Parameters { encoding: Encoding::new(&SMALL, table), network }
}

/// The same parameters in f64.
#[derive(Clone)]
pub struct SlowField {
    /// N of every level.
    pub resolutions: Vec<u32>,
    /// `[levels][entries][features]`.
    pub tables: Vec<Vec<[f64; N_FEATURES_PER_LEVEL]>>,
    /// `[layers][in][out]`.
    pub layers: Vec<Vec<Vec<f64>>>,
}

/// Density and colour.
pub struct SlowValue {
    /// σ per unit length, without the window.
    pub sigma: f64,
    pub color: [f64; 3],
}

impl SlowField {
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        let mut first = 0;
        let mut tables = Vec::new();
        for level in parameters.encoding.levels() {
            let entries = &parameters.encoding.table[first..first + level.size];
            tables.push(entries.iter().map(|entry| entry.map(f64::from)).collect());
            first += level.size;
        }
        let layers = super::LAYERS.iter().zip(parameters.network.layers()).map(|((_, [_, outputs]), weights)| {
            weights.chunks(*outputs).map(|row| row.iter().map(|w| f64::from(*w)).collect()).collect()
        });
        Self {
            resolutions: parameters.encoding.levels().iter().map(|level| level.resolution).collect(),
            tables,
            layers: layers.collect(),
        }
    }

    /// Entry of a level's corner: row by row if all corners fit, otherwise hashed (Müller et al. 2022, Eq. 4).
    #[must_use]
    pub fn entry(&self, level: usize, [x, y, z]: [u64; 3]) -> usize {
        let (n, size) = (u64::from(self.resolutions[level]), self.tables[level].len() as u64);
        let index = if (n + 1).pow(3) == size {
            (z * (n + 1) + y) * (n + 1) + x
        } else {
            (x ^ y.wrapping_mul(2_654_435_761) ^ z.wrapping_mul(805_459_861)) % size
        };
        index as usize
    }

    fn features(&self, u: DVec3) -> Vec<f64> {
        let mut features = Vec::new();
        for (level, &n) in self.resolutions.iter().enumerate() {
            let scaled = u * f64::from(n);
            let cell = scaled.to_array().map(|v| (v as u64).min(u64::from(n) - 1));
            let mut sum = [0.0; N_FEATURES_PER_LEVEL];
            for corner in 0..8_u64 {
                let up = [corner & 1, corner >> 1 & 1, corner >> 2];
                let mut weight = 1.0;
                for axis in 0..3 {
                    let t = scaled[axis] - cell[axis] as f64;
                    weight *= if up[axis] == 1 { t } else { 1.0 - t };
                }
                let entry = self.entry(level, std::array::from_fn(|axis| cell[axis] + up[axis]));
                for (sum, value) in sum.iter_mut().zip(self.tables[level][entry]) {
                    *sum += weight * value;
                }
            }
            features.extend(sum);
        }
        features
    }

    fn layer(&self, layer: usize, inputs: &[f64]) -> Vec<f64> {
        let weights = &self.layers[layer];
        assert_eq!(weights.len(), inputs.len());
        (0..weights[0].len()).map(|o| inputs.iter().zip(weights).map(|(x, row)| x * row[o]).sum()).collect()
    }

    pub fn value(&self, u: DVec3, direction: glam::Vec3) -> SlowValue {
        let relu = |x: Vec<f64>| -> Vec<f64> { x.into_iter().map(|v| v.max(0.0)).collect() };
        let hidden = relu(self.layer(0, &self.features(u)));
        let geometry = self.layer(1, &hidden);
        let sh = spherical_harmonics(direction.x, direction.y, direction.z).map(f64::from);
        let view = self.layer(3, &sh);
        let sum = self.layer(2, &geometry).into_iter().zip(view).map(|(a, b)| a + b).collect();
        let color = self.layer(4, &relu(sum));
        let sigmoid = |k: usize| 1.0 / (1.0 + (-color[k]).exp());
        SlowValue { sigma: geometry[0].min(15.0).exp(), color: [sigmoid(0), sigmoid(1), sigmoid(2)] }
    }
}
