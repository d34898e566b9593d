//! How far the depth of a pixel may be off: a standard deviation.
//!
//! Letters: s the spread of the ray's weights ([`RenderedView::spread`]); t the median depth; U the uncertainty at the
//! expected depth, and h the edge of a cube that has the volume of a finest cell there; b how far from the median depth
//! the training images agree best ([`Sweep`]), with half a step for what a sweep cannot tell apart; e pixels to an edge
//! of the depth map; p the width of a pixel of the training images at the depth t; k a factor of the kind of model.
//!
//! σ² = σ₀² + (p / 2)², as images do not fix a depth better than to a part of a pixel, however sure the model is, and
//!
//! - from the field alone: σ₀ = k √(s U′).
//! - With the training images: σ₀ = k s^0.34 U′^0.48 b^0.18 (1 + e)^−0.09.
//!
//! U′ = U (200 h / t)^(3/2) is U for cells as wide as 1/200 of the distance, about a pixel of the images on which the
//! factors were fitted: a vertex gathers the rays of a volume, so that U is proportional to h^(−3/2) where images
//! determine it. There σ hardly depends on the level and on the size of the box. The exponents of lengths add up to
//! one, so that σ has the unit of the scene whatever that is. They were fitted by the likelihood of errors on two
//! meshes, and hold on others, where σ ranks errors better than the default does; on lego and a kitchen σ is too small
//! (`experiments/depth.md`).

use glam::{DMat3, DVec3, Vec3};
use octobayes::geometry::{Camera, Domain, Ray};
use octobayes::monitor::Monitor;
use octobayes::posterior::Scale;
use octobayes::render::{Pixel, RenderedView, Renderer};
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};

use super::Sweep;
use super::edges::pixels_to_edge;

/// The level of the fields on which the factors were fitted.
pub const LEVEL: u8 = 7;

/// Deviations within which nine of ten errors lie, if they are normal.
pub const NINETY: f64 = 1.645;

/// Distances in cells of U′.
const CELLS: f64 = 200.0;

/// A jump of the depth is a change by more than this share of the nearer depth.
pub const DEPTH_JUMP: f64 = 0.025;

/// Exponents of s, U, b and 1 + e.
const EXPONENTS: [f64; 4] = [0.34, 0.48, 0.18, -0.09];

/// k of volumes and of other models: from the field alone, and with the training images.
const FACTORS: [[f64; 2]; 2] = [[1.1, 1.25], [0.85, 1.0]];

/// What σ from the field alone depends on beside a ray: for pages, which compute it themselves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldFactors {
    /// k.
    pub factor: f64,
    /// Distances in cells of U′.
    pub cells: f64,
    /// h in the middle of the field's domain, scene units.
    pub cell: f64,
    /// p of a distance of 1; 0 if the field does not know it.
    pub pixel_angle: f64,
}

impl FieldFactors {
    /// Those of a field of a volume or of another kind of model; `None` in the paper's scale, in which deviations are
    /// no lengths.
    #[must_use]
    pub fn new(field: &UncertaintyField, is_volume: bool) -> Option<Self> {
        let Scale::Data(_) = field.record().scale else { return None };
        let [factor, _] = FACTORS[usize::from(!is_volume)];
        let middle = match field.lattice().domain() {
            Domain::Box(bounds) => 0.5 * (bounds.min() + bounds.max()).as_vec3(),
            Domain::Contracted { center, .. } => Vec3::from_array(center.map(|v| v as f32)),
        };
        // Of samples from elsewhere it is not known, and left out.
        let pixel_angle = field.record().pixel_angle.unwrap_or(0.0);
        Some(Self { factor, cells: CELLS, cell: cell_edge(field, middle), pixel_angle })
    }
}

/// h: the edge of a cube that has the volume of a finest cell of a field at a point. The unit cube has cells of one
/// size, and Φ maps the scene to it.
fn cell_edge(field: &UncertaintyField, x: Vec3) -> f64 {
    let lattice = field.lattice();
    let [i, j, k] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| lattice.domain().pull_back(x, axis));
    1.0 / (f64::from(lattice.cells_per_axis()) * DMat3::from_cols(i, j, k).determinant().abs().cbrt())
}

/// How far depths of a model may be off.
pub struct DepthDeviation<'a> {
    field: &'a BakedField<'a>,
    images: Option<Sweep<'a>>,
}

impl<'a> DepthDeviation<'a> {
    /// Deviations by a field, and by training images if they are there.
    ///
    /// # Errors
    /// If the field is in the paper's scale, in which deviations are no lengths.
    pub fn new(field: &'a BakedField<'a>, images: Option<Sweep<'a>>) -> Result<Self> {
        let Scale::Data(_) = field.field().record().scale else {
            let expected = "a field in the scale of its data, in which U is a length (`uncertainty --for depth`)";
            return Err(Error::setting("scale", expected, "one in the paper's scale"));
        };
        Ok(Self { field, images })
    }

    /// Whether training images are counted.
    #[must_use]
    pub fn has_images(&self) -> bool {
        self.images.is_some()
    }

    /// `[height · width]`: σ of the median depth of every pixel of a camera's view, scene units; NaN where nothing is
    /// shown. Advances the monitor by one per row if there are training images.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    pub fn of_view(
        &self,
        renderer: &dyn Renderer,
        camera: &Camera,
        pixel_offset: f64,
        view: &RenderedView,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>> {
        let terms = self.terms(renderer, camera, pixel_offset, view, monitor)?;
        Ok(self.of_terms(renderer, &terms, view))
    }

    /// `[rays]`: σ of the median depth of single rays, rendered as one row, from the field alone; NaN as in views.
    #[must_use]
    pub fn of_rays(&self, renderer: &dyn Renderer, rays: &[Ray], view: &RenderedView) -> Vec<f64> {
        let u = self.uncertainty_of_cells(renderer, |i| rays[i], view);
        let terms = |(i, pixel): (usize, &Pixel)| {
            if pixel.opacity > 0.0 { [view.spread[i], u[i], f64::NAN, f64::NAN] } else { [f64::NAN; 4] }
        };
        let terms: Vec<[f64; 4]> = view.pixels.iter().enumerate().map(terms).collect();
        Self { field: self.field, images: None }.of_terms(renderer, &terms, view)
    }

    /// σ from [terms](Self::terms).
    #[doc(hidden)]
    #[must_use]
    pub fn of_terms(&self, renderer: &dyn Renderer, terms: &[[f64; 4]], view: &RenderedView) -> Vec<f64> {
        // Of samples from elsewhere it is not known, and left out.
        let angle = self.field.field().record().pixel_angle.unwrap_or(0.0);
        let [alone, with_images] = FACTORS[usize::from(renderer.marched().is_none())];
        let sigma = |(terms, pixel): (&[f64; 4], &Pixel)| {
            let of_model = match self.images {
                None => alone * (terms[0] * terms[1]).sqrt(),
                Some(_) => with_images * (0..4).map(|k| terms[k].powf(EXPONENTS[k])).product::<f64>(),
            };
            of_model.hypot(0.5 * angle * pixel.median_depth)
        };
        terms.iter().zip(&view.pixels).map(sigma).collect()
    }

    /// `[height · width]`: s, U′, b and 1 + e; b and e are left out without training images. NaN where nothing is
    /// shown.
    ///
    /// # Errors
    /// [`Error::Interrupted`] only.
    #[doc(hidden)]
    pub fn terms(
        &self,
        renderer: &dyn Renderer,
        camera: &Camera,
        pixel_offset: f64,
        view: &RenderedView,
        monitor: &dyn Monitor,
    ) -> Result<Vec<[f64; 4]>> {
        let width = view.resolution[0] as usize;
        let ray = |i: usize| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + pixel_offset);
            camera.ray(x, y)
        };
        let u = self.uncertainty_of_cells(renderer, ray, view);
        let agreement = self.images.map(|sweep| sweep.of_view(camera, pixel_offset, view, monitor)).transpose()?;
        let edges = self.images.map(|_| pixels_to_edge(view, DEPTH_JUMP));
        let of = |(i, pixel): (usize, &Pixel)| {
            if pixel.opacity == 0.0 {
                return [f64::NAN; 4];
            }
            let b = agreement.as_ref().map_or(f64::NAN, |b| b[i] + 0.5 * Sweep::STEP * pixel.median_depth);
            [view.spread[i], u[i], b, edges.as_ref().map_or(f64::NAN, |edges| 1.0 + f64::from(edges[i]))]
        };
        Ok(view.pixels.iter().enumerate().map(of).collect())
    }

    /// `[rays]`: U′ at the expected depth of every ray of a view.
    fn uncertainty_of_cells(
        &self,
        renderer: &dyn Renderer,
        ray: impl Fn(usize) -> Ray,
        view: &RenderedView,
    ) -> Vec<f64> {
        let bounds = renderer.bounds();
        let expected = |(i, pixel): (usize, &Pixel)| bounds.clamp(ray(i).at(pixel.expected_depth).as_vec3());
        let points: Vec<Vec3> = view.pixels.iter().enumerate().map(expected).collect();
        let found = self.field.query_all(&points);
        let u = |(i, pixel): (usize, &Pixel)| {
            let cell = cell_edge(self.field.field(), points[i]);
            found[i].uncertainty * (CELLS * cell / pixel.median_depth).powf(1.5)
        };
        view.pixels.iter().enumerate().map(u).collect()
    }
}

#[cfg(test)]
mod tests {
    use octobayes::estimate::{Estimation, GridSettings, RaySettings};
    use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField};
    use octobayes::geometry::Aabb;
    use octobayes::monitor::Silent;
    use octobayes::posterior::{Covariance, DataScale};
    use octobayes::render::{Marcher, Tracer, VolumeRenderer};

    use super::*;

    /// A ball in other units, in a box that is larger by `around`.
    struct Scaled {
        ball: ClosedForm,
        scale: f32,
        around: f64,
    }

    impl RadianceField for Scaled {
        fn bounds(&self) -> Aabb {
            let half = f64::from(self.scale) * self.around * 0.5 * self.ball.bounds().longest_edge();
            Aabb::centered_cube(half)
        }

        fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
            let positions: Vec<Vec3> = positions.iter().map(|x| *x / self.scale).collect();
            self.ball.evaluate(&positions, directions, out);
            out.iter_mut().for_each(|found| found.density /= self.scale);
        }

        fn suggested_step(&self) -> f64 {
            f64::from(self.scale) * 0.01
        }

        fn memory(&self) -> usize {
            0
        }
    }

    impl TrainedField for Scaled {
        fn describe(&self) -> String {
            "a ball".into()
        }
    }

    /// √(s U′) of a view of a ball, of which σ₀ is a multiple: half a pixel would hide how it varies.
    fn deviations(scale: f32, around: f64, level: u8) -> Vec<f64> {
        let ball = Scaled { ball: ClosedForm::ball(), scale, around };
        let eye = |azimuth: f64| 3.0 * f64::from(scale) * DVec3::new(azimuth.cos(), azimuth.sin(), 0.2);
        let camera = |azimuth| Camera::look_at(eye(azimuth), DVec3::ZERO, DVec3::Z, 0.5, [96; 2]);
        let cameras = [-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9].map(camera);
        let domain = Domain::Box(ball.bounds());
        let data = DataScale::from_cameras(&cameras, 0.01, &domain).unwrap();
        let grid = GridSettings::default().level(level).covariance(Covariance::Block).scale(Scale::Data(data));
        let rays = RaySettings::default().rays(400_000).occupancy(32);
        let field = Estimation::new(&ball, &cameras).rays(rays).grid(grid).run().unwrap().field;
        let marcher = Marcher { step: ball.suggested_step(), bounds: ball.bounds(), occupancy: None, cutoff: 0.0 };
        let tracer = Tracer { field: &ball, marcher, background: Vec3::ONE };
        let renderer = VolumeRenderer { tracer, differentiation: None };
        let view = renderer.image(&cameras[3], 0.5, &[], &Silent).unwrap();
        let baked = BakedField::unbaked(&field);
        let deviation = DepthDeviation::new(&baked, None).unwrap();
        let terms = deviation.terms(&renderer, &cameras[3], 0.5, &view, &Silent).unwrap();
        let found = deviation.of_view(&renderer, &cameras[3], 0.5, &view, &Silent).unwrap();
        let of_field: Vec<f64> = terms.iter().map(|[s, u, ..]| (s * u).sqrt()).collect();
        // Half a pixel of the training cameras beside it, for all pixels that show something.
        for ((found, own), pixel) in found.iter().zip(&of_field).zip(&view.pixels).filter(|(_, p)| p.opacity > 0.0) {
            let half = 0.5 * pixel.median_depth / cameras[0].focal[0];
            let expected = ((1.1 * own).powi(2) + half * half).sqrt();
            assert!((found / expected - 1.0).abs() < 1e-12, "{found} instead of {expected}");
        }
        of_field
    }

    fn median_ratio(a: &[f64], b: &[f64]) -> f64 {
        let mut ratios: Vec<f64> = a.iter().zip(b).map(|(a, b)| a / b).filter(|ratio| ratio.is_finite()).collect();
        assert!(ratios.len() > 100, "{} pixels show the ball", ratios.len());
        ratios.sort_unstable_by(f64::total_cmp);
        ratios[ratios.len() / 2]
    }

    #[test]
    fn sigma_has_the_unit_of_the_scene_and_hardly_depends_on_box_and_level_where_images_determine_u() {
        let plain = deviations(1.0, 1.0, 6);
        // All lengths a thousand times larger: the same but for rounding of f32, as the rays are the same.
        let ratio = median_ratio(&deviations(1024.0, 1.0, 6), &plain);
        assert!((ratio / 1024.0 - 1.0).abs() < 0.01, "{ratio}");
        // Cells of twice the edge, by a box of twice the edge or by a level less: without the conversion of U, σ would
        // be 2^(-3/4) = 0.59 of that.
        let wider = median_ratio(&deviations(1.0, 2.0, 6), &plain);
        let coarser = median_ratio(&deviations(1.0, 1.0, 5), &plain);
        assert!((0.8..1.25).contains(&wider) && (0.8..1.25).contains(&coarser), "{wider} {coarser}");
    }

    #[test]
    fn deviations_need_lengths() {
        let (ball, cameras) = (ClosedForm::ball(), ClosedForm::half_circle(2, [16; 2]));
        let rays = RaySettings::default().rays(2000).occupancy(32);
        let field = Estimation::new(&ball, &cameras).rays(rays).grid(GridSettings::default().level(4)).run();
        let field = field.unwrap().field;
        let baked = BakedField::unbaked(&field);
        let refused = DepthDeviation::new(&baked, None).err().unwrap().to_string();
        assert!(refused.contains("the scale of its data"), "{refused}");
    }
}
