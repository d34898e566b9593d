//! What a removal takes, and what it does to held-out images.

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use serde::{Deserialize, Serialize};

use common::recall::recall_at;
use common::surface::Place;

/// What is known of a scene.
pub struct Truth {
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
    /// Share of all parts that go.
    pub share: f64,
    /// Of those that are judged and go, the share in the air; `None` if none goes.
    pub precision: Option<f64>,
    /// Of those in the air, the share that goes.
    pub recall: f64,
}

impl Figures {
    /// Of parts that count alike.
    pub fn new(removed: &[bool], places: &[Place]) -> Self {
        Self::weighted(removed, places, &vec![1.0; places.len()])
    }

    /// Of parts that count as much as their weights.
    pub fn weighted(removed: &[bool], places: &[Place], weights: &[f64]) -> Self {
        let sum = |is: &dyn Fn(Place, bool) -> bool| -> f64 {
            let all = places.iter().zip(removed).zip(weights);
            all.filter(|((place, gone), _)| is(**place, **gone)).fold(0.0, |sum, (_, weight)| sum + weight)
        };
        let is_judged = |place: Place| place != Place::Elsewhere;
        let hits = sum(&|place, gone| gone && place == Place::Air);
        let (all, in_air) = (sum(&|place, gone| gone && is_judged(place)), sum(&|place, _| place == Place::Air));
        Self {
            share: sum(&|_, gone| gone) / weights.iter().sum::<f64>(),
            precision: (all > 0.0).then(|| hits / all),
            recall: if in_air > 0.0 { hits / in_air } else { 0.0 },
        }
    }
}

/// [`recall_at`] of what is in the air, among judged splats.
pub fn air_at(precision: f64, score: &[f64], places: &[Place]) -> f64 {
    let (score, is_air) = judged(score, places);
    recall_at(precision, &score, &is_air)
}

/// The scores of judged splats, and whether each is in the air.
pub fn judged(score: &[f64], places: &[Place]) -> (Vec<f64>, Vec<bool>) {
    let judged = score.iter().zip(places).filter(|(_, place)| **place != Place::Elsewhere);
    judged.map(|(score, place)| (*score, *place == Place::Air)).unzip()
}

/// Held-out images of a model beside the truth.
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
    pub fn of(model: &dyn Model, truth: &Truth) -> Result<Self> {
        let renderer = model.for_images(&RaySettings::for_images().background(Vec3::ONE), &Silent)?;
        let mut sums = [0.0; 7];
        for view in &truth.held_out {
            let [width, height] = view.camera.resolution;
            let image = renderer.image(&view.camera, 0.5, &[], &Silent)?;
            let at = |i: u32| [i % width, i / width].map(|v| f64::from(v) + 0.5);
            let samples = renderer.weighted(&[(view.camera, (0..width * height).map(at).collect())], &Silent)?;
            for (i, pixel) in image.pixels.iter().enumerate() {
                let distance = view.distances[i];
                let nearer = samples.samples(i).filter(|&k| samples.t[k] < distance - truth.slack);
                let floating: f64 = nearer.map(|k| samples.weights[k]).sum();
                let error = (pixel.color.min(DVec3::ONE) - view.colors[i]).length_squared() / 3.0;
                let mut of_pixel = [error, floating, 1.0, 0.0, 0.0, 0.0, 0.0];
                if view.is_object[i] {
                    (of_pixel[3], of_pixel[4]) = (pixel.opacity, 1.0);
                    if pixel.opacity >= 0.5 {
                        (of_pixel[5], of_pixel[6]) = ((pixel.median_depth - distance).abs() / truth.length, 1.0);
                    }
                }
                sums.iter_mut().zip(of_pixel).for_each(|(sum, value)| *sum += value);
            }
        }
        let [error, floating, pixels, light, of_object, depth, solid] = sums;
        Ok(Self {
            psnr: -10.0 * (error / pixels).log10(),
            floating: floating / pixels,
            coverage: light / of_object,
            depth: depth / solid,
        })
    }
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
        let found = Figures::weighted(&[true, false, true, true, false], &places, &[3.0, 1.0, 2.0, 4.0, 0.0]);
        assert_eq!((found.share, found.precision, found.recall), (0.9, Some(0.6), 0.75));
        // The one elsewhere has the largest score and does not count; equal scores are marked together.
        assert_eq!(air_at(0.9, &[3.0, 1.0, 1.0, 9.0, 0.0], &places), 0.5);
        assert_eq!(air_at(0.6, &[3.0, 1.0, 1.0, 9.0, 0.0], &places), 1.0);
    }
}
