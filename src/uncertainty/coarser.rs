//! U on coarser lattices, summed from the same rays.
//!
//! A finer level tells more places apart and knows less of each. The mean of log10 U over a few levels ranks depth
//! errors about as well as the best of them does, so that none has to be chosen (`experiments/depth.md`).

use glam::Vec3;

use super::{Answers as _, Protocol, RayCounts, UncertaintyField};
use crate::render::Probed;
use crate::{Error, Result};

impl UncertaintyField {
    /// The most coarser levels that a field may have.
    pub const MOST_COARSER: usize = 4;

    /// The most coarser levels below this one.
    pub(crate) fn most_coarser(level: u8) -> u8 {
        (Self::MOST_COARSER as u8).min(level.saturating_sub(1))
    }

    /// The same field with fields of the same rays on the next coarser levels, one after the other.
    ///
    /// [`RayAverage::USpread`] and [`RayAverage::USpreadPerRootRay`] then read the mean of log10 U over all these
    /// levels; U stays as it is. Of the coarser fields only their U and, if they have them, their sums are kept.
    ///
    /// [`RayAverage::USpread`]: crate::render::RayAverage::USpread
    /// [`RayAverage::USpreadPerRootRay`]: crate::render::RayAverage::USpreadPerRootRay
    ///
    /// # Errors
    /// If there are more than [`MOST_COARSER`](Self::MOST_COARSER), if one is not of the next coarser level of the same
    /// domain, or has another [protocol](Self::protocol) but for λ, other rays or no sums where this has them, or if a
    /// field is a part of a run or has leaves that are limited.
    pub fn with_coarser(self, coarser: Vec<Self>) -> Result<Self> {
        let wrong = |expected: &str, found: String| Err(Error::setting("coarser levels", expected, found));
        if coarser.len() > Self::MOST_COARSER {
            return wrong(&format!("at most {}", Self::MOST_COARSER), coarser.len().to_string());
        }
        for (i, other) in (1..).zip(&coarser) {
            let [level, found] = [&self, other].map(|field| field.lattice.level());
            if found + i != level || other.lattice.domain() != self.lattice.domain() {
                return wrong("the next coarser level of the same domain", format!("level {found} below {level}"));
            }
            let protocol = Protocol { lambda: self.protocol.lambda, ..other.protocol.clone() };
            let sums = [&self, other].map(|field| field.sums.is_some());
            if protocol != self.protocol || other.draws != self.draws || sums[0] != sums[1] {
                return wrong("the same protocol, rays and kinds of content", "others".into());
            }
        }
        if coarser.iter().chain([&self]).any(|field| field.is_part() || !field.limits.is_unlimited()) {
            return wrong("a whole run, with leaves as fine as its level", "a part, or limited leaves".into());
        }
        let coarser = coarser.into_iter().map(Self::bare).collect();
        Ok(Self { coarser, ..self })
    }

    /// U and sums alone.
    fn bare(self) -> Self {
        Self {
            rays: RayCounts::default(),
            error_bars: None,
            surface: Vec::new(),
            visits: None,
            correlations: None,
            misfit: None,
            conformal: None,
            coarser: Vec::new(),
            ..self
        }
    }

    /// The fields on coarser levels, finest first; usually none.
    #[must_use]
    pub fn coarser(&self) -> &[Self] {
        &self.coarser
    }

    /// Turns what this field says of points into what it and its coarser levels say: the mean of log10 U.
    pub(super) fn mean_over_levels(&self, points: &[Vec3], own: &[Probed]) -> Result<Vec<Probed>> {
        let mut probed = own.to_vec();
        for coarser in &self.coarser {
            for (probed, estimate) in probed.iter_mut().zip(coarser.estimates(points)?) {
                probed.value += estimate.uncertainty.log10();
            }
        }
        let levels = 1.0 + self.coarser.len() as f64;
        probed.iter_mut().for_each(|probed| probed.value /= levels);
        Ok(probed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Checkpoint, Estimation, GridKind, GridSettings, RaySettings};
    use crate::field::ClosedForm;
    use crate::posterior::{Covariance, Criteria, Criterion, DataScale, Scale};
    use crate::render::ProbedField;
    use crate::uncertainty::BakedField;

    fn settings(level: u8) -> GridSettings {
        GridSettings::default().level(level).covariance(Covariance::Block).keep_sums(true)
    }

    fn run(grid: GridSettings, coarser: u8) -> UncertaintyField {
        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(4, [48, 48]));
        // The same step of differences in scene units, whatever the level.
        let rays = RaySettings::default().rays(6_000).occupancy(32).step(f64::from(grid.level).exp2() / 4096.0);
        Estimation::new(&scene, &cameras).rays(rays).grid(grid).coarser_levels(coarser).run().unwrap().field
    }

    #[test]
    fn every_level_is_that_of_a_run_of_its_own() {
        let scale = Scale::Data(DataScale::new(9_216, 0.05, 0.1).unwrap());
        for (grid, coarser) in [(settings(6), 2), (settings(5).scale(scale), 1), (settings(4).grid(GridKind::Dense), 3)]
        {
            let field = run(grid, coarser);
            let alone = run(grid, 0);
            assert!(field.deviations() == alone.deviations() && field.rays() == alone.rays());
            assert!(alone.coarser().is_empty() && field.coarser().len() == usize::from(coarser));
            let others: Vec<_> =
                (1..=coarser).map(|i| run(GridSettings { level: grid.level - i, ..grid }, 0)).collect();
            for (coarser, other) in field.coarser().iter().zip(&others) {
                assert_eq!(coarser.lattice(), other.lattice());
                assert!(coarser.deviations() == other.deviations() && coarser.sums() == other.sums());
                assert!(coarser.support() == other.support() && coarser.protocol().lambda == other.protocol().lambda);
            }

            // At surfaces, in free space and outside.
            let golden = [0.819_172_5, 0.671_043_6, 0.549_700_5];
            let mut points: Vec<Vec3> = field.surface().iter().map(|&x| Vec3::from_array(x)).take(200).collect();
            points.extend((0..200).map(|i| Vec3::from_array(golden.map(|g: f32| 3.0 * (i as f32 * g).fract() - 1.5))));
            let own = field.at(&points).unwrap();
            let baked = BakedField::new(&field);
            let of_baked = baked.at(&points).unwrap();
            let found = [field.over_levels(&points, &own).unwrap(), baked.over_levels(&points, &of_baked).unwrap()];
            for (i, &x) in points.iter().enumerate() {
                let mean = others.iter().map(|field| field.log10(x)).sum::<f64>() + alone.log10(x);
                let mean = mean / f64::from(1 + coarser);
                // The baked field's own level is rounded to f32.
                for (found, tolerance) in found.iter().zip([1e-12, 1e-7]) {
                    assert!((found[i].value - mean).abs() < tolerance, "{x}: {} and {mean}", found[i].value);
                    let (rays, expected) = (found[i].rays, own[i].rays);
                    assert!((rays - expected).abs() <= 2_f64.powi(-23) * expected, "{x}: {rays} and {expected}");
                }
            }
            assert!(
                found[0].iter().zip(&own).filter(|(mean, own)| (mean.value - own.value).abs() > 0.01).count() > 100
            );
        }
    }

    #[test]
    fn other_readings_take_them_along_or_drop_them() {
        let field = run(settings(5), 2);
        let levels = |field: &UncertaintyField| field.coarser().iter().map(|f| f.lattice().level()).collect::<Vec<_>>();
        let trace = field.clone().with_covariance(Covariance::Trace).unwrap();
        assert_eq!(levels(&trace), [4, 3]);
        let alone = run(settings(3).covariance(Covariance::Trace), 0);
        assert!(trace.coarser()[1].deviations() == alone.deviations());
        let bare = field.clone().without_sums();
        assert!(levels(&bare) == [4, 3] && bare.coarser().iter().all(|field| field.sums().is_none()));
        assert!(bare.clone().with_covariance(Covariance::Trace).is_err());
        assert_eq!(levels(&bare.on_dense_grid()), [4, 3]);
        let lambda = 2.0 * field.protocol().lambda;
        assert!(levels(&field.clone().with_lambda(lambda).unwrap()).is_empty());

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.oct");
        for field in [&field, &bare, &run(settings(3).grid(GridKind::Dense), 1)] {
            field.write(&path).unwrap();
            let again = UncertaintyField::read(&path).unwrap();
            assert!(levels(&again) == levels(field) && !levels(field).is_empty());
            for (coarser, again) in field.coarser().iter().zip(again.coarser()) {
                assert!(again.deviations() == coarser.deviations() && again.support() == coarser.support());
                assert_eq!(again.sums().is_some(), coarser.sums().is_some());
                assert_eq!((again.lattice(), again.protocol()), (coarser.lattice(), coarser.protocol()));
            }
        }
        let of = |part| field.memory().iter().find(|(name, _)| *name == part).unwrap().1;
        assert!(of("coarser levels") > of("sums") / 16 && of("coarser levels") < 2 * of("sums"));
        assert!(field.query_memory() > run(settings(5), 0).query_memory());
    }

    #[test]
    fn what_they_need_is_said() {
        let field = |level| run(settings(level), 0);
        for (coarser, expected) in [
            (vec![field(3)], "next coarser level"),
            (vec![field(4), field(4)], "next coarser level"),
            (vec![field(4).without_sums()], "kinds of content"),
            (vec![field(4).with_covariance(Covariance::Trace).unwrap()], "same protocol"),
            (vec![field(4).with_model(7)], "same protocol"),
            (vec![field(4).with_draws(Vec::new())], "same protocol, rays"),
            (vec![field(1); 5], "at most 4"),
        ] {
            let error = field(5).with_coarser(coarser).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }

        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(4, [48, 48]));
        let base = |grid| Estimation::new(&scene, &cameras).rays(RaySettings::default().rays(2_000)).grid(grid);
        let ray_count = settings(4).criteria(Criteria::from_iter([Criterion::RayCount]));
        for (estimation, expected) in [
            (base(settings(2)).coarser_levels(2), "at most 1 below level 2"),
            (base(settings(9)).coarser_levels(5), "at most 4 below level 9"),
            (base(settings(4)).coarser_levels(1).error_bars(2), "in one group"),
            (base(settings(4)).coarser_levels(1).shard(0, 2), "in one group"),
            (base(settings(4)).coarser_levels(1).until_mean_error(0.1), "in one group"),
            (base(settings(4)).coarser_levels(1).checkpoint(Checkpoint::new("x.chk")), "without a checkpoint"),
            (base(ray_count).coarser_levels(1), "criterion `ray-count`"),
        ] {
            let error = estimation.prepare().err().unwrap().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_forecast_counts_them() {
        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(4, [48, 48]));
        let prepared = |coarser| {
            let rays = RaySettings::default().rays(20_000).occupancy(32);
            Estimation::new(&scene, &cameras).rays(rays).grid(settings(7)).coarser_levels(coarser).prepare().unwrap()
        };
        let forecast = |coarser| prepared(coarser).forecast().unwrap().summing;
        let needed = |coarser| prepared(coarser).finish().unwrap().sums_bytes as f64;
        let [forecast, needed] = [forecast(2) / forecast(0), needed(2) / needed(0)];
        // Between vertices along lines, half as many on every coarser level, and surfaces, a quarter as many.
        assert!(needed > 1.3125 && needed <= forecast && forecast <= 1.75, "{needed} needed, {forecast} forecast");
        let error = prepared(1).finish_on(&[settings(7)]).unwrap_err().to_string();
        assert!(error.contains("without a checkpoint or coarser levels"), "{error}");
    }
}
