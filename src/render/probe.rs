//! Scalars of space, averaged along the rays of an image.

use glam::Vec3;

use super::RayAverage;
use super::ray_average::Asked;

/// Number of rays assumed where no ray supports U: less than one, but not zero, so that the score is finite.
pub const MIN_SUPPORTING_RAYS: f64 = 0.5;

/// The value of a [`ProbedField`] at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probed {
    /// The scalar there.
    pub value: f64,
    /// Number of training rays around it, for [`RayAverage::USpreadPerRootRay`]; NaN if unknown.
    pub rays: f64,
}

/// A scalar function of space; usually log10 U at a scene point.
pub trait ProbedField: Sync {
    /// The scalar at points.
    fn at(&self, points: &[Vec3]) -> Vec<Probed>;
}

/// A scalar function of space, averaged along rays beside the colour.
#[derive(Clone, Copy)]
pub struct Probe<'a> {
    /// The function.
    pub field: &'a dyn ProbedField,
    /// Ray averages to compute: each gives one number per pixel.
    pub averages: &'a [RayAverage],
}

/// `[ray averages of the probe][rays]`. The probe's field is queried for all rays at once.
pub fn averages(rays: &[WeightedRay], probe: &Probe) -> Vec<Vec<f64>> {
    let needs = |asked| probe.averages.iter().any(|average| average.asks() == asked);
    let at_samples = match needs(Asked::Samples) {
        true => probe.field.at(&rays.iter().flat_map(WeightedRay::hit).map(|(_, x)| x).collect::<Vec<Vec3>>()),
        false => Vec::new(),
    };
    let at_expected = match needs(Asked::Expected) {
        true => probe.field.at(&rays.iter().map(|ray| ray.at_expected).collect::<Vec<Vec3>>()),
        false => Vec::new(),
    };
    let mut out = vec![Vec::with_capacity(rays.len()); probe.averages.len()];
    let mut rest = &at_samples[..];
    for (r, ray) in rays.iter().enumerate() {
        let (of_ray, others) = if rest.is_empty() { (rest, rest) } else { rest.split_at(ray.hit().count()) };
        rest = others;
        for (&average, out) in probe.averages.iter().zip(&mut out) {
            out.push(ray.average(average, of_ray, at_expected.get(r).copied().unwrap_or(UNASKED)));
        }
    }
    out
}

/// Of a point that no ray average needs.
const UNASKED: Probed = Probed { value: f64::NAN, rays: f64::NAN };

/// A ray along which scalars are averaged.
pub struct WeightedRay<'a> {
    /// Of its samples.
    pub weights: &'a [f64],
    pub positions: &'a [Vec3],
    pub at_expected: Vec3,
    pub spread: f64,
}

impl WeightedRay<'_> {
    /// Weights and positions of the samples that count.
    fn hit(&self) -> impl Iterator<Item = (f64, Vec3)> + '_ {
        self.weights.iter().copied().zip(self.positions.iter().copied()).filter(|(w, _)| *w > 0.0)
    }

    /// Computes a ray average from the values at the samples that count and at the expected depth.
    fn average(&self, average: RayAverage, at_samples: &[Probed], at_expected: Probed) -> f64 {
        let total: f64 = self.weights.iter().sum();
        let sum: f64 = self.hit().zip(at_samples).map(|((w, _), at)| w * at.value).sum();
        match average {
            _ if total <= 0.0 => f64::NAN,
            RayAverage::WeightedMean => sum / total,
            RayAverage::USpread => at_expected.value + self.spread.log10(),
            RayAverage::USpreadPerRootRay => {
                let rays = at_expected.rays.clamp(MIN_SUPPORTING_RAYS, f64::INFINITY);
                at_expected.value + self.spread.log10() - 0.5 * rays.log10()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use super::*;

    #[test]
    fn blends_of_two_samples() {
        // U = 1 with weight 0.3, U = 100 with weight 0.1, one sample without weight.
        let (weights, positions) = (&[0.3, 0.0, 0.1], &[Vec3::X, Vec3::Y, Vec3::Z]);
        let ray = WeightedRay { weights, positions, at_expected: Vec3::X, spread: 0.1 };
        let probed = |value| Probed { value, rays: 100.0 };
        let average = |average, at_expected| ray.average(average, &[probed(0.0), probed(2.0)], at_expected);
        let expected = [
            (RayAverage::WeightedMean, 0.2 / 0.4),
            (RayAverage::USpread, 1.5 - 1.0),
            (RayAverage::USpreadPerRootRay, 1.5 - 1.0 - 1.0),
        ];
        for (name, expected) in expected {
            let found = average(name, probed(1.5));
            assert!((found - expected).abs() < 1e-12, "{name:?}: {found} instead of {expected}");
        }
        assert_eq!(expected.map(|(name, _)| name), RayAverage::ALL);
        let unseen = average(RayAverage::USpreadPerRootRay, Probed { value: 1.5, rays: 0.0 });
        assert!((unseen - 0.5 - 0.5 * 2_f64.log10()).abs() < 1e-12, "{unseen}");
        assert!(average(RayAverage::USpreadPerRootRay, Probed { value: 1.5, rays: f64::NAN }).is_nan());
        assert_eq!(ray.hit().collect::<Vec<_>>(), [(0.3, Vec3::X), (0.1, Vec3::Z)]);
    }

    #[test]
    fn a_ray_that_meets_nothing_has_no_value() {
        let (weights, positions) = (&[0.0], &[Vec3::X]);
        let ray = WeightedRay { weights, positions, at_expected: Vec3::ZERO, spread: 0.1 };
        for average in RayAverage::ALL {
            assert!(ray.average(average, &[], Probed { value: 5.0, rays: 5.0 }).is_nan(), "{average:?}");
        }
    }

    /// The scalar x, and the number of queries.
    #[derive(Default)]
    struct Counting(std::sync::Mutex<Vec<usize>>);

    impl ProbedField for Counting {
        fn at(&self, points: &[Vec3]) -> Vec<Probed> {
            self.0.lock().unwrap().push(points.len());
            points.iter().map(|x| Probed { value: f64::from(x.x), rays: 1.0 }).collect()
        }
    }

    #[test]
    fn all_rays_are_asked_about_at_once_and_get_their_own_answers() {
        let positions = [1.0, 2.0, 3.0, 4.0, 5.0].map(|x| Vec3::X * x);
        let weights = [0.5, 0.0, 0.25, 0.75, 0.0];
        let ray = |samples: Range<usize>, x| WeightedRay {
            weights: &weights[samples.clone()],
            positions: &positions[samples],
            at_expected: Vec3::X * x,
            spread: 1.0,
        };
        let rays = [ray(0..2, 7.0), ray(2..2, 0.0), ray(2..4, 8.0), ray(4..5, 0.0)];
        let field = Counting::default();
        let kinds = [RayAverage::WeightedMean, RayAverage::USpread];
        let found = averages(&rays, &Probe { field: &field, averages: &kinds });
        let known = |values: &[f64]| [values[0], values[2]];
        assert_eq!(found.iter().map(|values| known(values)).collect::<Vec<_>>(), [[1.0, 3.75], [7.0, 8.0]]);
        assert!(found.iter().all(|values| values[1].is_nan() && values[3].is_nan()), "{found:?}");
        assert_eq!(*field.0.lock().unwrap(), [3, 4]);
        // Several averages may use the expected depth, which is queried once.
        let kinds = [RayAverage::USpread, RayAverage::USpreadPerRootRay];
        let found = averages(&rays, &Probe { field: &field, averages: &kinds });
        let known: Vec<_> = found.iter().map(|values| known(values)).collect();
        assert_eq!(known, [[7.0, 8.0]; 2]);
        assert_eq!(field.0.lock().unwrap()[2..], [4]);
    }
}
