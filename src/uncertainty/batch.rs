//! Queries at many points at once.
//!
//! The path to a leaf of an octree is long, but neighbouring points share most of it. Points are therefore
//! looked up along the Z-curve, tile by tile. Points in one leaf share its corners, and points in neighbouring
//! leaves share what is in the caches.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{Estimate, Support, UncertaintyField};
use crate::octree::{Corner, Cursor, Octree, VertexId, morton};

/// Maximal number of points sorted together: enough that even leaves at surfaces contain several of them, and few
/// enough that the sorted order stays in a cache.
const TILE: usize = 1 << 18;
/// Fewer points than this are answered one by one: sorting them and waking threads would take longer.
const MIN_SORTED_POINTS: usize = 64;

/// Values at the corners of a leaf.
pub(super) struct LeafValues {
    pub(super) deviations: [f64; 8],
    /// Errors of log10 σ; `None` inside where unknown.
    errors: Option<[Option<f64>; 8]>,
    pub(super) rays: Option<[f64; 8]>,
}

impl UncertaintyField {
    /// Estimates at many points, in parallel: the same as those of [`UncertaintyField::query`], several times faster.
    #[must_use]
    pub fn query_all(&self, points: &[Vec3]) -> Vec<Estimate> {
        match &self.support {
            _ if points.len() < MIN_SORTED_POINTS => points.iter().map(|&x| self.query(x)).collect(),
            Support::Dense => points.par_iter().with_min_len(1024).map(|&x| self.query(x)).collect(),
            Support::Octree(octree) => {
                // By all threads: the first touch of so much memory takes its time.
                let mut estimates: Vec<_> = rayon::iter::repeat_n(self.outside(), points.len()).collect();
                // Even a few points are distributed over the threads.
                let tile = points.len().div_ceil(rayon::current_num_threads()).clamp(1, TILE);
                let tiles = points.par_chunks(tile).zip(estimates.par_chunks_mut(tile));
                tiles.for_each(|(points, estimates)| self.query_tile(octree, points, estimates));
                estimates
            }
        }
    }

    /// Overwrites the estimates of the points inside the box.
    fn query_tile(&self, octree: &Octree, points: &[Vec3], estimates: &mut [Estimate]) {
        // The first 32 bits of the path to the finest cell, then the point's index. Integers sort faster than structs.
        let level = u32::from(self.lattice.level());
        let place = |code: u64| (code << (63 - 3 * level)) >> 31 << 32;
        let inside = (0_u64..).zip(points).filter_map(|(i, &x)| {
            let u = self.lattice.coordinates(x)?;
            Some(place(morton::encode(self.lattice.cell(u).0)) | i)
        });
        let mut order: Vec<u64> = inside.collect();
        order.sort_unstable();
        let mut cursor = octree.cursor();
        let mut values = LeafValues { deviations: [0.0; 8], errors: None, rays: None };
        for i in order.into_iter().map(|key| key as u32 as usize) {
            let Some(u) = self.lattice.coordinates(points[i]) else { continue };
            if cursor.seek(u) {
                values = self.leaf_values(&cursor);
            }
            estimates[i] = self.interpolate(&values, &cursor, u);
        }
    }

    /// The values at the corners of the cursor's leaf.
    pub(super) fn leaf_values(&self, cursor: &Cursor) -> LeafValues {
        self.corner_values(cursor.corners().each_ref().map(Corner::masters))
    }

    /// The values at corners. The value of a corner is the mean over its vertices.
    pub(super) fn corner_values(&self, corners: [&[VertexId]; 8]) -> LeafValues {
        let covariance = self.record.covariance;
        let deviation = |&VertexId(v): &VertexId| self.deviations.get(v as usize);
        let deviations = corners.map(|masters| match masters {
            [vertex] => deviation(vertex),
            masters => covariance.mean(masters.iter().map(deviation)),
        });
        let errors = self.error_bars().map(|errors| {
            corners.map(|masters| match masters {
                [VertexId(v)] => errors.get(*v as usize),
                masters => {
                    let each = |vertex: &VertexId| (errors.get(vertex.0 as usize), deviation(vertex), 1.0);
                    covariance.joined_error(masters.iter().map(each))
                }
            })
        });
        let rays = (!self.rays.is_empty()).then(|| {
            let of_vertex = |&VertexId(v): &VertexId| self.rays.get(v as usize) as f64;
            corners.map(|masters| masters.iter().map(of_vertex).sum::<f64>() / masters.len() as f64)
        });
        LeafValues { deviations, errors, rays }
    }

    /// The estimate at lattice coordinates `u` in the cursor's leaf, whose values are given.
    pub(super) fn interpolate(&self, values: &LeafValues, cursor: &Cursor, u: DVec3) -> Estimate {
        self.interpolated_at(values, &cursor.weights(u), cursor.leaf().level)
    }

    /// The estimate in a leaf, from the values and the weights of its corners.
    pub(super) fn interpolated_at(&self, values: &LeafValues, weights: &[f64; 8], level: u8) -> Estimate {
        let rays = values.rays.map(|rays| rays.iter().zip(weights).map(|(rays, w)| w * rays).sum());
        let covariance = self.record.covariance;
        let uncertainty = covariance.interpolate(&values.deviations, weights);
        let errors = values.errors.as_ref();
        let log10_error = errors.and_then(|errors| covariance.interpolate_errors(errors, &values.deviations, weights));
        Estimate { uncertainty, log10_error, rays, level, inside: true }
    }

    /// The estimate outside the box, which is the prior.
    pub(super) fn outside(&self) -> Estimate {
        Estimate { uncertainty: self.prior(), log10_error: None, rays: None, level: 0, inside: false }
    }
}
