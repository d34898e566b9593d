//! Checks what cameras see of a field, before anything is computed from them.
//!
//! Cameras with other axes or units, another box, a model in other coordinates: each gives a field, but one that says
//! "never seen" everywhere. A few thousand rays detect this: [`Framing`] by geometry alone, [`Sight`] by tracing them.

use glam::DMat3;
use rayon::prelude::*;

use crate::Result;
use crate::geometry::{Aabb, Camera, Domain, Ray};
use crate::monitor::{Monitor, check};
use crate::rays::{RayStream, SURFACE_WEIGHT};
use crate::render::{CompositingWeights, TraceBuffers};

/// Approximate number of rays traced, a thousandth of a default run's. The standard error of a fraction is at
/// most 0.008, so it is known to within 0.016 (two standard errors, at ½).
const RAYS: usize = 4096;
/// Maximal number of cameras used, evenly spread over all.
const CAMERAS: usize = 512;
/// Factor by which rays are increased before a run reports that nothing is seen. A fraction of 10⁻⁴
/// is then missed once in 26 runs.
const INSISTENCE: usize = 8;
/// A camera is inside matter if half the light of half its rays is lost within this many samples.
const NEAR: f64 = 4.0;
/// Fractions of rays below this are small. `tests/sight.rs` has values for correct and wrong settings of real models.
const LITTLE: f64 = 0.05;
/// Fractions of cameras from this value on are large.
const MANY: f64 = 0.25;

/// The position of cameras relative to a box.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Framing {
    /// Number of rays.
    pub rays: u64,
    /// Fraction of them that pass through the box.
    pub meet_box: f64,
    /// Fraction of the cameras that look away from the box: they stand outside, and none of their rays meets it.
    pub looking_away: f64,
    /// Fraction of the rays that would meet the box if the cameras' axes were OpenCV's (y down, looking along +z).
    pub turned: f64,
    /// Mean distance of the cameras from the centre of the box, in half diagonals of the box.
    pub distance: f64,
}

/// A camera and its rays.
struct View {
    camera: Camera,
    rays: Vec<Ray>,
}

/// About `count` rays, equally many from each camera. All cameras use the same low-discrepancy sequence
/// over the image (R₂: Roberts 2018).
fn views(cameras: &[Camera], count: usize, pixel_offset: f64) -> Vec<View> {
    let used = cameras.len().min(CAMERAS);
    let each = count.div_ceil(used.max(1)).max(8);
    let view = |i: usize| {
        let camera = cameras[i * cameras.len() / used];
        let pixel = |n: usize, axis: usize| {
            let share = (0.5 + (n + 1) as f64 * [0.754_877_666_246_693, 0.569_840_290_998_053_3][axis]).fract();
            (share * f64::from(camera.resolution[axis])).floor() + pixel_offset
        };
        View { camera, rays: (0..each).map(|n| camera.ray(pixel(n, 0), pixel(n, 1))).collect() }
    };
    (0..used).map(view).collect()
}

impl Framing {
    /// Measures how `cameras` relate to `bounds`.
    #[must_use]
    pub fn from_cameras(cameras: &[Camera], bounds: &Aabb) -> Self {
        Self::from_views(&views(cameras, RAYS, 0.5), bounds)
    }

    fn from_views(views: &[View], bounds: &Aabb) -> Self {
        let middle = 0.5 * (bounds.min() + bounds.max());
        let mut sums = [0.0; 4];
        for View { camera, rays } in views {
            let meets = |ray: &Ray| bounds.clip(ray).is_some();
            // In the camera's own axes, OpenCV's differ by the signs of y and z.
            let axes = camera.axes * DMat3::from_diagonal(glam::DVec3::new(1.0, -1.0, -1.0)) * camera.axes.transpose();
            let turned = |ray: &&Ray| meets(&Ray::new(ray.origin, axes * ray.direction));
            let met = rays.iter().filter(|ray| meets(ray)).count();
            sums[0] += met as f64 / rays.len() as f64;
            sums[1] += f64::from(u8::from(met == 0));
            sums[2] += rays.iter().filter(turned).count() as f64 / rays.len() as f64;
            sums[3] += (camera.position - middle).length() / (0.5 * bounds.size().length());
        }
        let [meet_box, looking_away, turned, distance] = sums.map(|sum| sum / views.len().max(1) as f64);
        let rays = views.iter().map(|view| view.rays.len() as u64).sum();
        Self { rays, meet_box, looking_away, turned, distance }
    }

    /// Whether no ray meets the box.
    #[must_use]
    pub fn is_nothing(&self) -> bool {
        self.meet_box == 0.0
    }

    /// Whether few rays meet the box, or many cameras look away.
    #[must_use]
    pub fn is_little(&self) -> bool {
        self.meet_box < LITTLE || self.looking_away >= MANY
    }

    /// Describes what was measured.
    #[must_use]
    pub fn measured(&self) -> String {
        let [met, away] = [self.meet_box, self.looking_away].map(|share| 100.0 * share);
        format!("of {} rays {met:.1} % meet the model's box, {away:.0} % of the cameras look away from it", self.rays)
    }

    /// The likely causes, if little is seen.
    #[must_use]
    pub fn causes(&self) -> Option<String> {
        let turned = 100.0 * self.turned;
        if self.is_little() && self.turned > (2.0 * self.meet_box).max(LITTLE) {
            Some(format!("OpenCV's camera axes instead of OpenGL's: turned, {turned:.0} % of the rays meet the box"))
        } else if self.is_little() {
            let distance = self.distance;
            Some(format!(
                "units, origin or axes of the cameras, which stand {distance:.1} half diagonals of the box from it"
            ))
        } else {
            None
        }
    }
}

/// What cameras see of a field.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Sight {
    /// Their position relative to the field's box.
    pub framing: Framing,
    /// Fraction of the rays that meet matter, with opacity at least [`SURFACE_WEIGHT`].
    pub meet_matter: f64,
    /// Fraction of the rays that meet matter within the domain of the uncertainty field.
    pub meet_domain: f64,
    /// Fraction of the cameras that are inside matter.
    pub inside_matter: f64,
    /// Number of rays dropped because the field was not finite.
    pub dropped: u64,
}

/// Observations of one camera: rays that meet matter, rays that meet it in the domain, whether it
/// is inside matter, rays dropped.
type Seen = (f64, f64, bool, u64);

impl Sight {
    /// Measures what the cameras of `stream` see inside `domain`, with a thousandth of a default run's rays.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] only.
    pub fn measure(stream: &RayStream, domain: &Domain, monitor: &dyn Monitor) -> Result<Self> {
        let first = Self::with_rays(RAYS, stream, domain, monitor)?;
        if !first.is_nothing() {
            return Ok(first);
        }
        Self::with_rays(INSISTENCE * RAYS, stream, domain, monitor)
    }

    fn with_rays(rays: usize, stream: &RayStream, domain: &Domain, monitor: &dyn Monitor) -> Result<Self> {
        let views = views(stream.cameras, rays, stream.pixel_offset);
        // A field that wants many points at once sees all views as one.
        let each = if stream.tracer.field.batch() > 0 { views.len().max(1) } else { 1 };
        let seen = views
            .par_chunks(each)
            .map_init(TraceBuffers::default, |buffers, views| {
                check(monitor)?;
                Ok(seen(views, stream, domain, buffers))
            })
            .collect::<Result<Vec<_>>>()?
            .concat();
        let mean = |of: &dyn Fn(&Seen) -> f64| seen.iter().map(of).sum::<f64>() / seen.len().max(1) as f64;
        Ok(Self {
            framing: Framing::from_views(&views, &stream.tracer.field.bounds()),
            meet_matter: mean(&|seen| seen.0),
            meet_domain: mean(&|seen| seen.1),
            inside_matter: mean(&|seen| f64::from(u8::from(seen.2))),
            dropped: seen.iter().map(|seen| seen.3).sum(),
        })
    }

    /// Whether no ray meets matter in the domain. Fields that are not finite are reported elsewhere.
    #[must_use]
    pub fn is_nothing(&self) -> bool {
        self.meet_domain == 0.0 && self.dropped == 0
    }

    /// Whether few rays meet matter, many cameras look away, or many are inside matter.
    #[must_use]
    pub fn is_little(&self) -> bool {
        self.framing.is_little() || self.meet_domain < LITTLE || self.inside_matter >= MANY
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
        if !self.is_little() && !self.is_nothing() {
            None
        } else if let Some(causes) = self.framing.causes() {
            Some(causes)
        } else if self.meet_matter < LITTLE {
            Some("cameras of another scene, or in other units or axes than the model".into())
        } else if self.meet_domain < LITTLE {
            Some("a domain that is not where the cameras see matter".into())
        } else {
            Some("units that put the cameras into the scene's matter, or other axes".into())
        }
    }
}

fn seen<'b>(views: &[View], stream: &'b RayStream, domain: &Domain, buffers: &mut TraceBuffers<'b>) -> Vec<Seen> {
    let tracer = &stream.tracer;
    let rays: Vec<Ray> = views.iter().flat_map(|view| &view.rays).copied().collect();
    tracer.trace(&rays, &vec![0.5; rays.len()], buffers);
    let traced = &buffers.traced;
    let mut quadrature = CompositingWeights::default();
    quadrature.set(traced, tracer.marcher.step);
    let mut first = 0;
    let of_view = |view: &View| {
        let rays = first..first + view.rays.len();
        first = rays.end;
        let (mut matter, mut within, mut near, mut dropped) = (0_usize, 0_usize, 0_usize, 0_u64);
        for ray in rays {
            let sum = |keep: &dyn Fn(usize) -> bool| -> f64 {
                traced.samples(ray).filter(|&i| keep(i)).map(|i| quadrature.weights[i]).sum()
            };
            let least = f64::from(SURFACE_WEIGHT);
            matter += usize::from(sum(&|_| true) >= least);
            within += usize::from(sum(&|i| domain.to_unit(traced.positions[i]).is_some()) >= least);
            near += usize::from(sum(&|i| traced.t[i] <= NEAR * tracer.marcher.step) >= 0.5);
            dropped += u64::from(traced.is_dropped[ray]);
        }
        let count = view.rays.len() as f64;
        let inside = tracer.marcher.bounds.contains(view.camera.position.as_vec3());
        (matter as f64 / count, within as f64 / count, inside && 2 * near >= view.rays.len(), dropped)
    };
    views.iter().map(of_view).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{GridSettings, RaySettings};
    use crate::field::{ClosedForm, RadianceField};
    use crate::monitor::Silent;
    use glam::DVec3;

    fn sight(cameras: &[Camera], domain: Option<Domain>) -> Sight {
        let field = ClosedForm::courtyard();
        let domain = domain.unwrap_or(Domain::Box(field.bounds()));
        let grid = GridSettings { level: 4, ..GridSettings::default() };
        let lattice = grid.lattice(domain).unwrap();
        let rays = RaySettings { occupancy: 32, ..RaySettings::default() };
        let stream = rays.stream(&field, cameras, &lattice, &Silent).unwrap();
        Sight::measure(&stream, &domain, &Silent).unwrap()
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
        assert!(!right.is_little() && !right.is_nothing() && right.causes().is_none(), "{right:?}");
        assert!((right.framing.rays as usize).abs_diff(RAYS) < 6 * 8, "{right:?}");
    }

    #[test]
    fn each_mistake_has_its_cause() {
        let turned = sight(&changed(opencv), None);
        assert!(turned.is_nothing() && turned.framing.looking_away == 1.0, "{turned:?}");
        assert!(turned.causes().unwrap().contains("OpenCV"), "{turned:?}");
        // With their axes turned back, the same rays meet the box.
        let right = Framing::from_cameras(&changed(|_| {}), &ClosedForm::courtyard().bounds());
        let wrong = Framing::from_cameras(&changed(opencv), &ClosedForm::courtyard().bounds());
        assert!((wrong.turned - right.meet_box).abs() < 1e-9, "{wrong:?}, {right:?}");

        // Millimetres: a thousand times as far away.
        let far = sight(&changed(|camera| camera.position *= 1000.0), None);
        assert!(far.framing.meet_box < 0.01 && far.causes().unwrap().contains("units"), "{far:?}");

        let elsewhere = Aabb::new(DVec3::splat(5.0), DVec3::splat(6.0)).unwrap();
        let boxed = sight(&changed(|_| {}), Some(Domain::Box(elsewhere)));
        assert!(boxed.is_nothing() && boxed.meet_matter > 0.3, "{boxed:?}");
        assert!(boxed.causes().unwrap().contains("a domain"), "{boxed:?}");

        // Inside the ground, which is where z is about -0.75.
        let buried = sight(&changed(|camera| camera.position = DVec3::new(0.2, 0.2, -0.77)), None);
        assert!(buried.is_little() && buried.inside_matter == 1.0, "{buried:?}");
    }
}
