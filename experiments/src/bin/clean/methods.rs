//! What `clean` is compared with, and what each does to a model.

use glam::DVec3;
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::posterior::Covariance;
use octobayes::rays::Pixels;
use octobayes_clean::{Clean, Cleaned, Reason, Removal, Rule, Strength};
use octobayes_splats::Splats;
use serde::{Deserialize, Serialize};

use common::clock::Clock;
use common::isolation::isolation;
use common::surface::Place;

use crate::judge::{Figures, Images, Truth, air_at};

/// Share of floaters among those that a score marks, at which recalls are compared.
pub const PRECISION: f64 = 0.95;
/// Level of the field of U.
const LEVEL: u8 = 6;
/// The rule of a program that cleans by attributes: splats below this opacity whose largest deviation exceeds this part
/// of the cameras' diagonal, and those outside the cameras' box, a quarter longer.
const FAINT: f32 = 0.05;
const LARGE: f64 = 0.02;
const BEYOND: f64 = 0.25;

/// Scores of splats, in their order.
pub const SCORES: [&str; 6] =
    ["1 - opacity", "log volume", "distance of 8 neighbours", "U, block, level 6", "front share, first look", "clean"];
/// Removals, in their order.
pub const REMOVALS: [&str; 5] = ["nothing", "by opacity and size", "careful", "normal", "strong"];

/// Splats beside what is known of their scene.
pub struct Judged {
    pub splats: Splats,
    /// Those of their training.
    pub cameras: Vec<Camera>,
    /// Where each splat is.
    pub places: Vec<Place>,
    pub truth: Truth,
}

/// What is found of one model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Row {
    pub splats: usize,
    /// Share of the judged splats that is in the air.
    pub in_air: f64,
    /// `[SCORES]`: recall at [`PRECISION`].
    pub found: Vec<f64>,
    /// `[REMOVALS]`.
    pub removals: Vec<(Figures, Images)>,
    /// Of `clean` alone: floaters of reason `floating`, `[Strength]`.
    pub floating: Vec<Figures>,
    /// Time of `clean`.
    pub seconds: f64,
}

/// Cleans a model.
pub fn clean(judged: &Judged, rule: Rule) -> Result<Cleaned> {
    Clean::new(&judged.cameras).rule(rule).splats(&judged.splats)
}

/// What goes as floating.
pub fn floating(cleaned: &Cleaned, strength: Strength) -> Vec<bool> {
    cleaned.removed(strength).into_iter().map(|reason| reason == Some(Reason::Floating)).collect()
}

/// One number for each splat: those that go earlier have a larger one.
pub fn order(cleaned: &Cleaned) -> Vec<f64> {
    let of = |(removal, score): (&Option<Removal>, &f64)| match removal {
        Some(removal) if removal.reason == Reason::Floating => 10.0 * (100 - removal.look) as f64 + removal.score,
        _ => *score,
    };
    cleaned.removals.iter().zip(&cleaned.scores).map(of).collect()
}

fn by_opacity_and_size(judged: &Judged) -> Vec<bool> {
    let eyes = || judged.cameras.iter().map(|camera| camera.position);
    let (low, high) = (eyes().fold(DVec3::INFINITY, DVec3::min), eyes().fold(DVec3::NEG_INFINITY, DVec3::max));
    let (diagonal, margin) = ((high - low).length(), BEYOND * (high - low));
    let goes = |i: usize| {
        let (x, splats) = (judged.splats.mean(i).as_dvec3(), &judged.splats);
        let is_faint = splats.opacity(i) < FAINT && f64::from(splats.scale(i).max_element()) > LARGE * diagonal;
        is_faint || x.cmplt(low - margin).any() || x.cmpgt(high + margin).any()
    };
    (0..judged.splats.len()).map(goes).collect()
}

fn uncertainty(judged: &Judged) -> Result<Vec<f64>> {
    let (domain, _) = judged.splats.covered(&judged.cameras, glam::Vec3::ONE, &Silent)?;
    let grid = GridSettings::default().level(LEVEL).covariance(Covariance::Block);
    let run = Estimation::new(&judged.splats, &judged.cameras).domain(domain).grid(grid);
    let field = run.rays(RaySettings::default().pixels(Pixels::Every)).run()?.field;
    Ok(field.answers(judged.splats.means()).iter().map(|at| at.estimate.uncertainty).collect())
}

/// Measures all methods on a model.
pub fn measure(judged: &Judged) -> Result<Row> {
    let splats = &judged.splats;
    let each = |value: &dyn Fn(usize) -> f64| (0..splats.len()).map(value).collect::<Vec<_>>();
    let clock = Clock::start();
    let cleaned = clean(judged, Rule::default())?;
    let seconds = clock.elapsed().wall;
    let scores = [
        each(&|i| 1.0 - f64::from(splats.opacity(i))),
        each(&|i| f64::from(splats.log_scales()[i].element_sum())),
        isolation(splats),
        uncertainty(judged)?,
        each(&|i| cleaned.evidence.front_share(i)),
        order(&cleaned),
    ];
    let is_air = |place: &&Place| **place == Place::Air;
    let counted = judged.places.iter().filter(|place| **place != Place::Elsewhere).count();
    let mut removed = vec![vec![false; splats.len()], by_opacity_and_size(judged)];
    removed.extend(Strength::ALL.map(|strength| cleaned.removed(strength).iter().map(Option::is_some).collect()));
    let removal = |removed: &Vec<bool>| {
        let kept: Vec<bool> = removed.iter().map(|gone| !gone).collect();
        Ok((Figures::new(removed, &judged.places), Images::of(&splats.clone().keep(&kept)?, &judged.truth)?))
    };
    Ok(Row {
        splats: splats.len(),
        in_air: judged.places.iter().filter(is_air).count() as f64 / counted as f64,
        found: scores.iter().map(|score| air_at(PRECISION, score, &judged.places)).collect(),
        removals: removed.iter().map(removal).collect::<Result<_>>()?,
        floating: Strength::ALL.map(|s| Figures::new(&floating(&cleaned, s), &judged.places)).to_vec(),
        seconds,
    })
}
