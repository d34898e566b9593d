//! An octree's values on the dense grid, for tools without octrees and for comparing queries.

use glam::DVec3;
use rayon::prelude::*;

use super::{RayCounts, StandardDeviations, Support, UncertaintyField};

impl UncertaintyField {
    /// The same U at every vertex of the finest lattice: 4 (M + 1)³ bytes. Sums, error bars and correlations go, and a
    /// calibrated interval, which was of other deviations. Coarser levels stay octrees.
    #[must_use]
    pub fn on_dense_grid(&self) -> Self {
        let n = self.lattice.cells_per_axis() as usize + 1;
        let mut values = vec![0.0_f32; n * n * n];
        values.par_chunks_mut(n * n).enumerate().for_each(|(x, slab)| {
            for (y, row) in slab.chunks_mut(n).enumerate() {
                let at = |z: usize| DVec3::new(x as f64, y as f64, z as f64);
                match &self.support {
                    Support::Dense => {
                        (0..n).zip(row).for_each(|(z, value)| *value = self.query_dense(at(z)).uncertainty as f32);
                    }
                    Support::Octree(octree) => {
                        let mut cursor = octree.cursor();
                        let mut corners = None;
                        for (z, value) in row.iter_mut().enumerate() {
                            if cursor.seek(at(z)) {
                                corners = Some(self.leaf_values(&cursor));
                            }
                            let estimate = corners.as_ref().map(|corners| self.interpolate(corners, &cursor, at(z)));
                            *value = estimate.map_or(0.0, |e| e.uncertainty as f32);
                        }
                    }
                }
            }
        });
        Self {
            protocol: self.protocol.clone(),
            lattice: self.lattice,
            support: Support::Dense,
            limits: self.limits.clone(),
            deviations: StandardDeviations(values),
            rays: RayCounts::default(),
            sums: None,
            error_bars: None,
            surface: self.surface.clone(),
            visits: self.visits.clone(),
            draws: self.draws.clone(),
            correlations: None,
            misfit: self.misfit.clone(),
            coarser: self.coarser.iter().map(|field| field.clone().without_sums()).collect(),
            conformal: None,
            tile: self.tile,
        }
    }
}
