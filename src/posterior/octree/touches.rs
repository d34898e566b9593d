//! Counts how many of a pilot's rays touch each vertex, on the leaves of every coarseness that limits may require.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::pilot_counts::PilotCounts;
use crate::geometry::Lattice;
use crate::octree::{MaxLevels, morton};
use crate::render::RaySamples;

/// Numbers of rays that touched the vertices of each lattice: the finest, and coarser ones.
#[derive(Debug, Clone)]
pub struct Touches {
    lattice: Lattice,
    /// By coarseness, the number of rays of every vertex, by its Morton code.
    rays: Vec<FxHashMap<u64, u32>>,
}

impl Touches {
    /// Counts nothing yet.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        let finest = lattice.level();
        let sizes = usize::from(finest - MaxLevels::none(finest).region_level()) + 1;
        Self { lattice, rays: vec![FxHashMap::default(); sizes] }
    }

    /// Counts rays.
    pub fn add(&mut self, batches: &[RaySamples]) {
        for some in batches.chunks(rayon::current_num_threads()) {
            let touched: Vec<Vec<Vec<u64>>> = some.par_iter().map(|batch| self.touched(batch)).collect();
            for lists in touched {
                for (rays, codes) in self.rays.iter_mut().zip(lists) {
                    codes.into_iter().for_each(|code| *rays.entry(code).or_default() += 1);
                }
            }
        }
    }

    /// By coarseness, the vertices that single rays of a batch touched, each once per ray.
    fn touched(&self, batch: &RaySamples) -> Vec<Vec<u64>> {
        let mut touched = vec![Vec::new(); self.rays.len()];
        for (_, samples) in batch.iter() {
            let located = batch.positions[samples].iter().filter_map(|&x| self.lattice.coordinates(x));
            let mut cells: Vec<u64> = located.map(|u| morton::encode(self.lattice.cell(u).0)).collect();
            cells.sort_unstable();
            for all in &mut touched {
                cells.dedup();
                let mut vertices: Vec<u64> = cells.iter().flat_map(|&cell| corners(cell)).collect();
                vertices.sort_unstable();
                vertices.dedup();
                all.append(&mut vertices);
                // The parents, still sorted.
                cells.iter_mut().for_each(|code| *code >>= 3);
            }
        }
        touched
    }

    /// The counts by region, from which limits are made.
    #[must_use]
    pub fn counts(&self) -> PilotCounts {
        PilotCounts::new(self.lattice.level(), self.rays.iter().map(|rays| rays.iter().map(|(&code, &n)| (code, n))))
    }
}

/// The corners of a cell, by Morton codes.
fn corners(cell: u64) -> impl Iterator<Item = u64> {
    let at = morton::decode(cell);
    (0..8_u32).map(move |c| morton::encode(std::array::from_fn(|axis| at[axis] + (c >> axis & 1))))
}
