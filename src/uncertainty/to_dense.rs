//! An octree's values on the dense grid, for tools without octrees and for comparing queries.

use glam::DVec3;
use rayon::prelude::*;

use super::layers::Change;
use super::{RayCounts, Support, UncertaintyField};

impl UncertaintyField {
    /// The same U at every vertex of the finest lattice: 4 (M + 1)³ bytes. Ray counts go, and what belongs to the
    /// vertices of the octree.
    #[must_use]
    pub fn on_dense_grid(&self) -> Self {
        let n = self.lattice.cells_per_axis() as usize + 1;
        let deviations = match &self.support {
            Support::Dense => self.deviations.clone(),
            Support::Octree(octree) => {
                let mut values = vec![0.0_f32; n * n * n];
                values.par_chunks_mut(n).enumerate().for_each(|(row, values)| {
                    let mut cursor = octree.cursor();
                    let mut corners = None;
                    for (z, value) in values.iter_mut().enumerate() {
                        let at = DVec3::new((row / n) as f64, (row % n) as f64, z as f64);
                        if cursor.seek(at) {
                            corners = Some(self.leaf_values(&cursor));
                        }
                        let estimate = corners.as_ref().map(|corners| self.interpolate(corners, &cursor, at));
                        *value = estimate.map_or(0.0, |e| e.uncertainty as f32);
                    }
                });
                values.into()
            }
        };
        let mut layers = self.layers.clone();
        layers.drop_dependent(Change::Vertices);
        let (record, lattice, rays) = (self.record.clone(), self.lattice, RayCounts::default());
        Self { record, lattice, support: Support::Dense, deviations, rays, layers }
    }
}
