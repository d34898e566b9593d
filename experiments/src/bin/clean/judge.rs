//! What a removal takes, and what it does to held-out images.

use glam::{DVec3, Vec3};
use octobayes::geometry::Camera;
use octobayes::render::Outputs;
use octobayes_splats::{Hits, SplatRenderer, SplatView, Splats};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use common::recall::recall_at;
use common::surface::Place;

/// A model beside what is known of its scene.
pub struct Judged {
    pub splats: Splats,
    /// Those of its training.
    pub cameras: Vec<Camera>,
    /// Where each splat is.
    pub places: Vec<Place>,
    pub held_out: Vec<TrueView>,
    /// What is nearer than the true surface by more than this is in front of it, scene units.
    pub slack: f64,
    /// Length of the object, scene units.
    pub length: f64,
}

/// A held-out view; lists are `[height · width]`.
pub struct TrueView {
    pub camera: Camera,
    /// Colours in front of white.
    pub colors: Vec<DVec3>,
    /// Distance along the ray, scene units; infinite where nothing is.
    pub distances: Vec<f64>,
    /// Whether the pixel shows the object, not its ground.
    pub is_object: Vec<bool>,
}

/// How a removal does.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Figures {
    /// Share of all splats that go.
    pub share: f64,
    /// Of those that are judged and go, the share in the air; NaN if none goes.
    pub precision: Option<f64>,
    /// Of those in the air, the share that goes.
    pub recall: f64,
}

impl Figures {
    pub fn new(removed: &[bool], places: &[Place]) -> Self {
        let count = |is: &dyn Fn(Place, bool) -> bool| {
            let judged = places.iter().zip(removed).filter(|(place, _)| **place != Place::Elsewhere);
            judged.filter(|(place, gone)| is(**place, **gone)).count() as f64
        };
        let (hits, all) = (count(&|place, gone| gone && place == Place::Air), count(&|_, gone| gone));
        Self {
            share: removed.iter().filter(|gone| **gone).count() as f64 / removed.len() as f64,
            precision: (all > 0.0).then(|| hits / all),
            recall: hits / count(&|place, _| place == Place::Air).max(1.0),
        }
    }
}

/// [`recall_at`] of what is in the air, among judged splats.
pub fn air_at(precision: f64, score: &[f64], places: &[Place]) -> f64 {
    let judged = score.iter().zip(places).filter(|(_, place)| **place != Place::Elsewhere);
    let (score, is_air): (Vec<f64>, Vec<bool>) = judged.map(|(score, place)| (*score, *place == Place::Air)).unzip();
    recall_at(precision, &score, &is_air)
}

/// Held-out images of splats beside the truth.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Images {
    /// dB, of all pixels together.
    pub psnr: f64,
    /// Mean light in front of the true surface.
    pub floating: f64,
    /// Mean light of pixels of the object.
    pub coverage: f64,
    /// Mean error of the distance in lengths of the object, in pixels of it that have half of their light or more.
    pub depth: f64,
}

impl Images {
    pub fn of(splats: &Splats, judged: &Judged) -> Self {
        let renderer = SplatRenderer::new(splats, Vec3::ONE);
        let mut sums = [0.0; 7];
        for truth in &judged.held_out {
            let view = renderer.prepare(&truth.camera, Outputs::Colors);
            let mut colors = vec![DVec3::ZERO; splats.len()];
            view.colors().for_each(|(splat, color)| colors[splat] = color);
            let [width, height] = truth.camera.resolution;
            let of_row = |y: u32| {
                let mut sums = [0.0; 7];
                for x in 0..width {
                    let of_pixel = pixel(judged, truth, &view, &colors, [x, y]);
                    sums.iter_mut().zip(of_pixel).for_each(|(sum, value)| *sum += value);
                }
                sums
            };
            for row in (0..height).into_par_iter().map(of_row).collect::<Vec<_>>() {
                sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            }
        }
        let [error, floating, pixels, light, of_object, depth, solid] = sums;
        Self {
            psnr: -10.0 * (error / pixels).log10(),
            floating: floating / pixels,
            coverage: light / of_object,
            depth: depth / solid,
        }
    }
}

/// Squared error of the colour, light in front of the surface, 1; where the object is, light, 1; and where half of it
/// or more is reached, error of the distance in the object's lengths, 1.
fn pixel(judged: &Judged, truth: &TrueView, view: &SplatView, colors: &[DVec3], [x, y]: [u32; 2]) -> [f64; 7] {
    let at = [x, y].map(|i| f64::from(i) + 0.5);
    let mut hits = Hits::default();
    view.hits(at, &mut hits);
    let ray = truth.camera.ray(at[0], at[1]);
    let i = (y * truth.camera.resolution[0] + x) as usize;
    let distance = truth.distances[i];
    // Depths of splats are along the view axis.
    let slant = truth.camera.project(ray.origin + ray.direction).map_or(1.0, |(_, depth)| depth);
    let mut color = DVec3::splat(hits.passed);
    let mut floating = 0.0;
    for hit in &hits.list {
        color += hit.weight() * colors[view.splat(hit)];
        floating += if view.depth(hit) / slant < distance - judged.slack { hit.weight() } else { 0.0 };
    }
    let error = (color.min(DVec3::ONE) - truth.colors[i]).length_squared() / 3.0;
    if !truth.is_object[i] {
        return [error, floating, 1.0, 0.0, 0.0, 0.0, 0.0];
    }
    let light = 1.0 - hits.passed;
    let [depth, is_solid] =
        if light < 0.5 { [0.0; 2] } else { [(view.half_depth(&hits) / slant - distance).abs() / judged.length, 1.0] };
    [error, floating, 1.0, light, 1.0, depth, is_solid]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_leave_out_what_is_not_judged() {
        use Place::{Air, Elsewhere, Inside, Surface};
        let places = [Air, Air, Surface, Elsewhere, Inside];
        let found = Figures::new(&[true, false, false, true, true], &places);
        assert_eq!((found.share, found.precision, found.recall), (0.6, Some(0.5), 0.5));
        assert_eq!(Figures::new(&[false; 5], &places).precision, None);
        // The one elsewhere has the largest score and does not count; equal scores are marked together.
        assert_eq!(air_at(0.9, &[3.0, 1.0, 1.0, 9.0, 0.0], &places), 0.5);
        assert_eq!(air_at(0.6, &[3.0, 1.0, 1.0, 9.0, 0.0], &places), 1.0);
    }
}
