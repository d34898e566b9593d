//! Where space is cut into tiles: so that each is expected to have as many vertices.
//!
//! Boxes of equal size would not do. Surfaces fill a small part of their box, and those of a city the lowest part of a
//! cube: halved along z, its upper half is empty.

use super::census::{SpeciesCounts, SpeciesEstimate};
use crate::octree::{Leaves, MaxLevels, Tile};

/// The larger half may have so many times the mean of both. Then space is cut across the longest axis of what is in it,
/// so that rays cross few tiles; otherwise along the axis whose halves are the most even.
const UNEVEN: f64 = 1.05;

/// A vertex that the pilot touched.
#[derive(Debug, Clone, Copy)]
struct Touched {
    point: [u32; 3],
    /// Index of its sample.
    sample: usize,
    rays: u32,
}

impl SpeciesEstimate {
    /// The tile with its box, where all tiles need about as much if `scale` times the pilot's rays are summed on the
    /// leaves of `limits`. It is the same for the same pilot, for any tile and any number of threads.
    #[must_use]
    pub fn cut(&self, scale: f64, limits: &MaxLevels, tile: Tile) -> Tile {
        let (mut touched, mut weights) = (Vec::new(), Vec::new());
        for (sample, (points, weight)) in self.sampled(limits).enumerate() {
            touched.extend(points.into_iter().map(|(point, rays)| Touched { point, sample, rays }));
            weights.push(weight);
        }
        let (mut low, mut high) = ([0; 3], [1_u32 << limits.finest(); 3]);
        let mut of = tile.of;
        while of > 1 {
            of /= 2;
            let vertices = |caught: &[SpeciesCounts]| {
                caught.iter().zip(&weights).map(|(caught, weight)| weight * caught.expected(scale)).sum::<f64>()
            };
            let halves = |axis: usize, plane: u32| {
                let mut caught =
                    [vec![SpeciesCounts::default(); weights.len()], vec![SpeciesCounts::default(); weights.len()]];
                for Touched { point, sample, rays } in &touched {
                    let half = &mut caught[usize::from(point[axis] >= plane)][*sample];
                    *half = half.add(*rays);
                }
                caught.map(|caught| vertices(&caught))
            };
            let Some((axis, plane)) = best(&touched, low, high, of, halves) else { break };
            let is_upper = tile.index & of != 0;
            touched.retain(|touched| (touched.point[axis] >= plane) == is_upper);
            if is_upper { low[axis] = plane } else { high[axis] = plane }
        }
        tile.within(low, high)
    }
}

/// Axis and plane that cut a box in two parts of `of` tiles each; `None` if it is too small.
fn best(
    touched: &[Touched],
    low: [u32; 3],
    high: [u32; 3],
    of: u32,
    halves: impl Fn(usize, u32) -> [f64; 2],
) -> Option<(usize, u32)> {
    let extent = |axis: usize| {
        let along = || touched.iter().map(|touched| touched.point[axis]);
        along().max().zip(along().min()).map_or(0, |(max, min)| max - min)
    };
    let mut axes = [2, 1, 0].map(|axis| (extent(axis), high[axis] - low[axis], axis));
    // A stable sort: of axes that are alike, z comes first.
    axes.sort_by_key(|&(extent, length, _)| std::cmp::Reverse((extent, length)));
    let mut found: Option<(f64, usize, u32)> = None;
    for (_, length, axis) in axes {
        // A box can be cut into as many tiles as its edges, rounded down to powers of two, have cells.
        let others: u32 = (0..3).filter(|other| *other != axis).map(|other| (high[other] - low[other]).ilog2()).sum();
        let least = 1 << of.ilog2().saturating_sub(others);
        if length < 2 * least {
            continue;
        }
        let plane = even(low[axis] + least, high[axis] - least, |plane| halves(axis, plane));
        let [lower, upper] = halves(axis, plane);
        let uneven = if touched.is_empty() { 1.0 } else { 2.0 * lower.max(upper) / (lower + upper) };
        if uneven <= UNEVEN {
            return Some((axis, plane));
        }
        if found.is_none_or(|(least, ..)| uneven < least) {
            found = Some((uneven, axis, plane));
        }
    }
    found.map(|(_, axis, plane)| (axis, plane))
}

/// The plane between `first` and `last` that has the most even halves; the one in the middle where all are even.
fn even(first: u32, last: u32, halves: impl Fn(u32) -> [f64; 2]) -> u32 {
    let (mut low, mut high) = (first, last);
    while low < high {
        let middle = low + (high - low) / 2;
        let [lower, upper] = halves(middle);
        if lower == upper {
            return middle;
        }
        if lower < upper { low = middle + 1 } else { high = middle }
    }
    let off = |plane: u32| {
        let [lower, upper] = halves(plane);
        (upper - lower).abs()
    };
    if low > first && off(low - 1) <= off(low) { low - 1 } else { low }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::geometry::{Aabb, Lattice};
    use crate::octree::Tiling;
    use crate::render::{RaySample, RaySamples};

    /// What rays of one sample each touch, at points of a box of edge 2.
    fn census(level: u8, points: impl Iterator<Item = DVec3>) -> SpeciesEstimate {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), level).unwrap();
        let mut census = SpeciesEstimate::new(lattice, 1 << 12, false);
        let mut samples = RaySamples::default();
        for (ray, x) in (0..).zip(points) {
            samples.push(ray, RaySample { position: x.as_vec3(), jacobian: [Vec3::ONE.x; 9], weight: 1.0 });
        }
        census.add(&[samples]);
        census
    }

    fn golden(i: u32) -> [f64; 2] {
        [0.754_877_666_246_693, 0.569_840_290_998_053].map(|g| (f64::from(i) * g).fract())
    }

    #[test]
    fn tiles_have_as_many_vertices_wherever_these_are() {
        let level = 8;
        let flat = |axis: usize, at: f64| {
            (0..20_000).map(move |i| {
                let [u, v] = golden(i);
                let mut x = DVec3::splat(at);
                (x[(axis + 1) % 3], x[(axis + 2) % 3]) = (1.98 * u - 0.99, 1.98 * v * v - 0.99);
                x
            })
        };
        let small = (0..20_000).map(|i| {
            let [u, v] = golden(i);
            let (s, c) = (std::f64::consts::TAU * u).sin_cos();
            0.11 * DVec3::new(c * (v - v * v).sqrt(), s * (v - v * v).sqrt(), v) + 0.71
        });
        let scenes: [(&str, Vec<DVec3>); 5] = [
            ("flat along x, at the lower end", flat(0, -0.97).collect()),
            ("flat along y, in the middle", flat(1, 0.01).collect()),
            ("flat along z, at the upper end", flat(2, 0.96).collect()),
            ("a small ball in a corner", small.collect()),
            ("flat and a part of it far away", flat(2, -0.9).chain(flat(2, 0.9)).collect()),
        ];
        for (name, points) in scenes {
            let census = census(level, points.into_iter());
            let limits = MaxLevels::none(level);
            let all: Vec<[u32; 3]> = census.sampled(&limits).flat_map(|(points, _)| points).map(|(p, _)| p).collect();
            for of in [2, 4, 8, 16] {
                let tiles: Vec<Tile> =
                    (0..of).map(|index| census.cut(1.0, &limits, Tile::new(index, of).unwrap())).collect();
                let tiling = Tiling::new(level, &tiles).expect("tiles of one tree of cuts");
                let mut counts = vec![0; of as usize];
                all.iter().for_each(|point| counts[tiling.owner(*point)] += 1);
                let most = f64::from(*counts.iter().max().unwrap()) * f64::from(of) / all.len() as f64;
                assert!(most < 1.25, "{name}: {of} tiles have {counts:?} of {}", all.len());
            }
        }
    }

    /// Where hardly anything can be cut, there are still all tiles, and each has a box.
    #[test]
    fn there_are_always_all_tiles() {
        for (level, of) in [(1, 8), (2, 64), (3, 16), (4, 4096), (8, 4096)] {
            for points in [Vec::new(), vec![DVec3::splat(-0.99)], vec![DVec3::splat(0.99); 3]] {
                let census = census(level, points.into_iter());
                let limits = MaxLevels::none(level);
                let cut = |index| census.cut(1.0, &limits, Tile::new(index, of).unwrap());
                let tiles: Vec<Tile> = (0..of).map(cut).collect();
                assert!(Tiling::new(level, &tiles).is_some(), "{of} tiles of level {level}");
            }
        }
    }
}
