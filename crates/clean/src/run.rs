//! Looks at the splats through all training views, removes what they contradict, and looks again.

use glam::{DVec3, Vec3};
use octobayes::geometry::{Camera, Mask};
use octobayes::monitor::{Monitor, Silent, check};
use octobayes::{Error, Result};
use octobayes_splats::{Splats, stride_for};
use rayon::prelude::*;
use serde::Serialize;

use crate::rule::Stage;
use crate::views::{ListedView, Views};
use crate::{Evidence, Reason, Rule, Strength};

/// Most projections of a splat to a view, all together: each takes a third of a microsecond on two cores.
/// [`LEAST_VIEWS`] come first.
const MOST_PROJECTED: usize = 64_000_000;
const LEAST_VIEWS: usize = 48;

/// Why a splat goes, and at which strengths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Removal {
    /// Why.
    pub reason: Reason,
    /// The first strength at which it goes.
    pub strength: Strength,
    /// How far the views contradicted it when it went.
    pub score: f64,
    /// The look by which it went, from 1: the earlier, the surer.
    pub look: usize,
}

/// Splats and what goes of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Cleaned {
    /// `[n]`: what goes, at any strength.
    pub removals: Vec<Option<Removal>>,
    /// What the views showed before anything was removed.
    pub evidence: Evidence,
    /// `[n]`: how far the views contradict a splat, at the last look at it; at most 1.
    pub scores: Vec<f64>,
    /// Number of pixels that were looked at each time, and of all pixels.
    pub pixels: [u64; 2],
    /// How often they were looked at.
    pub looks: usize,
}

impl Cleaned {
    /// `[n]`: why a splat goes at a strength, if it does.
    #[must_use]
    pub fn removed(&self, strength: Strength) -> Vec<Option<Reason>> {
        let goes = |removal: &Option<Removal>| removal.filter(|removal| removal.strength <= strength);
        self.removals.iter().map(|removal| goes(removal).map(|removal| removal.reason)).collect()
    }

    /// How many splats go at a strength, by [`Reason`].
    #[must_use]
    pub fn counts(&self, strength: Strength) -> [usize; 4] {
        let removed = self.removed(strength);
        Reason::ALL.map(|reason| removed.iter().filter(|found| **found == Some(reason)).count())
    }
}

/// Splats to be cleaned, and the training views by which they are.
#[derive(Clone, Copy)]
pub struct Clean<'a> {
    splats: &'a Splats,
    cameras: &'a [Camera],
    masks: &'a [Option<Mask>],
    pixel_offset: f64,
    pixels: u64,
    rule: Rule,
    monitor: &'a dyn Monitor,
}

impl<'a> Clean<'a> {
    /// Pixels of all views together that are looked at by default.
    pub const PIXELS: u64 = 2_000_000;

    /// Cleans `splats` by the cameras that they were trained on.
    #[must_use]
    pub fn new(splats: &'a Splats, cameras: &'a [Camera]) -> Self {
        let (pixels, rule) = (Self::PIXELS, Rule::default());
        Self { splats, cameras, masks: &[], pixel_offset: 0.5, pixels, rule, monitor: &Silent }
    }

    /// Which pixels of each camera count, `[cameras]`, if not all.
    #[must_use]
    pub fn masks(self, masks: &'a [Option<Mask>]) -> Self {
        Self { masks, ..self }
    }

    /// Where the ray of a pixel lies in it, pixels; in its middle by default.
    #[must_use]
    pub fn pixel_offset(self, pixel_offset: f64) -> Self {
        Self { pixel_offset, ..self }
    }

    /// How many pixels of all views together are looked at, about; two million by default.
    #[must_use]
    pub fn pixels(self, pixels: u64) -> Self {
        Self { pixels, ..self }
    }

    /// With other constants.
    #[doc(hidden)]
    #[must_use]
    pub fn rule(self, rule: Rule) -> Self {
        Self { rule, ..self }
    }

    /// Reports progress, and may be stopped.
    #[must_use]
    pub fn monitor(self, monitor: &'a dyn Monitor) -> Self {
        Self { monitor, ..self }
    }

    /// Finds what goes at each strength.
    ///
    /// # Errors
    /// If there is no camera, if masks are not those of the cameras, if a lens distorts, if nothing would be left at any
    /// strength, or [`Error::Interrupted`].
    pub fn run(&self) -> Result<Cleaned> {
        if self.cameras.is_empty() {
            return Err(Error::setting("cameras", "at least one: what they show is what splats are held against", "0"));
        }
        let n = self.splats.len();
        let most = (MOST_PROJECTED / n).max(LEAST_VIEWS);
        let every = self.cameras.len().div_ceil(most);
        let all: u64 = self.cameras.iter().map(Camera::pixels).sum();
        let stride = stride_for(all / every as u64, self.pixels);
        let (cameras, masks, pixel_offset) = (self.cameras, self.masks, self.pixel_offset);
        let views = Views { cameras, masks, pixel_offset, stride, every };
        let mut listed = Vec::new();
        views.list(self.splats, self.monitor, |view| listed.push(view))?;
        let looked_at = listed.iter().map(ListedView::pixels).sum();
        let evidence = Evidence::of(&listed, self.splats.means(), &vec![true; n]);
        let (removals, scores) = (vec![None; n], vec![0.0; n]);
        let mut cleaned = Cleaned { removals, evidence, scores, pixels: [looked_at, all], looks: 1 };
        let by_look = ByLook { outside: self.outside(&cleaned.evidence), elsewhere: self.in_others(&views) };
        let mut latest = cleaned.evidence.clone();
        for stage in self.rule.stages {
            self.score(&mut cleaned, &latest, stage);
            self.remove_by_look(&mut cleaned, &by_look, stage.strength);
            self.remove_floaters(&mut cleaned, &mut latest, &listed, stage)?;
        }
        if cleaned.removed(Strength::Careful).iter().all(Option::is_some) {
            let expected = "splats of a scene that the cameras show (are they of another scene, or in another frame?)";
            return Err(Error::setting("splats", expected, format!("none of {n} in its place")));
        }
        Ok(cleaned)
    }

    /// `[n]`: whether the image of a camera that was not looked through has the centre.
    fn in_others(&self, views: &Views) -> Vec<bool> {
        let others: Vec<&Camera> = views.others().collect();
        let is_in_one = |x: &Vec3| others.iter().any(|camera| camera.project_inside(x.as_dvec3()).is_some());
        self.splats.means().par_iter().map(is_in_one).collect()
    }

    /// Removes what one look is enough for.
    fn remove_by_look(&self, cleaned: &mut Cleaned, by_look: &ByLook, strength: Strength) {
        let Cleaned { removals, scores, evidence, .. } = cleaned;
        for (i, (removal, &mut score)) in removals.iter_mut().zip(scores).enumerate() {
            let is_faint = f64::from(self.splats.opacity(i)) < self.rule.opacity[strength as usize];
            let reason = match () {
                () if removal.is_some() => continue,
                () if by_look.outside[i] => Reason::Outside,
                () if !by_look.elsewhere[i] && self.rule.is_unseen(evidence, i) => Reason::Unseen,
                () if is_faint => Reason::Transparent,
                () => continue,
            };
            *removal = Some(Removal { reason, strength, score, look: 1 });
        }
    }

    /// `[n]`: whether a splat is far beyond all that the views show.
    fn outside(&self, of: &Evidence) -> Vec<bool> {
        let middle = self.cameras.iter().map(|camera| camera.position).sum::<DVec3>() / self.cameras.len() as f64;
        let away: Vec<f64> = self.splats.means().iter().map(|x| x.as_dvec3().distance(middle)).collect();
        let mut order: Vec<usize> = (0..away.len()).collect();
        order.sort_by(|&a, &b| away[b].total_cmp(&away[a]));
        let most = self.rule.beyond * of.weight.iter().sum::<f64>();
        let mut beyond = 0.0;
        let farthest = order.into_iter().find(|&i| {
            beyond += of.weight[i];
            beyond > most
        });
        let limit = farthest.map_or(f64::INFINITY, |i| self.rule.far * away[i]);
        away.into_iter().map(|away| away > limit).collect()
    }

    /// How far the views contradict the splats that are left.
    fn score(&self, cleaned: &mut Cleaned, latest: &Evidence, stage: Stage) {
        let left = cleaned.scores.iter_mut().zip(&cleaned.removals).enumerate();
        for (i, (score, _)) in left.filter(|(_, (_, removal))| removal.is_none()) {
            *score = self.rule.score(latest, i, stage);
        }
    }

    /// Removes what floats, and looks again.
    fn remove_floaters(
        &self,
        cleaned: &mut Cleaned,
        latest: &mut Evidence,
        listed: &[ListedView],
        stage: Stage,
    ) -> Result<()> {
        let Stage { strength, threshold, .. } = stage;
        for _ in 0..self.rule.rounds {
            check(self.monitor)?;
            let (mut count, look) = (0, cleaned.looks);
            for (removal, &score) in cleaned.removals.iter_mut().zip(&cleaned.scores) {
                if removal.is_none() && score > threshold {
                    *removal = Some(Removal { reason: Reason::Floating, strength, score, look });
                    count += 1;
                }
            }
            if count == 0 {
                break;
            }
            let kept: Vec<bool> = cleaned.removals.iter().map(Option::is_none).collect();
            *latest = Evidence::of(listed, self.splats.means(), &kept);
            cleaned.looks += 1;
            self.score(cleaned, latest, stage);
        }
        Ok(())
    }
}

/// What is known after the first look; both `[n]`.
struct ByLook {
    outside: Vec<bool>,
    /// The image of a camera that was not looked through has the centre.
    elsewhere: Vec<bool>,
}

#[cfg(test)]
mod tests;
