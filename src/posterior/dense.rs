//! The dense reference: the paper's uniform grid, written for readability.

use std::collections::BTreeMap;
use std::ops::AddAssign;
use std::sync::Arc;

use rayon::prelude::*;

use super::{Fill, Posterior, Refinement, Sums, Support, VertexSums};
use crate::Result;
use crate::geometry::Lattice;
use crate::io::sorted::SortedFile;
use crate::octree::{MaxLevels, trilinear};
use crate::render::RaySamples;

/// The sums at all (M + 1)³ lattice points, added in f64 in ray order.
#[derive(Debug, Clone)]
pub struct DensePosterior {
    lattice: Lattice,
    /// `[(M + 1)³]`, x slowest, z fastest.
    sums: Vec<VertexSums>,
}

impl DensePosterior {
    /// Creates a posterior without information.
    #[must_use]
    pub fn new(lattice: Lattice) -> Self {
        Self { lattice, sums: vec![VertexSums::default(); lattice.dense_vertices() as usize] }
    }

    /// Bytes that a dense posterior of this lattice needs.
    #[must_use]
    pub fn required_memory(lattice: &Lattice) -> u64 {
        lattice.dense_vertices().saturating_mul(size_of::<VertexSums>() as u64)
    }

    /// Returns the sums, `[(M + 1)³]`, x slowest.
    #[must_use]
    pub fn into_sums(self) -> Vec<VertexSums> {
        self.sums
    }

    /// The sums, `[(M + 1)³]`, x slowest.
    #[must_use]
    pub fn sums(&self) -> &[VertexSums] {
        &self.sums
    }

    /// J_v(r) for every vertex v that one ray touches.
    fn ray_jacobian(&self, samples: &RaySamples, ray: std::ops::Range<usize>) -> BTreeMap<usize, [f64; 9]> {
        let mut jacobian: BTreeMap<usize, [f64; 9]> = BTreeMap::new();
        for i in ray {
            let Some(u) = self.lattice.coordinates(samples.positions[i]) else { continue };
            let (cell, offset) = self.lattice.cell(u);
            for (corner, weight) in trilinear(offset).into_iter().enumerate() {
                let point = std::array::from_fn(|axis| cell[axis] + (corner as u32 >> axis & 1));
                let j = jacobian.entry(self.lattice.dense_index(point)).or_default();
                for (sum, &g) in j.iter_mut().zip(&samples.jacobians[i]) {
                    *sum += weight * f64::from(g);
                }
            }
        }
        jacobian
    }
}

impl AddAssign<&Self> for DensePosterior {
    /// Adds the sums over other rays.
    fn add_assign(&mut self, other: &Self) {
        self.sums.iter_mut().zip(&other.sums).for_each(|(sum, other)| *sum += other);
    }
}

impl Posterior for DensePosterior {
    const NAME: [&'static str; 2] = ["dense grid", <VertexSums as Sums>::NAME];
    type Sums = VertexSums;
    /// All lattice points.
    type Vertices = ();

    fn empty(lattice: Lattice, _limits: &MaxLevels) -> Self {
        Self::new(lattice)
    }

    fn add(&mut self, batches: &[RaySamples]) {
        for batch in batches {
            for (_, samples) in batch.iter() {
                for (vertex, j) in self.ray_jacobian(batch, samples) {
                    let sum = &mut self.sums[vertex];
                    sum.rays = sum.rays.saturating_add(1);
                    let s = &mut sum.information;
                    for channel in 0..3 {
                        let [x, y, z] = [j[3 * channel], j[3 * channel + 1], j[3 * channel + 2]];
                        s[0] += x * x;
                        s[1] += x * y;
                        s[2] += x * z;
                        s[3] += y * y;
                        s[4] += y * z;
                        s[5] += z * z;
                    }
                }
            }
        }
    }

    fn add_sums(&mut self, point: [u32; 3], sums: &VertexSums) {
        self.sums[self.lattice.dense_index(point)] += sums;
    }

    fn memory(&self) -> usize {
        self.sums.capacity() * size_of::<VertexSums>()
    }

    fn spill(&mut self, _write: impl FnOnce(Fill<'_, VertexSums>) -> Result<SortedFile<VertexSums>>) -> Result<()> {
        Ok(())
    }

    fn merge_runs(
        &mut self,
        _write: impl FnOnce(Fill<'_, VertexSums>) -> Result<SortedFile<VertexSums>>,
    ) -> Result<()> {
        Ok(())
    }

    fn runs(&self) -> &[Arc<SortedFile<VertexSums>>] {
        &[]
    }

    fn add_run(&mut self, _run: SortedFile<VertexSums>) -> Result<bool> {
        Ok(false)
    }

    fn vertices(&self, _refinement: &Refinement) -> Result<()> {
        Ok(())
    }

    fn read_groups<T: Clone + Default + Send>(
        groups: &[Self],
        support: &Support,
        read: impl Fn(usize, [u32; 3], &[VertexSums]) -> T + Sync,
    ) -> Result<Vec<T>> {
        assert!(*support == Support::Dense, "a dense grid");
        let lattice = groups[0].lattice;
        let read = |v: usize| {
            let sums: Vec<VertexSums> = groups.iter().map(|group| group.sums[v]).collect();
            read(v, lattice.dense_point(v), &sums)
        };
        Ok((0..groups[0].sums.len()).into_par_iter().map(read).collect())
    }

    fn paired<T: Send>(
        &self,
        other: &Self,
        read: impl Fn(VertexSums, VertexSums) -> Option<T> + Send + Sync,
    ) -> Result<Vec<T>> {
        let touched = self.sums.par_iter().zip(&other.sums).filter(|(a, b)| a.rays > 0 || b.rays > 0);
        Ok(touched.filter_map(|(a, b)| read(*a, *b)).collect())
    }

    fn keys(&self) -> Vec<u64> {
        Vec::new()
    }

    fn slices(&self) -> impl Iterator<Item = &[VertexSums]> {
        std::iter::once(&self.sums[..])
    }

    fn restore(lattice: Lattice, _limits: &MaxLevels, _keys: &[u64], sums: Vec<VertexSums>) -> Option<Self> {
        (sums.len() as u64 == lattice.dense_vertices()).then_some(Self { lattice, sums })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::Aabb;
    use crate::render::RaySample;

    /// As in the octree: a run of more rays than a u32 counts continues, and reports "at least".
    #[test]
    fn a_full_count_of_rays_stays_full() {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 1).unwrap();
        let full = VertexSums::new([0.0; 6], u32::MAX);
        let mut posterior = DensePosterior { lattice, sums: vec![full; 27] };
        let mut ray = RaySamples::default();
        ray.push(0, RaySample { position: Vec3::splat(0.3), jacobian: [1.0; 9], weight: 1.0 });
        posterior.add(&[ray]);
        let sums = posterior.into_sums();
        assert!(sums.iter().all(|sums| sums.rays == u32::MAX) && sums.iter().any(|sums| sums.information[0] > 0.0));
    }
}
