//! What has been seen so far, and what another view would add to it.

use std::collections::BTreeSet;

use rustc_hash::FxHashMap;

use super::coverage::Coverage;
use super::evidence::Evidence;
use super::{Gain, VertexGain, first_order, log_det};
use octobayes::posterior::{Information, RayCoverage};
use octobayes::uncertainty::{Added, Precision};

/// The state of a greedy selection.
pub struct Objective<'a> {
    gain: Gain,
    /// What more precision at a vertex is worth.
    of_vertex: VertexGain<'a>,
    precision: Option<&'a Precision<'a>>,
    ray_coverage: Option<&'a RayCoverage>,
    /// What the views taken so far added to P, by Morton code.
    taken: FxHashMap<u64, Information>,
    coverage: Coverage,
    /// Cells of ray coverage that these views saw.
    seen: BTreeSet<usize>,
}

impl<'a> Objective<'a> {
    /// Before any view; `precision` is needed but for [`Gain::Coverage`].
    pub fn new(gain: Gain, precision: Option<&'a Precision<'a>>, ray_coverage: Option<&'a RayCoverage>) -> Self {
        let of_vertex: VertexGain = if gain == Gain::Trace { &first_order } else { &log_det };
        let coverage = Coverage::default();
        Self { gain, of_vertex, precision, ray_coverage, taken: FxHashMap::default(), coverage, seen: BTreeSet::new() }
    }

    /// The same with another gain of a vertex, if there is one.
    pub fn with(self, of_vertex: Option<VertexGain<'a>>) -> Self {
        Self { of_vertex: of_vertex.unwrap_or(self.of_vertex), ..self }
    }

    /// P of a vertex with the views taken so far.
    fn now(&self, precision: &Precision, added: &Added) -> Information {
        let mut p = precision.before(added);
        if let Some(taken) = self.taken.get(&added.code) {
            p.iter_mut().zip(taken).for_each(|(p, taken)| *p += taken);
        }
        p
    }

    /// The gain of what rays add, vertex by vertex.
    pub fn worth(&self, added: &[Added]) -> f64 {
        let Some(precision) = self.precision else { return 0.0 };
        let worth = |added: &Added| (self.of_vertex)(&self.now(precision, added), &added.precision);
        // The sum of no numbers is -0.0.
        0.0 + added.iter().map(worth).sum::<f64>()
    }

    /// The gain of a view.
    pub fn gain(&self, evidence: &Evidence) -> f64 {
        match self.gain {
            Gain::Logdet | Gain::Trace => self.worth(&evidence.added),
            Gain::Coverage => self.coverage.gain(&evidence.facets),
        }
    }

    /// Share of the view's surface that was never seen.
    pub fn unseen_share(&self, evidence: &Evidence) -> Option<f64> {
        let ray_coverage = self.ray_coverage?;
        evidence.unseen_share(|cell| ray_coverage.is_reached(cell) || self.seen.contains(&cell))
    }

    /// Takes a view.
    pub fn add(&mut self, evidence: &Evidence) {
        for added in &evidence.added {
            let taken = self.taken.entry(added.code).or_default();
            taken.iter_mut().zip(added.precision).for_each(|(taken, p)| *taken += p);
        }
        self.coverage.add(&evidence.facets);
        self.seen.extend(evidence.ends.iter().map(|(cell, _)| *cell));
    }
}
