//! Extrapolates from a few rays to many: how many rays each vertex of a region will get.
//!
//! Letters, for the vertices of one region on leaves of one size: `t` touches (one ray at one vertex), `d` distinct
//! vertices, `f1` and `f2` those touched once and twice. Chao's lower bound (Chao 1984), an estimator of unseen
//! species, gives the number of vertices that can be touched at all: V = d + f1 (f1 − 1) / (2 (f2 + 1)).
//!
//! The bound is loose where hardly a vertex was touched twice, because leaves are much finer than the distance between
//! the pilot's rays. There the next coarser leaves give a better estimate, and surfaces have a quarter of their
//! vertices.

use rustc_hash::FxHashMap;

use crate::octree::{DEPTH, MaxLevels, cells_around, morton};

/// Coverage, the share of touches at vertices that another ray touches, from which V is believed.
const MIN_COVERAGE: f64 = 0.5;
/// Sizes of leaves: as fine as the lattice, and coarser by up to [`DEPTH`] levels.
const SIZES: usize = DEPTH as usize + 1;

/// Counts in one region.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Counts {
    touches: f64,
    distinct: f64,
    once: f64,
    twice: f64,
}

impl Counts {
    /// Adds a vertex that `rays` rays touched.
    fn add(&mut self, rays: u32) {
        let is = |n: u32| f64::from(u8::from(rays == n));
        self.touches += f64::from(rays);
        self.distinct += 1.0;
        self.once += is(1);
        self.twice += is(2);
    }

    /// The vertices that rays can touch, V.
    fn all(&self) -> f64 {
        self.distinct + self.once * (self.once - 1.0) / (2.0 * (self.twice + 1.0))
    }

    /// Good and Turing's estimate of the share of touches at vertices that were touched before.
    fn coverage(&self) -> f64 {
        1.0 - self.once / self.touches.max(1.0)
    }
}

/// What is known of one region.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Evidence {
    /// On the finest leaves.
    touches: f64,
    /// Rays of the pilot per vertex that rays can touch, by the leaves' coarseness.
    rays_per_vertex: [f32; SIZES],
}

impl Evidence {
    /// From counts by coarseness.
    fn new(counts: &[Counts; SIZES]) -> Self {
        let mut rays_per_vertex = [0.0; SIZES];
        let mut coarser: Option<f64> = None;
        for size in (0..SIZES).rev() {
            let counted = &counts[size];
            if counted.distinct == 0.0 {
                continue;
            }
            let all = counted.all();
            let all =
                coarser.filter(|_| counted.coverage() < MIN_COVERAGE).map_or(all, |coarser| all.max(4.0 * coarser));
            rays_per_vertex[size] = (counted.touches / all) as f32;
            coarser = Some(all);
        }
        Self { touches: counts[0].touches, rays_per_vertex }
    }
}

/// The counts of a pilot's rays in every region.
#[derive(Debug, Clone)]
pub struct PilotCounts {
    finest: u8,
    regions: FxHashMap<u64, Evidence>,
}

impl PilotCounts {
    /// Sorts vertices by region. `touched` holds, from the finest leaves to the coarsest, the vertices of their
    /// lattices: Morton codes with their numbers of rays.
    #[must_use]
    pub fn new<T: IntoIterator<Item = (u64, u32)>>(finest: u8, touched: impl IntoIterator<Item = T>) -> Self {
        let limits = MaxLevels::none(finest);
        let mut counts = FxHashMap::<u64, [Counts; SIZES]>::default();
        for (size, touched) in touched.into_iter().take(SIZES).enumerate() {
            for (vertex, rays) in touched {
                let point = morton::decode(vertex).map(|i| i << size);
                let cell = cells_around(point, finest).next().unwrap_or_default();
                // These are sums of integers, so their order does not matter.
                counts.entry(limits.region_of(cell)).or_default()[size].add(rays);
            }
        }
        let regions = counts.iter().map(|(&region, counts)| (region, Evidence::new(counts))).collect();
        Self { finest, regions }
    }

    /// The finest limits with which `scale` times the pilot's rays give at least `min_rays` rays per vertex, by region.
    #[must_use]
    pub fn limits(&self, scale: f64, min_rays: f64) -> MaxLevels {
        let least = MaxLevels::none(self.finest).region_level();
        let wanted = self.regions.iter().map(|(&region, evidence)| {
            let is_enough =
                |coarser: &u8| scale * f64::from(evidence.rays_per_vertex[usize::from(*coarser)]) >= min_rays;
            (region, (0..=self.finest - least).find(is_enough).map_or(least, |coarser| self.finest - coarser))
        });
        MaxLevels::balanced(self.finest, wanted)
    }

    /// Fractions of all touches that fall on leaves k = 0, 1, … levels coarser than the finest.
    #[must_use]
    pub fn shares(&self, limits: &MaxLevels) -> Vec<f64> {
        let mut shares = vec![0.0; usize::from(self.finest - limits.region_level()) + 1];
        let mut total = 0.0;
        for (&region, evidence) in &self.regions {
            shares[usize::from(self.finest - limits.level(region))] += evidence.touches;
            total += evidence.touches;
        }
        // Integers below 2⁵³ add exactly in any order.
        shares.iter_mut().for_each(|share| *share /= f64::max(total, 1.0));
        shares
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Rays that meet a surface of side² vertices on the finest leaves of one region, at random; each touches one
    /// vertex on leaves of any size.
    fn on_a_surface(finest: u8, rays: u32) -> PilotCounts {
        let side = 1_u32 << DEPTH;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut next = || rng.random_range(0..side);
        let points: Vec<[u32; 3]> = (0..rays).map(|_| [next() + 1, next() + 1, 5]).collect();
        let touched = (0..SIZES as u32).map(|size| {
            let mut all = FxHashMap::<u64, u32>::default();
            for point in &points {
                *all.entry(morton::encode(point.map(|i| (i - 1) >> size))).or_default() += 1;
            }
            all
        });
        PilotCounts::new(finest, touched)
    }

    #[test]
    fn limits_are_as_fine_as_rays_support() {
        // 4096 rays on 1024 vertices: four each, and four times as many on every coarser size.
        let pilot = on_a_surface(8, 4096);
        let level = |scale, min_rays| pilot.limits(scale, min_rays).level(0);
        assert_eq!((level(1.0, 3.0), level(1.0, 6.0), level(1.0, 24.0), level(1.0, 1e9)), (8, 7, 6, 3));
        assert_eq!(level(8.0, 24.0), 8, "eight times the rays");
        assert_eq!(pilot.shares(&pilot.limits(1.0, 6.0)), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn where_no_vertex_is_touched_twice_coarser_leaves_say_how_many_there_are() {
        // The run has a thousand rays on 1024 vertices, a pilot a handful of them. By Chao's bound alone, whatever
        // three rays touched once would be all there is, and would get hundreds of rays each.
        for rays in [3, 8, 30, 300, 1000] {
            let pilot = on_a_surface(12, rays);
            let level = |min_rays| pilot.limits(1000.0 / f64::from(rays), min_rays).level(0);
            assert!((10..=11).contains(&level(4.0)), "{rays} rays of the pilot: level {}", level(4.0));
            assert!(level(64.0) <= 9, "{rays} rays of the pilot: level {}", level(64.0));
        }
    }
}
