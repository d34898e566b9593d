//! What a model's own derivatives would save.

use std::time::{Duration, Instant};

use crate::monitor::Monitor;
use crate::rays::{Purpose, RaySource, RayStream, RunProgress, Shard, VolumeRays};
use crate::render::{Differentiation, GradientMethod};
use crate::{Error, Result};

/// One in so many of the run's rays is timed, and at most [`MAX_TIMED_RAYS`].
const RAY_STRIDE: u64 = 512;
const MAX_TIMED_RAYS: u64 = 2048;
/// Each way is timed so often, in turns; the least counts.
const TURNS: usize = 2;

/// The time of some rays with the field's own derivatives, relative to that with the differences of `stream`; `None` if
/// it does not use differences, the field has no derivatives, or too many rays meet values that are not finite.
///
/// # Errors
/// [`Error::Interrupted`] only.
pub fn measure(stream: &RayStream, rays: u64, monitor: &dyn Monitor) -> Result<Option<f64>> {
    let RaySource::Volume(volume) = &stream.source else { return Ok(None) };
    let own = GradientMethod::Auto.of(volume.tracer.field)?;
    if volume.differentiation.analytic.is_some() || own.is_none() {
        return Ok(None);
    }
    let shard = Shard::whole((rays / RAY_STRIDE).clamp(1, MAX_TIMED_RAYS));
    let mut least = [Duration::MAX; 2];
    for _ in 0..TURNS {
        for (analytic, least) in [None, own].into_iter().zip(&mut least) {
            let differentiation = Differentiation { analytic, ..volume.differentiation };
            let source = RaySource::Volume(Box::new(VolumeRays { tracer: volume.tracer.clone(), differentiation }));
            let stream = RayStream { source, ..stream.for_purpose(Purpose::Pilot) };
            let start = Instant::now();
            match stream.run(shard, RunProgress::default(), monitor, |_, _| Ok(())) {
                // Of a few rays, too many may be at fault by chance; the run will tell.
                Err(Error::NonFinite { .. }) => return Ok(None),
                done => done?,
            };
            *least = start.elapsed().min(*least);
        }
    }
    Ok(Some(least[1].as_secs_f64() / least[0].as_secs_f64()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{GridSettings, RaySettings};
    use crate::field::{ClosedForm, RadianceField, VoxelGrid};
    use crate::geometry::Domain;
    use crate::monitor::Silent;

    #[test]
    fn only_who_could_do_better_is_told() {
        let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(3, [48, 48]));
        // Only the baked one knows its derivatives.
        let baked = VoxelGrid::bake(&scene, [32; 3], glam::Vec3::Z);
        let of = |field: &dyn RadianceField, gradient| {
            let lattice = GridSettings::default().level(5).lattice(Domain::Box(field.bounds())).unwrap();
            let rays = RaySettings::default().rays(100_000).occupancy(32).gradient(gradient);
            let stream = rays.stream(field, &cameras, &lattice, &Silent).unwrap();
            measure(&stream, rays.rays, &Silent).unwrap()
        };
        // How much better depends on what else runs.
        let ratio = of(&baked, GradientMethod::FiniteDifference).unwrap();
        assert!(ratio > 0.0 && ratio.is_finite(), "{ratio}");
        assert_eq!(of(&baked, GradientMethod::Analytic), None);
        assert_eq!(of(&scene, GradientMethod::FiniteDifference), None);
    }
}
