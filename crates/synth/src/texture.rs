//! Colour as a function of position: band-limited noise that makes every part of a surface distinct
//! from its surroundings.
//!
//! The noise is a sum of plane waves with wavelengths from [`FINEST`] to [`COARSEST`]. A soft saturation (tanh)
//! widens the contrast; its harmonics are weaker and stay above the size of a pixel.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Shortest wavelength in scene units: 8 pixels at 400 × 400 from the distance of the cameras.
pub const FINEST: f64 = 0.05;
/// Longest wavelength in scene units.
pub const COARSEST: f64 = 0.5;
/// Waves in a sum. Fewer look like a grid; more cost time.
const WAVES: usize = 16;
/// Edge of the ground's checks in scene units: ten across the disc.
const CHECK: f64 = 0.19;

/// A wave a·sin(k·x + phase).
#[derive(Debug, Clone, Copy)]
struct Wave {
    k: DVec3,
    phase: f64,
    amplitude: f64,
}

/// The pattern of mesh and ground, the same for every dataset.
#[derive(Debug, Clone)]
pub struct Texture {
    /// Three independent noises of mean 0 and variance 1.
    noises: [[Wave; WAVES]; 3],
}

impl Default for Texture {
    fn default() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(0x7e47);
        let mut noise = || {
            let mut waves: [Wave; WAVES] = std::array::from_fn(|i| {
                let share = (i as f64 + rng.random::<f64>()) / WAVES as f64;
                let wavelength = COARSEST * (FINEST / COARSEST).powf(share);
                let direction = on_sphere(rng.random(), rng.random());
                // Long waves carry more: contrast between parts first, detail on top.
                Wave {
                    k: TAU / wavelength * direction,
                    phase: TAU * rng.random::<f64>(),
                    amplitude: wavelength.powf(0.35),
                }
            });
            let variance: f64 = waves.iter().map(|w| 0.5 * w.amplitude * w.amplitude).sum();
            waves.iter_mut().for_each(|w| w.amplitude /= variance.sqrt());
            waves
        };
        Self { noises: [noise(), noise(), noise()] }
    }
}

/// A unit vector; uniform on the sphere if `a` and `b` are uniform in [0, 1).
fn on_sphere(a: f64, b: f64) -> DVec3 {
    let z = 2.0 * a - 1.0;
    let level = (1.0 - z * z).sqrt();
    DVec3::new(level * (TAU * b).cos(), level * (TAU * b).sin(), z)
}

impl Texture {
    /// One of the noises, squeezed into (0, 1).
    fn noise(&self, which: usize, x: DVec3) -> f64 {
        let sum: f64 = self.noises[which].iter().map(|w| w.amplitude * (w.k.dot(x) + w.phase).sin()).sum();
        0.5 + 0.5 * (1.4 * sum).tanh()
    }

    /// Linear albedo of the mesh at a scene point, channels in (0, 1).
    #[must_use]
    pub fn mesh(&self, x: DVec3) -> DVec3 {
        let [warm, pale, cool] =
            [DVec3::new(0.78, 0.27, 0.10), DVec3::new(0.90, 0.80, 0.58), DVec3::new(0.07, 0.30, 0.42)];
        let [a, b, c] = [0, 1, 2].map(|which| self.noise(which, x));
        warm.lerp(pale, a).lerp(cool, b * b) * (0.6 + 0.4 * c)
    }

    /// Linear albedo of the ground at a scene point, channels in (0, 1).
    #[must_use]
    pub fn ground(&self, x: DVec3) -> DVec3 {
        let wave = |v: f64| (0.5 * TAU * v / CHECK).sin();
        let check = 0.5 + 0.5 * (6.0 * wave(x.x) * wave(x.y)).tanh();
        let [dark, light] = [DVec3::new(0.22, 0.25, 0.30), DVec3::new(0.62, 0.60, 0.55)];
        let [b, c] = [1, 2].map(|which| self.noise(which, x));
        dark.lerp(light, check).lerp(DVec3::new(0.30, 0.45, 0.25), 0.35 * b) * (0.65 + 0.35 * c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn albedo_is_valid_and_varies_everywhere() {
        let texture = Texture::default();
        let at = |i: usize| 2.0 * DVec3::new((i % 23) as f64, (i / 23 % 23) as f64, (i / 529) as f64) / 22.0 - 1.0;
        for x in (0..23 * 23 * 23).map(at) {
            for albedo in [texture.mesh(x), texture.ground(x)] {
                assert!(albedo.min_element() > 0.0 && albedo.max_element() < 1.0, "{albedo} at {x}");
            }
            // There is no plain patch: within one longest wavelength along some axis the colour changes visibly.
            let there: Vec<DVec3> =
                (1..=6).flat_map(|s| DVec3::AXES.map(|axis| texture.mesh(x + 0.1 * f64::from(s) * axis))).collect();
            assert!(there.iter().any(|c| (*c - texture.mesh(x)).abs().max_element() > 0.04), "plain at {x}");
        }
    }

    #[test]
    fn waves_are_within_the_stated_band_and_have_unit_variance() {
        for waves in Texture::default().noises {
            assert!(waves.iter().all(|w| (FINEST..=COARSEST).contains(&(TAU / w.k.length()))));
            assert!((waves.iter().map(|w| 0.5 * w.amplitude * w.amplitude).sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}
