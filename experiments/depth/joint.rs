//! One variance for displacements and misfit: σ² = a² Var + s² + (c · misfit)², with constants of other scenes.

use octobayes::metrics::{Calibration, ErrorDensity};

use crate::judge::{Kept, Row};

/// Values of a² that are tried.
const FACTORS: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 7.0, 10.0];
/// Values of c that are tried, scene units for a residual of one.
const LENGTHS: [f64; 9] = [0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15];

/// Constants of the joint variance.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Joint {
    /// a².
    pub factor: f64,
    /// c, scene units.
    pub length: f64,
}

impl Joint {
    fn deviation(self, pixel: &Kept) -> f64 {
        let [posterior, weights, misfit] = [pixel.posterior, pixel.weights, pixel.misfit].map(f64::from);
        (self.factor * posterior + weights + (self.length * misfit).powi(2)).sqrt()
    }

    /// How well the kept pixels of a model are calibrated by these constants.
    pub fn calibration(self, row: &Row) -> Calibration {
        let errors: Vec<f64> = row.kept.iter().map(|pixel| f64::from(pixel.error)).collect();
        let deviations: Vec<f64> = row.kept.iter().map(|pixel| self.deviation(pixel)).collect();
        Calibration::new(&errors, &deviations).expect("finite deviations above zero")
    }

    fn nll(self, row: &Row) -> f64 {
        self.calibration(row).of(ErrorDensity::PREDICTIVE).nll
    }
}

/// The constants of least mean negative log likelihood over some models.
pub fn fit(rows: &[&Row]) -> Joint {
    let all = FACTORS.into_iter().flat_map(|factor| LENGTHS.into_iter().map(move |length| Joint { factor, length }));
    let scored = all.map(|joint| (joint, rows.iter().map(|row| joint.nll(row)).sum::<f64>()));
    scored.min_by(|a, b| a.1.total_cmp(&b.1)).expect("constants to try").0
}
