//! Checks what cameras see of a field, before anything is computed from them.
//!
//! Cameras with other axes or units, another box, a model in other coordinates: each gives a field, but one that says
//! "never seen" everywhere. A few thousand rays detect this: [`Framing`] by geometry alone, [`CoverageCheck`] by
//! tracing them.

use std::ops::Range;

use super::framing::{self, Framing, LARGE_SHARE, RAYS, SMALL_SHARE, View, WORLD_TO_CAMERA, views};
use crate::Result;
use crate::geometry::{Camera, Domain, inverted};
use crate::monitor::Monitor;
use crate::rays::{RayStream, SURFACE_WEIGHT};
use crate::render::{INSIDE_MATTER_SAMPLES, Renderer, WeightedSamples};

/// Factor by which rays are increased before a run reports that nothing is seen. A fraction of 10⁻⁴
/// is then missed once in 26 runs.
const MAX_RETRY_FACTOR: usize = 8;
/// Warn when more than this share of the rays' weight lies outside the domain.
const MIN_OUTSIDE_SHARE: f64 = 0.01;
/// A model is fog if no ray is more opaque than this, and no density is above 1.
const OPAQUE: f64 = 0.95;

/// Most cameras that are looked through, if each of their views has to be prepared.
const PREPARED_VIEWS: usize = 16;

/// What cameras see of a field.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct CoverageCheck {
    /// Their position relative to the field's box.
    pub framing: Framing,
    /// Fraction of the rays that meet matter, with opacity at least [`SURFACE_WEIGHT`].
    pub meet_matter: f64,
    /// Fraction of the rays that meet matter within the domain of the uncertainty field.
    pub meet_domain: f64,
    /// Fraction of the cameras that are inside matter.
    pub inside_matter: f64,
    /// Share of the rays' weight that lies outside the domain of the uncertainty field.
    pub outside_domain: f64,
    /// Opacity of the most opaque ray.
    pub most_opaque: f64,
    /// Largest density met, 1 / scene unit.
    pub densest: f64,
    /// [`CoverageCheck::meet_domain`] if the poses were world-to-camera; 0 if the cameras see enough as they are.
    pub inverted: f64,
    /// Number of rays dropped because the field was not finite.
    pub dropped: u64,
}

/// Observations of one camera.
#[derive(Clone, Copy)]
struct Seen {
    /// Fractions of the rays that meet matter, anywhere and in the domain.
    matter: f64,
    within: f64,
    is_inside_matter: bool,
    dropped: u64,
    /// Weight of all rays together, and the part of it outside the domain.
    weight: f64,
    outside: f64,
    most_opaque: f64,
    densest: f64,
}

impl CoverageCheck {
    /// Measures what the cameras of `stream` see inside `domain`, with a thousandth of a default run's rays.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn measure(stream: &RayStream, domain: &Domain, monitor: &dyn Monitor) -> Result<Self> {
        let measured = |rays, cameras: &[Camera]| Self::with_rays(rays, cameras, stream, domain, monitor);
        let mut found = measured(RAYS, stream.cameras)?;
        if found.is_empty() {
            found = measured(MAX_RETRY_FACTOR * RAYS, stream.cameras)?;
        }
        if found.is_below_threshold() || found.is_empty() {
            for axes in 0..2 {
                let cameras: Vec<Camera> = stream.cameras.iter().map(|camera| inverted(camera)[axes]).collect();
                found.inverted = found.inverted.max(measured(RAYS, &cameras)?.meet_domain);
            }
        }
        Ok(found)
    }

    fn with_rays(
        rays: usize,
        cameras: &[Camera],
        stream: &RayStream,
        domain: &Domain,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let views = views(cameras, rays, stream.pixel_offset);
        let source = &*stream.source;
        // Each view of a model that is not marched has to be prepared.
        let few: Vec<Camera> = match source.marched() {
            Some(_) => cameras.to_vec(),
            None => {
                let used = cameras.len().min(PREPARED_VIEWS);
                (0..used).map(|i| cameras[i * cameras.len() / used]).collect()
            }
        };
        let looked = framing::views(&few, rays, stream.pixel_offset);
        // A field that prefers many points at once gets all views as one; of others, no more are held than are traced.
        let together = if source.batch() > 0 { looked.len().max(1) } else { rayon::current_num_threads() };
        let mut seen: Vec<Seen> = Vec::new();
        for views in looked.chunks(together) {
            let points: Vec<_> = views.iter().map(|view| (view.camera, view.points.clone())).collect();
            let samples = source.weighted(&points, monitor)?;
            let mut first = 0;
            seen.extend(views.iter().map(|view| {
                let rays = first..first + view.points.len();
                first = rays.end;
                seen_by(view, rays, &samples, source, domain)
            }));
        }
        let bounds = source.main_box();
        let mean = |of: &dyn Fn(&Seen) -> f64| seen.iter().map(of).sum::<f64>() / seen.len().max(1) as f64;
        Ok(Self {
            framing: Framing::from_views(&views, &bounds),
            meet_matter: mean(&|seen| seen.matter),
            meet_domain: mean(&|seen| seen.within),
            inside_matter: mean(&|seen| f64::from(u8::from(seen.is_inside_matter))),
            outside_domain: mean(&|seen| seen.outside) / mean(&|seen| seen.weight).max(f64::MIN_POSITIVE),
            most_opaque: seen.iter().map(|seen| seen.most_opaque).fold(0.0, f64::max),
            densest: seen.iter().map(|seen| seen.densest).fold(0.0, f64::max),
            inverted: 0.0,
            dropped: seen.iter().map(|seen| seen.dropped).sum(),
        })
    }

    /// Whether no ray meets matter in the domain. Fields that are not finite are reported elsewhere.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.meet_domain == 0.0 && self.dropped == 0
    }

    /// [`CoverageCheck::outside_domain`], if that is worth saying.
    #[must_use]
    pub fn cut_off(&self) -> Option<f64> {
        Some(self.outside_domain).filter(|share| *share >= MIN_OUTSIDE_SHARE && !self.is_empty())
    }

    /// Whether few rays meet matter, many cameras look away, many are inside matter, or all they see is fog.
    #[must_use]
    pub fn is_below_threshold(&self) -> bool {
        self.framing.is_below_threshold()
            || self.meet_domain < SMALL_SHARE
            || self.inside_matter >= LARGE_SHARE
            || self.is_fog()
    }

    /// Whether all that the rays meet is transparent, as it is if opacity takes the place of density.
    fn is_fog(&self) -> bool {
        self.densest > 0.0 && self.densest <= 1.0 && self.most_opaque < OPAQUE
    }

    /// Describes what was measured.
    #[must_use]
    pub fn measured(&self) -> String {
        let [matter, domain, inside] =
            [self.meet_matter, self.meet_domain, self.inside_matter].map(|share| 100.0 * share);
        let framing = self.framing.measured();
        format!(
            "{framing}, {matter:.1} % meet matter, {domain:.1} % in the field's domain; \
             {inside:.0} % of the cameras stand in matter"
        )
    }

    /// The likely causes, if little is seen.
    #[must_use]
    pub fn causes(&self) -> Option<String> {
        if !self.is_below_threshold() && !self.is_empty() {
            None
        } else if let Some(causes) = self.framing.causes() {
            Some(causes)
        } else if self.inverted > (2.0 * self.meet_domain).max(SMALL_SHARE) {
            let inverted = 100.0 * self.inverted;
            Some(format!("{WORLD_TO_CAMERA}: inverted, {inverted:.0} % of the rays meet matter"))
        } else if self.is_fog() {
            let (opaque, densest) = (100.0 * self.most_opaque, self.densest);
            Some(format!(
                "opacity (0 to 1) in place of density (per scene unit): no density is above {densest:.3}, no ray loses \
                 more than {opaque:.0} % of its light"
            ))
        } else if let Some(units) =
            self.framing.units().filter(|_| self.meet_matter < SMALL_SHARE || self.inside_matter >= LARGE_SHARE)
        {
            Some(units)
        } else if self.meet_matter < SMALL_SHARE {
            Some("cameras of another scene, or in other units or axes than the model".into())
        } else if self.meet_domain < SMALL_SHARE {
            Some("a domain that is not where the cameras see matter".into())
        } else {
            Some("units that put the cameras into the scene's matter, or other axes".into())
        }
    }
}

/// What the rays of a view see. A camera stands in matter only if rays are marched: one among splats does not.
fn seen_by(view: &View, rays: Range<usize>, samples: &WeightedSamples, source: &dyn Renderer, domain: &Domain) -> Seen {
    let volume = source.marched();
    let within_near = source.march_step().map(|step| INSIDE_MATTER_SAMPLES * step);
    let (mut matter, mut within, mut near, mut dropped) = (0_usize, 0_usize, 0_usize, 0_u64);
    let (mut weight, mut outside, mut most_opaque, mut densest) = (0.0, 0.0, 0.0_f64, 0.0_f64);
    for ray in rays {
        let sum = |keep: &dyn Fn(usize) -> bool| -> f64 {
            samples.samples(ray).filter(|&i| keep(i)).map(|i| samples.weights[i]).sum()
        };
        let least = f64::from(SURFACE_WEIGHT);
        let opacity = sum(&|_| true);
        let inside = sum(&|i| domain.to_unit(samples.positions[i]).is_some());
        matter += usize::from(opacity >= least);
        within += usize::from(inside >= least);
        near += usize::from(within_near.is_some_and(|reach| sum(&|i| samples.t[i] <= reach) >= 0.5));
        dropped += u64::from(samples.is_dropped[ray]);
        weight += opacity;
        outside += opacity - inside;
        most_opaque = most_opaque.max(opacity);
        let densities = samples.densities.get(samples.samples(ray)).unwrap_or_default();
        densest = densities.iter().map(|&density| f64::from(density)).fold(densest, f64::max);
    }
    let [matter, within] = [matter, within].map(|count| count as f64 / view.points.len() as f64);
    let is_inside = volume.is_some_and(|v| v.tracer.marcher.bounds.contains(view.camera.position.as_vec3()));
    let is_inside_matter = is_inside && 2 * near >= view.points.len();
    Seen { matter, within, is_inside_matter, dropped, weight, outside, most_opaque, densest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{GridSettings, RaySettings};
    use crate::field::{ClosedForm, Radiance, RadianceField, TrainedField, VoxelGrid};
    use crate::geometry::Aabb;
    use crate::monitor::Silent;
    use glam::{DMat3, DVec3, Vec3};

    fn sight(cameras: &[Camera], domain: Option<Domain>) -> CoverageCheck {
        sight_of(&ClosedForm::courtyard(), cameras, domain)
    }

    fn sight_of(field: &dyn TrainedField, cameras: &[Camera], domain: Option<Domain>) -> CoverageCheck {
        let domain = domain.unwrap_or(Domain::Box(field.bounds()));
        let grid = GridSettings { level: 4, ..GridSettings::default() };
        let lattice = grid.lattice(domain).unwrap();
        let rays = RaySettings { occupancy: 32, ..RaySettings::default() };
        let stream = rays.stream(&field, cameras, &lattice, &Silent).unwrap();
        CoverageCheck::measure(&stream, &domain, &Silent).unwrap()
    }

    fn changed(change: impl Fn(&mut Camera)) -> Vec<Camera> {
        let mut cameras = ClosedForm::half_circle(6, [40, 30]);
        cameras.iter_mut().for_each(change);
        cameras
    }

    fn opencv(camera: &mut Camera) {
        camera.axes = DMat3::from_cols(camera.axes.x_axis, -camera.axes.y_axis, -camera.axes.z_axis);
    }

    #[test]
    fn what_is_right_gives_no_cause_for_complaint() {
        let right = sight(&changed(|_| {}), None);
        assert!(right.meet_matter > 0.3 && right.meet_domain == right.meet_matter, "{right:?}");
        assert!(!right.is_below_threshold() && !right.is_empty() && right.causes().is_none(), "{right:?}");
        assert!((right.framing.rays as usize).abs_diff(RAYS) < 6 * 8, "{right:?}");
    }

    #[test]
    fn each_mistake_has_its_cause() {
        let turned = sight(&changed(opencv), None);
        assert!(turned.is_empty() && turned.framing.looking_away == 1.0, "{turned:?}");
        assert!(turned.causes().unwrap().contains("OpenCV"), "{turned:?}");
        // With their axes turned back, the same rays meet the box.
        let right = Framing::from_cameras(&changed(|_| {}), &ClosedForm::courtyard().bounds());
        let wrong = Framing::from_cameras(&changed(opencv), &ClosedForm::courtyard().bounds());
        assert!((wrong.turned - right.meet_box).abs() < 1e-9, "{wrong:?}, {right:?}");

        // Millimetres: a thousand times as far away.
        let far = sight(&changed(|camera| camera.position *= 1000.0), None);
        assert!(far.framing.meet_box < 0.01 && far.causes().unwrap().contains("units"), "{far:?}");

        // And the reverse, at the middle of the box, where there is no matter.
        let near = sight(&changed(|camera| camera.position *= 0.001), None);
        assert!(near.framing.meet_box == 1.0 && near.framing.distance < 0.01, "{near:?}");

        let elsewhere = Aabb::new(DVec3::splat(5.0), DVec3::splat(6.0)).unwrap();
        let boxed = sight(&changed(|_| {}), Some(Domain::Box(elsewhere)));
        assert!(boxed.is_empty() && boxed.meet_matter > 0.3, "{boxed:?}");
        assert!(boxed.causes().unwrap().contains("a domain"), "{boxed:?}");

        // Inside the ground, which is where z is about -0.75.
        let buried = sight(&changed(|camera| camera.position = DVec3::new(0.2, 0.2, -0.77)), None);
        assert!(buried.is_below_threshold() && buried.inside_matter == 1.0, "{buried:?}");
    }

    /// Poses as other programs write them: world-to-camera, with OpenGL's axes or OpenCV's.
    #[test]
    fn inverted_poses_are_named_because_the_right_ones_see_the_model() {
        let to_camera = |camera: &mut Camera| {
            let to_camera = camera.axes.transpose();
            (camera.position, camera.axes) = (-(to_camera * camera.position), to_camera);
        };
        for axes in [false, true] {
            let found = sight(
                &changed(|camera| {
                    if axes {
                        opencv(camera);
                    }
                    to_camera(camera);
                }),
                None,
            );
            let causes = found.causes().unwrap();
            assert!(found.is_below_threshold() && causes.contains("world-to-camera"), "{causes}: {found:?}");
            assert!(found.inverted > 0.3, "{found:?}");
        }
        assert!(!sight(&changed(opencv), None).causes().unwrap().contains("world-to-camera"));
        assert_eq!(sight(&changed(|_| {}), None).inverted, 0.0);
    }

    #[test]
    fn units_that_differ_by_powers_of_ten_are_named_with_their_factor() {
        let named = |factor: f64| sight(&changed(|camera| camera.position *= factor), None).causes();
        for (factor, told) in [(10.0, "10 times smaller"), (100.0, "100 times smaller"), (1000.0, "1000 times smaller")]
        {
            let causes = named(factor).unwrap();
            assert!(causes.contains("units") && causes.contains(told), "{factor}: {causes}");
        }
        // Inside the ball, all is matter.
        let in_ball = |factor: f64| {
            let cameras = changed(|camera| camera.position *= factor);
            sight_of(&ClosedForm::ball(), &cameras, None).causes().unwrap()
        };
        assert!(in_ball(0.01).contains("100 times larger"), "{}", in_ball(0.01));
    }

    /// A scene whose opacity was taken for its density.
    struct Opacity(VoxelGrid);

    impl RadianceField for Opacity {
        fn bounds(&self) -> Aabb {
            self.0.bounds()
        }

        fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
            self.0.evaluate(positions, directions, out);
            out.iter_mut().for_each(|out| out.density = 1.0 - (-out.density).exp());
        }

        fn suggested_step(&self) -> f64 {
            self.0.suggested_step()
        }
    }

    impl TrainedField for Opacity {}

    #[test]
    fn opacity_in_place_of_density_is_named() {
        let scene = VoxelGrid::bake(&ClosedForm::ball(), [32; 3], Vec3::Z);
        let cameras = changed(|_| {});
        assert_eq!(sight_of(&scene, &cameras, None).causes(), None);
        let fog = sight_of(&Opacity(scene), &cameras, None);
        assert!(fog.is_below_threshold() && fog.causes().unwrap().contains("opacity"), "{fog:?}");
    }

    #[test]
    fn what_a_box_cuts_off_is_measured() {
        let all = sight(&changed(|_| {}), None);
        assert_eq!(all.outside_domain, 0.0);
        let half = Aabb::new(DVec3::splat(-1.0), DVec3::new(1.0, 0.0, 1.0)).unwrap();
        let cut = sight(&changed(|_| {}), Some(Domain::Box(half)));
        assert!(cut.outside_domain > 0.05 && cut.outside_domain < 0.95, "{cut:?}");
    }
}
