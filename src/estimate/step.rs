//! Checks whether the finite-difference step is suitable for the field.

use std::f64::consts::LOG10_E;

use glam::Vec3;

use super::rays::shortest_step;
use crate::Result;
use crate::geometry::Lattice;
use crate::monitor::Monitor;
use crate::rays::{Pixels, RayStream};
use crate::render::{DifferenceErrors, Differences, LONGEST_STEP, Stencil, VolumeRenderer};

/// Number of points on visible surfaces. A mean over them is known to about 1 / √1024 of its spread.
const POINTS: usize = 1024;
/// Number of rays used to find them: four batches.
const RAYS: u64 = 2048;
/// Seed of these rays. It does not depend on the run's, so the same model and cameras always get the same answer.
pub(super) const SEED: u64 = 0x57e9;

/// About [`POINTS`] points on surfaces that the cameras of `stream` see. They do not depend on the stream's pixels.
pub(super) fn surface_points(stream: &RayStream, seed: u64, monitor: &dyn Monitor) -> Result<Vec<Vec3>> {
    let seen = stream.with_pixels(Pixels::Sobol, seed).surface_points(usize::MAX, RAYS, monitor)?;
    let every = seen.len().div_ceil(POINTS).max(1);
    Ok(seen.into_iter().step_by(every).map(Vec3::from_array).collect())
}

/// A step, and the errors of central differences with this step and with others.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct StepCheck {
    /// The run's step, lattice edges.
    pub step: f64,
    /// Errors with this step and with others.
    pub errors: DifferenceErrors,
    /// Whether the step is unsuitable ([`DifferenceErrors::is_bad`]), or so long that forward differences are of
    /// another place: their middle is as far away as central ones of the longest step that runs take reach.
    pub is_bad: bool,
    /// Whether the run's differences are forward ones. The errors are those of central differences of the same width,
    /// and do not count that the place is off by a step.
    pub is_forward: bool,
    /// Whether the field can provide exact derivatives instead.
    pub knows_derivatives: bool,
}

impl StepCheck {
    /// Checks the step at surfaces seen by the cameras of `stream`. `None` if the field's own derivatives are
    /// used, or if there is nothing to see.
    ///
    /// The answer does not depend on the stream's pixels.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn measure(
        stream: &RayStream,
        lattice: &Lattice,
        tolerance: f64,
        monitor: &dyn Monitor,
    ) -> Result<Option<Self>> {
        Self::with_seed(SEED, stream, lattice, tolerance, monitor)
    }

    /// The warning, if the step is badly placed.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let (here, best) = (self.errors.at(self.step), self.errors.best());
        // Errors as large as the derivative itself: beyond, their size means nothing.
        let decades = |relative: f64| match relative * LOG10_E {
            decades if relative <= 1.0 => format!("{decades:.2}"),
            _ => "more than 0.43".into(),
        };
        let exact = match self.knows_derivatives {
            true => "; --gradient auto uses the model's own derivatives, which are exact",
            false => "",
        };
        self.is_bad.then(|| {
            format!(
                "finite differences over {} edges of the finest lattice put log10 U off by about {} decades (rounding \
                 and noise {}, truncation {}), central ones over {:.2e} edges by {}{exact}",
                self.step,
                decades(here.total()),
                decades(here.noise),
                decades(here.truncation),
                best.step,
                decades(best.total())
            )
        })
    }

    fn with_seed(
        seed: u64,
        stream: &RayStream,
        lattice: &Lattice,
        tolerance: f64,
        monitor: &dyn Monitor,
    ) -> Result<Option<Self>> {
        let Some(VolumeRenderer { tracer, differentiation: Some(differentiation) }) = stream.source.marched() else {
            return Ok(None);
        };
        if differentiation.analytic.is_some() {
            return Ok(None);
        }
        let field = tracer.field;
        let points = surface_points(stream, seed, monitor)?;
        let edges = Differences { step: lattice.edge(), domain: *lattice.domain(), stencil: Stencil::Central };
        let step = (differentiation.differences.step / lattice.edge()).max_element();
        let steps = DifferenceErrors::steps(shortest_step(lattice, &field.bounds()), step);
        let errors = DifferenceErrors::measure(field, &points, &edges, &steps);
        let knows_derivatives = field.differentiable().is_some();
        let is_forward = differentiation.differences.stencil == Stencil::Forward;
        let is_far = is_forward && step > LONGEST_STEP;
        let is_bad = |errors: &DifferenceErrors| is_far || errors.is_bad(step, tolerance);
        Ok(errors.map(|errors| Self { step, is_bad: is_bad(&errors), is_forward, errors, knows_derivatives }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Estimation, GridSettings, RaySettings};
    use crate::field::{ClosedForm, Differentiable, Radiance, RadianceField, RadianceJet, TrainedField};
    use crate::geometry::{Aabb, Domain};
    use crate::monitor::Silent;
    use crate::render::{GradientMethod, LONGEST_STEP};
    use glam::DVec3;

    /// A ball of waves too short for the default step, like the highest frequencies of an MLP on a coarse lattice.
    struct Waves;

    /// Radians per scene unit.
    const FREQUENCY: f64 = 4000.0;

    fn jet(x: Vec3) -> (f32, Vec3) {
        let (x, direction) = (x.as_dvec3(), DVec3::new(0.8, 0.36, 0.48));
        let (wave, slope) = (FREQUENCY * direction.dot(x)).sin_cos();
        // The density is 0 outside a radius of 0.6.
        let ramp = (1.0 - x.length() / 0.6).max(0.0);
        let inwards = if ramp > 0.0 { -x.normalize_or_zero() / 0.6 } else { DVec3::ZERO };
        let gradient = inwards * (1.5 + wave) + ramp * slope * FREQUENCY * direction;
        ((40.0 * ramp * (1.5 + wave)) as f32, (40.0 * gradient).as_vec3())
    }

    impl RadianceField for Waves {
        fn bounds(&self) -> Aabb {
            Aabb::centered_cube(1.0)
        }

        fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
            for (x, out) in positions.iter().zip(out) {
                *out = Radiance { density: jet(*x).0, color: Vec3::new(0.8, 0.4, 0.2) };
            }
        }

        fn differentiable(&self) -> Option<&dyn Differentiable> {
            Some(self)
        }

        fn suggested_step(&self) -> f64 {
            0.05
        }

        fn memory(&self) -> usize {
            0
        }
    }

    impl TrainedField for Waves {
        fn describe(&self) -> String {
            "waves".into()
        }
    }

    impl Differentiable for Waves {
        fn jets(&self, positions: &[Vec3], _: &[Vec3], out: &mut [RadianceJet]) {
            for (x, out) in positions.iter().zip(out) {
                let (density, density_gradient) = jet(*x);
                let value = Radiance { density, color: Vec3::new(0.8, 0.4, 0.2) };
                *out = RadianceJet { value, density_gradient, color_gradients: [Vec3::ZERO; 3] };
            }
        }
    }

    /// The same field as a black box.
    struct BlackBox;

    impl RadianceField for BlackBox {
        fn bounds(&self) -> Aabb {
            Waves.bounds()
        }

        fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
            Waves.evaluate(positions, directions, out);
        }

        fn suggested_step(&self) -> f64 {
            Waves.suggested_step()
        }

        fn memory(&self) -> usize {
            0
        }
    }

    impl TrainedField for BlackBox {
        fn describe(&self) -> String {
            "waves in a box".into()
        }
    }

    fn grid() -> GridSettings {
        GridSettings { level: 4, ..GridSettings::default() }
    }

    fn check(field: &dyn TrainedField, seed: u64) -> StepCheck {
        let cameras = ClosedForm::half_circle(6, [64, 64]);
        let lattice = grid().lattice(Domain::Box(field.bounds())).unwrap();
        let rays = RaySettings { occupancy: 32, ..RaySettings::default() };
        let stream = rays.stream(&field, &cameras, &lattice, &Silent).unwrap();
        StepCheck::with_seed(seed, &stream, &lattice, 0.01, &Silent).unwrap().unwrap()
    }

    /// Mean |Δ log10 U| relative to the field's own derivatives, over the vertices that these moved.
    fn error(step: f64) -> f64 {
        let cameras = ClosedForm::half_circle(6, [64, 64]);
        let domain = Domain::Box(Waves.bounds());
        let run = |rays: RaySettings| {
            Estimation::new(&Waves, &cameras).domain(domain).rays(rays).grid(grid()).run().unwrap().field
        };
        let rays = RaySettings { rays: 2_000, occupancy: 32, ..RaySettings::default() };
        let exact = run(RaySettings { gradient: GradientMethod::Analytic, ..rays });
        let field = run(RaySettings { step: Some(step), ..rays });
        let points =
            (0..16 * 16 * 16).map(|i| Vec3::new((i / 256) as f32, (i / 16 % 16) as f32, (i % 16) as f32) / 8.0 - 1.0);
        let pairs = points.map(|x| (exact.query(x).uncertainty, field.query(x).uncertainty));
        let moved: Vec<f64> =
            pairs.filter(|(e, _)| *e < 0.3 * exact.prior()).map(|(e, f)| (f / e).log10().abs()).collect();
        assert!(moved.len() > 100);
        moved.iter().sum::<f64>() / moved.len() as f64
    }

    #[test]
    fn whoever_obeys_is_better_off() {
        let told = check(&Waves, SEED);
        assert!(told.is_bad && told.knows_derivatives, "{told:?}");
        let best = told.errors.best().step;
        assert!(best <= LONGEST_STEP, "{told:?}");
        let [before, after] = [told.step, best].map(error);
        assert!(after < 0.5 * before, "{before}, {after} with {best}");
        // A step of ten edges was once recommended, in a box of sixteen edges: now none longer than one is taken.
        let lattice = grid().lattice(Domain::Box(Waves.bounds())).unwrap();
        let with = |step: f64| RaySettings::default().step(step).differentiation(&Waves, &lattice).map(|_| ());
        assert!(with(1.0).is_ok() && with(10.0).is_err());
        // The black box gets much the same answer.
        let blind = check(&BlackBox, SEED);
        assert!(blind.is_bad && !blind.knows_derivatives, "{blind:?}");
        // The size is that of log10 U, and the way out an option, if there is one.
        let [told, blind_told] = [&told, &blind].map(|check| check.warning().unwrap());
        assert!(told.contains(" decades (") && told.contains("--gradient auto") && !told.contains('%'), "{told}");
        assert!(blind_told.contains(" decades (") && !blind_told.contains("--gradient"), "{blind_told}");
        let proposed = error(blind.errors.best().step);
        assert!(proposed < 0.5 * before, "{proposed} instead of {before}");
    }

    #[test]
    fn forward_differences_may_not_look_far_away() {
        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
        let lattice = grid().lattice(Domain::Box(scene.bounds())).unwrap();
        let check = |gradient, step| {
            let rays = RaySettings { rays: 2_000, occupancy: 32, gradient, step, ..RaySettings::default() };
            let stream = rays.stream(&scene, &cameras, &lattice, &Silent).unwrap();
            // Anything is within this tolerance.
            StepCheck::measure(&stream, &lattice, 10.0, &Silent).unwrap().unwrap()
        };
        let bad = |gradient, step| check(gradient, step).is_bad;
        let [central, forward] = [GradientMethod::FiniteDifference, GradientMethod::ForwardDifference];
        assert!(bad(forward, Some(0.2)) && !bad(forward, None) && !bad(central, Some(0.2)));
        assert!(check(forward, None).is_forward && 4.0 * check(forward, None).step == check(central, None).step);
    }

    #[test]
    fn other_points_say_the_same() {
        for field in [&Waves as &dyn TrainedField, &BlackBox, &ClosedForm::courtyard()] {
            let checks: Vec<StepCheck> = (0..8).map(|seed| check(field, seed)).collect();
            let bad = checks.iter().filter(|check| check.is_bad).count();
            assert!(bad == 0 || bad == 8, "{}: {bad} of 8 warn", field.describe());
        }
    }
}
