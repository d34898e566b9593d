//! The state of a run that trains splats, and one step of it: one training image.

use std::path::Path;
use std::time::{Duration, Instant};

use glam::{DVec3, Vec2, Vec3};
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::SplatSettings;
use super::cloud::{self, LOGIT, MEAN, ROTATION, Row, SCALE, SH, WIDTH, rotation};
use super::growth::{Asked, Crowd, INTERVAL, UNTIL};
use super::loss::loss;
use super::picture::Picture;
use super::start::{SplatOrigin, Start};
use crate::{Background, Quality, Shot, Training};
use octobayes::geometry::{Aabb, Camera};
use octobayes::metrics::psnr;
use octobayes::{Error, Result};
use octobayes_data::ScenePoint;
use octobayes_splats::{MAX_DEGREE, SplatRenderer, Splats};

/// Most pixels of an image: every splat is drawn on all tiles that it touches, which takes memory.
pub(super) const MAX_IMAGE_PIXELS: u64 = 4_000_000;
/// Width and pixels to which larger images are shrunk.
const WIDTH_OF_IMAGES: f64 = 1600.0;
const PIXELS_OF_IMAGES: f64 = 3.9e6;
/// Decays of Adam's moments, and what keeps its steps finite: those of the original code.
const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-15;
/// Part of a run after which the next degree of the spherical harmonics is trained.
const DEGREE: f64 = 0.1;
/// One splat in so many of the most is there at the start.
const MOST_PER_START: usize = 4;
/// What is left of the rates of centres and of deviations at the end.
const FINAL_MEAN: f32 = 0.01;
const FINAL_SCALE: f32 = 0.2;
/// Part of the rate of constant colours that others have.
const DIRECTIONAL: f32 = 0.05;

/// A run in progress.
pub struct SplatTrainer<'a> {
    pub(super) settings: SplatSettings,
    shots: &'a [Shot],
    pub(super) rows: Vec<Row>,
    /// Adam's moments: running means of gradients and of their squares, `[rows]`.
    pub(super) means: Vec<Row>,
    pub(super) squares: Vec<Row>,
    /// `[rows]`.
    pub(super) asked: Vec<Asked>,
    extent: f32,
    origin: SplatOrigin,
    /// Highest degree of the spherical harmonics.
    degree: u8,
    pub(super) steps: u64,
}

impl<'a> SplatTrainer<'a> {
    /// Starts a run in the box of a scene: near the surface of the visual hull if all images have transparent pixels,
    /// else at `points`, if there are a hundred, else anywhere in the part of the box that a camera sees.
    ///
    /// # Errors
    /// If a lens distorts, or if there may not be any splats.
    ///
    /// # Panics
    /// If there are no shots.
    pub fn new(settings: SplatSettings, bounds: Aabb, points: &[ScenePoint], shots: &'a [Shot]) -> Result<Self> {
        assert!(!shots.is_empty(), "no images to train on");
        Self::check_cameras(&shots.iter().map(|shot| shot.camera).collect::<Vec<_>>())?;
        if settings.most == 0 {
            return Err(Error::setting("most splats", "at least one", "0"));
        }
        let first = settings.most.div_ceil(MOST_PER_START);
        Ok(Self::start(settings, Start::new(shots, bounds, points, first, settings.seed), MAX_DEGREE, shots))
    }

    /// Goes on with splats that were trained before, of as high a degree. Rates of centres are in `extent`, scene units.
    ///
    /// # Errors
    /// As [`SplatTrainer::new`].
    ///
    /// # Panics
    /// If there are no shots.
    pub(super) fn from_splats(
        settings: SplatSettings,
        extent: f64,
        splats: &Splats,
        shots: &'a [Shot],
    ) -> Result<Self> {
        assert!(!shots.is_empty(), "no images to train on");
        Self::check_cameras(&shots.iter().map(|shot| shot.camera).collect::<Vec<_>>())?;
        let (rows, extent) = (cloud::rows(splats), extent as f32);
        Ok(Self::start(settings, Start { rows, extent, origin: SplatOrigin::Box }, splats.degree(), shots))
    }

    fn start(settings: SplatSettings, Start { rows, extent, origin }: Start, degree: u8, shots: &'a [Shot]) -> Self {
        let zeros = vec![[0.0; WIDTH]; rows.len()];
        let asked = vec![[0.0; 2]; rows.len()];
        Self { settings, shots, means: zeros.clone(), squares: zeros, asked, rows, extent, origin, degree, steps: 0 }
    }

    /// The size at which images of a camera are trained on unless another is asked for: at most as wide as in the
    /// original code, and a little less than the most pixels.
    #[must_use]
    pub fn size(camera: &Camera) -> [u32; 2] {
        let [w, h] = camera.resolution.map(f64::from);
        let scale = (WIDTH_OF_IMAGES / w).min((PIXELS_OF_IMAGES / (w * h)).sqrt()).min(1.0);
        camera.resolution.map(|side| (f64::from(side) * scale).round().max(1.0) as u32)
    }

    /// Refuses cameras that splats cannot be trained on.
    ///
    /// # Errors
    /// If a lens distorts, or if an image has too many pixels.
    pub fn check_cameras(cameras: &[Camera]) -> Result<()> {
        SplatRenderer::check_cameras(cameras)?;
        let largest = cameras.iter().map(Camera::pixels).max().unwrap_or(0);
        if largest <= MAX_IMAGE_PIXELS {
            return Ok(());
        }
        let expected = format!("images of at most {MAX_IMAGE_PIXELS} pixels for splats; a smaller --resolution");
        Err(Error::setting("images", expected, largest.to_string()))
    }

    /// Number of splats.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "there is always one")]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Where the run began.
    #[must_use]
    pub fn origin(&self) -> SplatOrigin {
        self.origin
    }

    /// The splats in their present state.
    ///
    /// # Errors
    /// If a parameter is not finite.
    pub fn splats(&self) -> Result<Splats> {
        cloud::splats(&self.rows, self.degree)
    }

    /// Takes one step when `share` of the run is done. Returns the mean absolute and the mean squared error of colours,
    /// from before it changed the splats.
    pub fn step(&mut self, share: f64) -> [f64; 2] {
        let shot = self.next_shot();
        let background = self.next_background();
        let picture = Picture::new(&self.rows, &shot.camera, degree(share).min(self.degree));
        let image = picture.image(background);
        let loss = loss(shot, background, &image);
        let gradients = picture.pull_back(&self.rows, &image, &loss.by_pixel);
        self.steps += 1;
        self.note_places(&picture, &gradients, shot.camera.resolution);
        self.descend(&picture, &gradients, share);
        if self.steps.is_multiple_of(INTERVAL) && share < UNTIL {
            let Self { rows, means, squares, asked, .. } = self;
            Crowd { rows, means, squares, asked }.change(self.settings.most, self.settings.seed, self.steps);
        }
        [loss.loss, loss.squared_error]
    }

    /// Every image once in each round, in another order each time.
    fn next_shot(&self) -> &'a Shot {
        let count = self.shots.len() as u64;
        let mut order: Vec<usize> = (0..self.shots.len()).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed ^ 0x07de);
        rng.set_stream(self.steps / count);
        order.shuffle(&mut rng);
        &self.shots[order[(self.steps % count) as usize]]
    }

    fn next_background(&self) -> Vec3 {
        match self.settings.background {
            Background::Fixed(color) => Vec3::from_array(color),
            Background::Random => {
                let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed ^ 0xbac6);
                rng.set_stream(self.steps);
                Vec3::from_array(std::array::from_fn(|_| rng.random()))
            }
        }
    }

    /// Adds the gradients of splats' centres in the image, in half widths and heights of it.
    fn note_places(&mut self, picture: &Picture, gradients: &[(Row, Vec2)], resolution: [u32; 2]) {
        let half = 0.5 * Vec2::new(resolution[0] as f32, resolution[1] as f32);
        for (ellipse, (_, by_mean)) in picture.ellipses.iter().zip(gradients) {
            let asked = &mut self.asked[ellipse.splat as usize];
            asked[0] += (*by_mean * half).length();
            asked[1] += 1.0;
        }
    }

    /// Adam's step for all splats. Those that the image does not show move on, as in the original code.
    fn descend(&mut self, picture: &Picture, gradients: &[(Row, Vec2)], share: f64) {
        let power = |beta: f32| 1.0 - f64::from(beta).powi(self.steps.min(1 << 20) as i32);
        let (first, second) = (power(BETA1) as f32, power(BETA2).sqrt() as f32);
        let rates = rates(&self.settings, self.extent, share).map(|rate| rate / first);
        let mut of_splat = vec![usize::MAX; self.rows.len()];
        picture.ellipses.iter().enumerate().for_each(|(k, ellipse)| of_splat[ellipse.splat as usize] = k);
        let rows = self.rows.par_iter_mut().zip(&mut self.means).zip(&mut self.squares).zip(&of_splat);
        rows.with_min_len(256).for_each(|(((row, mean), square), &k)| {
            let none = [0.0; WIDTH];
            let gradient = gradients.get(k).map_or(&none, |(gradient, _)| gradient);
            for c in 0..WIDTH {
                mean[c] = BETA1 * mean[c] + (1.0 - BETA1) * gradient[c];
                square[c] = BETA2 * square[c] + (1.0 - BETA2) * gradient[c] * gradient[c];
                row[c] -= rates[c] * mean[c] / (square[c].sqrt() / second + EPSILON);
            }
            let unit = rotation(row).normalize();
            row[ROTATION..LOGIT].copy_from_slice(&unit.to_array());
        });
    }

    /// The error of a run that has diverged.
    fn diverged(&self, what: &str) -> Error {
        let expected = "rates at which loss and parameters stay finite, such as the default";
        let found = format!("{:?}, with which {what} at step {}", self.settings.rates, self.steps);
        Error::setting("rates", expected, found)
    }
}

/// Degree of the spherical harmonics that are trained when `share` of the run is done.
fn degree(share: f64) -> u8 {
    ((share / DEGREE) as u8).min(MAX_DEGREE)
}

/// Adam's rate of each number of a row.
fn rates(settings: &SplatSettings, extent: f32, share: f64) -> Row {
    let share = share.clamp(0.0, 1.0) as f32;
    let of = settings.rates;
    let mut rates = [0.0; WIDTH];
    rates[MEAN..SCALE].fill(extent * of.mean * FINAL_MEAN.powf(share));
    rates[SCALE..ROTATION].fill(of.scale * FINAL_SCALE.powf(share));
    rates[ROTATION..LOGIT].fill(of.rotation);
    rates[LOGIT] = of.opacity;
    rates[SH..SH + 3].fill(of.color);
    rates[SH + 3..].fill(of.color * DIRECTIONAL);
    rates
}

impl Training for SplatTrainer<'_> {
    fn steps(&self) -> u64 {
        self.steps
    }

    fn advance(&mut self, share: f64) -> Result<[f64; 2]> {
        let [loss, squared_error] = self.step(share);
        if loss.is_finite() { Ok([loss, squared_error]) } else { Err(self.diverged(&format!("the loss is {loss}"))) }
    }

    fn check(&self) -> Result<()> {
        let is_finite = self.rows.iter().flatten().all(|v| v.is_finite());
        if is_finite { Ok(()) } else { Err(self.diverged("parameters are not finite")) }
    }

    fn save(&self, path: &Path, key: &str, elapsed: f64) -> Result<()> {
        self.save_state(path, key, elapsed)
    }

    /// Whole images are compared, spread over the list: as many as have so many pixels.
    fn look(&self, shots: &[Shot], pixels: usize, within: Option<Duration>) -> Option<Quality> {
        let all: u64 = shots.iter().map(|shot| shot.camera.pixels()).sum();
        let count = (shots.len() as f64 * pixels as f64 / all.max(1) as f64).ceil().min(shots.len() as f64) as usize;
        let (start, background) = (Instant::now(), self.settings.background.for_images());
        let mut quality = Quality { psnr: 0.0, views: 0, pixels: 0 };
        for k in 0..count {
            let shot = &shots[(2 * k + 1) * shots.len() / (2 * count)];
            if within.is_some_and(|within| k > 0 && start.elapsed() > within) {
                break;
            }
            let image = Picture::new(&self.rows, &shot.camera, MAX_DEGREE).image(background);
            let kept = (0..image.len()).filter(|&i| shot.keeps(i));
            let (truth, found): (Vec<DVec3>, Vec<DVec3>) =
                kept.map(|i| (shot.image.over(i, background.as_dvec3()), image[i].as_dvec3())).unzip();
            // An image that is masked altogether has no quality.
            if !truth.is_empty() {
                quality.psnr += psnr(&found, &truth);
                quality.views += 1;
                quality.pixels += truth.len();
            }
        }
        quality.psnr /= quality.views as f64;
        (quality.views > 0).then_some(quality)
    }
}
