//! Seeds: each use of rays within a run has its own.

use crate::io::mix;

/// A use of rays other than a run's main sequence of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Purpose {
    /// The second of two halves that are compared; the first is the main sequence.
    SecondHalf,
    /// One of several groups that are compared, by index.
    Group(u16),
    /// The pilot from which a run is planned.
    Pilot,
    /// Points on visible surfaces, which must not be those that the run's own rays hit.
    Surface,
}

impl Purpose {
    /// The seed for this purpose in a run with the seed `base`.
    ///
    /// Base, purpose and index are mixed one after the other. A plain XOR would cancel: small bases and small
    /// indices would give the same few numbers, and two runs would draw the same rays.
    #[must_use]
    pub fn seed(self, base: u64) -> u64 {
        let [purpose, index] = match self {
            Self::SecondHalf => [1, 0],
            Self::Group(index) => [2, u64::from(index)],
            Self::Pilot => [3, 0],
            Self::Surface => [4, 0],
        };
        mix(mix(mix(base) ^ purpose) ^ index)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{HashMap, HashSet};

    use super::*;
    use crate::rays::{PixelSequence, Pixels};

    /// The base seeds in common use, with all seeds that a run of each draws from.
    fn seeds() -> Vec<(String, u64)> {
        let purposes = (0..64).map(Purpose::Group).chain([Purpose::SecondHalf, Purpose::Pilot, Purpose::Surface]);
        let of_base = |base: u64| {
            let derived = purposes.clone().map(move |p| (format!("{p:?} of {base}"), p.seed(base)));
            [(format!("run of {base}"), base)].into_iter().chain(derived)
        };
        (0..16).flat_map(of_base).collect()
    }

    /// An early version combined base and index by XOR: bases 0 to 7 drew the same eight groups in another order.
    #[test]
    fn no_two_uses_of_small_seeds_are_the_same() {
        let mut of_seed: HashMap<u64, String> = HashMap::new();
        for (name, seed) in seeds() {
            if let Some(other) = of_seed.insert(seed, name.clone()) {
                panic!("{name} and {other} have the seed {seed}");
            }
        }
        assert_eq!(of_seed.len(), 16 * 68);
    }

    #[test]
    fn no_two_uses_of_small_seeds_draw_the_same_ray() {
        // 1088 seeds × 64 rays, of 2⁴⁸ (pixel, jitter) pairs or more: one accidental match in 10⁵ such tests.
        for kind in [Pixels::Sobol, Pixels::Random] {
            let mut drawn = HashSet::new();
            for (name, seed) in seeds() {
                for pick in PixelSequence::new(kind, seed, vec![[4096, 4096]; 2]).picks(0, 64) {
                    let ray = (pick.camera, pick.pixel, pick.jitter.to_bits());
                    assert!(drawn.insert(ray), "{kind:?}: {name} draws a ray that was drawn before");
                }
            }
        }
    }

    #[test]
    fn a_plain_run_draws_the_rays_that_it_always_drew() {
        // Results that name their seed must stay reproducible.
        let picks = PixelSequence::new(Pixels::Sobol, 0, vec![[1000, 1000]]).picks(0, 4);
        let pixels: Vec<[u32; 2]> = picks.iter().map(|pick| pick.pixel).collect();
        assert_eq!(pixels, [[140, 299], [989, 618], [632, 27], [270, 952]]);
    }
}
