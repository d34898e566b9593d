//! Lengths between points on surfaces, with their deviations.

use glam::DVec3;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, Silent};
use octobayes::render::{RenderedView, Renderer};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};

use super::{DEPTH_JUMP, DepthDeviation, TrainingViews, Trust};

/// Pixels of the picture around a point, along each side: farther edges do not count.
const SIDE: u32 = 31;
/// Training cameras in whose views a point is looked for: of those that have it inside, the nearest.
const VIEWS: usize = 12;

/// Training cameras in front of a model, from which points are looked at.
pub struct Surveyor<'a> {
    /// The model for images.
    pub renderer: &'a dyn Renderer,
    /// The training cameras.
    pub cameras: &'a [Camera],
    /// What they see.
    pub training: &'a TrainingViews,
    /// Deviations of depth.
    pub deviation: &'a DepthDeviation<'a>,
    /// Where in a pixel rays pass.
    pub pixel_offset: f64,
}

/// What a training camera sees, pixel by pixel.
#[derive(Debug, Clone)]
pub struct SurveyedView {
    /// A camera with exactly these pixels.
    pub camera: Camera,
    /// The model's image.
    pub rendered: RenderedView,
    /// `[height · width]`: deviation of the median depth along the ray, scene units; NaN where nothing is shown.
    pub sigma: Vec<f64>,
    /// `[height · width]`: whether the depth can be trusted.
    pub trust: Vec<Trust>,
}

/// A point on a surface that a training camera sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Scene units.
    pub position: DVec3,
    /// Index of the camera whose view determines it best.
    pub camera: usize,
    /// Away from that camera.
    pub direction: DVec3,
    /// Standard deviation along the direction, scene units.
    pub deviation: f64,
    /// Width of a pixel of that camera there, scene units.
    pub pixel: f64,
    /// Whether its depth can be trusted.
    pub trust: Trust,
}

/// What is at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Snapped {
    /// A surface.
    On(SurfacePoint),
    /// No surface of this point's views: the nearest along them, and how much farther from the camera that is, scene
    /// units, negative in front of it.
    Off(SurfacePoint, f64),
    /// No training camera has the point in its picture, or sees anything there.
    Unseen,
}

/// A length between two points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Scene units.
    pub length: f64,
    /// Its standard deviation, scene units.
    pub deviation: f64,
    /// Correlation of the two depths, from -1 to 1.
    pub correlation: f64,
}

impl Surveyor<'_> {
    /// Every `stride`-th pixel along x and y of what camera `i` sees. Advances the monitor by one per row, and once more
    /// if the deviation has images.
    ///
    /// # Errors
    /// If the model cannot render the camera, or [`Error::Interrupted`].
    pub fn view(&self, i: usize, stride: u32, monitor: &dyn Monitor) -> Result<SurveyedView> {
        let (whole, offset) = (&self.cameras[i], self.pixel_offset);
        let rendered = self.renderer.strided_image(whole, stride, offset, &[], monitor)?;
        let camera = whole.strided(stride, offset);
        let sigma = self.deviation.of_view(self.renderer, &camera, offset, &rendered, monitor)?;
        let trust = Trust::of_view(self.training, &camera, offset, &rendered, Some(i));
        Ok(SurveyedView { camera, rendered, sigma, trust })
    }

    /// Moves a point along a view of it to the surface that the view shows. Of the training views that show one there,
    /// within a [jump](DEPTH_JUMP), the one of the smallest deviation counts.
    ///
    /// # Errors
    /// If the model cannot render a camera.
    pub fn snap(&self, x: DVec3) -> Result<Snapped> {
        let distance = |i: usize| self.cameras[i].position.distance(x);
        let mut inside: Vec<usize> =
            (0..self.cameras.len()).filter(|&i| self.cameras[i].project_inside(x).is_some()).collect();
        // Those that see the place first: a wall may hide it from nearer ones.
        let seeing: Vec<usize> = self.training.seeing(x).map(|(i, _)| i).collect();
        let hidden = |i: usize| !seeing.contains(&i);
        inside.sort_by(|&a, &b| hidden(a).cmp(&hidden(b)).then(distance(a).total_cmp(&distance(b))));
        inside.truncate(VIEWS);
        let (mut best, mut nearest): (Option<SurfacePoint>, Option<(SurfacePoint, f64)>) = (None, None);
        for i in inside {
            let Some(found) = self.in_view(i, x)? else { continue };
            let farther = found.position.distance(self.cameras[i].position) - distance(i);
            if farther.abs() <= DEPTH_JUMP * distance(i) && best.is_none_or(|best| found.deviation < best.deviation) {
                best = Some(found);
            }
            if nearest.is_none_or(|(_, other)| farther.abs() < other.abs()) {
                nearest = Some((found, farther));
            }
        }
        Ok(match (best, nearest) {
            (Some(best), _) => Snapped::On(best),
            (None, Some((nearest, farther))) => Snapped::Off(nearest, farther),
            (None, None) => Snapped::Unseen,
        })
    }

    /// The surface that camera `i` shows where it has the point; `None` if it shows none.
    fn in_view(&self, i: usize, x: DVec3) -> Result<Option<SurfacePoint>> {
        let camera = &self.cameras[i];
        let Some((at, _)) = camera.project_inside(x) else { return Ok(None) };
        // Pixels around the point, the middle one through it, by the whole camera: splats look otherwise by one of
        // another size.
        let middle = (SIDE / 2) as usize;
        let around = |i: u32| [i % SIDE, i / SIDE].map(|n| f64::from(n) - middle as f64);
        let points = (0..SIDE * SIDE).map(around).map(|[dx, dy]| [at[0] + dx, at[1] + dy]).collect();
        let view = self.renderer.points(&[(*camera, points)], &Silent)?;
        let view = RenderedView { resolution: [SIDE; 2], ..view };
        let center = [0, 1].map(|k| camera.center[k] - at[k] + middle as f64 + self.pixel_offset);
        let crop = Camera { center, resolution: [SIDE; 2], ..*camera };
        let index = middle * SIDE as usize + middle;
        let pixel = &view.pixels[index];
        if pixel.opacity <= 0.5 {
            return Ok(None);
        }
        let deviation = self.deviation.of_view(self.renderer, &crop, self.pixel_offset, &view, &Silent)?[index];
        let trust = Trust::of_view(self.training, &crop, self.pixel_offset, &view, Some(i))[index];
        let ray = camera.ray(at[0], at[1]);
        let position = ray.at(pixel.median_depth);
        let width = pixel.median_depth / camera.focal[0].min(camera.focal[1]);
        Ok(Some(SurfacePoint { position, camera: i, direction: ray.direction, deviation, pixel: width, trust }))
    }
}

impl Snapped {
    /// The surface; an error that says where the nearest is if there is none. `name` is that of the point at `x`;
    /// `place`, `length` and `view` say of a place, a length and a camera what people know them by.
    ///
    /// # Errors
    /// If there is no surface.
    pub fn surface(
        self,
        name: &str,
        x: DVec3,
        place: impl Fn(DVec3) -> String,
        length: impl Fn(f64) -> String,
        view: impl Fn(usize) -> String,
    ) -> Result<SurfacePoint> {
        let found = match self {
            Self::On(found) => return Ok(found),
            Self::Off(nearest, farther) => {
                let side = if farther > 0.0 { "behind" } else { "in front of" };
                format!(
                    "{}; the nearest surface lies {} {side} it, at {} in the view of {}",
                    place(x),
                    length(farther.abs()),
                    place(nearest.position),
                    view(nearest.camera)
                )
            }
            Self::Unseen => format!("{}, where no training camera sees anything", place(x)),
        };
        Err(Error::setting(name, "a point on a surface that a training camera sees", found))
    }
}

impl Length {
    /// The length between two points. Errors are along the views that determine the points, and correlated as the
    /// displacements of the field there are, through the vertices that they share; across the views they are a pixel's:
    /// σ² = (σ₁ c₁)² + (σ₂ c₂)² − 2 ρ σ₁ c₁ σ₂ c₂ + (p₁² + p₂²) / 12, where c is the cosine between a view and the line,
    /// and ρ the [correlation](UncertaintyField::correlation) times the cosine between the views.
    ///
    /// # Errors
    /// If a deviation is not finite.
    pub fn between(a: &SurfacePoint, b: &SurfacePoint, field: &UncertaintyField) -> Result<Self> {
        let shared = field.correlation(a.position.as_vec3(), b.position.as_vec3());
        let correlation = shared * a.direction.dot(b.direction).clamp(-1.0, 1.0);
        let line = (b.position - a.position).normalize_or_zero();
        let [along_a, along_b] = [a, b].map(|point| point.deviation * point.direction.dot(line));
        let across = (a.pixel * a.pixel + b.pixel * b.pixel) / 12.0;
        let variance = along_a * along_a + along_b * along_b - 2.0 * correlation * along_a * along_b + across;
        if !variance.is_finite() {
            let expected = "ends whose depths have deviations";
            return Err(Error::setting("length", expected, format!("{} and {}", a.deviation, b.deviation)));
        }
        Ok(Self { length: a.position.distance(b.position), deviation: variance.max(0.0).sqrt(), correlation })
    }
}

#[cfg(test)]
mod tests {
    use octobayes::estimate::{Estimation, GridSettings, RaySettings};
    use octobayes::field::{ClosedForm, RadianceField};
    use octobayes::geometry::Domain;
    use octobayes::posterior::{Covariance, DataScale, Scale};

    use super::*;

    #[test]
    fn errors_count_along_the_line_and_once_where_they_are_common() {
        let (ball, cameras) = (ClosedForm::ball(), ClosedForm::half_circle(4, [32; 2]));
        let data = DataScale::from_cameras(&cameras, 0.03, &Domain::Box(ball.bounds())).unwrap();
        let grid = GridSettings::default().level(4).covariance(Covariance::Block).scale(Scale::Data(data));
        let rays = RaySettings::default().rays(4000).occupancy(32);
        let field = Estimation::new(&ball, &cameras).rays(rays).grid(grid).run().unwrap().field;
        let end = |position, direction, deviation, pixel| SurfacePoint {
            position,
            camera: 0,
            direction,
            deviation,
            pixel,
            trust: Trust::Trusted,
        };
        let between = |a: &SurfacePoint, b: &SurfacePoint| Length::between(a, b, &field).unwrap();
        let is = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
        // Several cells apart, no vertex is shared: the ends are independent, and count by the cosine with the line.
        let (a, b) = (DVec3::new(0.45, -0.3, 0.0), DVec3::new(0.45, 0.3, 0.0));
        let slanted = DVec3::new(-0.8, 0.6, 0.0);
        let found = between(&end(a, slanted, 0.1, 0.0), &end(b, -DVec3::X, 0.2, 0.0));
        assert!(found.correlation.abs() < 1e-9, "{found:?}");
        is(found.length, 0.6);
        is(found.deviation, 0.06);
        let both = between(&end(a, DVec3::Y, 0.03, 0.0), &end(b, -DVec3::Y, 0.04, 0.0));
        is(both.deviation, 0.05);
        // Across the views, a pixel's width is left.
        is(between(&end(a, DVec3::X, 0.1, 0.03), &end(b, DVec3::X, 0.2, 0.04)).deviation, 0.05 / 12_f64.sqrt());
        // Ends in one place move together, from whichever side they are seen: the length stays.
        let near = a + DVec3::Y * 1e-6;
        let same = between(&end(a, DVec3::Y, 0.1, 0.0), &end(near, DVec3::Y, 0.1, 0.0));
        assert!(same.correlation > 0.999 && same.deviation < 1e-3, "{same:?}");
        let against = between(&end(a, DVec3::Y, 0.1, 0.0), &end(near, -DVec3::Y, 0.1, 0.0));
        assert!(against.correlation < -0.999 && against.deviation < 1e-3, "{against:?}");
        let unknown = Length::between(&end(a, DVec3::Y, f64::NAN, 0.0), &end(b, DVec3::Y, 0.1, 0.0), &field);
        assert!(unknown.unwrap_err().to_string().contains("ends whose depths have deviations"));
    }
}
