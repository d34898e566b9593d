//! The precision of every displacement, and what the rays of one more view would add to it.
//!
//! P_v = k S_v + I / τ² is the inverse of the posterior's covariance in the scale of the data
//! ([`DataScale`]). S_v is read as U is: on leaves that were kept coarser it is divided by their volume. Rays of
//! another view are summed on the same leaves, by the same posterior, so that hanging corners pass on their part of J;
//! then ΔP_v = m / s² ΔS_v, where each ray stands for m pixels.

use super::{Support, UncertaintyField};
use crate::octree::{MaxLevels, VertexId, morton};
use crate::posterior::{DataScale, Information, LocalSums, OctreePosterior, Scale, VertexSums, comparable, trace};
use crate::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// The precision P_v of the displacements of all vertices.
pub struct Precision<'a> {
    field: &'a UncertaintyField,
    sums: LocalSums<'a>,
    /// Of the leaves on which rays were summed.
    limits: MaxLevels,
    data: DataScale,
}

/// What some rays add to the precision of one vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Added {
    /// Morton code of the vertex's lattice point.
    pub code: u64,
    /// The vertex in the field, if it has one there.
    vertex: Option<u32>,
    /// Number of these rays that met it.
    pub rays: u32,
    /// ΔP, 1 / scene unit²: xx, xy, xz, yy, yz, zz.
    pub precision: Information,
}

impl UncertaintyField {
    /// The precision of all displacements.
    ///
    /// # Errors
    /// If the field is in the paper's scale, keeps no sums, or is a part of a run.
    #[doc(hidden)]
    pub fn precision(&self) -> Result<Precision<'_>> {
        let Scale::Data(data) = self.record.scale else {
            let expected =
                "a field computed with it, which counts information in pixels (`uncertainty --for next-view`)";
            return Err(Error::setting("scale", expected, "one in the paper's scale"));
        };
        if self.is_part() {
            let expected = "a whole run, whose parts `merge` joins";
            return Err(Error::setting("field", expected, "a part of one"));
        }
        let Some(sums) = self.local_sums(&self.record.reading().unpooled()) else {
            let expected = "a field that keeps its sums, to which the rays of a view can be added (`uncertainty --for \
                            next-view`)";
            return Err(Error::setting("kept sums", expected, "one that keeps deviations only"));
        };
        Ok(Precision { field: self, sums, limits: self.limits(), data })
    }
}

impl Precision<'_> {
    /// Sums without rays, on the leaves of the field's own.
    #[must_use]
    pub fn sums(&self) -> OctreePosterior {
        OctreePosterior::limited(self.field.lattice, self.limits.clone())
    }

    /// Where the vertex lies that rays add to, scene units.
    #[must_use]
    pub fn position(&self, added: &Added) -> DVec3 {
        self.field.lattice.position(DVec3::from(morton::decode(added.code).map(f64::from)))
    }

    /// What rays of a view add, by Morton code, if each stands for `pixels` pixels.
    #[must_use]
    pub fn added(&self, rays: &OctreePosterior, pixels: f64) -> Vec<Added> {
        let touched = rays.touched().filter(|(_, sums)| trace(&sums.information) > 0.0);
        let mut added: Vec<Added> = touched.map(|(point, sums)| self.added_at(point, *sums, pixels)).collect();
        added.par_sort_unstable_by_key(|added| added.code);
        added
    }

    /// What rays add at a lattice point, where their sums are `sums`.
    #[must_use]
    pub fn added_at(&self, point: [u32; 3], sums: VertexSums, pixels: f64) -> Added {
        let weight = pixels / (self.data.noise * self.data.noise);
        let vertex = match &self.field.support {
            Support::Dense => Some(self.field.lattice.dense_index(point) as u32),
            Support::Octree(octree) => octree.vertex(point).map(|VertexId(v)| v),
        };
        let rays = sums.rays;
        let precision = comparable(&self.limits, point, sums).information.map(|s| weight * s);
        Added { code: morton::encode(point), vertex, rays, precision }
    }

    /// P of the vertex that rays add to, before they do. Where an octree has no vertex, it is the prior's.
    #[must_use]
    pub fn before(&self, added: &Added) -> Information {
        let sums = added.vertex.map_or_else(VertexSums::default, |v| self.sums.at(v as usize));
        self.data.precision(&sums.information, self.field.record.rays)
    }
}
