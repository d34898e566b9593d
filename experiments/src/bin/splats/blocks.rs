//! What the training rays say of every splat by itself: the Hessian's 3×3 block of its centre, without a deformation
//! field, and the Fisher information of its colour. Baselines, from the same samples as the field's sums.

use glam::{DMat3, DVec3, Vec3};
use octobayes::posterior::{DataScale, Information};
use octobayes::render::{Probed, ProbedField, RaySamples};
use octobayes_splats::Splats;
use rustc_hash::FxHashMap;

use common::fisher::LAMBDA;

/// Finds splats by their centres, as samples know no more of them.
pub struct Index(FxHashMap<[u32; 3], usize>);

impl Index {
    pub fn new(splats: &Splats) -> Self {
        Self(splats.means().iter().enumerate().map(|(i, mean)| (mean.to_array().map(f32::to_bits), i)).collect())
    }

    /// The splat with this centre.
    pub fn of(&self, centre: Vec3) -> usize {
        self.0[&centre.to_array().map(f32::to_bits)]
    }
}

/// Sums over rays, splat by splat.
pub struct Sums {
    index: Index,
    /// `[n]`: Σ GᵀG.
    information: Vec<Information>,
    /// `[n]`: Σ w², the information of each channel of the colour.
    squares: Vec<f64>,
}

/// The posterior that takes every splat for independent of all others.
pub struct Blocks {
    index: Index,
    /// `[n]`: precision of the centre, 1 / scene unit².
    pub precision: Vec<DMat3>,
    /// `[n]`: covariance of the centre, scene units².
    pub covariance: Vec<DMat3>,
    /// `[n]`: Fisher information of the colour in all training pixels, with FisherRF's prior.
    pub fisher: Vec<f64>,
}

impl Sums {
    pub fn new(splats: &Splats) -> Self {
        Self { index: Index::new(splats), information: vec![[0.0; 6]; splats.len()], squares: vec![0.0; splats.len()] }
    }

    /// Adds batches of rays. A ray meets a splat once.
    pub fn add(&mut self, batches: &[RaySamples]) {
        for batch in batches {
            for ((position, jacobian), weight) in batch.positions.iter().zip(&batch.jacobians).zip(&batch.weights) {
                let i = self.index.of(*position);
                let column = |k: usize| DVec3::from([0, 3, 6].map(|row| f64::from(jacobian[row + k])));
                let [x, y, z] = [0, 1, 2].map(column);
                let products = [x.dot(x), x.dot(y), x.dot(z), y.dot(y), y.dot(z), z.dot(z)];
                self.information[i].iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                self.squares[i] += f64::from(*weight).powi(2);
            }
        }
    }

    /// The posterior after `rays` rays.
    pub fn blocks(self, scale: &DataScale, rays: u64) -> Blocks {
        let precision = |sums: &Information| {
            let [xx, xy, xz, yy, yz, zz] = scale.precision(sums, rays);
            DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
        };
        let precision: Vec<DMat3> = self.information.iter().map(precision).collect();
        let share = scale.pixels as f64 / rays as f64;
        Blocks {
            index: self.index,
            covariance: precision.iter().map(DMat3::inverse).collect(),
            precision,
            fisher: self.squares.iter().map(|squares| share * squares + LAMBDA).collect(),
        }
    }
}

/// Trace of a matrix.
pub fn trace(m: &DMat3) -> f64 {
    (0..3).map(|k| m.col(k)[k]).sum()
}

impl ProbedField for Blocks {
    /// log10 U of the splats at some centres.
    fn at(&self, points: &[Vec3]) -> Vec<Probed> {
        let of = |x: &Vec3| 0.5 * trace(&self.covariance[self.index.of(*x)]).log10();
        points.iter().map(|x| Probed { value: of(x), rays: f64::NAN }).collect()
    }
}
