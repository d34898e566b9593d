//! Ways to choose the next images.

use common::pixel_gradient::{PixelGradient, PixelGradients};
use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::field::TrainedField;
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{DataScale, Information, Scale};
use octobayes::rays::{PixelSequence, Pixels};
use octobayes::render::{Renderer, VolumeRenderer};
use octobayes_models::HashGrid;
use octobayes_next_view::{Gain, NextView, Settings, log_det};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use common::fisher::{Diagonal, LAMBDA};

/// Images that are taken between two trainings.
pub const TAKE: usize = 2;
/// Level of the field, and of the cells that coverage counts.
pub const LEVEL: u8 = 5;
const COUNT_LEVEL: u8 = 5;
/// Rays of the field.
pub const RAYS: u64 = 50_000;
/// Cells per axis of the grid that lets rays skip empty space.
pub const OCCUPANCY: usize = 64;
/// Pixels of a candidate, but for FisherRF.
pub const PIXELS: u64 = 2048;
/// Pixels of a candidate and of a training image whose derivatives FisherRF takes.
pub const FISHER_PIXELS: u64 = 256;
/// Every so many pixels of an image are counted, along x and y.
const COUNT_STRIDE: u32 = 6;

#[derive(Clone, Copy, PartialEq, serde::Serialize)]
pub enum Strategy {
    Random,
    Farthest,
    Count,
    Cover,
    Fisher,
    Trace,
    LogDet,
    LogDetTight,
    LogDetUnseen,
}

pub const STRATEGIES: [Strategy; 9] = [
    Strategy::Random,
    Strategy::Farthest,
    Strategy::Count,
    Strategy::Cover,
    Strategy::Fisher,
    Strategy::Trace,
    Strategy::LogDet,
    Strategy::LogDetTight,
    Strategy::LogDetUnseen,
];
/// By how much the prior of one strategy is tighter than the default.
const TIGHTER: f64 = 10.0;

/// A model with the cameras that it was trained on and those that may be next.
pub struct Choice<'a> {
    pub model: &'a HashGrid,
    pub domain: Domain,
    /// PSNR of the training images, dB.
    pub psnr: f64,
    pub taken: &'a [Camera],
    pub candidates: &'a [Camera],
    pub seed: u64,
}

impl Strategy {
    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Farthest => "farthest",
            Self::Count => "coverage count",
            Self::Cover => "directional coverage",
            Self::Fisher => "FisherRF",
            Self::Trace => "trace",
            Self::LogDet => "log det",
            Self::LogDetTight => "log det, τ / 10",
            Self::LogDetUnseen => "log det, never seen",
        }
    }

    /// The numbers of the candidates to take.
    pub fn choose(self, choice: &Choice) -> Result<Vec<usize>> {
        let gain =
            |gain| Settings::default().take(TAKE).gain(gain).pixels(PIXELS).seed(choice.seed).occupancy(OCCUPANCY);
        match self {
            Self::Random => {
                let mut order: Vec<usize> = (0..choice.candidates.len()).collect();
                // Another order after each training.
                order.shuffle(&mut ChaCha8Rng::seed_from_u64(choice.seed ^ (choice.taken.len() as u64) << 32));
                Ok(order[..TAKE].to_vec())
            }
            Self::Farthest => Ok(farthest(choice.taken.to_vec(), choice.candidates, TAKE)),
            Self::Count => counted(choice),
            Self::Fisher => Ok(fisher(choice)),
            Self::Cover => {
                let field = choice.field(1.0)?;
                let view = NextView::new(choice.model, &field, choice.candidates).training(choice.taken);
                Ok(view.settings(gain(Gain::Coverage)).run()?.steps.iter().map(|step| step.index).collect())
            }
            Self::Trace | Self::LogDet | Self::LogDetTight | Self::LogDetUnseen => {
                let tighter = if self == Self::LogDetTight { TIGHTER } else { 1.0 };
                let field = choice.field(tighter)?;
                let prior = choice.scale(tighter)?.precision(&[0.0; 6], 1)[0];
                let is_prior = |p: &Information| p[0] + p[3] + p[5] <= 3.0 * prior * (1.0 + 1e-9);
                let unseen = |p: &Information, d: &Information| if is_prior(p) { log_det(p, d) } else { 0.0 };
                let settings = gain(if self == Self::Trace { Gain::Trace } else { Gain::Logdet });
                let view = NextView::new(choice.model, &field, choice.candidates).settings(settings);
                let view = if self == Self::LogDetUnseen { view.vertex_gain(&unseen) } else { view };
                Ok(view.run()?.steps.iter().map(|step| step.index).collect())
            }
        }
    }
}

impl Choice<'_> {
    /// The scale of the data, with a prior so many times tighter than the default.
    fn scale(&self, tighter: f64) -> Result<DataScale> {
        let pixels = self.taken.iter().map(Camera::pixels).sum();
        let deviation = DataScale::default_prior_deviation(&self.domain) / tighter;
        DataScale::new(pixels, DataScale::noise_of(self.psnr), deviation)
    }

    fn field(&self, tighter: f64) -> Result<octobayes::uncertainty::UncertaintyField> {
        let grid = GridSettings::default().level(LEVEL).keep_sums(true).scale(Scale::Data(self.scale(tighter)?));
        // By the model's own derivatives.
        let rays = RaySettings::for_images().rays(RAYS).seed(self.seed).occupancy(OCCUPANCY);
        Ok(Estimation::new(self.model, self.taken).rays(rays).grid(grid).domain(self.domain).run()?.field)
    }
}

/// The candidates that stand farthest from all cameras before them, one after the other.
pub fn farthest(mut taken: Vec<Camera>, candidates: &[Camera], count: usize) -> Vec<usize> {
    let mut chosen = Vec::new();
    while chosen.len() < count.min(candidates.len()) {
        let apart = |i: usize| {
            let apart = taken.iter().map(|camera| camera.position.distance(candidates[i].position));
            apart.fold(f64::INFINITY, f64::min)
        };
        let left = (0..candidates.len()).filter(|i| !chosen.contains(i));
        let best = left.max_by(|a, b| apart(*a).total_cmp(&apart(*b)).then(b.cmp(a))).expect("one is left");
        taken.push(candidates[best]);
        chosen.push(best);
    }
    chosen
}

/// Those that show most of what few images showed: Σ over cells of surface in view of 1 / (1 + images so far).
fn counted(choice: &Choice) -> Result<Vec<usize>> {
    let tracer = RaySettings::for_images().occupancy(OCCUPANCY).tracer(choice.model, 0.0, &Silent)?;
    let renderer = VolumeRenderer { tracer, differentiation: None };
    let lattice = GridSettings::default().level(COUNT_LEVEL).lattice(choice.domain)?;
    let offset = choice.model.pixel_offset();
    let cells = |camera: &Camera| -> Result<FxHashSet<[u32; 3]>> {
        let seen = camera.strided(COUNT_STRIDE, offset);
        let view = renderer.strided_image(camera, COUNT_STRIDE, offset, &[], &Silent)?;
        let width = seen.resolution[0] as usize;
        let cell = |(i, pixel): (usize, &octobayes::render::Pixel)| {
            let ray = seen.ray((i % width) as f64 + offset, (i / width) as f64 + offset);
            let u = lattice.coordinates(ray.at(pixel.median_depth).as_vec3())?;
            (pixel.opacity > 0.5).then(|| lattice.cell(u).0)
        };
        Ok(view.pixels.iter().enumerate().filter_map(cell).collect())
    };
    let mut counts: FxHashMap<[u32; 3], u32> = FxHashMap::default();
    let add = |cells: &FxHashSet<[u32; 3]>, counts: &mut FxHashMap<[u32; 3], u32>| {
        cells.iter().for_each(|cell| *counts.entry(*cell).or_default() += 1);
    };
    for camera in choice.taken {
        add(&cells(camera)?, &mut counts);
    }
    let shown: Vec<FxHashSet<[u32; 3]>> = choice.candidates.iter().map(cells).collect::<Result<_>>()?;
    let mut chosen = Vec::new();
    for _ in 0..TAKE {
        let new = |i: usize| -> f64 {
            // The sum of fractions depends on its order, by rounding.
            let mut worth: Vec<u32> = shown[i].iter().map(|cell| counts.get(cell).copied().unwrap_or(0)).collect();
            worth.sort_unstable();
            worth.iter().map(|n| 1.0 / f64::from(1 + n)).sum()
        };
        let left = (0..shown.len()).filter(|i| !chosen.contains(i));
        let best = left.max_by(|a, b| new(*a).total_cmp(&new(*b)).then(b.cmp(a))).expect("one is left");
        add(&shown[best], &mut counts);
        chosen.push(best);
    }
    Ok(chosen)
}

/// Those of the largest Σ over parameters of H_candidate / (H + λ), with those before them in H.
fn fisher(choice: &Choice) -> Vec<usize> {
    let pixels = PixelGradients::new(choice.model, Vec3::ONE);
    let offset = choice.model.pixel_offset();
    let gradients = |camera: &Camera| -> Vec<PixelGradient> {
        let picks = PixelSequence::new(Pixels::Sobol, choice.seed, vec![camera.resolution]).picks(0, FISHER_PIXELS);
        let of = |pick: &octobayes::rays::PixelSample| {
            let [x, y] = pick.pixel.map(|i| f64::from(i) + offset);
            pixels.of(&camera.ray(x, y), pick.jitter)
        };
        picks.par_iter().map(of).collect()
    };
    let share = |camera: &Camera| camera.pixels() as f64 / FISHER_PIXELS as f64;
    let mut information = Diagonal::new(&pixels);
    for camera in choice.taken {
        gradients(camera).iter().for_each(|pixel| information.add(pixel, share(camera)));
    }
    let shown: Vec<Vec<PixelGradient>> = choice.candidates.iter().map(gradients).collect();
    let mut chosen = Vec::new();
    for _ in 0..TAKE {
        let gain = |i: usize| -> f64 {
            let of_pixel = |pixel: &PixelGradient| -> f64 {
                common::fisher::COLOR.map(|output| information.variance(pixel, output, LAMBDA)).sum()
            };
            share(&choice.candidates[i]) * shown[i].iter().map(of_pixel).sum::<f64>()
        };
        let gains: Vec<f64> = (0..shown.len()).into_par_iter().map(gain).collect();
        let left = (0..shown.len()).filter(|i| !chosen.contains(i));
        let best = left.max_by(|a, b| gains[*a].total_cmp(&gains[*b]).then(b.cmp(a))).expect("one is left");
        shown[best].iter().for_each(|pixel| information.add(pixel, share(&choice.candidates[best])));
        chosen.push(best);
    }
    chosen
}
