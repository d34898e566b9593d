//! Draws from the posterior, where P⁻¹ does not fit into memory.
//!
//! Perturb and MAP (Papandreou and Yuille 2010): if b has the covariance P, then P⁻¹ b has P⁻¹. Such a b is
//! √(N / (R s²)) Jᵀ ε + ε' / τ with independent ε, ε' of mean 0 and variance 1. Random signs will do, because only the
//! covariance is asked for. P is applied through the stored rows, and never formed.

use std::fmt;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::matrix_free::{LinOp, Precond};
use faer::{Mat, MatMut, MatRef, Par};
use glam::{DMat3, DVec3};
use octobayes::posterior::DataScale;
use octobayes::render::{DepthSample, DepthVariance};
use octobayes::{Error, Result};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::rows::{Columns, Rows};
use super::{FullPosterior, Vertices, share_of_a_ray};

/// How to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Draws {
    /// Number of draws n: variances have a relative error of √(2/n).
    pub number: usize,
    /// Seed of the random signs.
    pub seed: u64,
    /// Residual of P θ = b, relative to b, at which conjugate gradients end.
    pub residual: f64,
    /// Most iterations of conjugate gradients.
    pub iterations: usize,
}

/// Draws of all displacements from their posterior.
#[derive(Debug, Clone)]
pub struct DrawnPosterior {
    vertices: Vertices,
    /// `[3 vertices][draws]`, scene units.
    displacements: Vec<f64>,
    draws: usize,
    /// τ, scene units.
    prior_deviation: f64,
    /// Iterations that were needed.
    pub iterations: usize,
}

impl FullPosterior {
    /// Draws displacements, if `rays` rays were drawn in all.
    ///
    /// # Errors
    /// If conjugate gradients do not reach the residual.
    pub fn draw(&self, rays: u64, scale: DataScale, draws: Draws) -> Result<DrawnPosterior> {
        let (n, width) = (3 * self.vertices(), draws.number);
        let (share, prior) = (share_of_a_ray(&scale, rays), scale.prior_deviation.powi(2));
        let columns = self.rows.columns(self.vertices());
        let mut random = ChaCha8Rng::seed_from_u64(draws.seed);
        let mut signs = |n: usize| -> Vec<f64> { (0..n).map(|_| if random.random() { 1.0 } else { -1.0 }).collect() };
        let of_rays = signs(3 * self.rows.rays() * width);
        let mut right = self.rows.transposed_times(&columns, &of_rays, width);
        for (b, sign) in right.iter_mut().zip(signs(n * width)) {
            *b = share.sqrt() * *b + sign / prior.sqrt();
        }
        let inverse = |s: DMat3| (s * share + DMat3::from_diagonal(DVec3::splat(1.0 / prior))).inverse();
        let blocks = Blocks(self.rows.blocks(&columns).into_iter().map(inverse).collect());
        let precision = Precision { rows: &self.rows, columns: &columns, share, prior };
        let b = Mat::from_fn(n, width, |i, d| right[i * width + d]);
        let mut found = Mat::zeros(n, width);
        let mut settings = faer::matrix_free::conjugate_gradient::CgParams::default();
        (settings.rel_tolerance, settings.max_iters) = (draws.residual, draws.iterations);
        let scratch =
            faer::matrix_free::conjugate_gradient::conjugate_gradient_scratch(&blocks, &precision, width, Par::Seq);
        let done = faer::matrix_free::conjugate_gradient::conjugate_gradient(
            found.as_mut(),
            &blocks,
            &precision,
            b.as_ref(),
            settings,
            |_| {},
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
        );
        let done = done.map_err(|e| {
            Error::setting("iterations", format!("as many as reach a residual of {}", draws.residual), format!("{e:?}"))
        })?;
        Ok(DrawnPosterior {
            vertices: self.vertices.clone(),
            displacements: (0..n).flat_map(|i| (0..width).map(move |d| (i, d))).map(|at| found[at]).collect(),
            draws: width,
            prior_deviation: scale.prior_deviation,
            iterations: done.iter_count,
        })
    }
}

impl DrawnPosterior {
    /// σ of the displacement of a lattice point, scene units.
    pub fn deviation(&self, point: [u32; 3]) -> f64 {
        match self.vertices.numbers.get(&point) {
            Some(&v) => {
                let own = &self.displacements[3 * v as usize * self.draws..][..3 * self.draws];
                (own.iter().map(|u| u * u).sum::<f64>() / self.draws as f64).sqrt()
            }
            None => 3_f64.sqrt() * self.prior_deviation,
        }
    }
}

impl DepthVariance for DrawnPosterior {
    /// Mean of (Σ_v g_v · u_v)² over the draws.
    fn variance(&self, samples: &[DepthSample]) -> f64 {
        let (touched, untouched) = self.vertices.gradients(samples);
        let mut moved = vec![0.0; self.draws];
        for (v, g) in touched {
            let own = &self.displacements[3 * v * self.draws..][..3 * self.draws];
            for (u, g) in own.chunks(self.draws).zip(g.to_array()) {
                moved.iter_mut().zip(u).for_each(|(moved, u)| *moved += g * u);
            }
        }
        moved.iter().map(|d| d * d).sum::<f64>() / self.draws as f64 + self.prior_deviation.powi(2) * untouched
    }
}

/// P, applied through the rows of J.
struct Precision<'a> {
    rows: &'a Rows,
    columns: &'a Columns,
    share: f64,
    prior: f64,
}

/// The inverses of the blocks on the diagonal of P: the preconditioner.
struct Blocks(Vec<DMat3>);

impl fmt::Debug for Precision<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "P of {} rays", self.rows.rays())
    }
}

impl fmt::Debug for Blocks {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} blocks", self.0.len())
    }
}

impl LinOp<f64> for Precision<'_> {
    fn apply_scratch(&self, _: usize, _: Par) -> StackReq {
        StackReq::EMPTY
    }

    fn nrows(&self) -> usize {
        self.columns.unknowns()
    }

    fn ncols(&self) -> usize {
        self.columns.unknowns()
    }

    fn apply(&self, mut out: MatMut<f64>, x: MatRef<f64>, _: Par, _: &mut MemStack) {
        let width = x.ncols();
        let mut by_unknown = vec![0.0; x.nrows() * width];
        for d in 0..width {
            for i in 0..x.nrows() {
                by_unknown[i * width + d] = x[(i, d)];
            }
        }
        let product = self.rows.transposed_times(self.columns, &self.rows.times(&by_unknown, width), width);
        for d in 0..width {
            for i in 0..x.nrows() {
                out[(i, d)] = self.share * product[i * width + d] + by_unknown[i * width + d] / self.prior;
            }
        }
    }

    fn conj_apply(&self, out: MatMut<f64>, x: MatRef<f64>, par: Par, stack: &mut MemStack) {
        self.apply(out, x, par, stack);
    }
}

impl LinOp<f64> for Blocks {
    fn apply_scratch(&self, _: usize, _: Par) -> StackReq {
        StackReq::EMPTY
    }

    fn nrows(&self) -> usize {
        3 * self.0.len()
    }

    fn ncols(&self) -> usize {
        3 * self.0.len()
    }

    fn apply(&self, mut out: MatMut<f64>, x: MatRef<f64>, _: Par, _: &mut MemStack) {
        for d in 0..x.ncols() {
            for (v, block) in self.0.iter().enumerate() {
                let y = *block * DVec3::new(x[(3 * v, d)], x[(3 * v + 1, d)], x[(3 * v + 2, d)]);
                (out[(3 * v, d)], out[(3 * v + 1, d)], out[(3 * v + 2, d)]) = (y.x, y.y, y.z);
            }
        }
    }

    fn conj_apply(&self, out: MatMut<f64>, x: MatRef<f64>, par: Par, stack: &mut MemStack) {
        self.apply(out, x, par, stack);
    }
}

impl Precond<f64> for Blocks {}
