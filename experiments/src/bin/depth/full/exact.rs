//! P⁻¹ as a whole matrix, by Cholesky's factors.
//!
//! A ray touches many vertices, and shares most of them with other rays: at the coarse levels at which the inverse fits
//! into memory JᵀJ is nearly full, and factors for sparse matrices gain nothing.

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use glam::DVec3;
use octobayes::posterior::DataScale;
use octobayes::render::{DepthSample, DepthVariance};
use octobayes::{Error, Result};

use super::{FullPosterior, Vertices, share_of_a_ray};

/// The covariance of all displacements, scene units squared.
#[derive(Debug, Clone)]
pub struct ExactPosterior {
    vertices: Vertices,
    /// `[3 vertices][3 vertices]`.
    covariance: Mat<f64>,
    /// τ².
    prior: f64,
}

impl FullPosterior {
    /// Most vertices of [`FullPosterior::exact`]: P and its inverse take 9 GB.
    pub const MOST_VERTICES: usize = 8000;

    /// The covariance of all displacements, if `rays` rays were drawn in all.
    ///
    /// # Errors
    /// If there are more vertices than [`FullPosterior::MOST_VERTICES`], or if P is not positive definite, which only a
    /// prior deviation beyond all measure can cause.
    pub fn exact(&self, rays: u64, scale: DataScale) -> Result<ExactPosterior> {
        let vertices = self.vertices();
        if vertices > Self::MOST_VERTICES {
            let expected = format!("a coarser level, with at most {} vertices", Self::MOST_VERTICES);
            return Err(Error::setting("level", expected, format!("one with {vertices}")));
        }
        let n = 3 * vertices;
        let mut precision = Mat::<f64>::zeros(n, n);
        let share = share_of_a_ray(&scale, rays);
        let mut row = Vec::new();
        for ray in 0..self.rows.rays() {
            for channel in 0..3 {
                row.clear();
                for (vertex, jacobian) in self.rows.ray(ray) {
                    row.extend((0..3).map(|axis| (3 * vertex + axis, f64::from(jacobian[3 * channel + axis]))));
                }
                for &(column, a) in &row {
                    let into = precision.col_as_slice_mut(column);
                    // The lower half is all that is read.
                    for &(line, b) in row.iter().filter(|(line, _)| *line >= column) {
                        into[line] += share * a * b;
                    }
                }
            }
        }
        let prior = scale.prior_deviation.powi(2);
        for i in 0..n {
            precision[(i, i)] += 1.0 / prior;
        }
        let factors = precision.llt(Side::Lower).map_err(|_| {
            Error::setting("prior deviation", "one that keeps P positive definite", format!("{}", prior.sqrt()))
        })?;
        drop(precision);
        Ok(ExactPosterior { vertices: self.vertices.clone(), covariance: factors.inverse(), prior })
    }
}

impl ExactPosterior {
    /// Covariance of the displacements of two lattice points, row by row, scene units squared.
    pub fn covariance(&self, a: [u32; 3], b: [u32; 3]) -> [[f64; 3]; 3] {
        let number = |point| self.vertices.numbers.get(&point).map(|&v| 3 * v as usize);
        match (number(a), number(b)) {
            (Some(i), Some(j)) => [0, 1, 2].map(|x| [0, 1, 2].map(|y| self.covariance[(i + x, j + y)])),
            _ if a == b => [0, 1, 2].map(|x| [0, 1, 2].map(|y| if x == y { self.prior } else { 0.0 })),
            _ => [[0.0; 3]; 3],
        }
    }

    /// σ of the displacement of a lattice point, scene units.
    pub fn deviation(&self, point: [u32; 3]) -> f64 {
        let own = self.covariance(point, point);
        (own[0][0] + own[1][1] + own[2][2]).sqrt()
    }
}

impl DepthVariance for ExactPosterior {
    /// Σ_uv g_uᵀ C_uv g_v.
    fn variance(&self, samples: &[DepthSample]) -> f64 {
        let (touched, untouched) = self.vertices.gradients(samples);
        let of_pair = |&(u, g): &(usize, DVec3), &(v, h): &(usize, DVec3)| -> f64 {
            let column = |axis: usize| {
                let c = self.covariance.col_as_slice(3 * v + axis);
                g.dot(DVec3::new(c[3 * u], c[3 * u + 1], c[3 * u + 2]))
            };
            h.dot(DVec3::new(column(0), column(1), column(2)))
        };
        let whole: f64 = touched.iter().flat_map(|a| touched.iter().map(move |b| of_pair(a, b))).sum();
        // Rounding could leave less than nothing.
        whole.max(0.0) + self.prior * untouched
    }
}
