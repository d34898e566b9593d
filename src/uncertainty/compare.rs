//! Measures the difference between two fields.

use glam::{DVec3, Vec3};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::{Support, UncertaintyField};
use crate::metrics::quantile;
use crate::octree::OctreeStats;
use crate::{Error, Result};

/// Size and structure of a field.
#[derive(Debug, Clone, serde::Serialize)]
#[non_exhaustive]
pub struct Summary {
    /// `dense` or `octree`.
    pub grid: &'static str,
    /// Finest level.
    pub level: u8,
    /// Number of vertices that carry values.
    pub vertices: u64,
    /// Bytes needed for queries: the structure, deviation and ray count of every vertex.
    pub query_bytes: usize,
    /// Bytes of the structure alone.
    pub structure_bytes: usize,
    /// Number of leaves by level; empty for a dense grid.
    pub leaves_per_level: Vec<u64>,
}

/// |Δ log10 U| over a set of points.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Difference {
    /// Number of points compared.
    pub points: usize,
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub percentile_95: f64,
    /// 99th percentile.
    pub percentile_99: f64,
    /// Maximum.
    pub max: f64,
    /// Scene position of the maximum.
    pub max_at: [f32; 3],
    /// log10 U of the two fields there.
    pub log10_at_max: [f64; 2],
}

impl Comparison {
    /// Default number of random points.
    pub const POINTS: usize = 1_000_000;
}

/// The comparison of two fields.
#[derive(Debug, Clone, serde::Serialize)]
#[non_exhaustive]
pub struct Comparison {
    /// The fields.
    pub fields: [Summary; 2],
    /// Over points drawn uniformly from the cube that the domain is mapped to; `None` if no points were requested.
    pub in_box: Option<Difference>,
    /// Over points on visible surfaces (ray samples of weight ≥ 0.05), if one of the fields has any.
    pub on_surfaces: Option<Difference>,
}

impl UncertaintyField {
    /// Size and structure of the field.
    #[must_use]
    pub fn summary(&self) -> Summary {
        let (grid, leaves_per_level) = match &self.support {
            Support::Dense => ("dense", Vec::new()),
            Support::Octree(octree) => ("octree", octree.cells().leaves_per_level()),
        };
        Summary {
            grid,
            level: self.lattice.level(),
            vertices: self.deviations.len() as u64,
            query_bytes: self.query_memory(),
            structure_bytes: self.structure_memory(),
            leaves_per_level,
        }
    }

    /// Validates the octree; `None` for a dense grid.
    ///
    /// # Errors
    /// The first defect.
    #[doc(hidden)]
    pub fn validate(&self) -> std::result::Result<Option<OctreeStats>, crate::octree::Defect> {
        match &self.support {
            Support::Dense => Ok(None),
            Support::Octree(octree) => octree.validate().map(Some),
        }
    }
}

/// Most points of a comparison; they and the values of both fields there take some 10 GB.
const MAX_POINTS: usize = 100_000_000;

/// Compares `a` with the reference `b`.
///
/// log10 U is compared at `points` random points, uniform in the lattice's cube (drawn with `seed`), and at no
/// more than that many surface points. The latter are the reference's if it has any; those of a field of external
/// samples lie where its rays went, and there it would look better than it is.
///
/// # Errors
/// If the fields have different domains, or there are more than 100 million points.
pub fn compare(a: &UncertaintyField, b: &UncertaintyField, points: usize, seed: u64) -> Result<Comparison> {
    if points > MAX_POINTS {
        return Err(Error::setting("points", format!("at most {MAX_POINTS}"), points.to_string()));
    }
    let domain = a.lattice().domain();
    if domain != b.lattice().domain() {
        let text = |f: &UncertaintyField| f.lattice().domain().to_string();
        return Err(Error::setting("the fields' boxes", format!("the same box or contraction, {}", text(a)), text(b)));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || domain.clamp(domain.to_scene(DVec3::from(rng.random::<[f64; 3]>())).as_vec3());
    let in_box: Vec<Vec3> = (0..points).map(|_| draw()).collect();
    let surface = if b.surface().is_empty() { a.surface() } else { b.surface() };
    let surface: Vec<Vec3> = surface.iter().take(points).map(|&x| Vec3::from_array(x)).collect();
    Ok(Comparison {
        fields: [a.summary(), b.summary()],
        in_box: difference(a, b, &in_box),
        on_surfaces: difference(a, b, &surface),
    })
}

/// The difference over `points`; `None` without points.
fn difference(a: &UncertaintyField, b: &UncertaintyField, points: &[Vec3]) -> Option<Difference> {
    let log10 = |field: &UncertaintyField| -> Vec<f64> {
        field.query_all(points).iter().map(|found| found.uncertainty.log10()).collect()
    };
    let (of_a, of_b) = (log10(a), log10(b));
    let mut differences: Vec<f64> = of_a.iter().zip(&of_b).map(|(a, b)| (a - b).abs()).collect();
    let at = (0..points.len()).max_by(|&i, &j| differences[i].total_cmp(&differences[j]))?;
    let max = differences[at];
    let mean = differences.iter().sum::<f64>() / points.len() as f64;
    differences.par_sort_unstable_by(f64::total_cmp);
    Some(Difference {
        points: points.len(),
        mean,
        percentile_95: quantile(&differences, 0.95),
        percentile_99: quantile(&differences, 0.99),
        max,
        max_at: points[at].to_array(),
        log10_at_max: [of_a[at], of_b[at]],
    })
}
