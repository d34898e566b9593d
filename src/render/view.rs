//! Rendering of whole images.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::ray_average::Asked;
use super::trace::TraceBuffers;
use super::{CompositingWeights, DepthProbe, DepthVariance, Pixel, RayAverage, Tracer};
use crate::geometry::{Aabb, Camera, MAX_PIXELS, Ray};
use crate::monitor::{Monitor, check};
use crate::{Error, Result};

/// log10 U that the official code assigns to the part of a ray that hits nothing.
const OFFICIAL_EMPTY: f64 = -3.0;

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
    /// Approximate number of points per efficient query; 0 if that does not matter.
    fn batch(&self) -> usize {
        0
    }

    /// The scalar at points.
    ///
    /// # Errors
    /// If it has to be read first, and cannot be.
    fn at(&self, points: &[Vec3]) -> Result<Vec<Probed>>;
}

/// A scalar function of space, averaged along rays beside the colour.
#[derive(Clone, Copy)]
pub struct Probe<'a> {
    /// The function.
    pub field: &'a dyn ProbedField,
    /// Ray averages to compute: each gives one number per pixel.
    pub averages: &'a [RayAverage],
}

/// The image of a field, row by row from the top left pixel.
#[derive(Debug, Clone, Default)]
pub struct RenderedView {
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// `[height · width]`.
    pub pixels: Vec<Pixel>,
    /// `[height · width]`: s, the spread of the ray's weights, scene units. s² is their variance and, on average, that
    /// of what lies within one sample: δ²/12 for samples δ apart, or a splat's own extent along the ray.
    pub spread: Vec<f64>,
    /// `[ray averages of all probes in order][height · width]`: ray averages of log10 U. NaN where nothing was hit,
    /// except for [`RayAverage::Official`].
    pub log10_uncertainty: Vec<Vec<f64>>,
    /// `[variances of the depth probe][height · width]`: the variance of the expected depth under a posterior of
    /// displacements, squared scene units; NaN where nothing was hit.
    pub posterior_variance: Vec<Vec<f64>>,
    /// The same with what the ray's weights leave open, and what moving matter does not explain: √(Var + s² + e²). Here
    /// e² is [`DepthVariance::unexplained`] at the expected depth. A standard deviation of depth, scene units.
    ///
    /// [`DepthVariance::unexplained`]: super::DepthVariance::unexplained
    pub depth_deviation: Vec<Vec<f64>>,
    /// Number of rays dropped because the field was not finite; they show the background.
    pub dropped: u64,
}

impl RenderedView {
    /// `[height · width]`: the pixels, and where their median depths lie, scene units, of the camera and the pixel
    /// offset that the view was rendered with.
    pub fn median_points(&self, camera: &Camera, pixel_offset: f64) -> impl Iterator<Item = (&Pixel, DVec3)> {
        let width = self.resolution[0] as usize;
        self.pixels.iter().enumerate().map(move |(i, pixel)| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + pixel_offset);
            (pixel, camera.ray(x, y).at(pixel.median_depth))
        })
    }
}

/// Approximate number of points of a ray per query
/// ([`RadianceField::batch`](crate::field::RadianceField::batch)).
const POINTS_PER_RAY: usize = 4;

/// Number of values per pixel that the probes give.
fn channels(probes: &[Probe]) -> usize {
    probes.iter().map(|probe| probe.averages.len()).sum()
}

/// Renders a camera's image. `pixel_offset` is the position in a pixel that its ray
/// passes through (½ for the centre).
///
/// Advances the monitor by one per row. The caller begins and ends the stage.
///
/// # Errors
/// [`crate::Error::Interrupted`], and those of the probes.
pub fn render_view(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    probes: &[Probe],
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    render(tracer, camera, pixel_offset, probes, None, monitor)
}

/// Same as [`render_view`], with the variance of every pixel's expected depth.
///
/// # Errors
/// [`crate::Error::Interrupted`], and those of the probes.
pub fn render_view_with_depth(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    probes: &[Probe],
    depth: &DepthProbe,
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    render(tracer, camera, pixel_offset, probes, Some(depth), monitor)
}

/// Refuses images that are too large.
pub(crate) fn check_size(camera: &Camera) -> Result<()> {
    let [width, height] = camera.resolution;
    if camera.pixels() as f64 <= MAX_PIXELS {
        return Ok(());
    }
    let expected = format!("an image of at most {MAX_PIXELS:e} pixels");
    Err(Error::setting("resolution", expected, format!("{width} x {height}")))
}

fn render(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    probes: &[Probe],
    depth: Option<&DepthProbe>,
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    check_size(camera)?;
    let [width, height] = camera.resolution;
    // A field that wants many points at once gets several rows: a ray asks about a few points at a time.
    let batch = probes.iter().map(|probe| probe.field.batch()).fold(tracer.field.batch(), usize::max);
    let together = batch.div_ceil(POINTS_PER_RAY * width.max(1) as usize).max(1);
    let rows: Vec<u32> = (0..height).collect();
    let rows: Vec<RenderedView> = rows
        .par_chunks(together)
        .map(|rows| {
            check(monitor)?;
            let ray = |row: u32, x: u32| camera.ray(f64::from(x) + pixel_offset, f64::from(row) + pixel_offset);
            let rays: Vec<Ray> = rows.iter().flat_map(|&row| (0..width).map(move |x| ray(row, x))).collect();
            let rendered = render_rays(tracer, &rays, probes, depth)?;
            monitor.advance(rows.len() as u64);
            Ok(rendered)
        })
        .collect::<Result<_>>()?;
    Ok(RenderedView::joined(camera.resolution, rows))
}

impl RenderedView {
    /// The image of `resolution` pixels whose rows, one or several each, are `parts`.
    pub(crate) fn joined(resolution: [u32; 2], parts: Vec<Self>) -> Self {
        let lists = |of: fn(&Self) -> &Vec<Vec<f64>>| vec![Vec::new(); parts.first().map_or(0, |part| of(part).len())];
        let mut view = Self {
            resolution,
            log10_uncertainty: lists(|part| &part.log10_uncertainty),
            posterior_variance: lists(|part| &part.posterior_variance),
            depth_deviation: lists(|part| &part.depth_deviation),
            ..Self::default()
        };
        for part in parts {
            view.pixels.extend(part.pixels);
            view.spread.extend(part.spread);
            view.dropped += part.dropped;
            let lists = [
                (&mut view.log10_uncertainty, part.log10_uncertainty),
                (&mut view.posterior_variance, part.posterior_variance),
                (&mut view.depth_deviation, part.depth_deviation),
            ];
            for (all, part) in lists {
                all.iter_mut().zip(part).for_each(|(all, part)| all.extend(part));
            }
        }
        view
    }
}

/// Renders single rays, as an image of one row.
///
/// # Errors
/// Those of the probes.
pub fn render_rays(
    tracer: &Tracer,
    rays: &[Ray],
    probes: &[Probe],
    depth: Option<&DepthProbe>,
) -> Result<RenderedView> {
    let background: DVec3 = tracer.background();
    let mut buffers = TraceBuffers::default();
    // The middle of every interval makes the image deterministic.
    tracer.trace(rays, &vec![0.5; rays.len()], &mut buffers);
    let traced = &buffers.traced;
    let mut quadrature = CompositingWeights::default();
    quadrature.set(traced, tracer.marcher.step);
    let colors = tracer.visible_colors(rays, traced, &quadrature);
    let mut posterior_variance = depth.map_or_else(Vec::new, |depth| depth.ask(tracer, rays, traced, &quadrature));
    let (mut samples, mut dropped) = (Vec::with_capacity(rays.len()), traced.dropped);
    for r in 0..rays.len() {
        let of_ray = traced.samples(r);
        let is_finite = colors[of_ray.clone()].iter().all(|color| color.is_finite());
        if !is_finite {
            dropped += 1;
            posterior_variance.iter_mut().for_each(|variances| variances[r] = f64::NAN);
        }
        samples.push(if is_finite { of_ray } else { 0..0 });
    }
    let weighted = WeightedRays {
        rays,
        samples,
        quadrature: &quadrature,
        positions: &traced.positions,
        colors: &colors,
        t: &traced.t,
        // A sample may lie anywhere in its interval.
        thickness: vec![tracer.marcher.step.powi(2) / 12.0; rays.len()],
        background,
        bounds: tracer.marcher.bounds,
        posterior_variance,
        dropped,
    };
    weighted.view(probes, depth.map_or(&[], |depth| depth.variances))
}

/// Rays whose samples are weighted and coloured: all that an image of them needs.
pub(crate) struct WeightedRays<'a> {
    pub rays: &'a [Ray],
    /// `[rays]`: which samples are each ray's.
    pub samples: Vec<Range<usize>>,
    pub quadrature: &'a CompositingWeights,
    /// `[samples]`, scene units.
    pub positions: &'a [Vec3],
    pub colors: &'a [Vec3],
    /// `[samples]`: distances along the ray, scene units.
    pub t: &'a [f64],
    /// `[rays]`: variance of the distance of what a ray meets within its samples, scene units².
    pub thickness: Vec<f64>,
    pub background: DVec3,
    /// The box in which depths lie.
    pub bounds: Aabb,
    /// `[variances][rays]`: of each ray's expected depth.
    pub posterior_variance: Vec<Vec<f64>>,
    pub dropped: u64,
}

impl WeightedRays<'_> {
    /// The image of one row.
    ///
    /// # Errors
    /// Those of the probes.
    pub fn view(self, probes: &[Probe], of_depth: &[&dyn DepthVariance]) -> Result<RenderedView> {
        let rays = self.rays;
        let mut row = RenderedView {
            resolution: [rays.len() as u32, 1],
            pixels: Vec::with_capacity(rays.len()),
            spread: Vec::with_capacity(rays.len()),
            log10_uncertainty: Vec::with_capacity(channels(probes)),
            posterior_variance: self.posterior_variance,
            depth_deviation: vec![Vec::with_capacity(rays.len()); of_depth.len()],
            dropped: self.dropped,
        };
        let mut weighted = Vec::with_capacity(rays.len());
        for (r, ray) in rays.iter().enumerate() {
            let samples = self.samples[r].clone();
            let pixel = self.quadrature.pixel(&samples, self.colors, self.t, self.background);
            row.pixels.push(pixel);
            let ray = WeightedRay {
                weights: &self.quadrature.weights[samples.clone()],
                positions: &self.positions[samples.clone()],
                end_transmittance: self.quadrature.end_transmittance(&samples),
                at_expected: self.bounds.clamp(ray.at(pixel.expected_depth).as_vec3()),
                spread: (pixel.depth_variance + self.thickness[r]).sqrt(),
            };
            row.spread.push(ray.spread);
            for ((variances, out), variance) in
                row.posterior_variance.iter().zip(&mut row.depth_deviation).zip(of_depth)
            {
                // No depth, no place to ask about.
                let unexplained = if variances[r].is_nan() { f64::NAN } else { variance.unexplained(ray.at_expected) };
                out.push((variances[r] + ray.spread.powi(2) + unexplained).sqrt());
            }
            weighted.push(ray);
        }
        for probe in probes {
            row.log10_uncertainty.extend(averages(&weighted, probe)?);
        }
        Ok(row)
    }
}

/// `[ray averages of the probe][rays]`. The probe's field is queried for all rays at once.
fn averages(rays: &[WeightedRay], probe: &Probe) -> Result<Vec<Vec<f64>>> {
    let needs = |asked| probe.averages.iter().any(|average| average.asks() == asked);
    let at_samples = match needs(Asked::Samples) {
        true => probe.field.at(&rays.iter().flat_map(WeightedRay::hit).map(|(_, x)| x).collect::<Vec<Vec3>>())?,
        false => Vec::new(),
    };
    let at_expected = match needs(Asked::Expected) {
        true => probe.field.at(&rays.iter().map(|ray| ray.at_expected).collect::<Vec<Vec3>>())?,
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
    Ok(out)
}

/// Of a point that no ray average needs.
const UNASKED: Probed = Probed { value: f64::NAN, rays: f64::NAN };

/// A ray along which scalars are averaged.
struct WeightedRay<'a> {
    /// Of its samples.
    weights: &'a [f64],
    positions: &'a [Vec3],
    end_transmittance: f64,
    at_expected: Vec3,
    spread: f64,
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
            RayAverage::Official => sum + OFFICIAL_EMPTY * self.end_transmittance,
            _ if total <= 0.0 => f64::NAN,
            RayAverage::WeightedMean => sum / total,
            RayAverage::AtExpected => at_expected.value,
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
    use super::*;

    #[test]
    fn blends_of_two_samples() {
        // U = 1 with weight 0.3, U = 100 with weight 0.1, one sample without weight; 0.6 of the ray hits nothing.
        let (weights, positions) = (&[0.3, 0.0, 0.1], &[Vec3::X, Vec3::Y, Vec3::Z]);
        let ray = WeightedRay { weights, positions, end_transmittance: 0.6, at_expected: Vec3::X, spread: 0.1 };
        let probed = |value| Probed { value, rays: 100.0 };
        let average = |average, at_expected| ray.average(average, &[probed(0.0), probed(2.0)], at_expected);
        let expected = [
            (RayAverage::WeightedMean, 0.2 / 0.4),
            (RayAverage::Official, 0.2 - 3.0 * 0.6),
            (RayAverage::AtExpected, 1.5),
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
    fn a_ray_that_meets_nothing_has_no_value_but_the_official_one() {
        let (weights, positions) = (&[0.0], &[Vec3::X]);
        let ray = WeightedRay { weights, positions, end_transmittance: 1.0, at_expected: Vec3::ZERO, spread: 0.1 };
        for average in RayAverage::ALL {
            let found = ray.average(average, &[], Probed { value: 5.0, rays: 5.0 });
            assert!(
                if average == RayAverage::Official { found == -3.0 } else { found.is_nan() },
                "{average:?}: {found}"
            );
        }
    }

    /// The scalar x, and the number of queries.
    #[derive(Default)]
    struct Counting(std::sync::Mutex<Vec<usize>>);

    impl ProbedField for Counting {
        fn at(&self, points: &[Vec3]) -> Result<Vec<Probed>> {
            self.0.lock().unwrap().push(points.len());
            Ok(points.iter().map(|x| Probed { value: f64::from(x.x), rays: 1.0 }).collect())
        }
    }

    #[test]
    fn all_rays_are_asked_about_at_once_and_get_their_own_answers() {
        let positions = [1.0, 2.0, 3.0, 4.0, 5.0].map(|x| Vec3::X * x);
        let weights = [0.5, 0.0, 0.25, 0.75, 0.0];
        let ray = |samples: Range<usize>, x| WeightedRay {
            weights: &weights[samples.clone()],
            positions: &positions[samples],
            end_transmittance: 0.0,
            at_expected: Vec3::X * x,
            spread: 1.0,
        };
        let rays = [ray(0..2, 7.0), ray(2..2, 0.0), ray(2..4, 8.0), ray(4..5, 0.0)];
        let field = Counting::default();
        let kinds = [RayAverage::WeightedMean, RayAverage::AtExpected];
        let found = averages(&rays, &Probe { field: &field, averages: &kinds }).unwrap();
        let known = |values: &[f64]| [values[0], values[2]];
        assert_eq!(found.iter().map(|values| known(values)).collect::<Vec<_>>(), [[1.0, 3.75], [7.0, 8.0]]);
        assert!(found.iter().all(|values| values[1].is_nan() && values[3].is_nan()), "{found:?}");
        assert_eq!(*field.0.lock().unwrap(), [3, 4]);
        // Several averages may use the expected depth, which is queried once.
        let kinds = [RayAverage::USpread, RayAverage::AtExpected, RayAverage::USpreadPerRootRay];
        let found = averages(&rays, &Probe { field: &field, averages: &kinds }).unwrap();
        let known: Vec<_> = found.iter().map(|values| known(values)).collect();
        assert_eq!(known, [[7.0, 8.0]; 3]);
        assert_eq!(field.0.lock().unwrap()[2..], [4]);
    }
}
