//! One variance for displacements and residuals: σ² = a² Var + s² + (c · residuals)², with constants of other scenes.

use octobayes_evaluation::metrics::{Calibration, ErrorDensity, ErrorKind, sparsification};

use crate::judge::{Kept, Row};

/// Values of a² that are tried.
const FACTORS: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 7.0, 10.0];
/// Values of c that are tried, scene units for a residual of one.
const LENGTHS: [f64; 10] = [0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0];

/// Constants of the joint variance.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Joint {
    /// a².
    pub factor: f64,
    /// c, scene units.
    pub length: f64,
}

impl Joint {
    fn variance(self, pixel: &Kept) -> f64 {
        let [posterior, weights, residuals] = [pixel.posterior, pixel.weights, pixel.residuals].map(f64::from);
        self.factor * posterior + weights + (self.length * residuals).powi(2)
    }

    /// How well the kept pixels of a model are calibrated by these constants. `truth` is the variance of the depth maps
    /// themselves, squared scene units.
    pub fn calibration(self, row: &Row, truth: f64) -> Calibration {
        let errors: Vec<f64> = row.kept.iter().map(|pixel| f64::from(pixel.error)).collect();
        let deviations: Vec<f64> = row.kept.iter().map(|pixel| (self.variance(pixel) + truth).sqrt()).collect();
        Calibration::new(&errors, &deviations).expect("finite deviations above zero")
    }

    /// AUSE of the deviation over the kept pixels of a model, by mean absolute and by root mean square error.
    pub fn ranking(self, row: &Row) -> [f64; 2] {
        let errors: Vec<f64> = row.kept.iter().map(|pixel| f64::from(pixel.error)).collect();
        let variances: Vec<f64> = row.kept.iter().map(|pixel| self.variance(pixel)).collect();
        let area = |kind| sparsification(&variances, &errors, kind).map_or(f64::NAN, |found| found.area);
        [ErrorKind::Mae, ErrorKind::Rmse].map(area)
    }

    /// All constants that are tried.
    fn all() -> impl Iterator<Item = Self> {
        FACTORS.into_iter().flat_map(|factor| LENGTHS.into_iter().map(move |length| Self { factor, length }))
    }
}

/// The mean negative log likelihood of a model's errors, by all constants.
pub struct Fit(Vec<f64>);

impl Fit {
    pub fn new(row: &Row) -> Self {
        Self(Joint::all().map(|joint| joint.calibration(row, 0.0).of(ErrorDensity::PREDICTIVE).nll).collect())
    }

    /// The constants of least mean over some models.
    pub fn best<'a>(fits: impl Iterator<Item = &'a Self>) -> Joint {
        let mut sums = vec![0.0; FACTORS.len() * LENGTHS.len()];
        fits.for_each(|fit| sums.iter_mut().zip(&fit.0).for_each(|(sum, nll)| *sum += nll));
        let scored = Joint::all().zip(sums);
        scored.min_by(|a, b| a.1.total_cmp(&b.1)).expect("constants to try").0
    }
}
