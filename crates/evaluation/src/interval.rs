//! Split conformal prediction on evaluated views.

use super::{EvaluatedView, Evaluator, Measure};
use crate::metrics::{conformal_factor, normal};
use octobayes::uncertainty::Conformal;

/// An interval of depth, calibrated on some views.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Interval {
    /// The interval.
    pub conformal: Conformal,
    /// Half width without calibration, if errors are normal, in deviations.
    #[serde(rename = "predicted_factor")]
    pub predicted: f64,
    /// Share of a view's errors inside the interval that all other views give: smallest, median and largest over the
    /// views. NaN if there is one view only.
    #[serde(rename = "views_left_out")]
    pub left_out: [f64; 3],
}

impl Interval {
    /// Calibrates the deviation of depth by the first field that has one, without training images.
    ///
    /// `None` if there is none, or if the pixels are too few for this probability.
    #[must_use]
    pub fn calibrate(evaluator: &Evaluator, views: &[EvaluatedView], probability: f64) -> Option<Self> {
        let m = evaluator.measures().iter().position(|measure| matches!(measure, Measure::DepthDeviation(_)))?;
        // An infinite deviation holds every error.
        let ratio = |(e, s): (&f64, &f64)| e / s;
        let of_view = |view: &EvaluatedView| -> Vec<f64> {
            view.absolute_error.iter().zip(&view.measures[m]).map(ratio).collect()
        };
        Self::of_ratios(&views.iter().map(of_view).collect::<Vec<_>>(), probability)
    }

    /// From the ratios of error and deviation of each view.
    fn of_ratios(of_views: &[Vec<f64>], probability: f64) -> Option<Self> {
        let ratios: Vec<&Vec<f64>> = of_views.iter().filter(|ratios| !ratios.is_empty()).collect();
        let all: Vec<f64> = ratios.iter().copied().flatten().copied().collect();
        let conformal = Conformal {
            probability,
            factor: conformal_factor(&all, probability)?,
            pixels: all.len() as u64,
            views: ratios.len() as u64,
        };
        let mut shares: Vec<f64> = (0..ratios.len())
            .filter_map(|left_out| {
                let others: Vec<f64> =
                    (0..ratios.len()).filter(|&i| i != left_out).flat_map(|i| ratios[i]).copied().collect();
                let factor = conformal_factor(&others, probability)?;
                let own = ratios[left_out];
                Some(own.iter().filter(|z| **z <= factor).count() as f64 / own.len() as f64)
            })
            .collect();
        shares.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| octobayes::metrics::quantile(&shares, share);
        let predicted = normal::deviations(probability);
        Some(Self { conformal, predicted, left_out: [at(0.0), at(0.5), at(1.0)] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_left_out_of_the_interval_that_it_is_judged_by() {
        // All ratios of the second view are larger than those of the first: neither view's interval is the other's.
        let views = [(1..100).map(f64::from).collect(), Vec::new(), (101..200).map(f64::from).collect()];
        let found = Interval::of_ratios(&views, 0.8).unwrap();
        assert_eq!((found.conformal.views, found.conformal.pixels), (2, 198));
        assert_eq!([found.left_out[0], found.left_out[2]], [0.0, 1.0]);
        // ⌈(198 + 1) 0.8⌉ = 160 of all ratios: the 61st of the second view.
        assert_eq!(found.conformal.factor, 161.0);
    }
}
