//! A ranking with the names of its cameras, as files and Python have it.

use super::{Blank, Gain, Ranking, Settings, Step};

/// A ranking and what it depends on.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Report {
    /// What a view is worth.
    pub gain: Gain,
    /// Most pixels of a candidate that were traced.
    pub pixels: u64,
    /// Seed of the pixels.
    pub seed: u64,
    /// Mean number of a candidate's rays that meet a vertex that they meet at all; `None` for coverage.
    pub rays_per_vertex: Option<f64>,
    /// False if the work was interrupted after the listed steps.
    pub complete: bool,
    /// The views in the order in which to take them.
    pub steps: Vec<NamedStep>,
    /// All candidates.
    pub candidates: Vec<NamedCandidate>,
}

/// A view that was taken.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct NamedStep {
    /// The step.
    #[serde(flatten)]
    pub step: Step,
    /// Name of its camera.
    pub name: String,
}

/// A candidate before any view was taken.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct NamedCandidate {
    /// Its number, from 0.
    pub index: usize,
    /// Its name.
    pub name: String,
    /// The information that its image would add, nats.
    pub gain: f64,
    /// Why that is nothing.
    pub why_nothing: Option<Blank>,
}

impl Report {
    /// The report of a ranking by `settings` of candidates with these names, `[candidates]`.
    ///
    /// # Panics
    /// If there are fewer names than candidates.
    #[must_use]
    pub fn new(settings: &Settings, ranking: &Ranking, names: &[String]) -> Self {
        let step = |step: &Step| NamedStep { step: *step, name: names[step.index].clone() };
        let candidate = |(index, name): (usize, &String)| NamedCandidate {
            index,
            name: name.clone(),
            gain: ranking.gains[index],
            why_nothing: ranking.blanks[index],
        };
        Self {
            gain: settings.gain,
            pixels: settings.pixels,
            seed: settings.seed,
            rays_per_vertex: ranking.rays_per_vertex,
            complete: ranking.complete,
            steps: ranking.steps.iter().map(step).collect(),
            candidates: names.iter().enumerate().map(candidate).collect(),
        }
    }
}
