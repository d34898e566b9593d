//! The state of a training run, and one step of it.

use std::path::Path;
use std::time::Duration;

use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::adam::Adam;
use super::batch::{GROUP, GroupGradient, Scene, group};
use super::occupancy::{INTERVAL, OccupancyGrid};
use super::{Quality, Shot, TrainSettings, Training, quality, quality_within};
use octobayes::geometry::{Camera, Domain};
use octobayes::rays::{PixelSequence, Pixels};
use octobayes::{Error, Result};
use octobayes_models::HashGrid;
use octobayes_models::hash_grid::{
    Encoding, Entry, N_FEATURES_PER_LEVEL, N_LEVELS, Network, Parameters, Space, Transposed,
};

/// Range of the initial features.
const FEATURE_RANGE: f32 = 1e-4;
/// Maximal number of rays per step: more would go through the same few samples.
pub(super) const MAX_RAYS: u64 = 1 << 14;

/// Adam's moments: running means of the gradients and of their squares.
pub(super) struct Moments<T> {
    pub mean: T,
    pub square: T,
}

/// Results of a step, from before it changed the parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReport {
    /// Mean loss of a ray.
    pub loss: f64,
    /// Mean squared error of colour, averaged over channels.
    pub squared_error: f64,
    /// Number of rays of the step.
    pub rays: u64,
    /// Number of samples of these rays.
    pub samples: u64,
}

/// A training run in progress.
pub struct Trainer<'a> {
    pub(super) settings: TrainSettings,
    pub(super) space: Space,
    shots: &'a [Shot],
    pixels: PixelSequence,
    pub(super) parameters: Parameters,
    pub(super) table_moments: Moments<Vec<Entry>>,
    pub(super) network_moments: Moments<Box<Network>>,
    /// Gradient of the table; zero between steps.
    gradient: Vec<Entry>,
    pub(super) occupancy: OccupancyGrid,
    /// Number of steps so far.
    pub(super) steps: u64,
    /// Number of rays so far.
    pub(super) rays: u64,
    /// Number of rays of the next step.
    pub(super) rays_per_step: u64,
}

impl Training for Trainer<'_> {
    fn steps(&self) -> u64 {
        self.steps
    }

    fn advance(&mut self, share: f64) -> Result<[f64; 2]> {
        let step = self.step(share);
        self.check_step(&step)?;
        Ok([step.loss, step.squared_error])
    }

    fn check(&self) -> Result<()> {
        let is_finite = self.parameters.encoding.table.iter().flatten().all(|v| v.is_finite());
        if is_finite { Ok(()) } else { Err(self.diverged("features of the grid are not finite")) }
    }

    fn save(&self, path: &Path, key: &str, elapsed: f64) -> Result<()> {
        Trainer::save(self, path, key, elapsed)
    }

    fn look(&self, shots: &[Shot], pixels: usize, within: Option<Duration>) -> Option<Quality> {
        let (field, background) = (self.field(serde_json::Value::Null), self.settings.background.for_images());
        match within {
            None => quality(&field, shots, background, pixels),
            Some(allowance) => quality_within(&field, shots, background, pixels, allowance),
        }
    }
}

impl<'a> Trainer<'a> {
    /// Starts a run with random weights; every cell that a camera sees is occupied.
    ///
    /// # Errors
    /// If the settings are invalid.
    ///
    /// # Panics
    /// If there are no shots.
    pub fn new(settings: TrainSettings, domain: Domain, shots: &'a [Shot]) -> Result<Self> {
        assert!(!shots.is_empty(), "no images to train on");
        let config = settings.config.checked()?;
        let space = Space::new(domain)?;
        let cameras: Vec<Camera> = shots.iter().map(|shot| shot.camera).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let levels = Encoding::levels_of(&config);
        let entries = Encoding::entries(&levels);
        let mut random = |range: f32| rng.random_range(-range..range);
        let table = (0..entries).map(|_| std::array::from_fn(|_| random(FEATURE_RANGE))).collect();
        let mut network = Network::zero();
        // Xavier's uniform initialisation (Glorot, Bengio, 2010).
        for ((_, [inputs, outputs]), layer) in octobayes_models::hash_grid::LAYERS.iter().zip(network.layers_mut()) {
            let range = (6.0 / (inputs + outputs) as f32).sqrt();
            layer.fill_with(|| random(range));
        }
        network.clear_padding();
        let zero = || vec![[0.0; N_FEATURES_PER_LEVEL]; entries];
        Ok(Self {
            settings,
            space,
            shots,
            pixels: PixelSequence::masked(
                Pixels::Sobol,
                settings.seed,
                cameras.iter().map(|camera| camera.resolution).collect(),
                shots.iter().map(|shot| shot.mask.clone()).collect(),
            ),
            parameters: Parameters { encoding: Encoding::new(&config, table), network },
            table_moments: Moments { mean: zero(), square: zero() },
            network_moments: Moments { mean: Box::new(Network::zero()), square: Box::new(Network::zero()) },
            gradient: zero(),
            occupancy: OccupancyGrid::new(config.occupancy, &space, &cameras),
            steps: 0,
            rays: 0,
            rays_per_step: 2 * GROUP,
        })
    }

    /// Number of steps so far.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Number of rays so far.
    #[must_use]
    pub fn rays(&self) -> u64 {
        self.rays
    }

    /// Refuses a step whose loss is not finite, or that left weights of the networks that are not. Both are needed:
    /// where density is not a number nothing is occupied, and the loss is that of empty space.
    ///
    /// # Errors
    /// If that is so.
    pub(super) fn check_step(&self, step: &StepReport) -> Result<()> {
        if !step.loss.is_finite() {
            return Err(self.diverged(&format!("the loss is {}", step.loss)));
        }
        let is_finite = self.parameters.network.layers().iter().all(|layer| layer.iter().all(|v| v.is_finite()));
        if is_finite { Ok(()) } else { Err(self.diverged("weights of the networks are not finite")) }
    }

    /// The error of a run whose loss or parameters are no longer finite.
    pub(super) fn diverged(&self, what: &str) -> Error {
        let TrainSettings { learning_rate, .. } = TrainSettings::default();
        let expected = format!("a rate at which loss and parameters stay finite, such as the default {learning_rate}");
        let found = format!("{}, with which {what} at step {}", self.settings.learning_rate, self.steps);
        Error::setting("learning rate", expected, found)
    }

    /// Returns the field in its present state, with `training` as its description.
    #[must_use]
    pub fn field(&self, training: serde_json::Value) -> HashGrid {
        HashGrid::new(
            self.settings.config,
            self.space,
            self.parameters.clone(),
            self.occupancy.occupied().to_vec(),
            training,
        )
        .with_training_cameras(self.shots.iter().map(Shot::named_camera).collect())
    }

    /// Takes one step; `progress` in `[0, 1]` is the share of the run that is done, for the learning rate.
    ///
    /// The result does not depend on the number of threads: groups of rays are summed in order, and each level of
    /// the grid is summed by one thread.
    pub fn step(&mut self, progress: f64) -> StepReport {
        if self.steps > 0 && self.steps.is_multiple_of(INTERVAL) {
            self.occupancy.update(&self.parameters, self.settings.seed, self.steps / INTERVAL - 1);
        }
        let groups = self.gradients();
        let samples: u64 = groups.iter().map(|group| group.u.len() as u64).sum();
        let rays = self.rays_per_step;
        let mean = |sum: f64| sum / rays as f64;
        let report = StepReport {
            loss: mean(groups.iter().map(|group| group.loss).sum()),
            squared_error: mean(groups.iter().map(|group| group.squared_error).sum::<f64>() / 3.0),
            rays,
            samples,
        };
        self.steps += 1;
        self.rays += rays;
        self.descend(&groups, progress);
        // As many rays as would fill the budget if they were like these, changed at most by a factor of two.
        let fitting = u128::from(rays) * u128::from(self.settings.samples_per_step) / u128::from(samples.max(1));
        let fitting = (fitting as u64).clamp(rays / 2, 2 * rays).clamp(GROUP, MAX_RAYS);
        self.rays_per_step = fitting.next_multiple_of(GROUP);
        report
    }

    /// Forward and backward pass for the rays of this step.
    fn gradients(&self) -> Vec<GroupGradient> {
        let transposed = Transposed::new(&self.parameters.network);
        let scene = Scene {
            shots: self.shots,
            pixels: &self.pixels,
            space: &self.space,
            occupancy: &self.occupancy,
            parameters: &self.parameters,
            transposed: &transposed,
            background: self.settings.background,
            distortion: self.settings.distortion,
            seed: self.settings.seed,
        };
        (0..self.rays_per_step / GROUP).into_par_iter().map(|g| group(&scene, self.rays + g * GROUP, GROUP)).collect()
    }

    fn descend(&mut self, groups: &[GroupGradient], progress: f64) {
        let rate = self.settings.learning_rate * self.settings.final_rate.powf(progress.clamp(0.0, 1.0) as f32);
        let adam = Adam::new(rate, self.steps);
        let mut sum = Network::zero();
        groups.iter().for_each(|group| sum += &group.weights);
        let network = self.parameters.network.layers_mut().into_iter().zip(sum.layers());
        let moments = self.network_moments.mean.layers_mut().into_iter().zip(self.network_moments.square.layers_mut());
        for ((weights, gradients), (mean, square)) in network.zip(moments) {
            adam.update(weights, gradients, mean, square);
        }

        let levels = *self.parameters.encoding.levels();
        let parts = Encoding::split(&levels, &mut self.parameters.encoding.table)
            .into_par_iter()
            .zip(Encoding::split(&levels, &mut self.gradient))
            .zip(Encoding::split(&levels, &mut self.table_moments.mean))
            .zip(Encoding::split(&levels, &mut self.table_moments.square));
        // Free threads take one level at a time, because fine levels take longer.
        parts.enumerate().with_max_len(1).for_each(|(l, (((entries, gradient), mean), square))| {
            debug_assert!(l < N_LEVELS);
            for group in groups {
                Encoding::add_gradient(l, &levels[l], &group.u, &group.features, gradient);
            }
            adam.update_visited(entries, gradient, mean, square);
        });
    }
}
