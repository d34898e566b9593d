//! Rendering of whole images.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::trace::TraceBuffers;
use super::{CompositingWeights, DepthProbe, Pixel, Tracer};
use crate::Result;
use crate::geometry::{Camera, Ray};
use crate::monitor::{Monitor, check};

/// Ray average: how log10 U at the samples of a ray becomes one number per pixel.
///
/// Letters: w weights of the samples, u = log10 U at the samples, t their distances, δ the distance between samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum RayAverage {
    /// Σ w u / Σ w: the mean over what the ray meets.
    #[default]
    WeightedMean,
    /// Σ w u − 3 T_end, as in the official code, which counts empty space as certain.
    Official,
    /// u at the expected depth Σ w t / Σ w, which may lie between two surfaces.
    AtExpected,
    /// u at the expected depth + log10 s, where s² = Var t + δ²/12 is the variance of the ray's weights.
    ///
    /// How loosely matter is held there, times how widely it is spread along the ray; scene units squared. It is
    /// meant for ranking pixels by their depth error.
    Spread,
    /// [`RayAverage::Spread`] − ½ log10 n, where n is the number of training rays of the vertices around the expected
    /// depth, at least ½. NaN if the number is not known.
    ///
    /// What few rays support is known less well than its U says. It ranks depth errors best (`experiments/depth.md`).
    SpreadPerRay,
}

impl RayAverage {
    /// All ray averages.
    pub const ALL: [Self; 5] = [Self::WeightedMean, Self::Official, Self::AtExpected, Self::Spread, Self::SpreadPerRay];

    /// Name on the command line and in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::WeightedMean => "weighted-mean",
            Self::Official => "official",
            Self::AtExpected => "at-expected",
            Self::Spread => "spread",
            Self::SpreadPerRay => "spread-per-ray",
        }
    }

    /// Returns true if it needs u at every sample.
    fn is_of_samples(self) -> bool {
        !matches!(self, Self::AtExpected | Self::Spread | Self::SpreadPerRay)
    }
}

/// log10 U that the official code assigns to the part of a ray that hits nothing.
const OFFICIAL_EMPTY: f64 = -3.0;

/// What no ray supports counts as if half a ray did: known less well than by one ray, but not infinitely so.
pub const FEWEST: f64 = 0.5;

/// A scalar function of space, averaged along rays beside the colour; usually log10 U at a scene point.
#[derive(Clone, Copy)]
pub struct Probe<'a> {
    /// The scalar at a point.
    pub value: &'a (dyn Fn(Vec3) -> f64 + Sync),
    /// Number of training rays around a point, for [`RayAverage::SpreadPerRay`].
    pub rays: Option<&'a (dyn Fn(Vec3) -> f64 + Sync)>,
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
    /// `[ray averages of all probes in order][height · width]`: ray averages of log10 U. NaN where nothing was hit,
    /// except for [`RayAverage::Official`].
    pub log10_uncertainty: Vec<Vec<f64>>,
    /// `[variances of the depth probe][height · width]`: the variance of the expected depth under a posterior of
    /// displacements, squared scene units; NaN where nothing was hit.
    pub posterior_variance: Vec<Vec<f64>>,
    /// The same with what the ray's weights leave open: √(Var + s²), where s² is their variance + δ²/12. A standard
    /// deviation of depth, scene units.
    pub depth_deviation: Vec<Vec<f64>>,
    /// Number of rays dropped because the field was not finite; they show the background.
    pub dropped: u64,
}

/// About as many points of a ray are asked about at once
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
/// [`crate::Error::Interrupted`] only.
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
/// [`crate::Error::Interrupted`] only.
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

fn render(
    tracer: &Tracer,
    camera: &Camera,
    pixel_offset: f64,
    probes: &[Probe],
    depth: Option<&DepthProbe>,
    monitor: &dyn Monitor,
) -> Result<RenderedView> {
    let [width, height] = camera.resolution;
    // A field that wants many points at once gets several rows: a ray asks about a few points at a time.
    let together = tracer.field.batch().div_ceil(POINTS_PER_RAY * width.max(1) as usize).max(1);
    let rows: Vec<u32> = (0..height).collect();
    let rows: Vec<RenderedView> = rows
        .par_chunks(together)
        .map(|rows| {
            check(monitor)?;
            let ray = |row: u32, x: u32| camera.ray(f64::from(x) + pixel_offset, f64::from(row) + pixel_offset);
            let rays: Vec<Ray> = rows.iter().flat_map(|&row| (0..width).map(move |x| ray(row, x))).collect();
            let rendered = render_rays(tracer, &rays, probes, depth);
            monitor.advance(rows.len() as u64);
            Ok(rendered)
        })
        .collect::<Result<_>>()?;
    let posteriors = depth.map_or(0, |depth| depth.variances.len());
    let mut view = RenderedView {
        resolution: camera.resolution,
        log10_uncertainty: vec![Vec::new(); channels(probes)],
        posterior_variance: vec![Vec::new(); posteriors],
        depth_deviation: vec![Vec::new(); posteriors],
        ..RenderedView::default()
    };
    for row in rows {
        view.pixels.extend(row.pixels);
        for (all, part) in view.posterior_variance.iter_mut().zip(row.posterior_variance) {
            all.extend(part);
        }
        for (all, part) in view.depth_deviation.iter_mut().zip(row.depth_deviation) {
            all.extend(part);
        }
        view.dropped += row.dropped;
        for (all, part) in view.log10_uncertainty.iter_mut().zip(row.log10_uncertainty) {
            all.extend(part);
        }
    }
    Ok(view)
}

/// Renders single rays, as an image of one row.
#[must_use]
pub fn render_rays(tracer: &Tracer, rays: &[Ray], probes: &[Probe], depth: Option<&DepthProbe>) -> RenderedView {
    let background: DVec3 = tracer.background();
    let mut buffers = TraceBuffers::default();
    // The middle of every interval makes the image deterministic.
    tracer.trace(rays, &vec![0.5; rays.len()], &mut buffers);
    let traced = &buffers.traced;
    let mut quadrature = CompositingWeights::default();
    quadrature.set(traced, tracer.marcher.step);
    let colors = tracer.visible_colors(rays, traced, &quadrature);
    let mut row = RenderedView {
        resolution: [rays.len() as u32, 1],
        pixels: Vec::with_capacity(rays.len()),
        log10_uncertainty: vec![Vec::with_capacity(rays.len()); channels(probes)],
        posterior_variance: depth.map_or_else(Vec::new, |depth| depth.ask(tracer, rays, traced, &quadrature)),
        depth_deviation: vec![Vec::with_capacity(rays.len()); depth.map_or(0, |depth| depth.variances.len())],
        dropped: traced.dropped,
    };
    let mut values = Vec::new();
    for (r, ray) in rays.iter().enumerate() {
        let mut samples = traced.samples(r);
        if colors[samples.clone()].iter().any(|color| !color.is_finite()) {
            row.dropped += 1;
            samples = 0..0;
            row.posterior_variance.iter_mut().for_each(|variances| variances[r] = f64::NAN);
        }
        let pixel = quadrature.pixel(&samples, &colors, &traced.t, background);
        row.pixels.push(pixel);
        let weights = &quadrature.weights[samples.clone()];
        let averaged = WeightedRay {
            weights,
            end_transmittance: quadrature.end_transmittance(&samples),
            at_expected: tracer.marcher.bounds.clamp(ray.at(pixel.expected_depth).as_vec3()),
            spread: (pixel.depth_variance + tracer.marcher.step.powi(2) / 12.0).sqrt(),
        };
        for (variances, out) in row.posterior_variance.iter().zip(&mut row.depth_deviation) {
            out.push((variances[r] + averaged.spread.powi(2)).sqrt());
        }
        let mut channel = 0;
        for probe in probes {
            values.clear();
            if probe.averages.iter().any(|average| average.is_of_samples()) {
                let hit = weights.iter().zip(&traced.positions[samples.clone()]);
                values.extend(hit.map(|(w, x)| if *w > 0.0 { (probe.value)(*x) } else { 0.0 }));
            }
            for &average in probe.averages {
                row.log10_uncertainty[channel].push(averaged.average(average, &values, probe));
                channel += 1;
            }
        }
    }
    row
}

/// A ray along which scalars are averaged.
struct WeightedRay<'a> {
    weights: &'a [f64],
    end_transmittance: f64,
    at_expected: Vec3,
    spread: f64,
}

impl WeightedRay<'_> {
    /// Computes a ray average from `values` at the samples and from `probe` anywhere else.
    ///
    /// Where the weight is zero, `values` may be anything; they may be missing if the average needs none.
    fn average(&self, average: RayAverage, values: &[f64], probe: &Probe) -> f64 {
        let total: f64 = self.weights.iter().sum();
        let hit = self.weights.iter().zip(values).filter(|(w, _)| **w > 0.0);
        let sum: f64 = hit.map(|(w, u)| w * u).sum();
        match average {
            RayAverage::Official => sum + OFFICIAL_EMPTY * self.end_transmittance,
            _ if total <= 0.0 => f64::NAN,
            RayAverage::WeightedMean => sum / total,
            RayAverage::AtExpected => (probe.value)(self.at_expected),
            RayAverage::Spread => (probe.value)(self.at_expected) + self.spread.log10(),
            RayAverage::SpreadPerRay => {
                let rays = probe.rays.map_or(f64::NAN, |rays| rays(self.at_expected).clamp(FEWEST, f64::INFINITY));
                (probe.value)(self.at_expected) + self.spread.log10() - 0.5 * rays.log10()
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
        let weights = &[0.3, 0.0, 0.1];
        let ray = WeightedRay { weights, end_transmittance: 0.6, at_expected: Vec3::X, spread: 0.1 };
        let values = [0.0, 77.0, 2.0];
        let at = |there: f64, elsewhere: f64| move |x: Vec3| if x == Vec3::X { there } else { elsewhere };
        let (value, rays) = (at(1.5, 0.25), at(100.0, 1.0));
        let probe = Probe { value: &value, rays: Some(&rays), averages: &[] };
        let average = |average| ray.average(average, &values, &probe);
        let expected = [
            (RayAverage::WeightedMean, 0.2 / 0.4),
            (RayAverage::Official, 0.2 - 3.0 * 0.6),
            (RayAverage::AtExpected, 1.5),
            (RayAverage::Spread, 1.5 - 1.0),
            (RayAverage::SpreadPerRay, 1.5 - 1.0 - 1.0),
        ];
        for (name, expected) in expected {
            assert!((average(name) - expected).abs() < 1e-12, "{name:?}: {} instead of {expected}", average(name));
        }
        assert_eq!(expected.map(|(name, _)| name), RayAverage::ALL);
        let (unseen, unknown) = (|_| 0.0, Probe { rays: None, ..probe });
        let unseen = ray.average(RayAverage::SpreadPerRay, &values, &Probe { rays: Some(&unseen), ..probe });
        assert!((unseen - 0.5 - 0.5 * 2_f64.log10()).abs() < 1e-12, "{unseen}");
        assert!(ray.average(RayAverage::SpreadPerRay, &values, &unknown).is_nan());
        let unknown = |_| f64::NAN;
        let found = ray.average(RayAverage::SpreadPerRay, &values, &Probe { rays: Some(&unknown), ..probe });
        assert!(found.is_nan(), "{found}");
    }

    #[test]
    fn a_ray_that_meets_nothing_has_no_value_but_the_official_one() {
        let ray = WeightedRay { weights: &[0.0], end_transmittance: 1.0, at_expected: Vec3::ZERO, spread: 0.1 };
        for average in RayAverage::ALL {
            let five = |_| 5.0;
            let found = ray.average(average, &[5.0], &Probe { value: &five, rays: Some(&five), averages: &[] });
            assert!(
                if average == RayAverage::Official { found == -3.0 } else { found.is_nan() },
                "{average:?}: {found}"
            );
        }
    }
}
