//! Extrapolates from a few rays to many: how many vertices a run will touch, and how many rays each will get.
//!
//! Letters, for one region and P pilot rays on the finest lattice: `t` touches (one ray at one vertex), `d`
//! distinct vertices, `f1` and `f2` those touched once and twice. Chao's lower bound (Chao 1984), an estimator of
//! unseen species, gives the number of vertices that can be touched at all: V = d + f1 (f1 − 1) / (2 (f2 + 1)). R
//! rays touch V (1 − exp(−t R / (P V))) of them. Leaves that are k levels coarser have V / 4ᵏ vertices, as
//! surfaces do, and t / 2ᵏ touches, because a ray crosses fewer of them.

use rustc_hash::FxHashMap;

use crate::io::mix;
use crate::octree::{MaxLevels, cells_around, morton};

/// Counts in one region.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Counts {
    touches: f64,
    pub distinct: f64,
    once: f64,
    twice: f64,
}

impl Counts {
    /// One species that `rays` rays touched.
    pub fn of(rays: u32) -> Self {
        let is = |n: u32| f64::from(u8::from(rays == n));
        Self { touches: f64::from(rays), distinct: 1.0, once: is(1), twice: is(2) }
    }

    pub fn add(mut self, other: Self) -> Self {
        self.touches += other.touches;
        self.distinct += other.distinct;
        self.once += other.once;
        self.twice += other.twice;
        self
    }

    /// The vertices that rays can touch, and the touches by `scale` times the pilot's rays, on leaves
    /// that are `coarser` levels coarser.
    fn expected(&self, scale: f64, coarser: u8) -> (f64, f64) {
        let all = self.distinct + self.once * (self.once - 1.0) / (2.0 * (self.twice + 1.0));
        let halves = f64::from(coarser);
        (all * (-2.0 * halves).exp2(), self.touches * scale * (-halves).exp2())
    }

    /// Number of vertices that `scale` times the pilot's rays touch.
    pub fn vertices(&self, scale: f64, coarser: u8) -> f64 {
        let (all, touches) = self.expected(scale, coarser);
        -all * (-touches / all).exp_m1()
    }
}

/// Counts by region.
#[derive(Debug, Clone)]
pub struct PilotCounts {
    finest: u8,
    counts: FxHashMap<u64, Counts>,
}

impl PilotCounts {
    /// Sorts vertices of the finest lattice, Morton codes with their numbers of rays, by region.
    #[must_use]
    pub fn new(finest: u8, touched: impl IntoIterator<Item = (u64, u32)>) -> Self {
        let limits = MaxLevels::none(finest);
        let mut counts = FxHashMap::<u64, Counts>::default();
        for (vertex, rays) in touched {
            let cell = cells_around(morton::decode(vertex), finest).next().unwrap_or_default();
            // These are sums of integers, so their order does not matter.
            let entry = counts.entry(limits.region_of(cell)).or_default();
            *entry = entry.add(Counts::of(rays));
        }
        Self { finest, counts }
    }

    /// The finest limits with which `scale` times the pilot's rays give at least `min_rays` rays per vertex, by region.
    #[must_use]
    pub fn limits(&self, scale: f64, min_rays: f64) -> MaxLevels {
        self.limits_where(scale, |_| min_rays)
    }

    /// As [`PilotCounts::limits`], but every region asks for up to twice as many rays, by chance.
    ///
    /// Many regions have the same few counts. Their limits would all fall at the same number of rays, and a budget that
    /// lies between could not be used.
    #[must_use]
    pub fn spread_limits(&self, scale: f64, min_rays: f64) -> MaxLevels {
        let chance = |region: u64| (mix(region) >> 40) as f64 / 2_f64.powi(24);
        self.limits_where(scale, |region| min_rays * chance(region).exp2())
    }

    fn limits_where(&self, scale: f64, min_rays: impl Fn(u64) -> f64) -> MaxLevels {
        let least = MaxLevels::none(self.finest).region_level();
        let wanted = self.counts.iter().map(|(&region, counts)| {
            let coarser = (0..=self.finest - least).find(|&coarser| {
                let (all, touches) = counts.expected(scale, coarser);
                touches >= min_rays(region) * all
            });
            (region, coarser.map_or(least, |coarser| self.finest - coarser))
        });
        MaxLevels::balanced(self.finest, wanted)
    }

    /// Fractions of all touches that fall on leaves k = 0, 1, … levels coarser than the finest.
    #[must_use]
    pub fn shares(&self, limits: &MaxLevels) -> Vec<f64> {
        let mut shares = vec![0.0; usize::from(self.finest - limits.region_level()) + 1];
        let mut total = 0.0;
        for (&region, counts) in &self.counts {
            shares[usize::from(self.finest - limits.level(region))] += counts.touches;
            total += counts.touches;
        }
        // Integers below 2⁵³ add exactly in any order.
        shares.iter_mut().for_each(|share| *share /= f64::max(total, 1.0));
        shares
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of `touches` rays that each touch one of `vertices` at random.
    fn counts(touches: u64, vertices: u64) -> Counts {
        let mut rays = vec![0_u32; vertices as usize];
        let mut state = 1_u64;
        for _ in 0..touches {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            rays[((state >> 33) % vertices) as usize] += 1;
        }
        let number = |n: u32| rays.iter().filter(|&&r| r == n).count() as f64;
        Counts { touches: touches as f64, distinct: vertices as f64 - number(0), once: number(1), twice: number(2) }
    }

    #[test]
    fn a_few_rays_predict_how_many_vertices_many_rays_touch() {
        // A pilot sees a tenth of 10,000 vertices. The standard error of Chao's estimate is about 4 % here.
        let pilot = counts(1000, 10_000);
        assert!(pilot.distinct < 1000.0);
        for scale in [1_u64, 10, 100] {
            let found = pilot.vertices(scale as f64, 0);
            let truth = counts(1000 * scale, 10_000).distinct;
            assert!((found / truth - 1.0).abs() < 0.15, "scale {scale}: {found} expected, {truth} touched");
        }
    }

    #[test]
    fn limits_are_as_fine_as_rays_support() {
        let survey = PilotCounts { finest: 8, counts: [(0, counts(4000, 1000))].into_iter().collect() };
        let level = |scale, min_rays| survey.limits(scale, min_rays).level(0);
        // About four rays per vertex, which each coarser level doubles.
        assert_eq!((level(1.0, 3.0), level(1.0, 6.0), level(1.0, 12.0), level(1.0, 1e9)), (8, 7, 6, 3));
        assert_eq!(level(4.0, 12.0), 8, "four times the rays");
        let [fine, coarse] = [0, 1].map(|coarser| survey.counts[&0].vertices(1.0, coarser));
        assert!(
            (3.0..4.1).contains(&(fine / coarse)),
            "a quarter of the vertices, a little better filled: {fine}, {coarse}"
        );
        assert_eq!(survey.shares(&survey.limits(1.0, 6.0)), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
