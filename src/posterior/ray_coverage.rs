//! How many training rays reached each part of space: what was seen, whether or not anything was there.
//!
//! U does not distinguish free air from space that no ray reached: displacing either changes no pixel, and both keep
//! the prior. Ray coverage distinguishes them. A ray covers the space that it crosses before half of its light is lost,
//! T > ½, and the centres of the splats that it shows there. Counts are stored in the cells of a separate coarse grid,
//! because an octree's leaves in free space are far too large to separate the space in front of a surface from that
//! behind it.

use std::ops::AddAssign;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::{Domain, Lattice};
use crate::render::{RaySamples, VisibleSegment};

/// Most counters at once. One thread adds them up, a megabyte each, and takes longer with each of them.
const MOST_COUNTERS: usize = 4;

/// Steps per coarse cell along a contracted ray, which is curved on the grid.
const STEPS_PER_CELL: f64 = 2.0;

/// Ray counts in the cells of a coarse grid over a domain.
#[derive(Debug, Clone, PartialEq)]
pub struct RayCoverage {
    lattice: Lattice,
    /// `[cells]`, x slowest, z fastest.
    counts: Vec<u32>,
}

impl RayCoverage {
    /// Finest level: 64 cells per axis, a megabyte of counts. At level 8 a cell is four finest cells wide.
    pub const LEVEL: u8 = 6;

    /// No rays yet in the domain of `finest`, on a grid of its level but at most [`RayCoverage::LEVEL`].
    #[must_use]
    pub fn new(finest: &Lattice) -> Self {
        let lattice = finest.coarsened(Self::LEVEL);
        Self { lattice, counts: vec![0; 1 << (3 * u32::from(lattice.level()))] }
    }

    /// The ray coverage of `counts`, `[cells]`, x slowest; `None` if no grid over the domain of `finest` has as many
    /// cells.
    #[must_use]
    pub fn from_counts(finest: &Lattice, counts: Vec<u32>) -> Option<Self> {
        let level = (1..=finest.level().min(Self::LEVEL)).find(|level| counts.len() == 1 << (3 * u32::from(*level)))?;
        Some(Self { lattice: finest.coarsened(level), counts })
    }

    /// The finest level at which `rays` rays leave no holes by chance.
    ///
    /// A ray crosses about 1.5 · 2^level cells of 8^level. Where rays are spread evenly, a cell is then visited by 1.5
    /// rays / 4^level of them; ten and more leave one cell in 10⁴ unvisited by chance.
    #[must_use]
    pub fn level_of(rays: u64) -> u8 {
        (1..=Self::LEVEL).rev().find(|level| rays >= 10 << (2 * u32::from(*level))).unwrap_or(1)
    }

    /// The same ray coverage in the cells of a coarser level: the most that any part of such a cell had.
    #[must_use]
    pub fn coarsened(&self, level: u8) -> Self {
        let lattice = self.lattice.coarsened(level);
        let shift = self.lattice.level() - lattice.level();
        let mut counts = vec![0; 1 << (3 * u32::from(lattice.level()))];
        let fine = self.lattice.level();
        for (i, &count) in self.counts.iter().enumerate() {
            let most: &mut u32 = &mut counts[index(&lattice, cell_at(fine, i).map(|i| i >> shift))];
            *most = count.max(*most);
        }
        Self { lattice, counts }
    }

    /// `[cells]`, x slowest, z fastest.
    #[must_use]
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Number of rays that reached the cell around a scene point; `None` outside the domain.
    #[must_use]
    pub fn at(&self, x: Vec3) -> Option<u32> {
        self.cell(x).map(|cell| self.counts[cell])
    }

    /// The number of the cell around a scene point, the place of its count in [`RayCoverage::counts`]; `None` outside
    /// the domain.
    #[must_use]
    pub fn cell(&self, x: Vec3) -> Option<usize> {
        let u = self.lattice.coordinates(x)?;
        Some(index(&self.lattice, self.lattice.cell(u).0))
    }

    /// Whether a ray reached a cell, by its number: what is never seen is where none did.
    #[must_use]
    pub fn is_reached(&self, cell: usize) -> bool {
        self.counts[cell] > 0
    }

    /// Share of the cells that no ray reached.
    #[must_use]
    pub fn unseen_share(&self) -> f64 {
        (0..self.counts.len()).filter(|&cell| !self.is_reached(cell)).count() as f64 / self.counts.len() as f64
    }

    /// Bytes on the heap.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.counts.capacity() * size_of::<u32>()
    }

    /// Adds rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        let lattice = &self.lattice;
        let at_centre = |(_, x): &(usize, Vec3)| self.cell(*x);
        // Each part has a counter of its own. One call counts far fewer rays than a u32 holds.
        let counted = |batches: &[RaySamples]| {
            let mut counts = vec![0_u32; self.counts.len()];
            for batch in batches {
                let mut reached = batch.reached.iter().peekable();
                // Cells of centres that the line itself does not cross.
                let mut aside = Vec::new();
                for (k, line) in batch.sight.iter().enumerate() {
                    aside.extend(std::iter::from_fn(|| reached.next_if(|(line, _)| *line == k)).flat_map(at_centre));
                    aside.sort_unstable();
                    aside.dedup();
                    let visit = |cell: usize| {
                        counts[cell] += 1;
                        aside.retain(|other| *other != cell);
                    };
                    match lattice.domain() {
                        Domain::Box(_) => along_straight(lattice, line, visit),
                        Domain::Contracted { .. } => along_curved(lattice, line, visit),
                    }
                    aside.drain(..).for_each(|cell| counts[cell] += 1);
                }
            }
            counts
        };
        let share = batches.len().div_ceil(rayon::current_num_threads().min(MOST_COUNTERS)).max(1);
        let counted: Vec<Vec<u32>> = batches.par_chunks(share).map(counted).collect();
        for counts in counted {
            self.counts.iter_mut().zip(counts).for_each(|(sum, count)| *sum = sum.saturating_add(count));
        }
    }
}

impl AddAssign<&Self> for RayCoverage {
    /// Adds other rays. The sum has the coarser level of the two.
    fn add_assign(&mut self, other: &Self) {
        let level = self.lattice.level().min(other.lattice.level());
        if level < self.lattice.level() {
            *self = self.coarsened(level);
        }
        if level < other.lattice.level() {
            return *self += &other.coarsened(level);
        }
        self.counts.iter_mut().zip(&other.counts).for_each(|(sum, count)| *sum = sum.saturating_add(*count));
    }
}

/// Position of a cell in the array of counts.
fn index(lattice: &Lattice, cell: [u32; 3]) -> usize {
    cell.into_iter().fold(0, |index, i| index << lattice.level() | i as usize)
}

/// The cell at a position in the array of counts of a grid of 2^`level` cells per axis.
fn cell_at(level: u8, i: usize) -> [u32; 3] {
    [2 * level, level, 0].map(|at| (i >> at) as u32 & ((1 << level) - 1))
}

/// Calls `visit` once for every cell that a line crosses in a box, in order (Amanatides & Woo 1987).
fn along_straight(lattice: &Lattice, line: &VisibleSegment, mut visit: impl FnMut(usize)) {
    let Some(bounds) = lattice.domain().bounds() else { return };
    let Some((enter, exit)) = bounds.clip(&line.ray) else { return };
    let (enter, exit) = (enter.max(0.0), exit.min(line.until));
    if enter >= exit {
        return;
    }
    let scale = f64::from(lattice.cells_per_axis()) / bounds.size();
    let last = i64::from(lattice.cells_per_axis()) - 1;
    let [origin, direction] = [line.ray.origin - bounds.min(), line.ray.direction].map(|v| (v * scale).to_array());
    let start = [0, 1, 2].map(|axis| origin[axis] + enter * direction[axis]);
    let cell = start.map(|u| (u as i64).clamp(0, last));
    let mut place = index(lattice, cell.map(|i| i as u32));
    let [mut x, mut y, mut z] = [0, 1, 2].map(|axis| {
        let (d, i) = (direction[axis], cell[axis]);
        let stride = 1 << ((2 - axis) * usize::from(lattice.level()));
        Crossing {
            next: if d == 0.0 { f64::INFINITY } else { ((i + i64::from(d > 0.0)) as f64 - origin[axis]) / d },
            between: 1.0 / d.abs(),
            stride: if d < 0.0 { -stride } else { stride },
            left: if d < 0.0 { i } else { last - i },
        }
    });
    loop {
        visit(place);
        // Each arm for itself: through a reference to the axis, all of them would live in memory.
        let stride = if x.next <= y.next && x.next <= z.next {
            x.pass(exit)
        } else if y.next <= z.next {
            y.pass(exit)
        } else {
            z.pass(exit)
        };
        let Some(stride) = stride else { return };
        place = place.wrapping_add_signed(stride);
    }
}

/// A line's crossings of the planes of an axis.
struct Crossing {
    /// Distance along the ray to the next plane.
    next: f64,
    /// Distance between two planes.
    between: f64,
    /// How far the next cell is in the array of counts.
    stride: isize,
    /// Cells that follow in the grid.
    left: i64,
}

impl Crossing {
    /// Passes the next plane, unless the line or the grid ends before it; how far the next cell is then.
    #[inline(always)]
    fn pass(&mut self, exit: f64) -> Option<isize> {
        if self.next >= exit || self.left == 0 {
            return None;
        }
        self.next += self.between;
        self.left -= 1;
        Some(self.stride)
    }
}

/// Calls `visit` for every cell that a line enters in contracted space, but for corners that it cuts by less than a
/// step.
fn along_curved(lattice: &Lattice, line: &VisibleSegment, mut visit: impl FnMut(usize)) {
    let shortest = |x: Vec3| lattice.edge().min_element() / STEPS_PER_CELL * lattice.domain().stretch(x);
    let (mut t, mut step) = (0.0, 0.0);
    let mut last: Option<(usize, DVec3)> = None;
    while t < line.until {
        let x = line.ray.at(t).as_vec3();
        let Some(u) = lattice.coordinates(x) else { return };
        let moved = last.map_or(0.0, |(_, last)| STEPS_PER_CELL * (u - last).abs().max_element());
        // Where the contraction bends (L∞: where another axis becomes the longest), lengths on the grid grow within a
        // step.
        if moved > FARTHEST && step > shortest(x) {
            step *= 0.5;
            t -= step;
            continue;
        }
        let cell = index(lattice, lattice.cell(u).0);
        if last.is_none_or(|(last, _)| last != cell) {
            visit(cell);
        }
        // Lengths along the direction to the centre grow faster than those across it, which set the first step.
        if t > 0.0 && moved < NOWHERE {
            return;
        }
        step = (step / moved.max(0.5)).max(shortest(x));
        last = Some((cell, u));
        t += step;
    }
}

/// Longest step on the grid, in steps of full length: 0.75 cells. A cell that a line crosses for longer is never
/// missed.
const FARTHEST: f64 = 0.75 * STEPS_PER_CELL;

/// Steps this short on the grid, in steps of full length, lead no farther: the ray has reached its last cell.
const NOWHERE: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Norm, Ray};
    use proptest::array::uniform3;
    use proptest::prelude::*;

    fn ray_coverage(domain: Domain, lines: Vec<VisibleSegment>) -> RayCoverage {
        let mut ray_coverage = RayCoverage::new(&Lattice::from_domain(domain, 8).unwrap());
        ray_coverage.add(&[RaySamples { sight: lines, ..RaySamples::default() }]);
        ray_coverage
    }

    fn line(origin: [f64; 3], direction: [f64; 3], until: f64) -> Option<VisibleSegment> {
        let direction = DVec3::from(direction).try_normalize()?;
        Some(VisibleSegment { ray: Ray::new(DVec3::from(origin), direction), until })
    }

    proptest! {
        /// Whole runs are coarsened before they are merged, parts of a run only after.
        #[test]
        fn counts_added_after_coarsening_are_an_upper_bound(
            of in proptest::collection::vec(proptest::collection::vec(0_u32..3, 512), 2..4),
            level in 1_u8..4,
        ) {
            let lattice = Lattice::new(Aabb::centered_cube(1.0), 3).unwrap();
            let of = of.into_iter().map(|counts| RayCoverage::from_counts(&lattice, counts).unwrap());
            let of: Vec<RayCoverage> = of.collect();
            let added = |mut each: Vec<RayCoverage>| {
                let first = each.swap_remove(0);
                each.iter().fold(first, |mut sum, more| { sum += more; sum })
            };
            let exact = added(of.clone()).coarsened(level);
            let bound = added(of.iter().map(|ray_coverage| ray_coverage.coarsened(level)).collect());
            for (exact, bound) in exact.counts().iter().zip(bound.counts()) {
                prop_assert!(exact <= bound && (*exact == 0) == (*bound == 0), "{exact} {bound}");
            }
        }

        /// Against thousands of points along the line.
        #[test]
        fn a_line_covers_the_cells_that_it_crosses_once(
            origin in uniform3(-2.0..2.0_f64),
            direction in uniform3(-1.0..1.0_f64),
            until in prop_oneof![Just(f64::INFINITY), 0.0..4.0_f64],
            contracted in proptest::option::of(prop_oneof![Just(Norm::L2), Just(Norm::Linf)]),
        ) {
            let domain = match contracted {
                Some(norm) => Domain::contracted(DVec3::ZERO, 0.5, norm).unwrap(),
                None => Domain::Box(Aabb::centered_cube(1.0)),
            };
            let Some(line) = line(origin, direction, until) else { return Ok(()) };
            let found = ray_coverage(domain, vec![line]);
            let lattice = found.lattice;
            // How far the line goes within every cell that it crosses, in cells.
            let mut crossed = std::collections::BTreeMap::<usize, f64>::new();
            let mut last: Option<DVec3> = None;
            for i in 0..200_000 {
                let t = 6.0 * f64::from(i) / 200_000.0;
                if t >= until {
                    break;
                }
                if let Some(u) = lattice.coordinates(line.ray.at(t).as_vec3()) {
                    let moved = last.map_or(0.0, |last| (u - last).abs().max_element());
                    *crossed.entry(index(&lattice, lattice.cell(u).0)).or_default() += moved;
                    last = Some(u);
                }
            }
            let least = if contracted.is_some() { 0.8 } else { 0.01 };
            for (cell, _) in crossed.iter().filter(|(_, length)| **length > least) {
                prop_assert!(found.counts[*cell] > 0, "cell {} of {:?}", cell, line);
            }
            if contracted.is_none() {
                prop_assert!(found.counts.iter().all(|count| *count <= 1));
                // Nothing else is visited, but for corners that no point fell into.
                let visited = found.counts.iter().enumerate().filter(|(_, count)| **count > 0);
                let others = visited.filter(|(cell, _)| !crossed.contains_key(cell));
                prop_assert!(others.count() <= 3);
            }
        }
    }

    #[test]
    fn centres_beside_a_line_are_reached_and_counted_once() {
        let cube = Domain::Box(Aabb::centered_cube(1.0));
        let lines = [-3.0, 3.0].map(|x: f64| line([x, 0.01, 0.01], [-x, 0.0, 0.0], 2.5).unwrap());
        // On the first line; far from the second, twice in one cell; and outside.
        let aside = Vec3::new(0.3, 0.5, 0.5);
        let reached =
            vec![(0, Vec3::new(-0.7, 0.01, 0.01)), (1, aside), (1, aside + 0.001), (1, Vec3::new(2.0, 0.0, 0.0))];
        let samples = RaySamples { sight: lines.to_vec(), reached, ..RaySamples::default() };
        let mut found = RayCoverage::new(&Lattice::from_domain(cube, 8).unwrap());
        found.add(&[samples.clone(), samples]);
        assert_eq!(found.at(aside), Some(2));
        assert_eq!(found.at(Vec3::new(-0.7, 0.01, 0.01)), Some(2));
        let without = ray_coverage(cube, lines.to_vec());
        assert_eq!(found.counts.iter().sum::<u32>(), 2 * (without.counts.iter().sum::<u32>() + 1));
    }

    #[test]
    fn a_line_ends_where_half_of_the_light_is_lost() {
        let cube = Domain::Box(Aabb::centered_cube(1.0));
        let wall = ray_coverage(cube, vec![line([-3.0, 0.01, 0.01], [1.0, 0.0, 0.0], 3.2).unwrap()]);
        let at = |x: f32| wall.at(Vec3::new(x, 0.01, 0.01));
        assert_eq!([-0.99, 0.0, 0.19].map(at), [Some(1); 3]);
        assert_eq!([0.25, 0.99, 1.01].map(at), [Some(0), Some(0), None]);
        assert_eq!(wall.unseen_share(), 1.0 - 39.0 / 262_144.0);
        // From inside, along a face, and past the box.
        let more =
            [([0.5, 0.5, 0.5], [0.0, 0.0, -1.0]), ([-1.0, -1.0, -3.0], [0.0, 0.0, 1.0]), ([-3.0; 3], [0.0, 1.0, 0.0])];
        let more = more.map(|(origin, direction)| line(origin, direction, f64::INFINITY).unwrap());
        let mut both = ray_coverage(cube, more.to_vec());
        assert_eq!(both.counts.iter().sum::<u32>(), 49 + 64);
        both += &wall;
        assert_eq!(both.counts.iter().sum::<u32>(), 49 + 64 + 39);
        assert_eq!(RayCoverage::from_counts(&both.lattice, both.counts.clone()), Some(both.clone()));
        assert_eq!(RayCoverage::from_counts(&both.lattice, vec![0; 7]), None);
        // Coarser cells hold the most of their parts, and may be added to finer ones.
        let coarse = both.coarsened(1);
        assert_eq!(coarse.counts, [1, 1, 0, 1, 0, 0, 1, 1]);
        let mut sum = both.clone();
        sum += &coarse;
        assert_eq!(sum.counts, [2, 2, 0, 2, 0, 0, 2, 2]);
        assert_eq!([10, 159, 160, 40_959, 40_960].map(RayCoverage::level_of), [1, 1, 2, 5, 6]);
    }
}
