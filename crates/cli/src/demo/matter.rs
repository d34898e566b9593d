//! What pictures of a field show, sample by sample, and what clean-up does to it.

use glam::Vec3;
use rayon::prelude::*;

use super::scene::Truth;
use octobayes::Result;
use octobayes::estimate::RaySettings;
use octobayes::field::RadianceField;
use octobayes::geometry::{Camera, Ray};
use octobayes::monitor::{Monitor, check};
use octobayes::render::{CompositingWeights, TraceBuffers};
use octobayes::uncertainty::{BakedField, Estimate, ThresholdedField};

/// Side of the pictures that are looked at, pixels.
const RESOLUTION: u32 = 60;
/// Maximal number of cameras, evenly spread over all.
const CAMERAS: usize = 8;
/// Smallest weight of a sample that counts; 1/256 would be one step of an 8-bit colour.
const LEAST_WEIGHT: f64 = 1e-3;
/// Cells per axis of the occupancy grid. These pictures are too small for a finer one to pay.
const OCCUPANCY: usize = 64;

/// Matter that pictures show: all samples of their rays.
pub struct Matter(Vec<Sample>);

struct Sample {
    /// Share of its pixel.
    weight: f64,
    position: Vec3,
    log10: f64,
}

impl Matter {
    /// What some of `cameras` see of `field`, with log10 U.
    pub fn seen(
        field: &dyn RadianceField,
        cameras: &[Camera],
        uncertainty: &BakedField,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        let settings = RaySettings::default().cutoff(1e-4).occupancy(OCCUPANCY);
        let tracer = settings.tracer(field, 0.0, monitor)?;
        let used = cameras.len().min(CAMERAS);
        let rows: Vec<(Camera, u32)> = (0..used)
            .map(|i| cameras[i * cameras.len() / used].resized([RESOLUTION; 2]))
            .flat_map(|camera| (0..RESOLUTION).map(move |y| (camera, y)))
            .collect();
        let samples: Vec<Vec<Sample>> = rows
            .par_iter()
            .map(|(camera, y)| {
                check(monitor)?;
                let center = |x: u32| camera.ray(f64::from(x) + 0.5, f64::from(*y) + 0.5);
                let rays: Vec<Ray> = (0..RESOLUTION).map(center).collect();
                let mut buffers = TraceBuffers::default();
                tracer.trace(&rays, &vec![0.5; rays.len()], &mut buffers);
                let mut quadrature = CompositingWeights::default();
                quadrature.set(&buffers.traced, tracer.marcher.step);
                let weighted = quadrature.weights.iter().zip(&buffers.traced.positions);
                let counted = weighted.filter(|(weight, _)| **weight >= LEAST_WEIGHT);
                let (weights, positions): (Vec<f64>, Vec<Vec3>) = counted.map(|(w, x)| (*w, *x)).unzip();
                let estimates = uncertainty.query_all(&positions);
                let sample = |((weight, position), found): ((f64, Vec3), Estimate)| Sample {
                    weight,
                    position,
                    log10: found.uncertainty.log10(),
                };
                Ok(weights.into_iter().zip(positions).zip(estimates).map(sample).collect())
            })
            .collect::<Result<_>>()?;
        Ok(Self(samples.into_iter().flatten().collect()))
    }

    /// Sum of the weights of some of the samples.
    fn weight(&self, counts: impl Fn(&Sample) -> bool) -> f64 {
        self.0.iter().filter(|sample| counts(sample)).map(|sample| sample.weight).sum()
    }
}

/// A clean-up, measured against the truth.
#[derive(Debug, Clone, Copy)]
pub struct Shares {
    /// Share of what is visible from the seen side that is made up.
    pub made_up_seen: f64,
    /// Share of what is visible from behind that is made up.
    pub made_up_behind: f64,
    /// Share of the made-up matter visible from behind that clean-up removes. What becomes visible behind removed
    /// matter counts as not removed.
    pub removed: f64,
    /// Share of the true surface visible from the seen side that clean-up keeps.
    pub kept: f64,
}

impl Shares {
    /// Measures the clean-up of `model`.
    pub fn measure(model: &ThresholdedField, truth: &Truth, monitor: &dyn Monitor) -> Result<Self> {
        let (field, uncertainty, threshold) = (model.uncleaned(), model.uncertainty(), model.threshold());
        let made_up = |sample: &Sample| !truth.has_matter_near(sample.position);
        let [seen, behind] =
            [&truth.held_out, &truth.behind].map(|cameras| Matter::seen(field, cameras, uncertainty, monitor));
        let (seen, behind) = (seen?, behind?);
        let cleaned = Matter::seen(model, &truth.behind, uncertainty, monitor)?;
        let all = |matter: &Matter| matter.weight(|_| true);
        let real = seen.weight(|sample| !made_up(sample));
        Ok(Self {
            made_up_seen: seen.weight(made_up) / all(&seen),
            made_up_behind: behind.weight(made_up) / all(&behind),
            removed: 1.0 - cleaned.weight(made_up) / behind.weight(made_up),
            kept: seen.weight(|sample| !made_up(sample) && sample.log10 <= threshold) / real,
        })
    }
}
