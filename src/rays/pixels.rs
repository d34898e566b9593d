//! The pixel of the k-th training ray.
//!
//! Letters: `k` index of a ray in the whole run; `n` its index among the rays of its camera. A ray depends only
//! on k and the seed, so shards, checkpoints and threads see the same rays. Rays of splats come camera by camera: k is
//! a ray's place in that order.

use rand::rngs::ChaCha8Rng;
use rand::{Rng, RngExt, SeedableRng};

use crate::geometry::Mask;
use crate::io::mix;

/// The method of choosing pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pixels {
    /// Uniformly at random from all images, as in the paper; for comparisons
    Random,
    /// Cameras in turn, each with its own low-discrepancy sequence; less noise from the same number of rays
    #[default]
    Sobol,
    /// Every pixel that counts, once: no error from the choice of pixels
    Every,
}

/// Number of rays after which a camera's sequence starts again with another scramble: the limit of the generator.
const SEQUENCE: u64 = 1 << 16;
/// Maximal length of a round in which cameras of unequal size take turns. Their fractions of the rays are
/// accurate to one part in this number.
const LONGEST_ROUND: u64 = 1 << 14;

/// The pixel of one ray and the shift of its samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelSample {
    /// Index of the camera.
    pub camera: usize,
    /// Column and row.
    pub pixel: [u32; 2],
    /// Shift of the ray's samples in steps, in `[0, 1)`.
    pub jitter: f64,
}

/// Chooses pixels of cameras with given resolutions, each pixel that counts equally often.
#[derive(Debug, Clone)]
pub struct PixelSequence {
    kind: Pixels,
    seed: u64,
    /// Width and height of every camera, pixels.
    resolutions: Vec<[u32; 2]>,
    /// The mask of every camera; empty if no camera has one.
    masks: Vec<Option<Mask>>,
    /// One round of turns: the camera, and the number of its earlier turns in the round.
    round: Vec<(u32, u32)>,
    /// Number of turns of each camera per round.
    turns: Vec<u64>,
    /// `[cameras + 1]`: the pixels that count of all earlier cameras.
    starts: Vec<u64>,
    /// `[cameras + 1]`: pixels from a ray to the next of a run through every pixel of a camera; the last, of all.
    strides: Vec<u64>,
}

impl PixelSequence {
    /// Creates a sequence over images of the given resolutions, `[width, height]` in pixels.
    #[must_use]
    pub fn new(kind: Pixels, seed: u64, resolutions: Vec<[u32; 2]>) -> Self {
        Self::masked(kind, seed, resolutions, Vec::new())
    }

    /// Creates a sequence over the pixels that masks keep: one mask or none for every image, or no list at all.
    ///
    /// # Panics
    /// If the masks are not those of the images, or if none keeps a pixel.
    #[must_use]
    pub fn masked(kind: Pixels, seed: u64, resolutions: Vec<[u32; 2]>, masks: Vec<Option<Mask>>) -> Self {
        let mask = |camera: usize| masks.get(camera).and_then(Option::as_ref);
        let fits = |camera: usize| mask(camera).is_none_or(|mask| mask.resolution() == resolutions[camera]);
        assert!(masks.is_empty() || masks.len() == resolutions.len(), "{} masks", masks.len());
        assert!((0..resolutions.len()).all(fits), "masks of other sizes than {resolutions:?}");
        let whole = |[w, h]: [u32; 2]| u64::from(w) * u64::from(h);
        let sizes = (0..resolutions.len()).map(|c| mask(c).map_or_else(|| whole(resolutions[c]), Mask::pixels));
        let sizes: Vec<u64> = sizes.collect();
        assert!(sizes.iter().any(|&size| size > 0) || sizes.is_empty(), "masks that keep no pixel");
        let (round, turns) = rounds(&sizes);
        let mut starts = vec![0];
        starts.extend(sizes.iter().scan(0, |sum, size| {
            *sum += size;
            Some(*sum)
        }));
        let strides = sizes.iter().chain(&starts[sizes.len()..]).map(|&size| stride(size)).collect();
        Self { kind, seed, resolutions, masks, round, turns, starts, strides }
    }

    /// A sequence over the same pixels in another order.
    #[must_use]
    pub fn reordered(&self, kind: Pixels, seed: u64) -> Self {
        Self { kind, seed, ..self.clone() }
    }

    /// The masks of the images, one or none for each; empty if there are none at all.
    #[must_use]
    pub fn masks(&self) -> &[Option<Mask>] {
        &self.masks
    }

    fn mask(&self, camera: usize) -> Option<&Mask> {
        self.masks.get(camera)?.as_ref()
    }

    /// Number of the camera's pixels that count.
    fn size(&self, camera: usize) -> u64 {
        self.starts[camera + 1] - self.starts[camera]
    }

    /// Number of pixels that count, over all cameras.
    fn total(&self) -> u64 {
        self.starts[self.resolutions.len()]
    }

    /// The method of choosing pixels.
    #[must_use]
    pub fn kind(&self) -> Pixels {
        self.kind
    }

    /// Seed of pixels and jitter.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The picks of the rays `first..first + count`. Random rays are drawn per batch, so ask for whole batches.
    #[must_use]
    pub fn picks(&self, first: u64, count: u64) -> Vec<PixelSample> {
        match self.kind {
            Pixels::Random => {
                let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
                rng.set_stream(first);
                (0..count).map(|_| self.random(&mut rng)).collect()
            }
            Pixels::Sobol => (first..first + count).map(|k| self.sobol(k)).collect(),
            Pixels::Every => (first..first + count)
                .map(|k| self.every(k, 0, self.total(), self.strides[self.resolutions.len()]))
                .collect(),
        }
    }

    fn random(&self, rng: &mut ChaCha8Rng) -> PixelSample {
        let n = rng.random_range(0..self.total());
        self.at(n, rng.next_u64())
    }

    /// Pixel `n` of all, in the order of the cameras, with a jitter made of random bits.
    fn at(&self, n: u64, bits: u64) -> PixelSample {
        let camera = self.starts.partition_point(|&start| start <= n) - 1;
        let (n, width) = (n - self.starts[camera], u64::from(self.resolutions[camera][0]));
        let pixel = self.mask(camera).map_or_else(|| [(n % width) as u32, (n / width) as u32], |mask| mask.nth(n));
        // The upper 53 bits as a binary fraction in [0, 1).
        let jitter = (bits >> 11) as f64 * 2.0_f64.powi(-53);
        PixelSample { camera, pixel, jitter }
    }

    /// Ray k of a run through every pixel from `start` on, of which there are `size`.
    fn every(&self, k: u64, start: u64, size: u64, stride: u64) -> PixelSample {
        let [k, size, stride, first] = [k, size, stride, mix(self.seed)].map(u128::from);
        let n = start + ((k * stride + first) % size) as u64;
        self.at(n, mix(mix(self.seed) ^ n))
    }

    fn sobol(&self, k: u64) -> PixelSample {
        let length = self.round.len() as u64;
        let (camera, turn) = self.round[(k % length) as usize];
        self.of_camera(camera as usize, k / length * self.turns[camera as usize] + u64::from(turn))
    }

    /// `[cameras]`: how many of the first `rays` rays are each camera's.
    pub(super) fn shares(&self, rays: u64) -> Vec<u64> {
        if self.kind == Pixels::Every && rays == self.total() {
            return (0..self.resolutions.len()).map(|camera| self.size(camera)).collect();
        }
        let length = self.round.len() as u64;
        let mut shares: Vec<u64> = self.turns.iter().map(|turns| rays / length * turns).collect();
        let rest = &self.round[..(rays % length) as usize];
        rest.iter().for_each(|&(camera, _)| shares[camera as usize] += 1);
        shares
    }

    /// A low-discrepancy sequence over the pixels of at most `most` of the cameras, spread over all that have pixels.
    pub(super) fn thinned(&self, most: usize) -> Self {
        let sizes: Vec<u64> = (0..self.resolutions.len()).map(|camera| self.size(camera)).collect();
        let with_pixels: Vec<usize> = (0..sizes.len()).filter(|&camera| sizes[camera] > 0).collect();
        let count = most.clamp(1, with_pixels.len().max(1));
        let kept: Vec<usize> =
            (0..count).filter_map(|i| with_pixels.get(i * with_pixels.len() / count)).copied().collect();
        let size = |camera: usize| if kept.binary_search(&camera).is_ok() { sizes[camera] } else { 0 };
        let (round, turns) = rounds(&(0..sizes.len()).map(size).collect::<Vec<u64>>());
        Self { kind: Pixels::Sobol, round, turns, ..self.clone() }
    }

    /// Ray `n` of a camera: an Owen-scrambled Sobol point in (column, row, jitter), with another scramble for every
    /// camera (Burley 2020); or the n-th of a run through every pixel.
    pub(super) fn of_camera(&self, camera: usize, n: u64) -> PixelSample {
        if self.kind == Pixels::Every {
            return self.every(n, self.starts[camera], self.size(camera), self.strides[camera]);
        }
        let scramble = mix(mix(mix(self.seed) ^ camera as u64) ^ (n / SEQUENCE)) as u32;
        let [x, y, jitter, _] = sobol_burley::sample_4d((n % SEQUENCE) as u32, 0, scramble);
        let ([w, h], place) = (self.resolutions[camera], [x, y].map(f64::from));
        let pixel = match self.mask(camera) {
            Some(mask) => mask.at(place),
            None => [0, 1].map(|k| ((place[k] * f64::from([w, h][k])) as u32).min([w, h][k] - 1)),
        };
        PixelSample { camera, pixel, jitter: f64::from(jitter) }
    }
}

/// One round of turns of cameras with so many pixels, and the number of turns of each.
fn rounds(sizes: &[u64]) -> (Vec<(u32, u32)>, Vec<u64>) {
    let turns = turns(sizes);
    // Turn t of a camera with m turns is due at (t + ½) / m of the round, which spreads turns evenly.
    let mut due: Vec<(f64, u32, u32)> = turns
        .iter()
        .enumerate()
        .flat_map(|(c, &m)| (0..m).map(move |t| ((t as f64 + 0.5) / m as f64, c as u32, t as u32)))
        .collect();
    due.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    (due.into_iter().map(|(_, camera, turn)| (camera, turn)).collect(), turns)
}

/// Number of turns of each camera per round, in proportion to its pixels: exact if the round is
/// short enough, otherwise rounded.
fn turns(sizes: &[u64]) -> Vec<u64> {
    let divisor = sizes.iter().fold(0, |a, &b| gcd(a, b)).max(1);
    let exact: u64 = sizes.iter().map(|s| s / divisor).sum();
    if exact <= LONGEST_ROUND {
        return sizes.iter().map(|s| s / divisor).collect();
    }
    let total: f64 = sizes.iter().map(|&s| s as f64).sum();
    let length = LONGEST_ROUND.max(4 * sizes.len() as u64) as f64;
    sizes.iter().map(|&s| ((s as f64 / total * length).round() as u64).max(u64::from(s > 0))).collect()
}

/// A number without a common divisor with `total`: its multiples modulo `total` are all numbers below that, each once.
/// It is about the golden ratio's share, by which the multiples are spread evenly at any time.
fn stride(total: u64) -> u64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let golden = (total as f64 * GOLDEN) as u64;
    (golden.max(1)..).find(|&stride| gcd(stride, total) == 1).unwrap_or(1)
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    fn sequence(kind: Pixels, resolutions: &[[u32; 2]]) -> PixelSequence {
        PixelSequence::new(kind, 3, resolutions.to_vec())
    }

    proptest! {
        #[test]
        fn every_camera_has_its_share_of_rays(
            sides in proptest::collection::vec(1_u32..40, 1..6),
            rays in 1_u64..5000,
        ) {
            let resolutions: Vec<[u32; 2]> = sides.iter().map(|&s| [s, 7]).collect();
            let picks = sequence(Pixels::Sobol, &resolutions).picks(0, rays);
            let total: f64 = sides.iter().map(|&s| f64::from(s)).sum();
            for (camera, &side) in sides.iter().enumerate() {
                let found = picks.iter().filter(|p| p.camera == camera).count() as f64;
                let fair = f64::from(side) / total * rays as f64;
                // With evenly spread turns, no camera is more than 1 + half the number of cameras
                // away from its fair number of rays.
                prop_assert!((found - fair).abs() <= 1.0 + sides.len() as f64 / 2.0, "{} of {}", found, fair);
            }
            for p in &picks {
                let [w, h] = resolutions[p.camera];
                prop_assert!(p.pixel[0] < w && p.pixel[1] < h && (0.0..1.0).contains(&p.jitter));
            }
        }

        #[test]
        fn rays_do_not_depend_on_how_they_are_asked_for(first in 0_u64..200_000, cut in 1_u64..50) {
            let sequence = sequence(Pixels::Sobol, &[[40, 30], [20, 20]]);
            let mut parts = sequence.picks(first, cut);
            parts.extend(sequence.picks(first + cut, 64 - cut));
            prop_assert_eq!(parts, sequence.picks(first, 64));
        }
    }

    proptest! {
        #[test]
        fn a_run_through_every_pixel_meets_each_once(
            sides in proptest::collection::vec((1_u32..12, 1_u32..12), 1..5),
            seed: u64,
            masked in 0_usize..5,
        ) {
            let resolutions: Vec<[u32; 2]> = sides.iter().map(|&(w, h)| [w, h]).collect();
            let mask = |(i, &size): (usize, &[u32; 2])| {
                (i == masked && size != [1, 1]).then(|| Mask::new(size, |column, row| (column + row) % 2 == 0))
            };
            let masks: Vec<Option<Mask>> = resolutions.iter().enumerate().map(mask).collect();
            let keeps = |camera: usize, [column, row]: [u32; 2]| {
                masks[camera].as_ref().is_none_or(|mask| mask.keeps(column, row))
            };
            let sequence = PixelSequence::masked(Pixels::Every, seed, resolutions.clone(), masks.clone());
            let picks = sequence.picks(0, sequence.total());
            let met: HashSet<(usize, [u32; 2])> = picks.iter().map(|pick| (pick.camera, pick.pixel)).collect();
            let all = resolutions.iter().enumerate().flat_map(|(camera, &[w, h])| {
                (0..w).flat_map(move |x| (0..h).map(move |y| (camera, [x, y])))
            });
            let wanted: HashSet<(usize, [u32; 2])> = all.filter(|&(camera, at)| keeps(camera, at)).collect();
            prop_assert_eq!(picks.len(), met.len());
            prop_assert_eq!(&met, &wanted);
            prop_assert!(picks.iter().all(|pick| (0.0..1.0).contains(&pick.jitter)));
            // Camera by camera they are the same rays.
            let shares = sequence.shares(sequence.total());
            let ranks = (0..shares.len()).flat_map(|camera| (0..shares[camera]).map(move |n| (camera, n)));
            for pick in ranks.map(|(camera, n)| sequence.of_camera(camera, n)) {
                prop_assert!(picks.contains(&pick), "{pick:?}");
            }
        }
    }

    #[test]
    fn few_rays_of_a_run_through_every_pixel_are_spread_over_the_image() {
        let sequence = sequence(Pixels::Every, &[[40, 40], [30, 40]]);
        let picks = |camera: usize| (0..64).map(|n| sequence.of_camera(camera, n)).collect::<Vec<_>>();
        for picks in [sequence.picks(0, 128), picks(0), picks(1)] {
            // Multiples of the golden ratio leave gaps of at most φ²/n = 2.62/64 (three-distance theorem): a quarter of
            // an image has at least 64 / 4 / 2.62 − 1 = 5 of them.
            for quarter in 0..4 {
                let in_quarter = |pick: &&PixelSample| pick.pixel[1] / 10 == quarter;
                assert!(picks.iter().filter(in_quarter).count() >= 5, "quarter {quarter}: {picks:?}");
            }
        }
    }

    #[test]
    fn sobol_pixels_fill_an_image_evenly_and_random_ones_do_not() {
        // 4 rays for each of 16 × 16 tiles of one image. An Owen-scrambled (0, 2)-sequence puts exactly 4 into
        // each. The variance of random counts is 4.
        let spread = |kind| {
            let mut counts = [0.0_f64; 256];
            for p in sequence(kind, &[[64, 64]]).picks(0, 1024) {
                counts[(p.pixel[0] / 4 * 16 + p.pixel[1] / 4) as usize] += 1.0;
            }
            counts.iter().map(|c| (c - 4.0).powi(2)).sum::<f64>() / 256.0
        };
        assert_eq!(spread(Pixels::Sobol), 0.0);
        // The mean of 256 squares, each of variance 2 · 4²: 4 ± 3 · 5.7 / 16.
        assert!((2.9..5.1).contains(&spread(Pixels::Random)), "{}", spread(Pixels::Random));
    }

    #[test]
    fn every_one_of_several_cameras_is_filled_evenly() {
        // Cameras of equal size take turns, and each has its own sequence without gaps: 4 rays for each of
        // 16 × 16 tiles.
        let picks = sequence(Pixels::Sobol, &[[64, 64]; 3]).picks(0, 3 * 1024);
        for camera in 0..3 {
            let mut counts = [0; 256];
            for p in picks.iter().filter(|p| p.camera == camera) {
                counts[(p.pixel[0] / 4 * 16 + p.pixel[1] / 4) as usize] += 1;
            }
            assert_eq!(counts, [4; 256], "camera {camera}");
        }
    }

    #[test]
    fn every_pixel_that_masks_keep_is_drawn_equally_often_and_no_other() {
        // A mask of 30 pixels, one of none, and a whole image of 60.
        let kept = |column: u32, row: u32| (column + row).is_multiple_of(2);
        let masks = vec![Some(Mask::new([10, 6], kept)), Some(Mask::new([9, 9], |_, _| false)), None];
        let resolutions = vec![[10, 6], [9, 9], [12, 5]];
        for kind in [Pixels::Sobol, Pixels::Random] {
            let sequence = PixelSequence::masked(kind, 3, resolutions.clone(), masks.clone());
            let mut counts = std::collections::BTreeMap::new();
            let rays = 90 * 1000;
            for pick in sequence.picks(0, rays) {
                *counts.entry((pick.camera, pick.pixel)).or_insert(0_u32) += 1;
            }
            let [first, second, third] = [0, 1, 2].map(|c| counts.keys().filter(|(camera, _)| *camera == c).count());
            assert_eq!([first, second, third], [30, 0, 60], "{kind:?}");
            assert!(counts.keys().all(|(camera, [x, y])| *camera == 2 || kept(*x, *y)), "{kind:?}");
            // A thousand rays a pixel: five deviations of a random count. A low-discrepancy sequence does better.
            let worst = counts.values().map(|n| n.abs_diff(1000)).max().unwrap();
            assert!(worst < if kind == Pixels::Sobol { 20 } else { 160 }, "{kind:?}: {worst}");
        }
    }

    #[test]
    fn masks_that_keep_all_change_no_ray() {
        let resolutions = vec![[40, 30], [21, 17]];
        let whole: Vec<Option<Mask>> = resolutions.iter().map(|&r| Some(Mask::new(r, |_, _| true))).collect();
        for kind in [Pixels::Sobol, Pixels::Random] {
            let masked = PixelSequence::masked(kind, 3, resolutions.clone(), whole.clone());
            assert_eq!(masked.picks(0, 5000), sequence(kind, &resolutions).picks(0, 5000), "{kind:?}");
        }
    }

    #[test]
    fn a_sequence_goes_on_with_another_scramble_when_it_is_used_up() {
        let sequence = sequence(Pixels::Sobol, &[[4096, 4096]]);
        assert_ne!(sequence.picks(0, 32), sequence.picks(SEQUENCE, 32));
    }
}
